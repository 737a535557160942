"""Which sampled parameters decide what: an interval for each, of a few results."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import xarray as xr

from demflow.sweep.analysis.cases import axes, display
from demflow.sweep.analysis.sensitivity import OBSERVED, sensitivity
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import BLUE, VERMILION, legend_text, name_ticks, new_figure, save

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
    figure = new_figure(2.0 + 2.4 * len(panels), 1.4 + 0.4 * len(names))
    rows = np.arange(len(names))
    unknown = 0
    for panel, (title, found) in zip(
        figure.subplots(1, len(panels), sharey=True, squeeze=False)[0], panels, strict=True
    ):
        unknown = max(unknown, int(found["unknown"]))
        units = str(found[SHOWN[method][0][0]].attrs["units"])
        every = [found[f"{name}_high"].values for name, _, _ in SHOWN[method]]
        factor, unit = display(units, np.concatenate(every)) if units != "1" else (1.0, "")
        for place, (name, words, colour) in zip((-0.12, 0.12), SHOWN[method], strict=True):
            low, high = (factor * found[f"{name}_{end}"].values for end in ("low", "high"))
            panel.hlines(rows + place, low, high, color=colour, linewidth=3, alpha=0.45)
            panel.plot(factor * found[name], rows + place, "o", color=colour, markersize=4,
                       label=legend_text(words))  # fmt: skip
        panel.set(title=title, xlabel=unit or "part of the variance")
        name_ticks(panel.yaxis, rows, names)
    figure.axes[0].invert_yaxis()
    figure.axes[0].legend()
    what = "Sobol' indices" if method == "saltelli" else "Effects of whole ranges"
    told = f"; {unknown} cases without a good result are bounded by the others" if unknown else ""
    return save(figure, path, f"{what} of the sampled parameters, with 95 % intervals{told}")


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
