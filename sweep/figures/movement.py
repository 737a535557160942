"""How rock moves while fluid does: walls in time, joints and permeability with well pressure."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from demflow.model.outcome import Status
from demflow.sweep.analysis.cases import axes, case_title, display
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import (
    LINE_STYLES,
    legend_text,
    narrow,
    new_figure,
    pick,
    save,
    sequence,
)

_MOST = (4, 2)  # values of an axis told apart by colour and by line style
_HEIGHT, _WIDTH = 3.4, 4.4  # inches of a panel
_STILL = 1e-9  # of the largest way: a wall that moves less stands


def draw_settlement(dataset: xr.Dataset, path: Path) -> Path | None:
    """Ways of the walls that move, inwards, against time; None where none was observed or moved.

    The first two axes that vary are told apart by colour and line style, a few values of each;
    others stay at their first value.

    Parameters
    ----------
    dataset : as `open_results` gives it
    path : where the figure is written
    """
    if "wall_displacement" not in dataset:
        return None
    cases = list(_cases(dataset))
    if not cases:
        return None
    ways = (case["wall_displacement"].transpose("wall", "elapsed_time") for case, _ in cases)
    inwards = [-way.values for way in ways]
    largest = np.nanmax(np.abs(inwards), axis=(0, 2), initial=0.0)
    moving = np.flatnonzero(largest > _STILL * largest.max()).tolist()
    if not moving:
        return None
    figure, panels = _panels(len(moving))
    for panel, wall in zip(panels, moving, strict=True):
        name = str(dataset["wall"].values[wall])
        plot_settlement(dataset, name, panel).set_title(f"{name} wall")
    if len(cases) > 1:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left")
    return save(figure, path, "Ways of the walls inwards, such as settlement, in time")


def plot_settlement(dataset: xr.Dataset, wall: str, panel: Axes) -> Axes:
    """Draw the way of a wall inwards against time, a few cases; return the axes.

    Parameters
    ----------
    dataset : as `open_results` gives it, with `wall_displacement`
    wall : left, right, bottom or top
    panel : where to draw

    Raises ResultsError where no walls were observed, there is no such wall, or no case has a
    result.
    """
    if "wall_displacement" not in dataset:
        raise ResultsError("the dataset has no wall_displacement: observe it")
    walls = [str(name) for name in dataset["wall"].values]
    if wall not in walls:
        raise ResultsError(f"there is no wall {wall}; there are {', '.join(walls)}")
    cases = _some(dataset)
    curves = [-case["wall_displacement"].sel(wall=wall).values for case, _ in cases]
    factor, unit = display("m", np.abs(curves))
    time, of_time = display("s", dataset["elapsed_time"].values)
    for curve, (_, look) in zip(curves, cases, strict=True):
        panel.plot(time * dataset["elapsed_time"].values, factor * curve, **look)
    panel.set(
        xscale="log",
        xlabel=f"time ({of_time})",
        ylabel=f"way inwards: settlement ({unit})",
    )
    return panel


def draw_slip(dataset: xr.Dataset, path: Path) -> Path | None:
    """Slip of joints, and permeability over that at the start, against the first well's pressure.

    Each curve runs through its times in their order, a dot each; None where neither was observed.
    Cases are chosen as in `draw_settlement`.

    Parameters
    ----------
    dataset : as `open_results` gives it
    path : where the figure is written
    """
    shown = [name for name in ("joint_slip", "permeability_in_time") if name in dataset]
    cases = list(_cases(dataset)) if shown and "well_pressure" in dataset else []
    if not cases:
        return None
    figure, panels = _panels(len(shown))
    for panel, name in zip(panels, shown, strict=True):
        plot_slip(dataset, panel, name)
    if len(cases) > 1:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left")
    return save(figure, path, "Slip of joints and permeability in time against well pressure")


def plot_slip(dataset: xr.Dataset, panel: Axes, of: str = "joint_slip") -> Axes:
    """Draw slip of joints, or permeability, against the first well's pressure, a few cases.

    Parameters
    ----------
    dataset : as `open_results` gives it, with `well_pressure`
    panel : where to draw
    of : joint_slip, or permeability_in_time, which is drawn over that at the start

    Raises ResultsError where it was not observed, there is no well, or no case has a result.
    """
    for name in (of, "well_pressure"):
        if name not in dataset or of not in ("joint_slip", "permeability_in_time"):
            raise ResultsError(f"the dataset has no {name} to draw: observe it")
    cases = _some(dataset)
    pressures = [case["well_pressure"].isel(well=0).values for case, _ in cases]
    factor, unit = display("Pa", np.abs(pressures))
    if of == "joint_slip":
        curves = [case[of].values for case, _ in cases]
        scale, slip = display("m", np.abs(curves))
        title = f"mean slip of the joints ({slip})"
    else:
        curves = [_mean(case[of]) / _mean(case["permeability_at_start"]) for case, _ in cases]
        scale, title = 1.0, "mean permeability over the first"
    for pressure, curve, (_, look) in zip(pressures, curves, cases, strict=True):
        panel.plot(factor * pressure, scale * curve, marker=".", **look)
    well = str(dataset["well"].values[0])
    panel.set(xlabel=f"pressure of {well} ({unit})", ylabel=title)
    return panel


def _some(dataset: xr.Dataset) -> list[tuple[xr.Dataset, dict[str, Any]]]:
    """The cases that are drawn. Raises ResultsError where none came to results."""
    found = list(_cases(dataset))
    if not found:
        raise ResultsError("no case that would be drawn came to results")
    return found


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    """Panels beside each other; one above the other in a column."""
    rows, columns = (count, 1) if narrow() else (1, count)
    figure = new_figure(_WIDTH * columns + 0.6, _HEIGHT * rows)
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


def _mean(tensor: xr.DataArray) -> np.ndarray:
    """Half the trace of tensors."""
    diagonal = [tensor.sel(row=axis, column=axis, drop=True).values for axis in "xy"]
    return np.mean(diagonal, axis=0)


def _cases(dataset: xr.Dataset) -> Iterator[tuple[xr.Dataset, dict[str, Any]]]:
    """Cases that came to results, along the first two axes that vary, and the look of each."""
    varied = [axis for axis in axes(dataset) if dataset.sizes[axis] > 1][:2]
    chosen = [pick(dataset.sizes[a], most) for a, most in zip(varied, _MOST, strict=False)]
    colours = sequence(len(chosen[0]) if chosen else 1)
    for places in product(*(enumerate(one) for one in chosen)):
        at = {axis: k for axis, (_, k) in zip(varied, places, strict=True)}
        case = dataset.isel({axis: 0 for axis in axes(dataset)} | at)
        if int(case["status"]) not in (Status.DONE, Status.STOPPED):
            continue
        look: dict[str, Any] = {"color": colours[places[0][0] if places else 0]}
        look["linestyle"] = LINE_STYLES[places[1][0] if len(places) > 1 else 0]
        yield case, look | {"label": legend_text(case_title(dataset, at))}
