"""Measured tests: the block `data:`, and what is wrong with a gauge's file, line by line.

Nothing is mended in silence: each line that is sorted, joined or left out is told in `notes`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from demflow.model.parameters import parameter
from demflow.sweep.study.blocks import Block, block_of
from demflow.sweep.study.schedules import opened
from demflow.sweep.study.sections import NoParameter, Parameter, Reading, Section
from demflow.sweep.study.tables import (
    PRESSURE_NAMES,
    RATE_NAMES,
    TIME_NAMES,
    Readings,
    Table,
    TableError,
    column,
    date_of,
    numbers,
    times,
    told_lines,
    with_time_of_day,
)
from demflow.sweep.study.units import UnitError, parse_quantity
from demflow.sweep.study.yaml_source import Mapping, Node, Scalar, Sequence

SPIKE = 8.0  # times the scatter that a lone point lies off its neighbours
GAP = 10.0  # times the steps around it that a step without data is long
MOST_GAPS = 5
RESTING = 8  # points before the first rate from which a drift is told


class MeasuredTest(NamedTuple):
    """A pressure record and the rates behind it, SI, times since the record's zero."""

    name: str
    well: str | None
    time: np.ndarray  # (n,) s, increasing; below zero before the study's clock begins
    pressure: np.ndarray  # (n,) Pa
    lines: np.ndarray  # (n,) where each stands in its file
    rate_changes: tuple[tuple[float, float], ...] | None  # (s, m³/s), in order
    notes: tuple[str, ...]  # what was sorted, joined, left out or looks odd


@dataclass(frozen=True)
class Data:
    """A measured test: a file with times and pressures of a well, and its rates."""

    file: str = parameter(help="CSV, LAS or summary file, its path relative to the study")
    time: str | None = parameter(
        default=None, help="column of times, with its unit where the head has none: t [h]"
    )
    pressure: str | None = parameter(default=None, help="column of pressures: p [psi]")
    well: str | None = parameter(default=None, help="well of the scene that was measured")
    rates: Any = parameter(
        default=None, help="file of rates, or a list of times or dates and the rate from each on"
    )
    rate_time: str | None = parameter(default=None, help="column of times in the file of rates")
    rate: str | None = parameter(
        default=None, help="column of rates, positive for production: q [bbl/d]"
    )
    date_format: str | None = parameter(
        default=None, help="form of dates, as in %d.%m.%Y %H:%M:%S; ISO 8601 needs none"
    )
    zero: str | None = parameter(
        default=None,
        help="date or time at which the study's clock begins; by default, of dates, that of the "
        "first rate, or of the first point where no rates are given",
    )
    outliers: str = parameter(
        default="leave_out", choices=("leave_out", "keep"), help="what becomes of lone spikes"
    )


class Dated(tuple[tuple[float, float], ...]):
    """Rate changes (s since 1970, m³/s) that stand in the study with dates."""


class RateForms(Section):
    """Rates: a file, or pairs of a time or date and the rate from then on."""

    def __init__(self) -> None:
        declared = next(one for one in fields(Data) if one.name == "rates")
        pairs = parameter("s, m3/s", default=(), help=declared.metadata["help"])
        pairs.name = "rates"
        self.word = Parameter(declared, str, True)
        self.pairs = Parameter(pairs, tuple[tuple[float, float], ...], True)

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """The name of a file, or (s, m³/s) pairs."""
        if isinstance(node, Sequence) and any(_date(item) is not None for item in node.items):
            return self._dated(node, path, reading)
        section = self.word if isinstance(node, Scalar) else self.pairs
        return section.read(node, path, reading)

    def _dated(self, node: Sequence, path: str, reading: Reading) -> Dated:
        """Dates in place of the times, all of them."""
        times, plain = [], []
        for item in node.items:
            date = _date(item)
            if date is None or not isinstance(item, Sequence):
                what = "the first has a date, so each is a date, as 2024-05-17 08:30:00, and a rate"
                reading.report(item.place, f"{path}: {what}", path)
                return Dated()
            times.append(date)
            plain.append(Sequence(item.place, (Scalar(item.place, "0"), *item.items[1:])))
        rates = self.pairs.read(Sequence(node.place, tuple(plain)), path, reading)
        if len(rates) < len(times):
            return Dated()  # a rate that cannot be read was told
        return Dated(zip(times, (rate for _, rate in rates), strict=True))

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """Never: what was measured is as it is."""
        raise NoParameter("what was measured is no parameter")


