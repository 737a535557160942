"""Permeability against the varied parameters."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from demflow.sweep.analysis.cases import axes, axis_title, axis_value, display
from demflow.sweep.figures.style import (
    BLUE,
    GREY,
    VERMILION,
    beside,
    heading,
    is_log_spaced,
    narrow,
    new_figure,
    plain_log_ticks,
    quiet_minor_labels,
    save,
)

_COMPONENTS = (("k_xx", 0, BLUE, "o"), ("k_yy", 1, VERMILION, "s"))


def draw_permeability(
    dataset: xr.Dataset, path: Path, ensembles: Set[str] = frozenset()
) -> Path | None:
    """k_xx and k_yy against each axis that changes them, one panel an axis.

    Thin lines are the values of the other axes, thick ones their geometric mean. Along an
    axis of `ensembles` (seeds of packings), whose order means nothing, no lines are drawn.
    None where no case has a permeability; without an axis that matters, one panel shows the
    values.

    Parameters
    ----------
    dataset : as `open_results` gives it
    path : where the figure is written
    ensembles : axes whose order means nothing, as seeds
    """
    tensor = dataset["permeability"]
    if not np.any(np.isfinite(tensor.values)):
        return None
    varied = [a for a in axes(dataset) if dataset.sizes[a] > 1]
    matter = [a for a in varied if _matters(tensor, a)]
    idle = [a for a in varied if a not in matter]
    # along the others all cases that have a value have the same
    tensor = tensor.max([a for a in axes(dataset) if a not in matter])
    factor, unit = display("m2", np.array([tensor.values[..., i, i] for i in (0, 1)]))
    figure, panels = _panels(max(len(matter), 1))
    values = np.concatenate([tensor.values[..., i, i].ravel() for i in (0, 1)])
    values = values[np.isfinite(values)]
    logarithmic = values.min() > 0 and values.max() / values.min() > 8
    shown: list[str | None] = [*matter] or [None]
    for axis, panel in zip(shown, panels, strict=True):
        for _, i, colour, marker in _COMPONENTS:
            _draw(
                panel,
                tensor.isel(row=i, column=i) * factor,
                axis,
                colour,
                marker,
                axis in ensembles,
            )
        if logarithmic:
            panel.set_yscale("log")
        elif 0 < 1.5 * values.min() < values.max():
            panel.set_ylim(0, 1.08 * factor * values.max())
        if axis:
            _place(panel, dataset, axis)
        else:
            panel.set_xticks([])
    if logarithmic:
        plain_log_ticks(panels[0].yaxis)
    _name(panels, f"permeability ({unit})")
    handles = [
        Line2D([], [], color=colour, marker=marker, markersize=5, label=name)
        for name, _, colour, marker in _COMPONENTS
    ]
    if len(matter) > 1:
        handles.append(Line2D([], [], color=GREY, linewidth=2.2, label="geometric mean"))
        handles.append(Line2D([], [], color=GREY, linewidth=0.6, label="each of the other cases"))
    beside(figure, handles=handles)
    heading(figure, "Permeability of the region", fontsize=11)
    caption = "Diagonal of the permeability tensor"
    if matter:
        caption += " against " + ", ".join(axis_title(a) for a in matter)
    if len(matter) > 1:
        caption += "; thick: geometric mean over the other axes, thin: each of their values"
    if idle:
        caption += f". It does not change with {', '.join(axis_title(a) for a in idle)}"
    return save(figure, path, caption + ".")


def _name(panels: np.ndarray, text: str) -> None:
    """Say what is drawn upwards, once for panels beside each other."""
    for panel in panels if narrow() else panels[:1]:
        panel.set_ylabel(text)


def _panels(count: int) -> tuple[Figure, np.ndarray]:
    """Panels beside each other, or below where there is one column for them."""
    rows = count if narrow() else 1
    figure = new_figure(max(3.0 * (count // rows) + 1.2, 4.6), 3.6 if rows == 1 else 2.1 * rows)
    return figure, figure.subplots(rows, count // rows, sharey=True, squeeze=False).ravel()


def _matters(tensor: xr.DataArray, axis: str) -> bool:
    """Whether the tensor changes along an axis, beyond round-off and missing cases."""
    with np.errstate(invalid="ignore"):
        spread = tensor.max(axis) - tensor.min(axis)
        size = abs(tensor).max()
    return bool(np.any(spread.values > 1e-9 * float(size)))


def _draw(
    panel: Axes,
    values: xr.DataArray,
    axis: str | None,
    colour: str,
    marker: str,
    ensemble: bool,
) -> None:
    if axis is None:
        panel.plot([0.0], np.nanmean(values.values), color=colour, marker=marker, linestyle="none")
        return
    others = [d for d in values.dims if d != axis]
    curves = values.transpose(axis, *others).values.reshape(values.sizes[axis], -1)
    place = _positions(values, axis)
    order = np.argsort(place)
    single = curves.shape[1] == 1
    if not single:
        line, dot = ("none", ".") if ensemble else ("-", "none")
        panel.plot(
            place[order],
            curves[order],
            color=colour,
            alpha=0.45,
            linestyle=line,
            linewidth=0.6,
            marker=dot,
        )
    positive = np.where(curves > 0, curves, np.nan)
    count = np.sum(np.isfinite(positive), axis=1)
    total = np.nansum(np.log(positive), axis=1)
    mean = np.exp(np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0))
    panel.plot(
        place[order],
        mean[order],
        color=colour,
        marker=marker,
        markersize=5,
        linestyle="none" if ensemble else "-",
        linewidth=2.2,
    )


def _positions(values: xr.DataArray, axis: str) -> np.ndarray:
    """Where the values of an axis stand: at themselves, or one apart where they are words."""
    if axis in values.coords and values[axis].dtype.kind in "iuf":
        return values[axis].values.astype(float) * _axis_unit(values, axis)[0]
    return np.arange(values.sizes[axis], dtype=float)


def _axis_unit(values: xr.DataArray | xr.Dataset, axis: str) -> tuple[float, str]:
    return display(str(values[axis].attrs.get("units", "1")), values[axis].values)


def _place(panel: Axes, dataset: xr.Dataset, axis: str) -> None:
    """Label, scale and ticks of the x axis of a panel."""
    if axis not in dataset.coords or dataset[axis].dtype.kind not in "iuf":
        names = [axis_value(dataset, axis, i) for i in range(dataset.sizes[axis])]
        panel.set_xticks(range(len(names)), names)
        panel.set_xlabel(axis_title(axis))
        return
    values = dataset[axis].values.astype(float)
    factor, unit = _axis_unit(dataset, axis)
    panel.set_xlabel(f"{axis_title(axis)} ({unit})" if unit else axis_title(axis))
    if is_log_spaced(values):
        panel.set_xscale("log")
    if len(values) <= 6:
        quiet_minor_labels(panel, list(values * factor))
