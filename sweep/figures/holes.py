"""Around holes: what the contacts carry, and what flows in."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from demflow.model.region import bounding_box
from demflow.model.scene import Scene
from demflow.sweep.analysis.cases import axes, axis_title, case_title, display
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.maps import rims
from demflow.sweep.figures.rates import MOST_CURVES, draw_rates, in_powers
from demflow.sweep.figures.style import (
    BLACK,
    BLUE,
    LINE_STYLES,
    VERMILION,
    heading,
    is_log_spaced,
    new_figure,
    plain_log_ticks,
    save,
)

WIDEST = 0.6  # of a mean radius, the width of a force at the 99th percentile


def plot_forces(maps: xr.Dataset, panel: Axes, widest: float = 2.5) -> Axes:
    """Draw normal forces at contacts as lines between the grains' centres; return the axes.

    The width of a line is its force, up to the 99th percentile; tension is red.

    Parameters
    ----------
    maps : of one case that observes `grain_map`, as `open_case` gives them
    panel : where to draw
    widest : points

    Raises ResultsError where no forces were mapped.
    """
    if "normal_force" not in maps:
        raise ResultsError("the maps hold no forces: observe grain_map")
    centres = np.stack([maps["grain_x"].values, maps["grain_y"].values], axis=1)
    ends = np.stack([maps["grain_a"].values, maps["grain_b"].values], axis=1)
    force = maps["normal_force"].values
    most = max(float(np.percentile(np.abs(force), 99.0)), 1e-300)
    for pulls, colour in ((False, BLACK), (True, VERMILION)):
        drawn = (force < 0.0) == pulls
        lines = LineCollection(
            centres[ends[drawn]],
            colors=colour,
            linewidths=widest * np.minimum(np.abs(force[drawn]) / most, 1.5),
            capstyle="round",
        )
        panel.add_collection(lines)
    panel.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    panel.autoscale_view()
    panel.grid(False)
    return panel


def draw_forces(maps: xr.Dataset, scene: Scene, title: str, path: Path) -> Path:
    """Normal forces at the contacts of a rock with holes, as lines between the grains' centres.

    Parameters
    ----------
    maps : maps of one case, with its grains and contacts.
    scene : its scene, for the region.
    title : what tells this case from others.
    path : PNG to write.
    """
    most = max(float(np.percentile(np.abs(maps["normal_force"].values), 99.0)), 1e-300)
    xmin, xmax, ymin, ymax = bounding_box(scene.region)
    aspect = (ymax - ymin) / (xmax - xmin)
    wide = 6.2
    figure = new_figure(wide, wide * min(aspect, 1.6) + 0.8)
    widest = WIDEST * float(maps["radius"].mean()) * 72.0 * wide / (xmax - xmin)
    panel = figure.subplots()
    outline, *_ = [panel.add_patch(rim) for rim in rims(scene)]
    plot_forces(maps, panel, widest)
    for lines in panel.collections:
        lines.set_clip_path(outline)
    panel.set(xlim=(xmin, xmax), ylim=(ymin, ymax), aspect="equal", xlabel="x (m)", ylabel="y (m)")
    panel.grid(False)
    heading(figure, title, fontsize=10.5)
    factor, unit = display("N m-1", most)
    caption = (
        f"Contact forces around the excavation, {title.replace(chr(10), ', ')}: the width of a "
        f"line is its normal force, up to {most * factor:.3g} {unit}; tension is red."
    )
    return save(figure, path, caption)


def draw_inflow(
    dataset: xr.Dataset, holes: Collection[str], path: Path, ensembles: Collection[str]
) -> Path | None:
    """Inflow into holes against the axis that changes it most, a curve for the others; or in time.

    Parameters
    ----------
    dataset : of a study. Where its `boundary_flow` has times, the inflow is drawn against these.
    holes : names of their sides.
    path : where the figure is written.
    ensembles : axes whose order means nothing: their mean is drawn, its spread as a bar or a band.

    None where there is no such flow, or neither a time nor an axis that is a number.
    """
    if "boundary_flow" not in dataset:
        return None
    known = [name for name in dataset["boundary"].values.tolist() if name in holes]
    if "elapsed_time" in dataset["boundary_flow"].dims:
        flow = -dataset["boundary_flow"].sel(boundary=known)
        return draw_rates(dataset, flow, "inflow", path, ensembles) if known else None
    varied = [a for a in axes(dataset) if dataset.sizes[a] > 1 and a not in ensembles]
    numeric = [a for a in varied if a in dataset.coords and dataset[a].dtype.kind in "iuf"]
    if not known or not numeric:
        return None
    flow = -dataset["boundary_flow"].sel(boundary=known)
    over = [a for a in axes(dataset) if a in ensembles]
    mean, spread = flow.mean(over), flow.std(over)

    def effect(axis: str) -> float:
        return float((mean.max(axis) - mean.min(axis)).max())

    x = max(numeric, key=effect)
    others = [a for a in varied if a != x]
    factor, unit = display(str(dataset[x].attrs.get("units", "1")), dataset[x].values)
    scale, flow_title = in_powers(mean, "inflow")
    figure = new_figure(5.6, 3.8)
    panel = figure.subplots()
    cases = itertools.product(known, *(range(dataset.sizes[a]) for a in others))
    count = len(known) * math.prod(dataset.sizes[a] for a in others)
    for number, (name, *at) in enumerate(itertools.islice(cases, MOST_CURVES)):
        place = dict(zip(others, at, strict=True))
        told = case_title(dataset, place)
        one = {"boundary": name}
        panel.errorbar(
            dataset[x].values * factor,
            mean.sel(one).isel(place).values * scale,
            spread.sel(one).isel(place).values * scale,
            label=", ".join(filter(None, [name if len(known) > 1 else "", told])) or name,
            color=BLUE if number % 2 == 0 else VERMILION,
            linestyle=LINE_STYLES[number // 2 % len(LINE_STYLES)],
            marker="o",
            markersize=3.5,
            capsize=2.5,
        )
    values = mean.values[np.isfinite(mean.values)]
    if is_log_spaced(dataset[x].values.astype(float)):
        panel.set_xscale("log")
    if len(values) and values.min() > 0 and values.max() > 8 * values.min():
        panel.set_yscale("log")
        plain_log_ticks(panel.yaxis)
    panel.set_xlabel(f"{axis_title(x)} ({unit})" if unit else axis_title(x))
    panel.set_ylabel(flow_title)
    panel.legend()
    caption = f"Steady inflow into {', '.join(known)} against {axis_title(x)}"
    if count > MOST_CURVES:
        caption += f", the first {MOST_CURVES} of {count} curves"
    if over:
        caption += f"; bars: standard deviation over {', '.join(map(axis_title, over))}"
    return save(figure, path, caption + ".")