def _date(item: Node) -> float | None:
    """The instant that a pair begins with, s since 1970; None where it is no date."""
    first = item.items[0] if isinstance(item, Sequence) and item.items else None
    return date_of(first.text) if isinstance(first, Scalar) else None


DATA: Block = block_of(Data, {"rates": RateForms()})


def read_data(node: Node | None, reading: Reading) -> dict[str, MeasuredTest]:
    """The block `data:`: each measured test by its name. Problems go to `reading`."""
    if node is None or (isinstance(node, Scalar) and node.empty):
        return {}
    if not isinstance(node, Mapping):
        reading.report(node.place, "data is a mapping of names to measured tests")
        return {}
    tests: dict[str, MeasuredTest] = {}
    for name, value in node.entries.items():
        path = f"data.{name}"
        reading.places[path] = node.keys[name]
        before = len(reading.problems)
        values = DATA.read(value, path, reading)
        if len(reading.problems) > before:
            reading.unreadable.add(path)
            continue
        given = DATA.build(values, path, [])
        try:
            tests[name] = measured(name, given, reading)
        except TableError as error:
            key = getattr(error, "key", "file")
            for what in error.problems:
                reading.report(reading.place(f"{path}.{key}"), f"{path}.{key}: {what}", path)
    return tests


def measured(name: str, given: Data, reading: Reading) -> MeasuredTest:
    """A measured test from its files. Raises TableError; its `key` says of which part.

    Its times are those of the study's clock.

    Parameters
    ----------
    name : of the test
    given : its files and columns
    reading : takes the problems that are met
    """
    table = opened(given.file, reading)
    at, notes = _clock(table, given.time, given.date_format)
    pressure = numbers(table, column(table, given.pressure, PRESSURE_NAMES, "pressure"), "Pa")
    rates, rate_notes = _rates(given, table, at, reading)
    zero = _zero(given, at, rates)
    notes += rate_notes
    changes = None if rates is None else tuple((start - zero, rate) for start, rate in rates)
    record = _cleaned(at.values - zero, pressure, table, given.outliers, changes, notes)
    return MeasuredTest(name, given.well, *record, changes, tuple(notes))


def _zero(given: Data, at: Readings, rates: tuple[tuple[float, float], ...] | None) -> float:
    """What the clock of the files shows where that of the study begins, s."""
    if given.zero is None:
        first = rates[0][0] if rates else float(np.nanmin(at.values))
        return first if at.dates else 0.0
    date = date_of(given.zero)
    if (date is not None) != at.dates:
        like = "a date, as 2024-05-17 08:30:00" if at.dates else "an elapsed time, as 2 h"
        raise _of("zero", f"the times of the file need {like}")
    try:
        return parse_quantity(given.zero, "s", "it") if date is None else date
    except UnitError as error:
        raise _of("zero", str(error)) from None


def _clock(table: Table, wanted: str | None, form: str | None) -> tuple[Readings, list[str]]:
    """The times of a file, and what was noted of them."""
    one, joined = with_time_of_day(table, column(table, wanted, TIME_NAMES, "time"))
    return times(table, one, form), [note for note in (*table.notes, joined) if note]


