"""Flow periods on the axes on which radial flow is a straight line: MDH, Horner, superposition."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from demflow.model.outcome import Status
from demflow.model.scene import Well
from demflow.sweep.analysis.cases import Index, axes, case_title, display, with_unit
from demflow.sweep.analysis.straight_lines import Rates, StraightLine, abscissa, straight_line
from demflow.sweep.figures.style import (
    BLUE,
    LINE_STYLES,
    legend_text,
    narrow,
    new_figure,
    pick,
    save,
    shades,
    shorten,
)
from demflow.sweep.figures.wells import WellOf
from demflow.sweep.study.reservoir import Rock
from demflow.sweep.study.units import parse_unit

_MOST = (5, 3)  # values shown by colour and by line style
_INSIDE = 6  # names that have room among the curves


def production_time(well: Well) -> float | None:
    """How long a well produced at one rate before it was shut in for good, s; else None."""
    changes = well.rate_changes
    if len(changes) == 2 and changes[0][1] != 0.0 and changes[1][1] == 0.0:
        return changes[1][0] - changes[0][0]
    return None


def draw_horner(
    dataset: xr.Dataset,
    well: str,
    well_of: WellOf,
    path: Path,
    rock_of: Callable[[Index, Well], Rock | None] = lambda _index, _well: None,
) -> Path | None:
    """Pressure of a shut well against Horner's time; None where it is not such a test.

    Where radial flow is found, its straight line is drawn on to p*, and k, S and p* are told.

    The first two axes that vary are told apart by colour and line style; others stay at their
    first value.

    Parameters
    ----------
    dataset : as `open_results` gives it
    well : name of the well
    well_of : the well of the case at an index
    path : where the figure is written
    rock_of : rock and fluid of the case at an index, or None
    """
    varied = [a for a in axes(dataset) if dataset.sizes[a] > 1]
    colour, style = ([*varied, None, None])[:2]
    colours = pick(dataset.sizes[colour], _MOST[0]) if colour else [0]
    styles = pick(dataset.sizes[style], _MOST[1]) if style else [0]
    times = dataset["elapsed_time"].values
    factor, unit = display("Pa", float(np.nanmax(np.abs(dataset["well_pressure"].values))))
    panel: Axes | None = None
    drawn = 0
    for (c, i), (s, j) in product(enumerate(colours), enumerate(styles)):
        index = {a: 0 for a in axes(dataset)}
        index |= {name: at for name, at in ((colour, i), (style, j)) if name}
        own = well_of(index, well)
        production = production_time(own) if own is not None else None
        if own is None or production is None:
            continue
        case = dataset.isel(index)
        if int(case["status"]) != Status.DONE:
            continue
        since = times - own.rate_changes[1][0]
        shut = since > 0
        if np.count_nonzero(shut) < 2:
            continue
        named = case_title(dataset, {name: at for name, at in ((colour, i), (style, j)) if name})
        pressure, colour_here = (
            case["well_pressure"].sel(well=well).values,
            shades("Blues", len(colours))[c],
        )
        from demflow.model.analytic.wellbore import horner_time  # with special functions

        if panel is None:
            panel = new_figure(7.4, 4.6).subplots()
        line = _line(times, pressure, own, rock_of(index, own))
        if line is not None:
            told = f"k {with_unit(line.permeability, 'm2', 3)}, S {line.skin_factor:.2f}"
            named = f"{named or well}: {told}, p* {with_unit(line.extrapolated, 'Pa')}"
            ends = horner_time(np.array([line.end, 1e6 * production]), production)
            reached = line.extrapolated - line.slope * np.log(ends)
            panel.plot(ends, reached * factor, color="0.4", linewidth=0.8, linestyle="--")
        panel.plot(
            horner_time(since[shut], production),
            pressure[shut] * factor,
            color=colour_here,
            linestyle=LINE_STYLES[s],
            linewidth=1.8 + 2.0 * (len(colours) - 1 - c),  # a skin alone leaves no trace: they meet
            label=legend_text(named or well),
        )
        drawn += 1
    if panel is None:
        return None
    panel.set(
        xscale="log",
        xlabel="Horner time (t_p + Δt) / Δt",
        ylabel=f"well pressure ({unit})",
        title=f"Well {well}: build-up",
    )
    panel.invert_xaxis()
    figure = panel.get_figure(root=True)
    assert figure is not None
    if narrow():
        figure.legend(loc="outside lower left")
    elif drawn > _INSIDE:
        figure.legend(loc="outside lower left", ncols=2, handlelength=1.3, columnspacing=1.0)
    else:
        panel.legend()
    caption = (
        f"Horner plot of well {well}, {drawn} cases. Radial flow in a reservoir whose boundary is "
        "not felt is a straight line of slope q μ / (4π k) per natural-log unit, which reaches "
        "the initial pressure at 1. Dashed: the line of what the derivative shows as radial, with "
        "what it gives."
    )
    return save(figure, path, caption)


def plot_straight_line(
    record: tuple[np.ndarray, np.ndarray],
    rates: Rates,
    rock: Rock,
    panel: Axes,
    *,
    plot: str = "superposition",
    between: tuple[float, float] | None = None,
    name: str = "",
    units: tuple[str, str] = ("h", "kPa"),
    colour: Any = BLUE,
) -> Axes:
    """Draw the last flow period of a record, and the straight line through its radial flow.

    The label tells permeability, skin factor and p*, or why there is no line.

    Parameters
    ----------
    record : (t,) s and (t,) Pa, with a point at or before the last change of the rate
    rates : (time in s, new rate in m³/s) in order
    rock : viscosity, and for the skin porosity, compressibility and radius of the well
    panel : where to draw
    plot : mdh, horner or superposition
    between : s since the period began; by default the radial stretch of the derivative
    name : what tells this record from others
    units : of time and pressure
    colour : of the points

    Raises ValueError for another plot, and rates that it does not suit.
    """
    times, pressure = record
    changes = [one for one in rates if one[0] <= rates[-1][0]]
    now = times > changes[-1][0]
    x, end = abscissa(times[now], changes, plot)
    hours, shown = (float(1 / parse_unit(unit).factor) for unit in units)

    def place(x: np.ndarray) -> np.ndarray:
        if plot == "superposition":
            return x
        return np.exp(x) * hours if plot == "mdh" else np.exp(end - x)

    told = ""
    try:
        line = straight_line(times, pressure, changes, rock, plot=plot, between=between)
    except ValueError as error:
        told = shorten(f"no straight line: {error}")
    else:
        told = f"k {with_unit(line.permeability, 'm2', 3)}"
        if np.isfinite(line.skin_factor):
            told += f", S {line.skin_factor:.2f}"
        far = np.log(line.end) if not np.isfinite(end) else end
        if np.isfinite(line.extrapolated):
            told += f", p* {with_unit(line.extrapolated, 'Pa')}"
        ends = np.array([x.min(), max(x.max(), far)])
        before = pressure[np.flatnonzero(~now)[-1]]
        step = changes[-1][1] - (changes[-2][1] if len(changes) > 1 else 0.0)
        reached = before - np.sign(step) * (line.height + line.slope * ends)
        panel.plot(place(ends), reached * shown, color="0.4", linewidth=0.8, linestyle="--")
    panel.plot(
        place(x),
        pressure[now] * shown,
        "o",
        markersize=3,
        markerfacecolor="none",
        color=colour,
        label=legend_text(f"{name}: {told}" if name else told),
    )
    titles = {
        "mdh": f"time since the rate change Δt ({units[0]})",
        "horner": "Horner time (t_p + Δt) / Δt",
        "superposition": "superposition time, natural logarithm of s",
    }
    panel.set(xlabel=titles[plot], ylabel=f"well pressure ({units[1]})")
    if plot != "superposition":
        panel.set_xscale("log")
    if plot == "horner" and not panel.xaxis_inverted():
        panel.invert_xaxis()
    return panel


def _line(
    times: np.ndarray, pressure: np.ndarray, well: Well, rock: Rock | None
) -> StraightLine | None:
    """The straight line of a build-up, if rock and fluid are known and flow is radial."""
    if rock is None:
        return None
    try:
        return straight_line(times, pressure, well.rate_changes, rock, plot="horner")
    except ValueError:
        return None
