"""Which sampled parameters decide what: an interval for each, of a few results."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from demflow.sweep.analysis.cases import (
    Index,
    axes,
    axis_title,
    axis_value,
    case_title,
    display,
)
from demflow.sweep.analysis.sensitivity import OBSERVED, sensitivity
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import (
    BLACK,
    BLUE,
    VERMILION,
    legend_text,
    name_ticks,
    narrow,
    new_figure,
    save,
)

RESULTS = ("permeability", "well_pressure", "well_rate", "boundary_flow", "peak_strength")
MOST = 6  # panels
SHOWN = {
    "saltelli": (("first_order", "alone", BLUE), ("total", "with interactions", VERMILION)),
    "morris": (("mu_star", "mean size", BLUE), ("sigma", "deviation", VERMILION)),
}


def draw_sensitivity(dataset: xr.Dataset, path: Path) -> Path | None:
    """Indices of a Saltelli sample or effects of a Morris one, other axes at their first value.

    Results in time are taken at the last time. None where there is no such sample, or nothing
    that varies with it.
    """
    method = str(dataset["sample"].attrs.get("sampling_method", "")) if "sample" in dataset else ""
    if method not in SHOWN:
        return None
    others = {name: 0 for name in axes(dataset) if name != "sample"}
    panels = []
    for title, values in _results(dataset.isel(others)):
        try:
            found = sensitivity(dataset.isel(others), values, limits=OBSERVED)
        except ResultsError:  # no case has it, or some are left out
            continue
        if bool(np.any(np.isfinite(found[f"{SHOWN[method][0][0]}_high"]))):
            panels.append((title, found))
    if not panels:
        return None
    panels = panels[:MOST]
    names = list(panels[0][1]["parameter"].values)
    rows, columns = (len(panels), 1) if narrow() else (1, len(panels))
    high = 0.6 + 0.4 * len(names)
    figure = new_figure(2.0 + 2.4 * columns, 1.1 + high * rows)
    unknown = 0
    for panel, (title, found) in zip(
        figure.subplots(rows, columns, sharey=True, squeeze=False).ravel(), panels, strict=True
    ):
        unknown = max(unknown, int(found["unknown"]))
        plot_sensitivity(found, panel).set_title(title)
    handles, words = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, words, loc="outside lower center", ncols=2)
    what = "Sobol' indices" if method == "saltelli" else "Effects of whole ranges"
    told = f"; {unknown} cases without a good result are bounded by the others" if unknown else ""
    return save(figure, path, f"{what} of the sampled parameters, with 95 % intervals{told}")


def plot_sensitivity(found: xr.Dataset, panel: Axes) -> Axes:
    """Draw Sobol' indices, or Morris' effects, as bars with their intervals; return the axes.

    Parameters
    ----------
    found : what `dataset.demflow.sensitivity` gives
    panel : where to draw; the parameters stand on its y axis, the first on top
    """
    method = "saltelli" if "total" in found else "morris"
    names = [str(name) for name in found["parameter"].values]
    rows = np.arange(len(names))
    units = str(found[SHOWN[method][0][0]].attrs["units"])
    every = [found[f"{name}_high"].values for name, _, _ in SHOWN[method]]
    factor, unit = display(units, np.concatenate(every)) if units != "1" else (1.0, "")
    for place, (name, words, colour) in zip((-0.18, 0.18), SHOWN[method], strict=True):
        value, low, high = (factor * found[f"{name}{end}"].values for end in ("", "_low", "_high"))
        panel.barh(
            rows + place, value, 0.32, color=colour, alpha=0.6, linewidth=0.0,
            label=legend_text(words),
        )  # fmt: skip
        panel.hlines(rows + place, low, high, color=BLACK, linewidth=1.2)
    if units == "1" and method == "saltelli":  # an interval that leaves the panel says nothing
        left, right = panel.get_xlim()
        panel.set_xlim(max(left, -0.5), min(right, 1.5))
    panel.set(xlabel=unit or "part of the variance", ylim=(len(names) - 0.5, -0.5))
    name_ticks(panel.yaxis, rows, [axis_title(name) for name in names])
    return panel


def plot_tornado(dataset: xr.Dataset, values: xr.DataArray, held: Index, panel: Axes) -> Axes:
    """Draw how far each axis of a study moves a number alone, the strongest on top.

    Parameters
    ----------
    dataset : as `open_results` gives it
    values : one number a case, in SI
    held : where each axis stays while another moves; what they all give is the line in the middle
    panel : where to draw

    Raises ResultsError where the case in the middle has no such number, or no axis varies.
    """
    held = {axis: at for axis, at in held.items() if axis in values.dims}
    middle = float(values.isel(held))
    if not np.isfinite(middle):
        told = case_title(dataset, held)
        raise ResultsError(f"the case in the middle ({told}) has no result; choose another")
    along: dict[str, np.ndarray] = {}
    for axis in (a for a in axes(dataset) if dataset.sizes[a] > 1 and a in values.dims):
        others = {name: at for name, at in held.items() if name != axis}
        along[axis] = values.isel(others).values
    if not along:
        raise ResultsError("no axis of the study varies it")
    swings = {axis: float(np.nanmax(one) - np.nanmin(one)) for axis, one in along.items()}
    order = sorted(swings, key=lambda axis: -swings[axis])
    factor, unit = display(str(values.attrs.get("units", "1")), np.concatenate([*along.values()]))
    for row, axis in enumerate(order):
        for extreme, colour, shift in (
            (np.nanargmin, BLUE, (-4, "right")),
            (np.nanargmax, VERMILION, (4, "left")),
        ):
            at = int(extreme(along[axis]))
            way = factor * (float(along[axis][at]) - middle)
            panel.barh(row, way, 0.6, factor * middle, color=colour, alpha=0.7, linewidth=0.0)
            if way:
                panel.annotate(
                    axis_value(dataset, axis, at),
                    (factor * middle + way, row),
                    (shift[0], 0),
                    textcoords="offset points",
                    ha=shift[1],
                    va="center",
                    fontsize="small",
                )
    panel.axvline(factor * middle, color=BLACK, linewidth=0.8)
    panel.margins(x=0.3)
    name = str(values.attrs.get("long_name", axis_title(str(values.name or ""))))
    panel.set(xlabel=f"{name} ({unit})" if unit else name, ylim=(len(order) - 0.5, -0.5))
    name_ticks(panel.yaxis, range(len(order)), [axis_title(axis) for axis in order])
    return panel


def _results(dataset: xr.Dataset) -> Iterator[tuple[str, xr.DataArray]]:
    """Numbers of each sample that vary with it, with their names."""
    for name in RESULTS:
        if name not in dataset:
            continue
        values = dataset[name]
        if "elapsed_time" in values.dims:
            values = values.isel(elapsed_time=-1)
        places = [d for d in values.dims if d != "sample"]
        stacked = values.stack(place=places) if places else values.expand_dims("place", -1)
        for k in range(stacked.sizes["place"]):
            one = stacked.isel(place=k)
            column = one.values[np.isfinite(one.values)]
            if len(column) == 0 or np.ptp(column) <= 1e-9 * np.abs(column).max():
                continue
            of = " ".join(str(one[d].values) for d in places)
            if name == "permeability" and one["row"] != one["column"]:
                continue
            words = f"{name.replace('_', ' ')} {of}".strip()
            yield words, one.drop_vars(["place", *places], errors="ignore").rename(name)
