"""A measured test and the model that was fitted to it, on one picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from demflow.sweep.analysis.cases import display
from demflow.sweep.analysis.periods import longest_period, transient
from demflow.sweep.figures.style import (
    BLACK,
    BLUE,
    VERMILION,
    house_style,
    new_figure,
    save,
    time_unit,
)

SMOOTHING = 0.2  # L of the derivatives that are drawn


def draw_fit(
    time: np.ndarray,
    pressure: np.ndarray,
    fitted: np.ndarray,
    rates: Sequence[tuple[float, float]],
    title: str,
    path: Path,
) -> Path:
    """Pressure against time, and Δp with its derivative of the period with most points.

    Parameters
    ----------
    title : over the figure
    path : where it is written
    time, pressure, fitted : (n,) s and Pa, measured and by the model.
    rates : (s, m³/s) in order.
    """
    with house_style():
        figure = new_figure(9.6, 4.4)
        whole, logs = figure.subplots(1, 2)
        scale, word = time_unit(time[time > 0])
        factor, unit = display("Pa", pressure)
        whole.plot(time * scale, pressure * factor, "o", ms=3, mfc="none", color=BLUE)
        whole.plot(time * scale, fitted * factor, color=BLACK, linewidth=1.2)
        whole.set(xlabel=f"time ({word})", ylabel=f"pressure ({unit})", title=title)
        period = longest_period(time, rates)
        since = (time[period.members] - period.start) * scale
        for values, name, mark in ((pressure, "measured", "o"), (fitted, "model", "-")):
            change, slope = transient(time, values, rates, period, SMOOTHING)
            if name == "measured":
                dp_scale, dp_unit = display("Pa", change)
            style = {"ms": 3, "mfc": "none"} if mark == "o" else {"linewidth": 1.2}
            colour = BLUE if mark == "o" else BLACK
            logs.plot(since, change * dp_scale, mark, color=colour, label=f"Δp {name}", **style)
            tone = VERMILION if mark == "o" else "#7F2A00"
            logs.plot(since, slope * dp_scale, mark, color=tone, label=f"Δp' {name}", **style)
        logs.set(
            xscale="log",
            yscale="log",
            xlabel=f"time since the rate changed ({word})",
            ylabel=f"Δp and derivative ({dp_unit})",
        )
        logs.legend()
        caption = (
            f"{title}. Measured pressure and the fitted model; on the right the flow period with "
            "most points: pressure change and Bourdet derivative by superposition time "
            f"(L = {SMOOTHING})."
        )
        return save(figure, path, caption)
