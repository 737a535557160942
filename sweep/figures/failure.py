"""How specimens failed: stress against strain, cracks against strain, and where the cracks lie."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from demflow.model.outcome import Status
from demflow.model.scene import MEASURED_BY_A_TEST
from demflow.sweep.analysis.cases import Index, axes, axis_title, axis_value, display
from demflow.sweep.analysis.compare import MapsOf
from demflow.sweep.figures.style import (
    BLACK,
    BLUE,
    GREY,
    VERMILION,
    legend_text,
    narrow,
    new_figure,
    save,
    sequence,
)

MOST_CURVES = 6  # values of the axis whose curves are drawn
HEIGHT = 3.6  # inches of a specimen
MODES = ((1, "tension", BLUE), (2, "shear", VERMILION))


def draw_failure(
    dataset: xr.Dataset, maps_of: MapsOf, path: Path, ensembles: Set[str]
) -> Path | None:
    """Curves and cracks of tests along the first axis that is no ensemble, others at their first.

    Axial strain grows to the right, lateral strain to the left, as in the laboratory. None
    where nothing was tested.

    Parameters
    ----------
    dataset : as `open_results` gives it
    maps_of : the maps of the case at an index
    path : where the figure is written
    ensembles : axes whose order means nothing, as seeds
    """
    cases = _cases(dataset, ensembles)
    if not cases:
        return None
    tests = [maps_of(index) for _, index in cases]
    cracked = any(len(test["crack_x"]) for test in tests)
    chosen = sorted({0, len(tests) // 2, len(tests) - 1}) if cracked else []
    shapes = [np.diff(tests[k]["box"].values.reshape(2, 2), axis=1).ravel() for k in chosen]
    ratios = [4.2, *([3.0] if cracked else [])]
    ratios += [max(HEIGHT * width / height, 1.4) for width, height in shapes]
    if narrow() and cracked:  # curves over each other, specimens below them
        figure = new_figure(4.2, 3 * HEIGHT)
        grid = figure.add_gridspec(3, len(chosen))
        places = [grid[0, :], grid[1, :], *(grid[2, k] for k in range(len(chosen)))]
        curves, *others = (figure.add_subplot(place) for place in places)
    else:
        figure = new_figure(sum(ratios) + 0.6, HEIGHT + 0.6)
        curves, *others = figure.subplots(1, len(ratios), width_ratios=ratios, squeeze=False)[0]
    factor, unit = display("Pa", np.concatenate([t["axial_stress"].values for t in tests]))
    for (name, _), test, colour in zip(cases, tests, sequence(len(tests)), strict=True):
        axial, lateral = 100.0 * test["axial_strain"].values, 100.0 * test["lateral_strain"].values
        stress = factor * test["axial_stress"].values
        curves.plot(axial, stress, color=colour, label=legend_text(name))
        curves.plot(-lateral, stress, color=colour)
        if cracked:
            others[0].plot(axial, test["cracks"].values, color=colour)
    curves.axvline(0.0, color=GREY, linewidth=0.8)
    curves.set(ylim=(0.0, None), ylabel=f"axial stress ({unit})")
    curves.set_xlabel("lateral  ←  strain (%)  →  axial")
    if len(cases) > 1:
        first = next(a for a in axes(dataset) if a not in ensembles and dataset.sizes[a] > 1)
        curves.legend(title=axis_title(first), title_fontsize=8.5)
    if cracked:
        others[0].set(ylim=(0.0, None), xlabel="axial strain (%)", ylabel="cracks")
    for panel, k in zip(others[1:], chosen, strict=True):
        _draw_cracks(panel, tests[k], cases[k][0])
    told = "stress, cracks, and where they are at the end" if cracked else "stress; nothing cracked"
    return save(figure, path, f"Tests to failure: {told}")


def _cases(dataset: xr.Dataset, ensembles: Set[str]) -> list[tuple[str, Index]]:
    """Name and index of the cases to draw: those along one axis that came to an end."""
    if not any(name in dataset for name in MEASURED_BY_A_TEST):
        return []
    first: Index = {axis: 0 for axis in axes(dataset)}
    along = [a for a in axes(dataset) if a not in ensembles and dataset.sizes[a] > 1]
    indices = [first | {along[0]: k} for k in range(dataset.sizes[along[0]])] if along else [first]
    done = [i for i in indices if int(dataset["status"].isel(i)) == Status.DONE]
    if len(done) > MOST_CURVES:
        done = [done[k] for k in np.linspace(0, len(done) - 1, MOST_CURVES).round().astype(int)]
    return [(axis_value(dataset, along[0], i[along[0]]) if along else "", i) for i in done]


def _draw_cracks(panel: Axes, test: xr.Dataset, name: str) -> None:
    """The specimen before the test, and where its bonds broke."""
    left, right, bottom, top = test["box"].values
    factor, _unit = display("m", np.array([right - left, top - bottom]))
    panel.add_patch(
        Rectangle(
            (factor * left, factor * bottom), factor * (right - left), factor * (top - bottom),
            fill=False, edgecolor=BLACK, linewidth=0.8,
        )
    )  # fmt: skip
    x, y, mode = (test[n].values for n in ("crack_x", "crack_y", "crack_mode"))
    size = 3000.0 / max(len(x), 300)
    for value, word, colour in MODES:
        held = mode == value
        if held.any():
            panel.scatter(
                factor * x[held], factor * y[held], s=size, color=colour, linewidths=0.0,
                label=f"{np.count_nonzero(held)} in {word}",
            )  # fmt: skip
    panel.set_aspect("equal")
    panel.grid(False)
    for side in ("left", "bottom"):
        panel.spines[side].set_visible(False)
    panel.set_xticks([])
    panel.set_yticks([])
    panel.set_title(name)
    if len(x):
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), handletextpad=0.1)
