"""Files of measured data → columns: CSV, LAS 2 and the summary of a reservoir simulator.

`.csv`, `.txt`, `.dat`, `.tsv`
    a head of names, with units behind them (`p [psi]`, `p (psi)`) or in the line below; fields
    parted by commas, semicolons (then decimals may take a comma), tabs or spaces; `#` begins a
    remark, and lines of fewer fields may stand above the head.
`.las`
    LAS 2 and 1.2, by `lasio`.
`.unsmry`, `.smspec`
    Eclipse summary, both files side by side, by `resfo`; a vector is named `WBHP:P1` by keyword
    and well.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from demflow.sweep.study.units import UnitError, nearest, parse_quantity

LARGEST_TABLE = 100_000_000  # bytes
TIME_NAMES = ("time", "elapsed", "date", "t", "zeit", "dept")
PRESSURE_NAMES = ("pressure", "pres", "bhp", "wbhp", "p", "pwf", "druck")
RATE_NAMES = ("rate", "wopr", "wwpr", "q", "flow")
MOST_TOLD = 8  # lines of one fault that are told
MOST_ABOVE = 100  # lines of a logger's own that may stand above the head

_HEAD = re.compile(r"\s*(?P<name>[^\[(]*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\s*")
_WORDS = {  # what loggers write for units, in small letters
    **{word: word for word in ("h", "s", "min", "d", "bar", "psi", "m3/d", "m3/h", "bbl/d")},
    **{"kpa": "kPa", "kpaa": "kPa", "psia": "psi", "bara": "bar", "days": "d", "day": "d"},
    **dict.fromkeys(("hrs", "hours", "hour", "hr"), "h"),
    **dict.fromkeys(("mins", "minutes"), "min"),
    **dict.fromkeys(("secs", "seconds", "sec"), "s"),
    **dict.fromkeys(("stb/d", "stb/day", "sm3/d", "sm3/day", "bbls/day"), "surface"),
}
_SURFACE = {"stb": "bbl", "sm3": "m3", "bbls": "bbl"}
_DAYS = (
    "%d.%m.%Y",
    "%d/%m/%Y",
    "%m/%d/%Y",
    "%Y-%m-%d",
    "%Y/%m/%d",
    "%d-%m-%Y",
    "%d-%b-%Y",
    "%d-%b-%y",
    "%d %b %Y",
)
_HOURS = ("%H:%M:%S", "%H:%M", "%H:%M:%S.%f", "%I:%M:%S %p", "%I:%M %p", "")
_OF_DAY = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?(\s*[ap]\.?m\.?)?", re.IGNORECASE)
_DAY = re.compile(r"\d{1,4}([-./ ])\w{1,3}\1\d{2,4}")
_EMPTY = ("", "nan", "na", "n/a", "null", "none", "-", "--", "-999", "-999.25", "-9999")


class TableError(Exception):
    """A file that holds no such data, with everything that is wrong with it."""

    def __init__(self, *problems: str):
        self.problems = list(problems)
        super().__init__("; ".join(problems))


class Column(NamedTuple):
    """One column: text, or numbers where the file is binary."""

    name: str
    unit: str  # as the file has it, "" where it says nothing
    cells: list[str] | np.ndarray


class Table(NamedTuple):
    """The columns of a file, and the line of each of their rows."""

    columns: tuple[Column, ...]
    lines: np.ndarray  # (n,) from 1; rows of a binary file are counted from 1
    word: str = "line"  # what a row is called
    notes: tuple[str, ...] = ()  # what was left out


class Readings(NamedTuple):
    """One column in SI; times may be dates."""

    values: np.ndarray  # (n,) NaN where the file has nothing
    dates: bool = False  # seconds since 1970 then


def read_table(files: Mapping[str, bytes]) -> Table:
    """The columns of a file.

    Parameters
    ----------
    files : content by name, the table first; what belongs to it (a `.smspec`) may follow.

    Raises
    ------
    TableError : what is wrong with it.
    """
    name, content = next(iter(files.items()))
    suffix = Path(name).suffix.lower()
    reader = READERS.get(suffix)
    if reader is None:
        raise TableError(f"'{name}' is none of {', '.join(READERS)}, the tables that can be read")
    if not content.strip():
        raise TableError("the file is empty")
    return reader(files)


def split_head(text: str) -> tuple[str, str]:
    """Name and unit of the head of a column: `p [psi]` is ("p", "psi")."""
    match = _HEAD.fullmatch(text)
    if match is None:
        return text.strip(), ""
    return match["name"].strip(), (match["unit"] or "").strip()


def _text_of(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _csv(files: Mapping[str, bytes]) -> Table:
    text = _text_of(next(iter(files.values())))
    if "\0" in text:
        raise TableError("it holds bytes that are no text")
    numbered = [(k, line) for k, line in enumerate(text.splitlines(), start=1)]
    numbered = [(k, line) for k, line in numbered if line.strip() and line.lstrip()[0] != "#"]
    if len(numbered) < 2:
        raise TableError("there is a head at most and no data in it")
    above, delimiter = _head_of([line for _, line in numbered])
    notes: tuple[str, ...] = ()
    if above:
        told = told_lines([k for k, _ in numbered[:above]])
        notes = (f"{told} above the head, left out",)
        numbered = numbered[above:]
    rows = [_fields(line, delimiter) for _, line in numbered]
    if all(map(_is_number, filter(None, rows[0]))):
        raise TableError(
            f"line {numbered[0][0]} holds numbers; the first line names the columns, as in "
            "`time [h], pressure [psi]`"
        )
    heads = [split_head(cell) for cell in rows[0]]
    begin = 1
    below = rows[1]
    if not any(unit for _, unit in heads) and not any(
        _is_number(cell) or re.match(r"\d", cell) for cell in below if cell
    ):
        heads = [
            (name, below[k].strip("[]() ") if k < len(below) else "")
            for k, (name, _) in enumerate(heads)
        ]
        begin = 2
    body = rows[begin:]
    if delimiter == ";":  # where semicolons part fields, commas may part decimals
        body = [[re.sub(r"^([-+]?\d+),(\d+)", r"\1.\2", cell) for cell in row] for row in body]
    lines = np.array([k for k, _ in numbered[begin:]])
    wide = [int(k) for k, row in zip(lines, body, strict=True) if len(row) > len(heads)]
    if wide:
        raise TableError(f"{told_lines(wide)}: more fields than the head has names")
    cells = [[row[k] if k < len(row) else "" for row in body] for k in range(len(heads))]
    columns = (Column(n, u, c) for (n, u), c in zip(heads, cells, strict=True))
    return Table(tuple(columns), lines, notes=notes)


def _delimiter(line: str) -> str | None:
    outside = re.sub(r"\[[^\]]*\]|\([^)]*\)|\"[^\"]*\"", "", line)  # no comma of a unit counts
    return next((one for one in ("\t", ";", ",") if one in outside), None)


def _fields(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return re.split(r"\s+(?![^\[(]*[\])])", line.strip())
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]
    while len(cells) > 1 and not cells[-1]:  # a delimiter at the end of a line parts nothing
        cells.pop()
    return cells


def _head_of(lines: list[str]) -> tuple[int, str | None]:
    """How many lines stand above the head, and what parts its fields.

    The head is the first line that has as many fields as the last lines of the file, parted by the
    same sign; where none has, the first.
    """
    last = lines[1:][-20:]
    for k, line in enumerate(lines[: min(MOST_ABOVE + 1, len(lines) - 1)]):
        delimiter = _delimiter(line)
        if delimiter != _delimiter(lines[-1]):
            continue
        counts = sorted(len(_fields(one, delimiter)) for one in last)
        if len(_fields(line, delimiter)) >= counts[len(counts) // 2] > 1:
            return k, delimiter
    return 0, _delimiter(lines[0])


def _las(files: Mapping[str, bytes]) -> Table:
    try:
        import lasio
    except ImportError:
        what = "reading LAS needs lasio: pip install 'demflow[data]', or save it as CSV"
        raise TableError(what) from None
    try:
        las = lasio.read(io.StringIO(_text_of(next(iter(files.values())))))
        columns = [
            Column(curve.mnemonic, curve.unit or "", np.asarray(curve.data)) for curve in las.curves
        ]
    except Exception as error:  # whatever lasio meets in a damaged file
        raise TableError(f"it is no LAS file, or a damaged one: {error}") from None
    if not columns or not len(columns[0].cells):
        raise TableError("there are no curves in it")
    as_text = [
        column._replace(cells=[str(c) for c in column.cells])
        if np.asarray(column.cells).dtype.kind not in "fi"
        else column
        for column in columns
    ]
    return Table(tuple(as_text), np.arange(1, len(columns[0].cells) + 1), "row")


def _summary(files: Mapping[str, bytes]) -> Table:
    try:
        import resfo
    except ImportError:
        what = "reading a summary needs resfo: pip install 'demflow[data]', or save it as CSV"
        raise TableError(what) from None
    by_kind = {Path(name).suffix.lower(): content for name, content in files.items()}
    missing = [kind for kind in (".smspec", ".unsmry") if kind not in by_kind]
    if missing:
        raise TableError(f"the file with the ending {missing[0].upper()} is not beside it")
    try:
        heads = dict(_records(resfo.read(io.BytesIO(by_kind[".smspec"]))))
        steps = [
            np.asarray(array, dtype=float)
            for key, array in _records(resfo.read(io.BytesIO(by_kind[".unsmry"])))
            if key == "PARAMS"
        ]
        keys = [_word(one) for one in heads["KEYWORDS"]]
        wells = [_word(one) for one in heads.get("WGNAMES", heads.get("NAMES", keys))]
        units = [_word(one) for one in heads["UNITS"]]
        values = np.array(steps)
        if values.ndim != 2 or values.shape[1] != len(keys):
            raise ValueError(f"{len(keys)} vectors are named, {values.shape[1:]} written")
    except Exception as error:  # whatever resfo meets in a damaged file
        raise TableError(f"it is no summary, or a damaged one: {error}") from None
    columns = [
        Column(f"{key}:{well}" if well and key[:1] in "WG" else key, _simulator(unit), values[:, k])
        for k, (key, well, unit) in enumerate(zip(keys, wells, units, strict=True))
    ]
    return Table(tuple(columns), np.arange(1, len(values) + 1), "step")


def _records(found: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
    return [(key.strip(), array) for key, array in found]


def _word(one: Any) -> str:
    text = one.decode("latin-1") if isinstance(one, bytes) else str(one)
    return "" if text.strip(":+ ") == "" else text.strip()


def _simulator(unit: str) -> str:
    """A unit as a simulator writes it, in the words of a study."""
    known = {"DAYS": "d", "HOURS": "h", "PSIA": "psi", "BARSA": "bar", "ATMA": "atm"}
    return known.get(unit.upper(), unit.lower().replace("hr", "h") if "/" in unit else unit)


READERS: dict[str, Callable[[Mapping[str, bytes]], Table]] = {
    **dict.fromkeys((".csv", ".txt", ".dat", ".tsv"), _csv),
    ".las": _las,
    **dict.fromkeys((".unsmry", ".smspec"), _summary),
}


def told_lines(lines: Any, word: str = "line") -> str:
    """Lines as people say them: `lines 3, 7 and 5 more`."""
    shown = [str(int(k)) for k in lines[:MOST_TOLD]]
    more = len(lines) - len(shown)
    text = ", ".join(shown) + (f" and {more} more" if more > 0 else "")
    return f"{word} {text}" if len(lines) == 1 else f"{word}s {text}"


def column(
    table: Table,
    wanted: str | None,
    likely: tuple[str, ...],
    what: str,
    otherwise: str = "say which",
) -> Column:
    """The column that a study means; with its unit, where either of them says one.

    Parameters
    ----------
    table : of a file
    wanted : as the study has it, `p [psi]` or `p`; None for whichever bears a likely name.
    likely : beginnings of names, in small letters, the likeliest first, whole words before others
        and single letters as whole words only; or of words in names (`oil rate`).
    what : what is looked for, for messages.
    otherwise : what to do where no column, or more than one, bears a likely name.

    Raises
    ------
    TableError : no such column, or several; two units that differ.
    """
    names = [one.name for one in table.columns]
    shown = ", ".join(f"'{name}'" for name in names[:12])
    if wanted is None:
        whole = [re.compile(rf"{re.escape(start)}\b") for start in likely]
        first = [re.compile(re.escape(start)) for start in likely if len(start) > 1]
        later = [re.compile(rf".*\b{re.escape(start)}") for start in likely if len(start) > 3]
        found = next(
            (
                hits
                for form in (*whole, *first, *later)
                if (hits := [one for one in table.columns if form.match(one.name.lower())])
            ),
            [],
        )
        if len(found) != 1:
            few = "no column is" if not found else "several columns could be"
            raise TableError(f"{few} the {what}; {otherwise}: the columns are {shown}")
        return found[0]
    name, unit = split_head(wanted)
    found = [one for one in table.columns if one.name == name]
    found = found or [one for one in table.columns if one.name.lower() == name.lower()]
    if len(found) != 1:
        like = nearest(name, names)
        hint = f"; did you mean '{like}'?" if like and not found else f"; there are {shown}"
        raise TableError(f"{'no' if not found else 'more than one'} column is named '{name}'{hint}")
    there = found[0]
    if unit and there.unit and unit != there.unit:
        raise TableError(
            f"column '{name}' is in {there.unit} by its file and in {unit} by the study; "
            f"write '{name}' alone, or mend the head"
        )
    return there._replace(unit=unit or there.unit)


def factor(unit: str, si: str, name: str) -> float:
    """Factor of a column's unit to SI. Raises TableError.

    Parameters
    ----------
    unit : of the column
    si : unit that is wanted
    name : of the column
    """
    if not unit:
        raise TableError(
            f"column '{name}' has no unit; write it in the head or in the study, for instance "
            f"'{name} [{_EXAMPLES.get(si, si)}]'"
        )
    word = unit.strip()
    word = _WORDS.get(word.lower(), word)
    if word == "surface":
        word = re.sub(r"^\w+", lambda hit: _SURFACE[hit[0].lower()], unit.strip())
    try:
        return parse_quantity(f"1 {word}", si, f"column '{name}'")
    except UnitError as error:
        raise TableError(f"column '{name}': {error}") from None


_EXAMPLES = {"s": "h", "Pa": "psi", "m3/s": "bbl/d"}


def numbers(table: Table, one: Column, si: str) -> np.ndarray:
    """A column in SI, NaN where its file has nothing. Raises TableError with the lines.

    Parameters
    ----------
    table : of a file
    one : the column
    si : unit that is wanted
    """
    scale = factor(one.unit, si, one.name)
    if isinstance(one.cells, np.ndarray):
        return np.asarray(one.cells, dtype=float) * scale
    values = np.full(len(one.cells), np.nan)
    wrong = []
    for k, cell in enumerate(one.cells):
        if cell.strip().lower() in _EMPTY:
            continue
        try:
            values[k] = float(cell)
        except ValueError:
            wrong.append(k)
    if wrong:
        shown = one.cells[wrong[0]][:40]
        comma = "; decimals take a point" if re.fullmatch(r"[-+]?\d+,\d+", shown) else ""
        raise TableError(
            f"{told_lines(table.lines[wrong], table.word)}: '{shown}' in column '{one.name}' is "
            f"no number{comma}"
        )
    return values * scale


def _dated(cells: list[str]) -> str:
    """The forms of dates, as `strptime` has them, that read some cells from all of the column."""
    some = [
        cell for cell in cells[:: max(len(cells) // 500, 1)] if cell.strip().lower() not in _EMPTY
    ]
    read = [f"{day} {hour}".strip() for day in _DAYS for hour in _HOURS]
    fit = [form for form in read if all(_has_form(cell.strip(), form) for cell in some)]
    if not fit:
        return "for instance '%d.%m.%Y %H:%M'"
    return " or ".join(f"'{form}'" for form in fit) + (", as it is meant" if len(fit) > 1 else "")


def _has_form(cell: str, form: str) -> bool:
    try:
        datetime.strptime(cell, form)
    except ValueError:
        return False
    return True


def date_of(text: str) -> float | None:
    """Seconds since 1970 of a date as ISO 8601 writes it, in UTC where it names no zone; or None.

    Parameters
    ----------
    text : what may be a date; a plain number is none.
    """
    if _is_number(text):
        return None
    try:
        return _instant(datetime.fromisoformat(text))
    except ValueError:
        return None


def _instant(date: datetime) -> float:
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _first(one: Column) -> str:
    """The first cell that holds something, "" of numbers."""
    cells = one.cells if isinstance(one.cells, list) else []
    return next((c.strip() for c in cells if c.strip().lower() not in _EMPTY), "")


def with_time_of_day(table: Table, one: Column) -> tuple[Column, str]:
    """A column of days or of times of day joined with that of the other, and a note of it.

    Any other column is given back as it is. Raises TableError where times of day have no days, or
    where the other may be one of several columns.

    Parameters
    ----------
    table : of a file
    one : the column of times
    """
    of_day = _OF_DAY.fullmatch(_first(one)) is not None
    if not of_day and not _DAY.fullmatch(_first(one)):
        return one, ""
    form = _DAY if of_day else _OF_DAY
    others = [column for column in table.columns if form.fullmatch(_first(column))]
    if not others and not of_day:
        return one, ""
    if len(others) != 1:
        has, what = ("times of day", "days") if of_day else ("days", "times of day")
        shown = ", ".join(f"'{column.name}'" for column in others[:8])
        which = f"{shown} have {what}; name another as time" if others else f"no column has {what}"
        raise TableError(f"column '{one.name}' holds {has}, as {_first(one)}, and {which}")
    day, hour = (others[0], one) if of_day else (one, others[0])
    pairs = zip(day.cells, hour.cells, strict=True)
    empty = {*_EMPTY}
    cells = [f"{d} {h}" if not {d.lower(), h.lower()} & empty else "" for d, h in pairs]
    note = f"the days of column '{day.name}' with the times of '{hour.name}'"
    return Column(f"{day.name} {hour.name}", "", cells), note


def times(table: Table, one: Column, form: str | None) -> Readings:
    """A column of times, s: elapsed, or dates by `form` or as ISO 8601 writes them.

    Dates without a zone are taken as they are, those with one as UTC. Raises TableError.

    Parameters
    ----------
    table : of a file
    one : the column
    form : of dates, as `strptime` reads them, or None
    """
    cells = one.cells
    texts = isinstance(cells, list)
    first = next((c for c in cells if c.strip().lower() not in _EMPTY), "") if texts else ""
    if form and texts and not _has_form(first.strip(), form) and date_of(first.strip()) is not None:
        form = None  # one of several files, whose dates can be read in one way only
    if form is None and (not texts or _is_number(str(first))):
        return Readings(numbers(table, one, "s"))
    if not texts:
        raise TableError(f"column '{one.name}' holds numbers and no dates; leave date_format out")
    values = np.full(len(cells), np.nan)
    wrong = []
    for k, cell in enumerate(cells):
        if cell.strip().lower() in _EMPTY:
            continue
        try:
            date = datetime.strptime(cell, form) if form else datetime.fromisoformat(cell)
        except ValueError:
            wrong.append(k)
            continue
        values[k] = _instant(date)
    if wrong:
        shown = cells[wrong[0]][:40]
        how = f"not of the form '{form}'" if form else "neither a number nor a date as in "
        how += "" if form else f"2024-05-17T08:30:00; say date_format, {_dated(list(cells))}"
        raise TableError(f"{told_lines(table.lines[wrong], table.word)}: '{shown}' is {how}")
    return Readings(values, dates=True)
