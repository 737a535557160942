"""A small table of results: shown in the report, written beside its figure as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple


class Table(NamedTuple):
    """Rows of numbers and words under named columns; units stand in the column names."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[float | int | str, ...], ...]

    def write_csv(self, path: Path) -> Path:
        """Write the table as RFC 4180 text, numbers in full precision. Returns the path."""
        text = io.StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(self.columns)
        writer.writerows(self.rows)
        path.write_bytes(text.getvalue().encode())
        return path


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> Table:
    """A `Table` with plain Python values (NumPy numbers become Python's).

    Parameters
    ----------
    title : what it shows
    columns : heads of the columns
    rows : one sequence of cells a row
    """
    plain = tuple(tuple(v.item() if hasattr(v, "item") else v for v in row) for row in rows)
    return Table(title, tuple(columns), plain)
