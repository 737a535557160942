"""A measured test and the model that was fitted to it, on one picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from demflow.model.transient import bourdet_derivative, flow_periods, log_time
from demflow.sweep.analysis.cases import display
from demflow.sweep.figures.style import (
    BLACK,
    BLUE,
    VERMILION,
    house_style,
    new_figure,
    save,
    time_unit,
)


def longest_period(
    time: np.ndarray, rates: Sequence[tuple[float, float]]
) -> tuple[float, float, np.ndarray]:
    """Start, sign and members of the flow period with most points."""
    starts, signs = flow_periods(rates)
    period = np.searchsorted(starts, time, side="left") - 1
    counts = np.bincount(period[period >= 0], minlength=len(starts))
    k = int(np.argmax(counts))
    return float(starts[k]), float(signs[k]), period == k


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
        start, sign, members = longest_period(time, rates)
        at = time[members]
        before = np.flatnonzero(time <= start)
        # the level at the change: the last point before it, by measurement and by model
        level = (
            (pressure[before[-1]], fitted[before[-1]])
            if len(before)
            else (float(np.max(pressure * sign) * sign),) * 2
        )
        x = log_time(at, rates, "superposition")
        rows = ((pressure, level[0], "o", BLUE), (fitted, level[1], "-", BLACK))
        dp_scale, dp_unit = display("Pa", sign * (level[0] - pressure[members]))
        for values, first, mark, colour in rows:
            change = sign * (first - values[members])
            slope = bourdet_derivative(at, change, (start,), 0.2, x=x)
            since = (at - start) * scale
            style = {"ms": 3, "mfc": "none"} if mark == "o" else {"linewidth": 1.2}
            name = "measured" if mark == "o" else "model"
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
            "most points: pressure change and Bourdet derivative by superposition time (L = 0.2)."
        )
        return save(figure, path, caption)
