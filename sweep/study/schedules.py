"""Changes in time, written as a list in the study or as a table in a file that it names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from demflow.sweep.study.sections import Parameter, Reading
from demflow.sweep.study.tables import (
    LARGEST_TABLE,
    PRESSURE_NAMES,
    RATE_NAMES,
    READERS,
    TIME_NAMES,
    Table,
    TableError,
    column,
    numbers,
    read_table,
    times,
    told_lines,
    with_time_of_day,
)
from demflow.sweep.study.yaml_source import Node, Place, Scalar, Sequence

MOST_CHANGES = 10_000  # of a table


@dataclass(frozen=True)
class Schedule(Parameter):
    """Pairs of a time and the value from then on, or a file with a column of each.

    Times of the file that are dates count from the first.
    """

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """Pairs in SI."""
        if not isinstance(node, Scalar) or Path(node.text).suffix.lower() not in READERS:
            return super().read(node, path, reading)
        try:
            pairs = self._table(node.text, node.place, reading)
        except TableError as error:
            for what in error.problems:
                reading.report(node.place, f"{path}: {what}", path)
            return self.stand_in()
        return super().read(pairs, path, reading)

    def _table(self, text: str, place: Place, reading: Reading) -> Sequence:
        """The rows of a file as a study writes them, bare numbers in SI. Raises TableError."""
        table, unit = opened(text, reading), self.unit.split(", ")[1]
        likely = {"m3/s": ("inflow", *RATE_NAMES), "Pa": ("stress", "load", *PRESSURE_NAMES)}[unit]
        try:
            named = column(table, None, TIME_NAMES, "time", "name it so")
            one, _ = with_time_of_day(table, named)
            at = times(table, one, None)
            value = numbers(table, column(table, None, likely, likely[1], "name it so"), unit)
        except TableError as error:
            ours = (what.partition("; say date_format")[0] for what in error.problems)
            raise TableError(*(f"{text}: {what}" for what in ours)) from None
        empty = ~(np.isfinite(at.values) & np.isfinite(value))
        if empty.any():
            told = told_lines(table.lines[empty], table.word)
            raise TableError(f"{text}: {told} without time or value")
        if len(value) > MOST_CHANGES:
            raise TableError(f"{text}: {len(value)} changes, where {MOST_CHANGES} may be")
        since = at.values - at.values[0] if at.dates else at.values
        rows = zip(since.tolist(), value.tolist(), strict=True)
        return Sequence(
            place,
            tuple(Sequence(place, tuple(Scalar(place, repr(x)) for x in row)) for row in rows),
        )


def opened(text: str, reading: Reading) -> Table:
    """The table in a file that a study names, or in its kept copy. Raises TableError.

    Parameters
    ----------
    text : its path relative to the study
    reading : learns of the file
    """
    named = Path(text)
    names = [named]
    if named.suffix.lower() in (".unsmry", ".smspec"):
        upper = named.suffix.isupper()
        other = ".smspec" if named.suffix.lower() == ".unsmry" else ".unsmry"
        names.append(named.with_suffix(other.upper() if upper else other))
    files: dict[str, bytes] = {}
    for name in names:
        try:
            files[name.name] = reading.content(str(name), LARGEST_TABLE)
        except ValueError as error:
            raise TableError(f"{name}: {error}") from None
    try:
        return read_table(files)
    except TableError as error:
        raise TableError(*(f"{text}: {what}" for what in error.problems)) from None