def _rates(
    given: Data, table: Table, at: Readings, reading: Reading
) -> tuple[tuple[tuple[float, float], ...] | None, list[str]]:
    """Rate changes on the clock of the file they stand in, and what was noted."""
    if given.rates is None and given.rate is None:
        return None, []
    if isinstance(given.rates, tuple):
        if at.dates != isinstance(given.rates, Dated):
            have = "have dates" if at.dates else "have elapsed times"
            like = "[[2024-05-17 08:30:00, 5 m3/d], …]" if at.dates else "[[2 h, 5 m3/d], …]"
            raise _of("rates", f"the pressures {have}, and so must the rates: {like}")
        found = np.array(given.rates, dtype=float).reshape(-1, 2)
        if np.any(np.diff(found[:, 0]) <= 0.0):
            raise _of("rates", "the times must increase")
        return tuple(map(tuple, found.tolist())), []
    try:
        source = table if given.rates is None else opened(given.rates, reading)
        rate = numbers(source, column(source, given.rate, RATE_NAMES, "rate"), "m3/s")
        named = given.rate_time or (given.time if given.rates is None else None)
        clock, seen = _clock(source, named, given.date_format)
    except TableError as error:
        raise _of("rates" if given.rates is not None else "rate", *error.problems) from None
    if clock.dates != at.dates:
        raise _of("rates", "one file has dates and the other elapsed times; give both the same")
    notes = [f"rates: {note}" for note in seen] if source is not table else []
    whole = np.isfinite(rate) & np.isfinite(clock.values)
    lines, rate, start = source.lines[whole], rate[whole], clock.values[whole]
    if not len(start):
        raise _of("rates", "there is no rate in it")
    if not whole.all():
        notes.append(f"rates: {told_lines(source.lines[~whole], source.word)} empty, left out")
    if np.any(np.diff(start) < 0.0):
        order = np.argsort(start, kind="stable")
        moved = lines[order != np.arange(len(order))]
        notes.append(f"rates: sorted by time, {told_lines(moved, source.word)}")
        start, rate, lines = start[order], rate[order], lines[order]
    twice = np.flatnonzero(np.diff(start) == 0.0)
    if len(twice):
        unequal = twice[rate[twice] != rate[twice + 1]]
        if len(unequal):
            where = told_lines(lines[unequal + 1], source.word)
            raise _of("rates", f"{where}: a second rate from the same time; leave one of them")
        start, rate = np.delete(start, twice + 1), np.delete(rate, twice + 1)
    keep = np.flatnonzero(np.diff(rate, prepend=np.nan) != 0.0)  # a rate that goes on is no change
    return tuple(zip(start[keep].tolist(), rate[keep].tolist(), strict=True)), notes


def _of(key: str, *problems: str) -> TableError:
    error = TableError(*problems)
    error.key = key  # type: ignore[attr-defined]
    return error


Record = tuple[np.ndarray, np.ndarray, np.ndarray]


def _cleaned(
    time: np.ndarray,
    pressure: np.ndarray,
    table: Table,
    outliers: str,
    changes: tuple[tuple[float, float], ...] | None,
    notes: list[str],
) -> Record:
    """Times, pressures and lines in order and once each; what was done goes to `notes`."""
    lines, word = table.lines, table.word
    whole = np.isfinite(time) & np.isfinite(pressure)
    if not whole.all():
        notes.append(f"{told_lines(lines[~whole], word)} without time or pressure, left out")
    time, pressure, lines = time[whole], pressure[whole], lines[whole]
    if len(time) < 3:
        raise TableError(f"{len(time)} points with time and pressure; a test needs at least 3")
    if np.any(np.diff(time) < 0.0):
        back = np.flatnonzero(np.diff(time) < 0.0) + 1
        notes.append(f"sorted by time: it goes back at {told_lines(lines[back], word)}")
        order = np.argsort(time, kind="stable")
        time, pressure, lines = time[order], pressure[order], lines[order]
    same = np.flatnonzero(np.diff(time) == 0.0) + 1
    if len(same):
        group = np.cumsum(np.diff(time, prepend=-np.inf) > 0.0) - 1
        count = np.bincount(group)
        mean = np.bincount(group, pressure) / count
        apart = float(np.max(np.abs(pressure - mean[group])))
        how = f"the mean is taken, up to {apart:.3g} Pa off" if apart else "with the same pressure"
        verb = "repeats" if len(same) == 1 else "repeat"
        notes.append(f"{told_lines(lines[same], word)} {verb} the time before; {how}")
        first = np.flatnonzero(np.diff(group, prepend=-1))
        time, pressure, lines = time[first], mean, lines[first]
    lone = _spikes(time, pressure, changes)
    if len(lone):
        text = f"{told_lines(lines[lone], word)} off the neighbours, more than {SPIKE:g} times the"
        left = outliers == "leave_out"
        notes.append(f"{text} scatter: {'left out' if left else 'kept'}")
        if left:
            time, pressure, lines = (np.delete(one, lone) for one in (time, pressure, lines))
    notes += _gaps(time, lines, word)
    notes += _drift(time, pressure, lines, word, changes)
    return time, pressure, lines


