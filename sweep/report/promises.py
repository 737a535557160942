"""What each case was asked for, what came out, and whether that was expected."""

from __future__ import annotations

from collections import Counter

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.sweep.analysis.cases import Index, axes, case_title
from demflow.sweep.report.html import escape, grid
from demflow.sweep.study.expect import ends_as_expected, in_words
from demflow.sweep.study.load import Study

MANY = 60  # cases from which the table is folded, but for those that came out otherwise

_NUMBERS = {  # columns of the table, where the dataset has them
    "time_error": "error in time",
    "mass_balance_error": "mass balance",
    "residual": "residual",
    "range_error": "range",
    "solver_time": "solver (s)",
}


def promises(dataset: xr.Dataset, study: Study) -> str:
    """A table of all cases where the study states how they should end; else nothing.

    What most cases are expected to do is said once, before the table; a long table is folded.
    """
    if not study.promised:
        return ""
    columns = [name for name in _NUMBERS if name in dataset]
    rows: list[tuple[object, ...]] = []
    met = 0
    words = [in_words(study.expectation(k)) for k in np.ndindex(*dataset["status"].shape)]
    usual, times = Counter(words).most_common(1)[0]
    told = escape(f" The usual expectation is: {usual}.") if times > 1 else ""
    for position in np.ndindex(*dataset["status"].shape):
        index: Index = dict(zip(axes(dataset), map(int, position), strict=True))
        case = dataset.isel(index)
        if int(case["status"]) == Status.LEFT_OUT:
            continue
        expected, status = study.expectation(position), Status(int(case["status"]))
        message = str(case["message"].values)
        came_out = "done" if status is Status.DONE else f"{_words(status)}: {message}"
        good = ends_as_expected(expected, status, message)
        met += good
        title = case_title(dataset, index) or "the only case"
        values = [float(case[name]) for name in columns]
        asked = "the usual" if told and in_words(expected) == usual else in_words(expected)
        rows.append((title, asked, came_out, "yes" if good else "NO", *values))
    head = ("case", "expected", "came out", "as expected", *(_NUMBERS[name] for name in columns))
    table = grid(head, rows, digits=2)
    if len(rows) > MANY:
        bad = [row for row in rows if row[3] == "NO"]
        table = f"<details><summary>all cases</summary>{table}</details>"
        table = (grid(head, bad, digits=2) if bad else "") + table
    return (
        "<section><h2>Expected and found</h2>\n"
        f"<p>{met} of {len(rows)} cases came out as the study says that they should.{told}</p>\n"
        f"{table}</section>"
    )


def _words(status: Status) -> str:
    return status.words
