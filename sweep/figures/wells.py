"""Diagnostic plots of the wells: pressure change and its derivative on log-log axes."""

from __future__ import annotations

from collections.abc import Callable
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
    decade_ticks,
    fixed_panels,
    heading,
    legend_text,
    narrow,
    pick,
    save,
    shades,
    shorten,
    time_unit,
)
from demflow.sweep.study.units import parse_unit

WellOf = Callable[[Index, str], Well | None]  # None: the case has no such well

MOST_LINES = 10  # cases on axes of the caller's

MOST_VALUES = 4  # of an axis in its panel: eight curves
MOST_PANELS = 4
WIDTH, ALONE = 3.5, 5.6  # inches of a panel beside others, and of one alone
_DECADES = 4.5  # shown below the largest pressure change
_SHAPE = (0.5, 1.1)  # height of a panel over its width, whose decades are as long both ways
_SLOPES = ((1.0, "1"), (0.5, "1/2"), (0.25, "1/4"), (0.0, "0"))


class _Panel(NamedTuple):
    """One axis of the study and which of its values are drawn; the others stay as `held`."""

    axis: str | None
    shown: list[Index]


def _panels(dataset: xr.Dataset, held: Index) -> list[_Panel]:
    """A panel for each axis that varies, of its cases that are done."""
    found = []
    for axis in [a for a in axes(dataset) if dataset.sizes[a] > 1][:MOST_PANELS]:
        cases = [held | {axis: k} for k in range(dataset.sizes[axis])]
        good = [one for one in cases if int(dataset["status"].isel(one)) == Status.DONE]
        found.append(_Panel(axis, [good[k] for k in pick(len(good), MOST_VALUES)]))
    return found or [_Panel(None, [held])]


