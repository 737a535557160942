"""Diagnostic plots of the wells: pressure change and its derivative on log-log axes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from demflow.model.outcome import Status
from demflow.model.scene import Well
from demflow.model.transient import SMOOTHING, flow_periods
from demflow.sweep.analysis.cases import (
    Index,
    axes,
    axis_title,
    axis_value,
    case_title,
    display,
    done,
)
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import (
    GREY,
    LIGHT_GREY,
    LINE_STYLES,
    beside,
    heading,
    legend_text,
    narrow,
    new_figure,
    pick,
    plain_log_ticks,
    save,
    shades,
    time_unit,
)
from demflow.sweep.study.units import parse_unit

WellOf = Callable[[Index, str], Well | None]  # None: the case has no such well

MOST_LINES = 10  # cases on axes of the caller's

_MOST = (5, 3, 3, 2)  # values shown by colour, line style, column of panels, row of panels
_DECADES = 4.5  # shown below the largest pressure change
_SLOPES = ((1.0, "1"), (0.5, "1/2"), (0.25, "1/4"), (0.0, "0"))


class _Roles(NamedTuple):
    """Which axis is told apart by what, and the positions of its values that are shown."""

    names: tuple[str | None, ...]  # colour, line style, column, row
    shown: tuple[list[int], ...]
    held: Index  # the other axes, at their first value


def _roles(dataset: xr.Dataset) -> _Roles:
    varied = [a for a in axes(dataset) if dataset.sizes[a] > 1]
    unused: list[str | None] = [None] * len(_MOST)
    kept = varied[:2] if narrow() else varied  # one panel fits into a column
    names = tuple([*kept, *unused][: len(_MOST)])
    shown = tuple(
        pick(dataset.sizes[name], most) if name else [0]
        for name, most in zip(names, _MOST, strict=True)
    )
    held = {a: 0 for a in axes(dataset) if a not in names}
    return _Roles(names, shown, held)


def _index(roles: _Roles, positions: tuple[int, ...]) -> Index:
    return roles.held | {
        name: position for name, position in zip(roles.names, positions, strict=True) if name
    }


def draw_well(dataset: xr.Dataset, well: str, well_of: WellOf, path: Path) -> Path | None:
    """Pressure change and Bourdet derivative of one well; None where no case has any.

    Up to four axes are told apart by colour, line style, column and row of panels; of long
    axes a few values are drawn, and the caption says which. Flow periods after the first
    are thinner lines over the time since their own rate change.

    Parameters
    ----------
    dataset : as `open_results` gives it
    well : name of the well
    well_of : the well of the case at an index
    path : where the figure is written
    """
    roles = _roles(dataset)
    columns, rows = roles.shown[2], roles.shown[3]
    times = dataset["elapsed_time"].values
    changes = dataset["pressure_change"].sel(well=well)
    if not np.any(changes.values > 0):
        return None
    top = float(np.nanmax(changes.values))
    time_factor, time_name = time_unit(times)
    factor, pressure_name = display("Pa", top)
    wide = len(columns) == 1
    figure = new_figure(
        7.4 if wide else 3.1 * len(columns) + 1.7, 4.6 if len(rows) == 1 else 3.2 * len(rows) + 0.6
    )
    panels = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
    blues, reds = (shades(name, len(roles.shown[0])) for name in ("Blues", "Reds"))
    drawn = 0
    for c, s, col, row in product(*(range(len(shown)) for shown in roles.shown)):
        index = _index(roles, tuple(roles.shown[i][j] for i, j in enumerate((c, s, col, row))))
        case = dataset.isel(index)
        if int(case["status"]) != Status.DONE:
            continue
        own = well_of(index, well)
        if own is None:
            continue
        starts, _ = flow_periods(own.rate_changes)
        drawn += 1
        for name, colour in (("pressure_change", blues[c]), ("pressure_derivative", reds[c])):
            values = case[name].sel(well=well).values
            for k, start in enumerate(starts):
                end = starts[k + 1] if k + 1 < len(starts) else np.inf
                shown = (times > start) & (times <= end) & (values > 0)
                panels[row, col].plot(
                    (times[shown] - start) * time_factor,
                    values[shown] * factor,
                    color=colour,
                    linestyle=LINE_STYLES[s],
                    linewidth=1.6 if k == 0 else 0.9,
                    marker="." if np.count_nonzero(shown) <= 12 else "",
                )
    if not drawn:
        return None
    panels[0, 0].set(xscale="log", yscale="log")
    low = max(_least(dataset, well) / 1.5, top / 10**_DECADES)
    panels[0, 0].set_ylim(low * factor, 2.0 * top * factor)
    plain_log_ticks(panels[0, 0].yaxis)
    corner = _emptiest_corner(list(panels.flat))
    for (j, row), (i, col) in product(enumerate(rows), enumerate(columns)):
        title = [
            f"{axis_title(name)} {axis_value(dataset, name, position)}"
            for name, position in zip(roles.names[2:], (col, row), strict=True)
            if name
        ]
        panels[j, i].set_title(", ".join(title))
        _slope_fan(panels[j, i], corner)
    figure.supxlabel(
        f"time since the rate change ({time_name})", fontsize=rcParams["axes.labelsize"]
    )
    figure.supylabel(f"Δp and dΔp/d ln t ({pressure_name})", fontsize=rcParams["axes.labelsize"])
    # from the left, so that a long legend on the right cannot reach it
    heading(
        figure,
        f"Well {well}: pressure change and Bourdet derivative",
        x=0.01,
        ha="left",
        fontsize=11,
    )
    beside(figure, handles=_legend(dataset, roles, blues, reds), handlelength=2.6)
    return save(figure, path, _caption(dataset, well, roles, drawn))


def plot_period(
    dataset: xr.Dataset,
    well: str,
    panel: Axes | None,
    *,
    since: float,
    until: float,
    time: str,
    pressure: str,
) -> Axes:
    """Draw pressure change and derivative of one flow period of a well on axes of the caller's.

    Parameters
    ----------
    dataset : as `open_results` gives it; every case of it that is done is drawn
    well : name of the well
    panel : where to draw; None: the current axes of pyplot
    since, until : begin and end of the flow period, s
    time, pressure : units of the axes

    Raises ResultsError for too many cases, or a rate that changes within the period.
    """
    change, derivative, rate = (
        dataset[name].sel(well=well)
        for name in ("pressure_change", "pressure_derivative", "well_rate")
    )
    times = dataset["elapsed_time"].values
    shown = list(done(dataset))
    if not 0 < len(shown) <= MOST_LINES:
        raise ResultsError(
            f"{len(shown)} cases are done, and 1 to {MOST_LINES} can be told apart; choose values "
            f"of {', '.join(axes(dataset)) or 'no axis'}"
        )
    period, within = (times > since) & (times <= until), (times > since) & (times < until)
    if not period.any():
        raise ResultsError(f"no time lies after {since:g} s and up to {until:g} s")
    for index in shown:
        own = rate.isel(index).values[within]
        other = np.flatnonzero(~np.isclose(own, own[:1], rtol=1e-9, atol=0.0))
        if len(other):
            raise ResultsError(
                f"the rate of {well} is not constant: it is another one at "
                f"{times[within][other[0]]:g} s; give since= and until= of one flow period, in s"
            )
    if panel is None:
        from matplotlib import pyplot

        panel = pyplot.gca()
    by_time, by_pressure = (
        float(1 / quantity.factor) for quantity in (parse_unit(time), parse_unit(pressure))
    )
    blues, reds = (shades(name, len(shown)) for name in ("Blues", "Reds"))
    for index, blue, red in zip(shown, blues, reds, strict=True):
        title = case_title(dataset, index)
        for values, colour, name in ((change, blue, "Δp"), (derivative, red, "dΔp/d ln t")):
            own = values.isel(index).values
            seen = period & (own > 0.0)
            panel.plot(
                (times[seen] - since) * by_time,
                own[seen] * by_pressure,
                color=colour,
                marker="." if np.count_nonzero(seen) <= 12 else "",
                label=f"{name}, {title}" if title else name,
            )
    panel.set(
        xscale="log",
        yscale="log",
        xlabel=f"time since the rate change ({time})",
        ylabel=f"Δp and dΔp/d ln t ({pressure})",
    )
    return panel


def _least(dataset: xr.Dataset, well: str) -> float:
    """Smallest positive change or derivative of the well, Pa."""
    both = np.concatenate(
        [
            dataset[name].sel(well=well).values.ravel()
            for name in ("pressure_change", "pressure_derivative")
        ]
    )
    return float(np.min(both[both > 0]))


def _legend(
    dataset: xr.Dataset, roles: _Roles, blues: np.ndarray, reds: np.ndarray
) -> list[Line2D]:
    def heading(text: str) -> Line2D:
        return Line2D([], [], linestyle="none", label=legend_text(text))

    handles = [
        Line2D([], [], color=blues[-1], label="Δp"),
        Line2D([], [], color=reds[-1], label="dΔp/d ln t"),
    ]
    colour, style = roles.names[:2]
    if colour:
        handles.append(heading(f"\n{axis_title(colour)}"))
        for position, blue, red in zip(roles.shown[0], blues, reds, strict=True):
            text = axis_value(dataset, colour, position)
            handles.append(
                Line2D(
                    [],
                    [],
                    color=blue,
                    marker="s",
                    markersize=5,
                    markerfacecolor=red,
                    markeredgecolor=red,
                    label=legend_text(text),
                )
            )
    if style:
        handles.append(heading(f"\n{axis_title(style)}"))
        for position, dash in zip(roles.shown[1], LINE_STYLES, strict=False):
            text = axis_value(dataset, style, position)
            handles.append(Line2D([], [], color=GREY, linestyle=dash, label=legend_text(text)))
    return handles


def _caption(dataset: xr.Dataset, well: str, roles: _Roles, drawn: int) -> str:
    window = float(dataset["pressure_derivative"].attrs.get("smoothing_window", SMOOTHING))
    parts = [f"Pressure change and its Bourdet derivative at {well}, {drawn} cases"]
    chosen = [
        f"{axis_title(name)} {', '.join(axis_value(dataset, name, i) for i in shown)}"
        for name, shown in zip(roles.names, roles.shown, strict=True)
        if name and len(shown) < dataset.sizes[name]
    ]
    chosen += [
        f"{axis_title(name)} {axis_value(dataset, name, position)}"
        for name, position in roles.held.items()
        if dataset.sizes[name] > 1
    ]
    if chosen:
        parts.append(f"of more; drawn are {'; '.join(chosen)}")
    text = " ".join(parts) + f". Smoothing of the derivative L = {window:g} (natural-log units)."
    if shut_in(dataset, well):
        text += (
            " The derivative of a shut-in is taken by its equivalent time, t_p Δt / (t_p + Δt) "
            "after one rate, that of all rates before it after several; the abscissa is Δt."
        )
    return (
        text + " The grey fan shows the slopes of wellbore storage and pseudo-steady flow (1), "
        "linear (1/2), bilinear (1/4) and radial flow (0)."
    )


def shut_in(dataset: xr.Dataset, well: str) -> bool:
    """Whether the well of any case is shut in after it flowed."""
    rate = dataset["well_rate"].sel(well=well).transpose(..., "elapsed_time").values
    flowed = np.maximum.accumulate(np.abs(np.nan_to_num(rate)), axis=-1) > 0.0
    return bool(np.any(flowed & (rate == 0.0)))


def _fan_size(panel: Axes) -> tuple[float, float, float]:
    """Length of the fan in decades, and the part of the panel that it takes, wide and high."""
    (x0, x1), (y0, y1) = np.log10(panel.get_xlim()), np.log10(panel.get_ylim())
    reach = min(0.2 * (x1 - x0), 0.26 * (y1 - y0))
    return reach, reach / (x1 - x0), reach / (y1 - y0)


def _emptiest_corner(panels: list[Axes]) -> tuple[float, float]:
    """Where in the panels (as a part of each) a fan of slopes covers least of the data."""
    _, width, height = _fan_size(panels[0])
    (x0, x1), (y0, y1) = np.log10(panels[0].get_xlim()), np.log10(panels[0].get_ylim())
    lines = [np.array(line.get_xydata(), dtype=float) for panel in panels for line in panel.lines]
    data = np.log10(np.concatenate(lines))
    place = (data - [x0, y0]) / [x1 - x0, y1 - y0]
    reach = [0.6 * width + 0.05, 0.6 * height + 0.03]

    def crowd(corner: tuple[float, float]) -> int:
        middle = np.array(corner) + np.array([width, height]) / 2
        return int(np.sum(np.all(np.abs(place - middle) < reach, axis=1)))

    left, right, bottom, top = 0.04, 0.88 - width, 0.06, 0.96 - height
    return min([(left, top), (right, bottom), (left, bottom), (right, top)], key=crowd)


def _slope_fan(panel: Axes, corner: tuple[float, float]) -> None:
    """Short grey lines of slope 1, 1/2, 1/4 and 0."""
    reach, width, height = _fan_size(panel)
    low = np.array([np.log10(panel.get_xlim()[0]), np.log10(panel.get_ylim()[0])])
    start = low + np.array(corner) * reach / np.array([width, height])
    for slope, name in _SLOPES:
        end = start + reach * np.array([1.0, slope])
        ends = 10.0 ** np.stack([start, end], axis=1)
        panel.plot(*ends, color=LIGHT_GREY, linewidth=0.8, zorder=1)
        panel.annotate(
            name,
            tuple(10.0**end),
            xytext=(2, 0),
            textcoords="offset points",
            color=GREY,
            fontsize=7,
            va="center",
        )
