"""Points of an axis from a CSV file: a column for each of its parameters.

The first line that is no comment (`#`) holds the names: the path of a parameter, or its last
part, with the unit of its column behind it if it has one, `permeability [mD]`. A number may carry
a unit of its own. Columns are parted by commas, semicolons or tabs.
"""

from __future__ import annotations

import csv
import re
from typing import Any, NamedTuple

from demflow.sweep.printable import shortened
from demflow.sweep.study.sections import Parameter, Reading
from demflow.sweep.study.units import bare
from demflow.sweep.study.yaml_source import Mapping, Place, Scalar, Sequence

LARGEST_FILE = 50_000_000  # bytes
MOST_TOLD = 8  # faults that are told one by one
_HEAD = re.compile(r"\s*(?P<name>[^\[(]*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*")


class Table(NamedTuple):
    """What a file holds."""

    heads: list[tuple[str, str]]  # name and unit of each column
    rows: list[tuple[int, list[str]]]  # with the number of each line


def read_points(
    name: str,
    node: Mapping,
    paths: tuple[str, ...],
    parameters: list[Parameter],
    reading: Reading,
) -> list[tuple[tuple[Any, ...], Place]] | None:
    """The points of an axis in the file that it names, None after reporting why there are none.

    Parameters
    ----------
    reading : takes the problems that are met
    name, node : the axis and what it says: `file`, and `columns` where these have other names.
    paths, parameters : what its columns are.
    """
    given = node.entries["file"]
    try:
        table = _table(given, reading)
        columns = _columns(node, paths, table)
    except (ValueError, OSError) as error:
        what = error.strerror if isinstance(error, OSError) else str(error)
        shown = shortened(given.text, 60) if isinstance(given, Scalar) else "file"
        reading.report(given.place, f"axis '{name}': {shown}: {what}")
        return None
    points, told = [], 0
    for line, row in table.rows:
        inner = Reading()
        values = []
        for column, path, parameter in zip(columns, paths, parameters, strict=True):
            text = row[column].strip() if column < len(row) else ""
            unit = table.heads[column][1]
            if not text:
                inner.report(given.place, f"{path} is empty")
                continue
            if unit and bare(text):
                text = f"{text} {unit}"
            values.append(parameter.read(Scalar(given.place, text), path, inner))
        for problem in inner.problems[: MOST_TOLD - told]:
            reading.report(given.place, f"axis '{name}': line {line}: {problem.message}")
        told += len(inner.problems)
        points.append((tuple(values), given.place))
    if told > MOST_TOLD:
        reading.report(given.place, f"axis '{name}': and {told - MOST_TOLD} faults more")
    return None if told else points


def _table(given: Any, reading: Reading) -> Table:
    """The cells of a file. Raises ValueError, OSError."""
    if not isinstance(given, Scalar) or given.empty:
        raise ValueError("a file is named by its path relative to the study")
    content = reading.content(given.text, LARGEST_FILE)
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"it is no text in UTF-8 (byte {error.start})") from None
    kept_lines = [(k, t) for k, t in enumerate(lines, 1) if t.strip() and not t.startswith("#")]
    if len(kept_lines) < 2:
        raise ValueError("it holds no points: a line of names, then a line for each point")
    head = kept_lines[0][1]
    delimiter = max(",;\t", key=head.count)
    try:
        cells = list(csv.reader([text for _, text in kept_lines], delimiter=delimiter))
    except csv.Error as error:
        raise ValueError(str(error)) from None
    heads = [_head(text) for text in cells[0]]
    return Table(heads, [(k, row) for (k, _), row in zip(kept_lines[1:], cells[1:], strict=False)])


def _head(text: str) -> tuple[str, str]:
    match = _HEAD.fullmatch(text)
    return (match["name"], match["unit"] or "") if match else (text.strip(), "")


def _columns(node: Mapping, paths: tuple[str, ...], table: Table) -> list[int]:
    """Number of the column of each parameter. Raises ValueError."""
    named = node.entries.get("columns")
    words: list[str] = []
    if named is not None:
        items = named.items if isinstance(named, Sequence) else (named,)
        words = [item.text for item in items if isinstance(item, Scalar)]
        if len(words) != len(paths):
            raise ValueError(f"columns names {len(paths)} columns, one for each parameter")
    heads = [head for head, _ in table.heads]
    shown = shortened(", ".join(heads), 120)
    found = []
    for k, path in enumerate(paths):
        parts = path.split(".")
        wanted = [words[k]] if words else [".".join(parts[n:]) for n in range(len(parts))]
        at = next((heads.index(one) for one in wanted if one in heads), None)
        if at is None and len(heads) == 1 and len(paths) == 1 and not words:
            at = 0
        if at is None:
            hint = "" if words else "; name it so, or say columns: [its name]"
            raise ValueError(f"no column is named '{wanted[0]}' (there are {shown}){hint}")
        found.append(at)
    return found
