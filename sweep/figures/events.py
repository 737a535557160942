"""What broke: the pressure of the wells and the breaks in time, and the path of the crack."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from demflow.model.outcome import Status
from demflow.sweep.analysis.cases import Index, axes, case_title, display, events
from demflow.sweep.figures.style import (
    BLACK,
    BLUE,
    GREY,
    VERMILION,
    legend_text,
    narrow,
    new_figure,
    save,
    shorten,
)

MOST_CASES = 4
HEIGHT, WIDTH, MAP = 3.0, 4.2, 3.2  # inches of a row, and of its two panels
MODES = (
    (1, "broken in tension", BLUE),
    (2, "broken in shear", VERMILION),
    (3, "sliding joint", BLACK),
)


def draw_events(dataset: xr.Dataset, path: Path) -> Path | None:
    """A row for each of the first cases in which something broke; None where nothing did.

    Parameters
    ----------
    dataset : as `open_results` gives it
    path : where the figure is written
    """
    if not {"event_count", "event_time", "event_x", "event_y", "event_mode"} <= set(dataset):
        return None
    names = axes(dataset)
    status, counts = dataset["status"].values, dataset["event_count"].values
    kept = np.isin(status, (Status.DONE, Status.STOPPED)) & (counts > 0)
    cases: list[Index] = [
        dict(zip(names, map(int, position), strict=True)) for position in np.argwhere(kept)
    ][:MOST_CASES]
    if not cases:
        return None
    if narrow():
        figure = new_figure(WIDTH, HEIGHT * 2 * len(cases))
        panels = figure.subplots(2 * len(cases), 1).reshape(-1, 2)
    else:
        figure = new_figure(WIDTH + MAP + 0.8, HEIGHT * len(cases))
        panels = figure.subplots(len(cases), 2, squeeze=False, width_ratios=(WIDTH, MAP))
    for (in_time, path_of_it), index in zip(panels, cases, strict=True):
        own = events(dataset, index)
        factor, unit = 1.0, ""
        if "well_pressure" in dataset:
            time = dataset["elapsed_time"].values
            pressure = dataset["well_pressure"].isel(index).values
            factor, unit = display("Pa", pressure[np.isfinite(pressure)])
            names_of = [str(name) for name in dataset["well"].values]
            for name, one in zip(names_of, pressure, strict=True):
                in_time.plot(time, factor * one, ".-", label=legend_text(name))
            what = f"pressure of {shorten(names_of[0], 20)}" if len(names_of) == 1 else "pressure"
            in_time.set(ylabel=f"{what} ({unit})", ylim=(0.0, None))
            if len(names_of) > 1:
                in_time.legend(loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=3)
        broken = in_time.twinx()
        at = np.sort(own["event_time"].values)
        last = max(float(dataset["elapsed_time"].values[-1]), float(at[-1]))
        counts_in_time = np.append(np.arange(len(at) + 1), len(at))
        broken.step(np.concatenate([[0.0], at, [last]]), counts_in_time, where="post", color=GREY)
        broken.set(ylabel="breaks and slides until then", ylim=(0.0, None))
        broken.yaxis.get_major_locator().set_params(integer=True)
        broken.grid(False)
        in_time.set_xlabel("time (s)")
        in_time.set_title(textwrap.fill(case_title(dataset, index), 48))
        plot_break_places(own, path_of_it).legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), handletextpad=0.1, borderaxespad=0.2
        )
    return save(figure, path, "Pressure of the wells, breaks in time, and where they are")


def plot_breaks(own: xr.Dataset, panel: Axes) -> Axes:
    """Draw how many contacts broke, or began to slide, until each time, by mode; return the axes.

    Parameters
    ----------
    own : of one case, with `event_time` (s) and `event_mode`
    panel : where to draw
    """
    times = own["event_time"].values
    factor, unit = display("s", times)
    last = times.max(initial=0.0)
    for mode, word, colour in MODES:
        at = np.sort(times[own["event_mode"].values == mode])
        if len(at):
            count = np.append(np.arange(len(at) + 1), len(at))
            places = factor * np.concatenate([[0.0], at, [last]])
            panel.step(places, count, where="post", color=colour, label=f"{len(at)} {word}")
    panel.set(xlabel=f"time ({unit})", ylabel="breaks until then", ylim=(0.0, None))
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))
    return panel


def plot_break_places(own: xr.Dataset, panel: Axes) -> Axes:
    """Draw where contacts broke or began to slide, by mode; return the axes.

    Parameters
    ----------
    own : of one case, with `event_x`, `event_y` (m) and `event_mode`
    panel : where to draw
    """
    scale, length = display("m", np.concatenate([own["event_x"].values, own["event_y"].values]))
    for mode, word, colour in MODES:
        which = own["event_mode"].values == mode
        if which.any():
            panel.scatter(
                scale * own["event_x"].values[which],
                scale * own["event_y"].values[which],
                s=8.0,
                color=colour,
                linewidths=0.0,
                label=f"{np.count_nonzero(which)} {word}",
            )
    panel.set(xlabel=f"x ({length})", ylabel=f"y ({length})")
    panel.set_aspect("equal", adjustable="datalim")
    return panel
