"""Work and precision: the error of every solver against its processor time, scene by scene."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from demflow.sweep.analysis.cases import plain_number
from demflow.sweep.analysis.speed import Ladder, SpeedError
from demflow.sweep.figures.style import (
    BLACK,
    BLUE,
    GREY,
    LIGHT_GREY,
    VERMILION,
    heading,
    legend_text,
    narrow,
    new_figure,
    save,
)

_COLOURS = {"explicit": VERMILION, "implicit": BLUE, "krylov": BLACK}
_MARKERS = {"explicit": "s", "implicit": "o", "krylov": "D"}
_NOTE = """\
Each line is one solver, each point one of its settings, from loose to tight. Lower is more \
exact, further left is faster. {sizes}

Time error: the solver's own, against the solution of the same network to 1e-10.

Model error (grey): the network's, against the continuum; mean of {packings} packings, band \
from the best to the worst. A time error below it buys no more truth."""


def draw_speed(result: SpeedError, path: Path) -> Path:
    """One panel a scene, a panel for the model error by size, and how to read them."""
    shown = result.scenes
    rows, columns = (len(shown), 1) if narrow() else (2, -(-len(shown) // 2))
    # the model's error and how to read it stand below the scenes, or right of them
    below, right = (1, 0) if narrow() else (0, 1)
    high = 1.9 if narrow() else 3.45
    figure = new_figure(3.55 * (columns + right), high * (rows + below))
    panels = figure.subplots(rows + below, columns + right, squeeze=False)
    scenes = list(panels[:rows, :columns].ravel()[: len(shown)])
    for panel in panels[:rows, :columns].ravel()[len(shown) :]:
        panel.axis("off")
    for panel, scene in zip(scenes, shown, strict=True):
        _draw_scene(panel, scene, result)
    for panel in scenes[1:]:
        panel.sharex(scenes[0])
        panel.sharey(scenes[0])
    if any(np.isfinite(ladder.error * ladder.seconds).any() for ladder in result.ladders):
        scenes[0].set(xscale="log", yscale="log")
    for panel in panels[:rows, 0]:
        panel.set_ylabel("time error, relative")
    for panel in panels[rows - 1, :columns]:
        panel.set_xlabel("processor time (s)")
    _draw_model(panels[-1, -1] if narrow() else panels[0, -1], result)
    methods = dict.fromkeys(ladder.method for ladder in result.ladders)
    handles = [
        Line2D([], [], color=_COLOURS.get(m, GREY), marker=_MARKERS.get(m, "^"), label=m)
        for m in methods
    ]
    if narrow():  # the words under a figure say how to read it
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    else:
        _explain(panels[1, -1], result, handles)
    heading(figure, f"Speed against error of every solver{_gain(result)}", fontsize=11.5)
    caption = (
        f"Error in time against processor time of {', '.join(methods)} on {_list(shown)}, median "
        f"over packings, for {_list([f'{n:,}' for n in result.sizes])} grains. The error is that "
        "of well pressures (where there is no well, of all pore pressures) against the solution of "
        "the same network to 1e-10; the time includes setting up the equations. Grey: model "
        "error against the continuum's formula, mean and range over packings."
    )
    return save(figure, path, caption)


def _draw_scene(panel: Axes, scene: str, result: SpeedError) -> None:
    largest = max(result.sizes)
    for ladder in (one for one in result.ladders if one.scene == scene):
        strong = ladder.grains == largest
        order = np.argsort(ladder.error)[::-1]
        panel.plot(
            ladder.seconds[order],
            ladder.error[order],
            color=_COLOURS.get(ladder.method, GREY),
            marker=_MARKERS.get(ladder.method, "^") if strong else "",
            markersize=4.5,
            linewidth=1.5 if strong else 0.8,
            alpha=1.0 if strong else 0.3,
            zorder=3 if strong else 2,
        )
    models = [m for m in result.models if m.scene == scene and m.grains == largest]
    for model in models:
        low, mean, high = model.error.min(), model.error.mean(), model.error.max()
        panel.axhspan(low, high, color=LIGHT_GREY, alpha=0.35, linewidth=0)
        panel.axhline(mean, color=GREY, linewidth=1.2)
        panel.annotate(
            f"model error {100 * mean:.2g} % ({model.formula})",
            (0.98, high),
            xycoords=("axes fraction", "data"),
            xytext=(0, 2),
            textcoords="offset points",
            ha="right",
            va="bottom",
            fontsize=7.5,
            color=GREY,
        )
    panel.set_title(scene)
    refused = [one for one in result.ladders if _refused(one, scene, largest)]
    for k, ladder in enumerate(refused):
        text = textwrap.fill(f"{ladder.refusal.split(';')[0]}: refused", 42)
        panel.text(
            0.97,
            0.97 - 0.16 * k,
            text,
            transform=panel.transAxes,
            ha="right",
            va="top",
            fontsize=7.5,
            color=_COLOURS.get(ladder.method, GREY),
        )


def _refused(ladder: Ladder, scene: str, grains: int) -> bool:
    return ladder.scene == scene and ladder.grains == grains and bool(ladder.refusal)


def plot_work_precision(ladders: Sequence[Ladder], panel: Axes) -> Axes:
    """Draw the error of each solver against its processor time, log-log; return the axes.

    Parameters
    ----------
    ladders : solvers from their loosest setting on, see `sweep.analysis.speed.ladders_of`
    panel : where to draw
    """
    for ladder in ladders:
        order = np.argsort(ladder.error)[::-1]
        panel.plot(
            ladder.seconds[order],
            ladder.error[order],
            color=_COLOURS.get(ladder.method, GREY),
            marker=_MARKERS.get(ladder.method, "^"),
            markersize=4.5,
            label=legend_text(ladder.method),
        )
    panel.set(
        xscale="log",
        yscale="log",
        xlabel="processor time (s)",
        ylabel="time error, relative",
    )
    return panel


def _draw_model(panel: Axes, result: SpeedError) -> None:
    """Model error of each packing by size, and the mean."""
    panel.set_title("model error")
    scenes = dict.fromkeys(model.scene for model in result.models)
    if not scenes:
        panel.axis("off")
        return
    for scene, colour in zip(scenes, (GREY, "#009E73", "#CC79A7", BLUE), strict=False):
        models = [model for model in result.models if model.scene == scene]
        sizes = [model.grains for model in models]
        for model in models:
            here = np.full(len(model.error), model.grains)
            panel.plot(here, model.error, ".", color=colour, alpha=0.5, markersize=4)
        name = f"{scene} ({models[0].formula})"
        mean = [model.error.mean() for model in models]
        panel.plot(sizes, mean, marker="o", markersize=4.5, color=colour, label=legend_text(name))
    panel.set(xscale="log", yscale="log", xlabel="grains", ylabel="against the continuum, relative")
    panel.set_xticks(result.sizes, [f"{n:,}" for n in result.sizes])
    panel.minorticks_off()
    panel.legend(loc="upper right")


def _explain(panel: Axes, result: SpeedError, handles: list[Line2D]) -> None:
    panel.axis("off")
    panel.legend(handles=handles, loc="upper left", ncols=len(handles), columnspacing=1.0)
    *others, largest = (f"{n:,}" for n in sorted(result.sizes))
    sizes = f"{largest} grains; faint: {_list(others)}." if others else f"{largest} grains."
    packings = max((len(model.error) for model in result.models), default=1)
    note = _NOTE.format(sizes=sizes, packings=packings)
    lines = [textwrap.fill(part, 46) for part in note.split("\n\n")]
    panel.text(0.02, 0.84, "\n\n".join(lines), va="top", fontsize=8.5, transform=panel.transAxes)


def _gain(result: SpeedError) -> str:
    """What krylov saves against explicit at its best error, over the scenes, for the title."""
    largest, found = max(result.sizes), []
    for scene in result.scenes:
        of = {o.method: o for o in result.ladders if (o.scene, o.grains) == (scene, largest)}
        if not {"explicit", "krylov"} <= of.keys():
            continue
        euler, krylov = of["explicit"], of["krylov"]
        if not np.isfinite(euler.error).any():
            continue
        good = krylov.error <= np.nanmin(euler.error)
        if good.any():
            k = int(np.nanargmin(euler.error))
            found.append(euler.seconds[k] / krylov.seconds[good].min())
    if not found:
        return ""
    ends = dict.fromkeys(plain_number(ratio, 2) for ratio in (min(found), max(found)))
    return f": at explicit's best error, krylov is {' to '.join(ends)} times faster"


def _list(words: list[str] | tuple[str, ...]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
