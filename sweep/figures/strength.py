"""What tests to failure measured, against the varied parameters."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.ticker import MaxNLocator

from demflow.model.scene import MEASURED_BY_A_TEST
from demflow.sweep.analysis.cases import axes, display
from demflow.sweep.figures.permeability import place_axis, positions, tick_names
from demflow.sweep.figures.style import BLUE, narrow, new_figure, save


def draw_strength(dataset: xr.Dataset, path: Path, ensembles: Set[str]) -> Path | None:
    """Each measured quantity against the first axis that is no ensemble, a mark for each case.

    The line is the mean over all other axes. None where nothing was measured.

    Parameters
    ----------
    dataset : as `open_results` gives it
    path : where the figure is written
    ensembles : axes whose order means nothing, as seeds
    """
    shown = [name for name in MEASURED_BY_A_TEST if name in dataset]
    shown = [name for name in shown if np.any(np.isfinite(dataset[name].values))]
    if not shown:
        return None
    along = [a for a in axes(dataset) if a not in ensembles and dataset.sizes[a] > 1]
    columns = min(2, len(shown)) if narrow() else len(shown)
    high = -(-len(shown) // columns)
    figure = new_figure(3.0 * columns, 3.2 * high)
    panels = figure.subplots(high, columns, squeeze=False).ravel()
    for panel in panels[len(shown) :]:
        panel.axis("off")
    for name, panel in zip(shown, panels, strict=False):
        quantity = dataset[name]
        factor, unit = display(quantity.attrs.get("units", "1"), quantity.values)
        if along:
            rows = quantity.transpose(along[0], ...).values.reshape(quantity.sizes[along[0]], -1)
            at = positions(dataset, along[0])
            panel.plot(at, factor * rows, "o", color=BLUE, markersize=3, alpha=0.6)
            panel.plot(at, factor * _means(rows), color=BLUE)
            place_axis(panel, dataset, along[0], tick_names(dataset, along[0]))
        else:
            panel.plot(factor * quantity.values.ravel(), "o", color=BLUE)
            panel.set_xticks([])
        words = name.replace("_", " ").replace("youngs", "Young's").replace("poissons", "Poisson's")
        panel.set_ylabel(f"{words} ({unit})" if unit else words)
        highest = 1.06 * factor * float(np.nanmax(quantity.values))
        if name.endswith("_count"):
            panel.yaxis.set_major_locator(MaxNLocator(integer=True))
            highest = max(highest, 1.0)
        panel.set_ylim(0.0, highest or None)
    return save(figure, path, "What the tests to failure measured; lines are means over the cases")


def _means(rows: np.ndarray) -> np.ndarray:
    """Mean of each row, of its values that are there; NaN where none is."""
    count = np.count_nonzero(np.isfinite(rows), axis=1)
    total = np.nansum(rows, axis=1)
    found: np.ndarray = np.divide(total, count, out=np.full(len(rows), np.nan), where=count > 0)
    return found
