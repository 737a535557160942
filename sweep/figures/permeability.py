"""Permeability against the varied parameters."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from demflow.sweep.analysis.cases import (
    axes,
    axis_title,
    axis_value,
    case_title,
    display,
    done,
)
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import (
    BLUE,
    GREY,
    VERMILION,
    fixed_panels,
    heading,
    is_log_spaced,
    legend_text,
    name_ticks,
    narrow,
    pick,
    plain_log_ticks,
    quiet_minor_labels,
    save,
    sequence,
    shorten,
)

_COMPONENTS = (("k_xx", 0, BLUE, "o"), ("k_yy", 1, VERMILION, "s"))
MOST_PANELS = 6
SLANTED, LONGEST_NAME = 16, 24  # letters of a name below a panel
MOST_ROSES = 10  # cases that are told apart
SIZE = (2.6, 2.3)  # inches of a panel
FEW = 4  # curves that are drawn each; of more their range


def draw_permeability(
    dataset: xr.Dataset, path: Path, ensembles: Set[str] = frozenset()
) -> Path | None:
    """k_xx and k_yy against each axis that changes them, one panel an axis.

    Lines are geometric means over the other axes, bands all of their values. Along an axis of
    `ensembles` (seeds of packings), whose order means nothing, no lines are drawn. None where no
    case has a permeability; without an axis that matters, one panel shows the values.

    Parameters
    ----------
    dataset : as `open_results` gives it
    path : where the figure is written
    ensembles : axes whose order means nothing, as seeds
    """
    if "permeability" not in dataset or not np.any(np.isfinite(dataset["permeability"].values)):
        return None
    tensor = dataset["permeability"]
    varied = [a for a in axes(dataset) if dataset.sizes[a] > 1]
    matter = [a for a in varied if _matters(tensor, a)]
    idle = [a for a in varied if a not in matter]
    # along the others all cases that have a value have the same
    tensor = tensor.max([a for a in axes(dataset) if a not in matter])
    shown: list[str | None] = [*matter[:MOST_PANELS]] or [None]
    columns = 1 if narrow() else min(len(shown), 3)
    names = [tick_names(dataset, axis) for axis in shown]
    below = 0.55 + max(room_of_names(one) for one in names)
    figure, panels = fixed_panels(
        -(-len(shown) // columns), columns, SIZE if len(shown) > 1 else (1.5 * SIZE[0], SIZE[1]),
        between=(0.25, below + 0.1), margins=(0.8, 0.2, below, 0.75), shown=len(shown),
    )  # fmt: skip
    values = np.concatenate([tensor.values[..., i, i].ravel() for i in (0, 1)])
    for axis, panel, own in zip(shown, panels, names, strict=True):
        panel.tick_params(labelbottom=True)
        for name, i, colour, marker in _COMPONENTS:
            plot_along(
                dataset, tensor.isel(row=i, column=i), axis, panel,
                colour=colour, marker=marker, label=name, joined=axis not in ensembles,
                at=values,
            )  # fmt: skip
        if axis:
            place_axis(panel, dataset, axis, own)
    for k, panel in enumerate(panels):
        panel.set_ylim(panels[0].get_ylim())
        if k % columns:
            panel.set_ylabel("")
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=colour, marker=marker, markersize=5, label=name)
        for name, _, colour, marker in _COMPONENTS
    ]
    if len(matter) > 1:
        handles.append(Line2D([], [], color=GREY, linewidth=2.2, label="geometric mean"))
        handles.append(Patch(color=GREY, alpha=0.25, linewidth=0, label="all cases"))
    height = figure.get_size_inches()[1]
    figure.legend(
        handles=handles, loc="upper left", ncols=2 if narrow() else 4, columnspacing=1.2,
        bbox_to_anchor=(0.01, 1.0 - (0.0 if narrow() else 0.28) / height),
    )  # fmt: skip
    heading(figure, "Permeability of the region", x=0.02, ha="left", fontsize=11)
    caption = "Diagonal of the permeability tensor"
    if matter:
        caption += " against " + ", ".join(axis_title(a) for a in matter[:MOST_PANELS])
    if len(matter) > 1:
        caption += "; lines: geometric mean over the other axes, bands: all of their values"
    if idle:
        caption += f". It does not change with {', '.join(axis_title(a) for a in idle)}"
    return save(figure, path, caption + ".")


def _matters(tensor: xr.DataArray, axis: str) -> bool:
    """Whether the tensor changes along an axis, beyond round-off and missing cases."""
    with np.errstate(invalid="ignore"):
        spread = tensor.max(axis) - tensor.min(axis)
        size = abs(tensor).max()
    return bool(np.any(spread.values > 1e-9 * float(size)))


def plot_along(
    dataset: xr.Dataset,
    values: xr.DataArray,
    axis: str | None,
    panel: Axes,
    *,
    colour: str = BLUE,
    marker: str = "o",
    label: str = "",
    joined: bool = True,
    at: np.ndarray | None = None,
) -> Axes:
    """Draw a quantity against an axis of a study, with what the other axes make of it; return it.

    A line is the mean over the other axes, the geometric one of what is above zero everywhere; a
    band reaches from the least to the greatest. Of few values each is a point or a thin line.

    Parameters
    ----------
    dataset : as `open_results` gives it
    values : one number a case, over axes of the study, in SI
    axis : along which; None: their mean is one point
    panel : where to draw
    colour, marker, label : of the line
    joined : False where the order along the axis means nothing, as of seeds
    at : numbers that choose unit and scale, by default the values
    """
    seen = np.asarray(values.values if at is None else at, dtype=float)
    seen = seen[np.isfinite(seen)]
    factor, unit = display(str(values.attrs.get("units", "1")), seen)
    name = axis_title(str(values.name or ""))
    panel.set_ylabel(f"{name} ({unit})" if unit else name)
    if not len(seen):
        return panel
    others = [d for d in values.dims if d != axis]
    curves = values.transpose(*([axis] if axis else []), *others).values * factor
    curves = curves.reshape(values.sizes[axis] if axis else 1, -1)
    place = positions(dataset, axis) if axis else np.zeros(1)
    order = np.argsort(place)
    place, curves = place[order], curves[order]
    many = curves.shape[1]
    look: dict[str, Any] = {"color": colour, "linewidth": 0}
    if 1 < many <= FEW and joined:
        panel.plot(place, curves, color=colour, alpha=0.45, linewidth=0.6)
    elif many > 1 and joined:
        low, high = (f(curves, axis=1, initial=s, where=np.isfinite(curves))
                     for f, s in ((np.min, np.inf), (np.max, -np.inf)))  # fmt: skip
        kept = high >= low
        panel.fill_between(place[kept], low[kept], high[kept], alpha=0.2, **look)
    elif many > 1:
        panel.plot(place, curves, color=colour, alpha=0.45, linestyle="none", marker=".")
    panel.plot(
        place, _middle(curves, bool(seen.min() > 0)), color=colour, marker=marker, markersize=5,
        linestyle="-" if joined and axis else "none", linewidth=2.0, label=legend_text(label),
    )  # fmt: skip
    if seen.min() > 0 and seen.max() / seen.min() > 8:
        panel.set_yscale("log")
        plain_log_ticks(panel.yaxis)
    elif 0 < 1.5 * seen.min() < seen.max():
        panel.set_ylim(0, 1.08 * factor * seen.max())
    if axis is None:
        panel.set_xticks([])
    return panel


def _middle(curves: np.ndarray, geometric: bool) -> np.ndarray:
    """Mean of each row, of its values that are there; NaN where none is."""
    good = np.where(curves > 0, curves, np.nan) if geometric else curves
    count = np.sum(np.isfinite(good), axis=1)
    total = np.nansum(np.log(good) if geometric else good, axis=1)
    mean = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return np.exp(mean) if geometric else mean


def _numeric(dataset: xr.Dataset, axis: str) -> bool:
    return axis in dataset.coords and dataset[axis].dtype.kind in "iuf"


def positions(dataset: xr.Dataset, axis: str) -> np.ndarray:
    """Where the values of an axis stand: at themselves, or one apart where they are words."""
    if _numeric(dataset, axis):
        return dataset[axis].values.astype(float) * _axis_unit(dataset, axis)[0]
    return np.arange(dataset.sizes[axis], dtype=float)


def _axis_unit(dataset: xr.Dataset, axis: str) -> tuple[float, str]:
    return display(str(dataset[axis].attrs.get("units", "1")), dataset[axis].values)


def tick_names(dataset: xr.Dataset, axis: str | None) -> list[str]:
    """Words under an axis of a study that is no number; none where it is one."""
    if axis is None or _numeric(dataset, axis):
        return []
    return [shorten(axis_value(dataset, axis, i), LONGEST_NAME) for i in range(dataset.sizes[axis])]


def room_of_names(names: list[str]) -> float:
    """Inches that slanted words take below a panel."""
    longest = max(map(len, names), default=0)
    return 0.04 * longest if longest <= SLANTED else 0.062 * longest


def place_axis(panel: Axes, dataset: xr.Dataset, axis: str, names: list[str]) -> None:
    """Label, scale and ticks of the x axis of a panel.

    Parameters
    ----------
    panel : where the values are drawn
    dataset : as `open_results` gives it
    axis : of the study
    names : its `tick_names`
    """
    if not _numeric(dataset, axis):
        name_ticks(panel.xaxis, range(len(names)), names)
        if max(map(len, names), default=0) * len(names) > 24:
            steep = max(map(len, names)) > SLANTED  # it must not reach beyond the figure's left
            panel.tick_params(axis="x", labelrotation=60 if steep else 30)
            for text in panel.get_xticklabels():
                text.set_horizontalalignment("right")
        panel.set_xlabel(axis_title(axis))
        return
    values = dataset[axis].values.astype(float)
    factor, unit = _axis_unit(dataset, axis)
    panel.set_xlabel(f"{axis_title(axis)} ({unit})" if unit else axis_title(axis))
    if is_log_spaced(values):
        panel.set_xscale("log")
        panel.minorticks_off()
        chosen = [values[k] * factor for k in pick(len(values), 5)]
        quiet_minor_labels(panel, chosen)
    elif len(values) <= 6:
        quiet_minor_labels(panel, list(values * factor))


def plot_permeability_rose(dataset: xr.Dataset, panel: Axes) -> Axes:
    """Draw how permeable the rock of each case is in every direction; return the axes.

    The distance from the middle is n·K n, which a gradient of pressure along n drives along n.

    Parameters
    ----------
    dataset : as `open_results` gives it, with `permeability`
    panel : where to draw

    Raises ResultsError where there is no permeability, or no case, or more than can be told apart.
    """
    if "permeability" not in dataset:
        raise ResultsError("the dataset has no permeability: observe it")
    shown = list(done(dataset))
    if not 0 < len(shown) <= MOST_ROSES:
        raise ResultsError(
            f"{len(shown)} cases are done, and 1 to {MOST_ROSES} can be told apart; choose some by "
            "isel or sel"
        )
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    along = np.stack([np.cos(angle), np.sin(angle)])
    tensors = [
        dataset["permeability"].isel(index).transpose("row", "column").values for index in shown
    ]
    factor, unit = display("m2", np.asarray(tensors)[:, [0, 1], [0, 1]])
    for index, tensor, colour in zip(shown, tensors, sequence(len(shown)), strict=True):
        reach = factor * np.einsum("ia,ij,ja->a", along, tensor, along)
        name = legend_text(case_title(dataset, index))
        panel.plot(reach * along[0], reach * along[1], color=colour, label=name)
    name = f"({unit})"
    panel.set(aspect="equal", xlabel=f"permeability along x {name}", ylabel=f"along y {name}")
    return panel