def _spikes(
    time: np.ndarray, pressure: np.ndarray, changes: tuple[tuple[float, float], ...] | None
) -> np.ndarray:
    """Points that jump off a course on which the points around them agree.

    Each is held against the line between its neighbours, and that against the two points farther
    out: a step or a bend, which these share, is no spike. Nor is the last point before a change of
    the rate that nobody told, or the first after it: that lies on the line through the two points
    of its own side. Beside a change that is told nothing is judged.
    """
    n = len(time)
    if n < 12:
        return np.empty(0, dtype=int)
    here = np.arange(2, n - 2)

    def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        share = (time[here] - time[a]) / (time[b] - time[a])
        found: np.ndarray = pressure[a] + share * (pressure[b] - pressure[a])
        return found

    near, far = between(here - 1, here + 1), between(here - 2, here + 2)
    off = np.abs(pressure[here] - near)
    bend = np.abs(near - far)
    half = min(15, len(here) // 2)
    padded = np.pad(off, half, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    scatter = 1.4826 * np.median(windows, axis=1)
    floor = 1e-9 * (1.0 + float(np.ptp(pressure)))
    # the neighbours of a spike see it in `far` or in `near`: only the largest of three is one
    peak = np.ones(len(here), dtype=bool)
    peak[1:] &= off[1:] > off[:-1]
    peak[:-1] &= off[:-1] >= off[1:]
    scatter = np.maximum(scatter, floor)
    found = peak & (off > SPIKE * scatter) & (off > 3.0 * bend)
    for a, b in ((here - 2, here - 1), (here + 1, here + 2)):
        share = (time[here] - time[a]) / (time[b] - time[a])
        error = np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
        found &= np.abs(pressure[here] - between(a, b)) > SPIKE * scatter * error
    for start, _ in changes or ():
        beside = np.searchsorted(time, start)
        found &= np.abs(here - beside) > 3
    result: np.ndarray = here[found]
    return result


def _gaps(time: np.ndarray, lines: np.ndarray, word: str) -> list[str]:
    """Times without data that the steps before and after them do not foretell."""
    step = np.diff(time)
    if len(step) < 12:
        return []
    padded = np.pad(step, 5, mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 11)
    before, after = np.median(around[:, :5], axis=1), np.median(around[:, 6:], axis=1)
    wide = np.flatnonzero(step > GAP * np.maximum(before, after))
    notes = [
        f"nothing measured for {step[k]:.4g} s after {word} {lines[k]}" for k in wide[:MOST_GAPS]
    ]
    if len(wide) > MOST_GAPS:
        notes.append(f"and {len(wide) - MOST_GAPS} gaps more")
    return notes


def _drift(
    time: np.ndarray,
    pressure: np.ndarray,
    lines: np.ndarray,
    word: str,
    changes: tuple[tuple[float, float], ...] | None,
) -> list[str]:
    """A slope of the pressure while nothing has flowed yet, where it stands out of its scatter."""
    flows = [start for start, rate in changes or () if rate != 0.0]
    rest = time <= flows[0] if flows else np.zeros(len(time), dtype=bool)
    if rest.sum() < RESTING:
        return []
    t, p = time[rest] - time[rest].mean(), pressure[rest]
    slope = float(t @ p / (t @ t))
    scatter = float(np.sqrt(np.sum((p - p.mean() - slope * t) ** 2) / (len(t) - 2) / (t @ t)))
    if abs(slope) <= 4.0 * scatter:
        return []
    day, off = slope * 86400.0, scatter * 86400.0
    first, last = lines[rest][0], lines[rest][-1]
    return [
        f"before anything flows, {word}s {first} to {last}, the pressure drifts by "
        f"{day:.3g} ± {off:.2g} Pa a day"
    ]