def draw_well(dataset: xr.Dataset, well: str, well_of: WellOf, path: Path) -> Path | None:
    """Pressure change and Bourdet derivative of one well; None where no case has any.

    A panel for each of the first axes, in which that axis alone varies: the others are as in the
    first case that is done. Of long axes a few values are drawn, and the caption says which. Flow
    periods after the first are thinner lines over the time since their own rate change.

    Parameters
    ----------
    dataset : as `open_results` gives it
    well : name of the well
    well_of : the well of the case at an index
    path : where the figure is written
    """
    times = dataset["elapsed_time"].values
    flows = dataset["pressure_change"].sel(well=well)
    seen = (flows.transpose(*axes(dataset), ...) > 0).any("elapsed_time").values
    good = [index for index in done(dataset) if seen[tuple(index.values())]]
    if not good:
        return None
    shown = _panels(dataset, good[0])
    time_factor, time_name = time_unit(times)
    lines: list[list[_Line]] = []
    curves = dataset[["pressure_change", "pressure_derivative"]]
    for one in shown:
        blues, reds = (shades(name, len(one.shown)) for name in ("Blues", "Reds"))
        lines.append([])
        for index, blue, red in zip(one.shown, blues, reds, strict=True):
            own = well_of(index, well)
            if own is not None:
                lines[-1] += _lines(curves.isel(index), well, own, (blue, red))
    drawn = [line for own in lines for line in own if len(line.time)]
    if not drawn:
        return None
    top = max(float(line.value.max()) for line in drawn)
    factor, pressure_name = display("Pa", top)
    x, y, shape = _limits(drawn, top)
    beside_each_other = 1 if narrow() else {1: 1, 3: 3}.get(len(shown), 2)
    rows = -(-len(shown) // beside_each_other)
    width = ALONE if len(shown) == 1 else WIDTH
    heads = [_entries(dataset, one) for one in shown]
    room = 0.2 + 0.17 * max(-(-len(head.handles) // head.columns) for head in heads)
    figure, panels = fixed_panels(
        rows, beside_each_other, (width, width * shape),
        between=(0.25, room + 0.12), margins=(0.75, 0.2, 0.6, room + 0.42), shown=len(shown),
    )  # fmt: skip
    for panel, drawn_there, head in zip(panels, lines, heads, strict=True):
        _draw_panel(panel, drawn_there, head, (time_factor, factor))
        panel.set(xlim=np.multiply(x, time_factor), ylim=np.multiply(y, factor))
        decade_ticks(panel.xaxis)
        decade_ticks(panel.yaxis)
    fan = _emptiest_corner(panels)
    for k, panel in enumerate(panels):
        _slope_fan(panel, *fan)
        if k + beside_each_other >= len(panels):
            panel.set_xlabel(f"time since the rate change ({time_name})")
        if k % beside_each_other == 0:
            panel.set_ylabel(f"Δp (blue), dΔp/d ln t (red) ({pressure_name})")
    # from the left, so that it stands over what it names
    heading(
        figure, f"Well {well}: pressure change and Bourdet derivative", x=0.01, ha="left",
        fontsize=11,
    )  # fmt: skip
    return save(figure, path, _caption(dataset, well, shown, good[0]))


def _draw_panel(panel: Axes, lines: list[_Line], head: _Head, factors: tuple[float, float]) -> None:
    """Curves and their names over them, in units for people."""
    for line in lines:
        panel.plot(
            line.time * factors[0],
            line.value * factors[1],
            color=line.colour,
            linewidth=rcParams["lines.linewidth"] * (1.0 if line.first else 0.55),
            marker="." if len(line.time) <= 12 else "",
        )
    panel.set(xscale="log", yscale="log")
    if head.handles:
        panel.legend(
            handles=head.handles,
            ncols=head.columns,
            loc="lower left",
            borderaxespad=0.1,
            bbox_to_anchor=(0.0, 1.0),
            columnspacing=1.2,
            handlelength=1.6,
            title=head.title,
            alignment="left",
            title_fontsize=rcParams["axes.titlesize"],
        )


class _Line(NamedTuple):
    """A curve of one flow period."""

    time: np.ndarray  # s since the rate change
    value: np.ndarray  # Pa
    colour: np.ndarray
    first: bool  # of the periods


def _lines(
    case: xr.Dataset, well: str, own: Well, colours: tuple[np.ndarray, np.ndarray]
) -> list[_Line]:
    times = case["elapsed_time"].values
    starts, _ = flow_periods(own.rate_changes)
    found = []
    for name, colour in zip(("pressure_change", "pressure_derivative"), colours, strict=True):
        values = case[name].sel(well=well).values
        for k, start in enumerate(starts):
            end = starts[k + 1] if k + 1 < len(starts) else np.inf
            seen = (times > start) & (times <= end) & (values > 0)
            found.append(_Line(times[seen] - start, values[seen], colour, k == 0))
    return found


def _limits(
    lines: list[_Line], top: float
) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Ends of both axes, s and Pa, and height over width at which decades are as long both ways."""
    since = np.concatenate([line.time for line in lines])
    x = (float(since.min()) / 1.3, float(since.max()) * 1.3)
    least = min(float(line.value.min()) for line in lines)
    wide = np.log10(x[1] / x[0])
    high = np.log10(2.0 * top / max(least / 1.5, top / 10**_DECADES))
    high = float(max(high, _SHAPE[0] * wide))
    if high > _SHAPE[1] * wide:  # longer times, for no value is cut off below
        beside = 10 ** (0.5 * (high / _SHAPE[1] - wide))
        x, wide = (x[0] / beside, x[1] * beside), high / _SHAPE[1]
    return x, (2.0 * top / 10**high, 2.0 * top), high / wide


class _Head(NamedTuple):
    """What stands over a panel."""

    title: str
    handles: list[Line2D]
    columns: int


def _entries(dataset: xr.Dataset, panel: _Panel) -> _Head:
    """A mark and a value for each case of a panel."""
    if panel.axis is None:
        return _Head("", [], 1)
    blues, reds = (shades(name, len(panel.shown)) for name in ("Blues", "Reds"))
    texts = [shorten(axis_value(dataset, panel.axis, one[panel.axis])) for one in panel.shown]
    handles = [
        Line2D([], [], color=blue, marker="s", markersize=5, markerfacecolor=red,
               markeredgecolor=red, label=legend_text(text))
        for text, blue, red in zip(texts, blues, reds, strict=True)
    ]  # fmt: skip
    longest = max((len(text) for text in texts), default=1)
    return _Head(axis_title(panel.axis), handles, max(1, min(len(texts), 44 // (longest + 6))))


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
    leave_out_the_least(panel)
    return panel


def leave_out_the_least(panel: Axes) -> None:
    """End the y axis some decades below the largest value: a derivative dies away without end."""
    tops = [np.asarray(line.get_ydata(), dtype=float).max(initial=0.0) for line in panel.lines]
    least = max(tops, default=0.0) / 10**_DECADES
    if 0.0 < panel.get_ylim()[0] < least:
        panel.set_ylim(bottom=least)


def _caption(dataset: xr.Dataset, well: str, panels: list[_Panel], held: Index) -> str:
    window = float(dataset["pressure_derivative"].attrs.get("smoothing_window", SMOOTHING))
    drawn = {tuple(index.items()) for panel in panels for index in panel.shown}
    text = f"Pressure change (blue) and its Bourdet derivative (red) at {well}, {len(drawn)}"
    total = sum(1 for _ in done(dataset))
    text += f" of {total} cases" if total > len(drawn) else " cases" if total > 1 else " case"
    if len(panels) > 1 or total > len(drawn):
        told = "each panel varies one axis, the others are at " if len(panels) > 1 else ""
        told += case_title(dataset, held) if told else "values in between are left out"
        text += f": {told}"
    text += f". Smoothing of the derivative L = {window:g} (natural-log units)."
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


def _fan_size(panel: Axes, share: float) -> tuple[float, float, float]:
    """Length of the fan in decades, and the part of the panel that it takes, wide and high.

    `share` is of its greatest length, a fifth of the panel's width.
    """
    (x0, x1), (y0, y1) = np.log10(panel.get_xlim()), np.log10(panel.get_ylim())
    reach = share * min(0.2 * (x1 - x0), 0.26 * (y1 - y0))
    return reach, reach / (x1 - x0), reach / (y1 - y0)


def _emptiest_corner(panels: list[Axes]) -> tuple[tuple[float, float], float]:
    """Where in the panels (as a part of each) a fan of slopes covers least of the data.

    And the share of its length: less where it would cover any in every corner.
    """
    (x0, x1), (y0, y1) = np.log10(panels[0].get_xlim()), np.log10(panels[0].get_ylim())
    lines = [np.array(line.get_xydata(), dtype=float) for panel in panels for line in panel.lines]
    place = np.concatenate(
        [_along((np.log10(one) - [x0, y0]) / [x1 - x0, y1 - y0]) for one in lines]
    )
    found = []
    for share in (1.0, 0.7, 0.5):
        _, width, height = _fan_size(panels[0], share)
        reach = [0.6 * width + 0.05, 0.6 * height + 0.03]
        left, right, bottom, top = 0.04, 0.88 - width, 0.06, 0.96 - height
        for corner in ((left, top), (right, bottom), (left, bottom), (right, top)):
            middle = np.array(corner) + np.array([width, height]) / 2
            crowd = int(np.sum(np.all(np.abs(place - middle) < reach, axis=1)))
            if crowd == 0:
                return corner, share
            found.append((crowd, corner, share))
    _, corner, share = min(found)
    return corner, share


def _along(line: np.ndarray) -> np.ndarray:
    """Points close together along a line of few, (n, 2)."""
    share = np.linspace(0.0, 1.0, 12)[:, None, None]
    between: np.ndarray = line[:-1] + share * np.diff(line, axis=0)
    return between.reshape(-1, 2) if len(line) > 1 else line


def _slope_fan(panel: Axes, corner: tuple[float, float], share: float) -> None:
    """Short grey lines of slope 1, 1/2, 1/4 and 0."""
    reach, width, height = _fan_size(panel, share)
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
