"""What one constant rate would have shown: a deconvolved record beside what cases compute."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from demflow.sweep.analysis.cases import case_title, done, with_unit
from demflow.sweep.analysis.deconvolution import Deconvolved
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import BLUE, VERMILION, legend_text, shades
from demflow.sweep.figures.wells import MOST_LINES, leave_out_the_least
from demflow.sweep.study.units import parse_unit

SURE = 1.96  # standard deviations of a 95 % band


def plot_deconvolution(
    dataset: xr.Dataset,
    well: str,
    found: Deconvolved,
    panel: Axes,
    *,
    time: str = "h",
    pressure: str = "kPa",
) -> Axes:
    """Draw the response behind a record at its largest rate, and that of the cases at it.

    Dots are the pressure change (blue) and its derivative (red) at the nodes of the deconvolution,
    the band the derivative's 95 %, regularisation included; lines are what cases compute that
    flow at one rate from the start, as their rock is linear.

    Parameters
    ----------
    dataset : as `open_results` gives it
    well : name of the well
    found : what `sweep.analysis.deconvolution.deconvolve` gives of the record
    panel : where to draw
    time, pressure : units of the axes

    Raises ResultsError where the rate of a case changes, or too many cases are done.
    """
    rate = float(found.rates[np.argmax(np.abs(found.rates))])
    by_time, by_pressure = (float(1 / parse_unit(unit).factor) for unit in (time, pressure))
    scale = abs(rate) * by_pressure
    at = found.time * by_time
    spread = np.exp(SURE * found.spread)
    panel.fill_between(
        at,
        found.derivative / spread * scale,
        found.derivative * spread * scale,
        color=VERMILION,
        alpha=0.2,
        linewidth=0.0,
    )
    for values, colour, name in (
        (found.change, BLUE, "Δp"),
        (found.derivative, VERMILION, "dΔp/d ln t"),
    ):
        panel.plot(
            at, values * scale, "o", ms=3.5, mfc="none", color=colour,
            label=f"{name}, deconvolved",
        )  # fmt: skip
    shown = list(done(dataset))
    if len(shown) > MOST_LINES:
        raise ResultsError(
            f"{len(shown)} cases are done, and at most {MOST_LINES} can be told apart; choose some"
        )
    blues, reds = (shades(name, len(shown)) for name in ("Blues", "Reds"))
    for index, blue, red in zip(shown, blues, reds, strict=True):
        case = dataset.isel(index).sel(well=well)
        own = case["well_rate"].values
        own = own[np.isfinite(own)]
        title = case_title(dataset, index)
        if not len(own) or np.ptp(own) > 1e-9 * np.abs(own).max() or own[0] == 0.0:
            raise ResultsError(
                f"the rate of {well} is not one{f' at {title}' if title else ''}: a deconvolved "
                "record is laid beside cases that flow at one rate from the start"
            )
        for name, colour, word in (
            ("pressure_change", blue, "Δp"),
            ("pressure_derivative", red, "dΔp/d ln t"),
        ):
            values = case[name].values * abs(rate / own[0]) * by_pressure
            seen = values > 0.0
            panel.plot(
                dataset["elapsed_time"].values[seen] * by_time, values[seen], color=colour,
                linewidth=1.2, label=legend_text(f"{word}, {title or 'computed'}"),
            )  # fmt: skip
    panel.set(
        xscale="log",
        yscale="log",
        xlabel=f"time at one rate ({time})",
        ylabel=f"Δp and dΔp/d ln t ({pressure}) at {with_unit(abs(rate), 'm3 s-1', 3)}",
    )
    leave_out_the_least(panel)
    return panel
