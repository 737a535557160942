"""What flows in time: into a hole, or into a well that is held at a pressure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection
from pathlib import Path

import numpy as np
import xarray as xr

from demflow.sweep.analysis.cases import axes, axis_title, case_title, done, power_of_ten
from demflow.sweep.figures.style import (
    LINE_STYLES,
    legend_text,
    new_figure,
    pick,
    plain_log_ticks,
    save,
    sequence,
    time_unit,
)

MOST_CURVES = 8


def draw_rates(
    dataset: xr.Dataset, flow: xr.DataArray, what: str, path: Path, ensembles: Collection[str]
) -> Path | None:
    """Flows against time, a colour for each value of the axis that changes them most.

    Parameters
    ----------
    dataset : as `open_results` gives it
    flow : m³/s, along the axes of the study, a dimension of wells or sides, and `elapsed_time`
    what : their name, as inflow
    path : where the figure is written
    ensembles : axes whose order means nothing: means are drawn, with bands of their spread

    None where no case is done.
    """
    index = next(done(dataset), None)
    if index is None:
        return None
    (along,) = (str(d) for d in flow.dims if d not in (*axes(dataset), "elapsed_time"))
    names = [str(name) for name in flow[along].values]
    over = [a for a in axes(dataset) if a in ensembles]
    mean, spread = flow.mean(over), flow.std(over)
    varied = [a for a in axes(dataset) if dataset.sizes[a] > 1 and a not in ensembles]
    axis = max(varied, default=None, key=lambda a: float((mean.max(a) - mean.min(a)).max()))
    held = {a: k for a, k in index.items() if a not in over and a != axis}
    shown = pick(dataset.sizes[axis], max(MOST_CURVES // len(names), 1)) if axis else [0]
    times = dataset["elapsed_time"].values
    seen = times > 0.0
    factor, unit = time_unit(times[seen])
    scale, title = in_powers(mean, what)
    panel = (figure := new_figure(5.6, 3.8)).subplots()
    for colour, k in zip(sequence(len(shown)), shown, strict=True):
        at = held | ({axis: k} if axis else {})
        for name, style in zip(names[:MOST_CURVES], itertools.cycle(LINE_STYLES), strict=False):
            own, bar = (
                scale * one.isel(at).sel({along: name}).transpose("elapsed_time").values[seen]
                for one in (mean, spread)
            )
            told = case_title(dataset, {axis: k} if axis else {})
            words = ", ".join(filter(None, [name if len(names) > 1 else "", told])) or name
            look = {"color": colour, "linestyle": style, "label": legend_text(words)}
            panel.plot(times[seen] * factor, own, marker="." if len(own) <= 12 else "", **look)
            if over:
                panel.fill_between(
                    times[seen] * factor, own - bar, own + bar, color=colour, alpha=0.15, lw=0
                )
    panel.set(xscale="log", xlabel=f"time ({unit})", ylabel=title)
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in panel.lines])
    drawn = drawn[np.isfinite(drawn)]
    if len(drawn) and 0.0 < 8.0 * drawn.min() < drawn.max():
        panel.set_yscale("log")
        plain_log_ticks(panel.yaxis)
    panel.legend()
    caption = f"{what.capitalize()} of {', '.join(names[:MOST_CURVES])} in time"
    fixed = case_title(dataset, held)
    caption += f", at {fixed}" if fixed else ""
    if axis and len(shown) < dataset.sizes[axis]:
        caption += f"; {len(shown)} of {dataset.sizes[axis]} values of {axis_title(axis)}"
    if over:
        caption += f"; bands: standard deviation over {', '.join(map(axis_title, over))}"
    return save(figure, path, caption + ".")


def in_powers(flow: xr.DataArray, what: str) -> tuple[float, str]:
    """What makes flows (m³/s) numbers near one, and the label of their axis."""
    most = float(np.nan_to_num(np.abs(flow.values)).max(initial=0.0))
    exponent = math.floor(math.log10(most)) if most > 0.0 else 0
    return 10.0**-exponent, f"{what} ({power_of_ten(exponent)} m³/s for 1 m)"
