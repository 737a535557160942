"""The sections of the report, each a piece of HTML from the dataset."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np
import xarray as xr
from PIL import Image

from demflow.model.outcome import Status
from demflow.model.quantities import CASE
from demflow.sweep.analysis.cases import (
    Index,
    axes,
    axis_title,
    axis_value,
    case_title,
    display,
    plain_number,
)
from demflow.sweep.analysis.permeability import principal_permeability
from demflow.sweep.report.html import escape, grid
from demflow.sweep.store.written import ours
from demflow.sweep.study.load import Study

MOST_FAILURES = 50  # listed one by one
MANY_FAILURES = 12  # more are folded
MOST_VALUES, MOST_LONG_VALUES = 12, 4  # of an axis, listed one by one
LONG_VALUE = 24  # letters, of more than one parameter

# what a reader should see first of how far to trust the numbers: the worst over all cases
_QUALITIES = (
    "mass_balance_error",
    "residual",
    "range_error",
    "estimated_error",
    "time_error",
    "unbalanced_ratio",
    "isolated_domains",
)
_RANGES = (
    "porosity",
    "coordination",
    "floater_fraction",
    "fabric_anisotropy",
    "largest_overlap",
    "grain_count",
    "domain_count",
    "matrix_aperture",
)


def outcome(dataset: xr.Dataset) -> str:
    """How many cases ended how, and every failure with its message."""
    status = np.asarray(dataset["status"].values).astype(int)
    total = int(np.sum(status != Status.LEFT_OUT))
    rows = [
        (kind.words, int(np.sum(status == kind)))
        for kind in Status
        if np.any(status == kind) or kind is Status.DONE
    ]
    text = f"<p>{_count(total, 'case')}, {rows[0][1]} done.</p>"
    failures = np.argwhere((status != Status.DONE) & (status != Status.LEFT_OUT))
    if len(failures) or total < status.size:
        text += grid(("outcome", "cases"), rows)
        listed = []
        for position in failures[:MOST_FAILURES]:
            index: Index = dict(zip(axes(dataset), map(int, position), strict=True))
            at = dataset.isel(index)
            listed.append(
                (
                    case_title(dataset, index) or "the only case",
                    Status(int(at["status"])).words,
                    str(at["message"].values),
                )
            )
        more = len(failures) - len(listed)
        caption = "Cases without a good result" + (f" ({more} more are not listed)" if more else "")
        head = ("case", "outcome", "why, and what to try")
        if len(listed) > MANY_FAILURES:
            table = grid(head, listed)
            text += f"<details><summary>{caption}</summary>{table}</details>"
        else:
            text += grid(head, listed, caption)
    return text


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def axes_table(dataset: xr.Dataset, study: Study) -> str:
    """What was varied: each axis, its parameters and its values."""
    if not study.axes:
        return "<p>Nothing was varied: the study is a single case.</p>"
    rows = []
    for axis in study.axes:
        count = dataset.sizes[axis.name]
        long = len(axis_value(dataset, axis.name, 0)) > LONG_VALUE
        most = MOST_LONG_VALUES if long else MOST_VALUES
        shown = range(count) if count <= most else [*range(most - 1), count - 1]
        values = [axis_value(dataset, axis.name, i) for i in shown]
        if count > most:
            values.insert(-1, "…")
        rows.append((axis_title(axis.name), ", ".join(axis.parameters), count, "; ".join(values)))
    return grid(("axis", "parameters", "values", "which"), rows)


def key_numbers(dataset: xr.Dataset) -> str:
    """Ranges over the cases that are done: results first, then what they rest on."""
    rows = _ranges(dataset)
    text = grid(("quantity", "unit", "least", "median", "greatest"), rows) if rows else ""
    worst = _worst(dataset)
    if worst:
        text += grid(("quality", "meaning", "worst case"), worst)
    if "well_pressure" in dataset:
        below = int(np.count_nonzero(np.nanmin(_by_case(dataset), axis=1, initial=0.0) < 0.0))
        if below:
            text += (
                f"<p>In {_count(below, 'case')} the pressure of a well falls below zero: no liquid "
                "bears that. The rate is more than the rock yields at this initial pressure.</p>"
            )
    if "compute_time" in dataset:
        seconds = float(dataset["compute_time"].sum())
        text += (
            f"<p>The stage runs behind these cases worked for {plain_number(seconds)} s, each "
            "counted once. Compiling, starting workers and storing come on top.</p>"
        )
    return text or "<p>No case has a result yet.</p>"


def _ranges(dataset: xr.Dataset) -> list[tuple[object, ...]]:
    """Name, unit, least, median and greatest of each quantity."""
    rows: list[tuple[object, ...]] = []
    if "permeability" in dataset:
        principal = principal_permeability(dataset["permeability"])
        for name in ("largest", "smallest", "anisotropy"):
            attributes = principal[name].attrs
            rows += _range(attributes["long_name"], principal[name], attributes["units"])
    if "well_pressure" in dataset:
        pressure = dataset["well_pressure"]
        if "elapsed_time" in pressure.dims:
            pressure = pressure.min("elapsed_time")
        for well in map(str, dataset["well"].values):
            rows += _range(f"{well}: lowest well pressure", pressure.sel(well=well), "Pa")
            if "pressure_change" in dataset:
                change = dataset["pressure_change"].sel(well=well).max("elapsed_time")
                rows += _range(f"{well}: largest pressure change", change, "Pa")
    for name in _RANGES:
        if name in dataset:
            rows += _range(axis_title(name), dataset[name], CASE[name].unit)
    return rows


def _worst(dataset: xr.Dataset) -> list[tuple[object, ...]]:
    """Name, meaning and worst value of each measure of quality that any case has."""
    worst: list[tuple[object, ...]] = []
    for name in _QUALITIES:
        if name in dataset:
            values = np.asarray(dataset[name].values, dtype=float)
            if np.any(np.isfinite(values)):
                worst.append((axis_title(name), CASE[name].long_name, float(np.nanmax(values))))
    return worst


def _by_case(dataset: xr.Dataset) -> np.ndarray:
    """Well pressures of every case, (cases, values)."""
    pressure = dataset["well_pressure"].values
    return pressure.reshape(dataset["status"].size, -1)


def _range(name: str, values: xr.DataArray, unit: str) -> list[tuple[object, ...]]:
    """One row of least, median and greatest, or none where nothing is finite."""
    finite = np.asarray(values.values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return []
    factor, shown = display(unit, finite)
    least, median, greatest = (np.quantile(finite, [0.0, 0.5, 1.0]) * factor).tolist()
    return [(name, shown, least, median, greatest)]


def figures(paths: Sequence[Path], folder: Path) -> str:
    """Every figure with its caption, from where it lies, and the tables that lie beside it."""
    if not paths:
        return "<p>There is nothing to draw.</p>"
    return "\n".join(_figure(path, folder) for path in paths)


def _figure(path: Path, folder: Path) -> str:
    with Image.open(path) as image:
        width, height = image.size
        caption = str(image.info.get("Description", path.stem.replace("_", " ")))
    own = re.compile(rf"{re.escape(path.stem)}_\w+\.csv")
    beside = sorted(table for table in ours(path.parent) if own.fullmatch(table.name))
    tables = "".join(map(_csv_table, beside))
    source = quote(path.relative_to(folder).as_posix())
    # on a small screen one touch shows it as large as it is
    return (
        f"<figure><a href='{source}'><img src='{source}' width='{width}' "
        f"height='{height}' alt='{escape(caption)}'></a>"
        f"<figcaption>{escape(caption)}</figcaption></figure>{tables}"
    )


def _csv_table(path: Path) -> str:
    with path.open(newline="", encoding="utf-8") as lines:
        columns, *rows = csv.reader(lines)
    caption = path.stem.replace("_", " ")
    return grid(columns, [[_number(cell) for cell in row] for row in rows], caption)


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def provenance(dataset: xr.Dataset) -> str:
    """Attributes of the dataset that say where it comes from."""
    rows = [
        (name, str(value))
        for name, value in dataset.attrs.items()
        if name not in ("study_text", "title")
    ]
    return grid(("attribute", "value"), rows)
