"""What a gauge has measured beside what a study computes for its well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from demflow.sweep.analysis.cases import case_title, display, done, with_unit
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.style import BLACK, BLUE, legend_text, new_figure, save, shades
from demflow.sweep.figures.wells import MOST_LINES
from demflow.sweep.study.measured import MeasuredTest


def misfit(
    computed_at: np.ndarray, computed: np.ndarray, time: np.ndarray, pressure: np.ndarray
) -> float:
    """Root mean square of computed less measured pressure at the computed times, Pa.

    The record is linear between its points; NaN where no computed time lies within it.

    Parameters
    ----------
    computed_at, computed : (k,) s and Pa, by the model.
    time, pressure : (n,) s, increasing, and Pa, by the gauge.
    """
    both = (computed_at >= time[0]) & (computed_at <= time[-1]) & np.isfinite(computed)
    if not both.any():
        return float("nan")
    off = computed[both] - np.interp(computed_at[both], time, pressure)
    return float(np.sqrt(np.mean(off**2)))


def plot_measured(
    dataset: xr.Dataset, well: str, time: np.ndarray, pressure: np.ndarray, panel: Axes
) -> Axes:
    """Draw a record as points and the computed pressure of its well as a line for each case.

    Where more cases are done than can be told apart, it is their median and the band from the
    least to the greatest. Both clocks begin at the same zero.

    Parameters
    ----------
    dataset : as `open_results` gives it, with `well_pressure`
    well : name of the well
    time, pressure : (n,) s, increasing, and Pa, measured
    panel : where to draw

    Raises ResultsError where no case is done, or time and pressure are no record.
    """
    time, pressure = np.asarray(time, dtype=float), np.asarray(pressure, dtype=float)
    known = np.isfinite(time).all() and np.isfinite(pressure).all()
    if time.ndim != 1 or time.shape != pressure.shape or not len(time) or not known:
        raise ResultsError("a record is as many finite times as pressures, one after the other")
    if np.any(np.diff(time) <= 0.0):
        raise ResultsError("the times of a record must increase")
    shown = list(done(dataset))
    if not shown:
        raise ResultsError("no case is done: there is nothing to lay beside the record")
    values = dataset["well_pressure"].sel(well=well)
    at = dataset["elapsed_time"].values
    curves = np.array([values.isel(index).values for index in shown], dtype=float)
    scale, word = display("s", float(max(at.max(), time[-1])))
    factor, unit = display("Pa", pressure)
    panel.plot(
        time * scale, pressure * factor, "o", ms=3, mfc="none", color=BLACK, label="measured"
    )

    def told(name: str, curve: np.ndarray) -> str:
        off = misfit(at, curve, time, pressure)
        return legend_text(f"{name}: rms {with_unit(off, 'Pa', 3)}" if np.isfinite(off) else name)

    if len(shown) > MOST_LINES:
        panel.fill_between(
            at * scale, curves.min(axis=0) * factor, curves.max(axis=0) * factor,
            color=BLUE, alpha=0.25, linewidth=0, label=f"{len(shown)} cases, least to greatest",
        )  # fmt: skip
        middle = np.median(curves, axis=0)
        panel.plot(at * scale, middle * factor, color=BLUE, label=told("median", middle))
    else:
        for index, curve, colour in zip(shown, curves, shades("Blues", len(shown)), strict=True):
            name = case_title(dataset, index) or "computed"
            line = {"color": colour, "marker": ".", "label": told(name, curve)}
            panel.plot(at * scale, curve * factor, **line)
    panel.set(xlabel=f"time ({word})", ylabel=f"pressure of {well} ({unit})")
    return panel


def draw_measured(dataset: xr.Dataset, test: MeasuredTest, path: Path) -> Path | None:
    """A test of the study's `data` beside what its cases compute; None where none has its well.

    Parameters
    ----------
    dataset : as `open_results` gives it
    test : the record; one that names no well is that of the only one
    path : where the figure is written
    """
    if "well_pressure" not in dataset:
        return None
    wells = list(map(str, dataset["well"].values))
    well = test.well or (wells[0] if len(wells) == 1 else None)
    if well not in wells:
        return None
    figure = new_figure(7.4, 4.6)
    panel = plot_measured(dataset, well, test.time, test.pressure, figure.subplots())
    panel.set_title(f"Well {well}: measured ({test.name}) and computed")
    panel.legend()
    caption = (
        f"Measured pressure of well {well} (data.{test.name}, {len(test.time)} points) and what "
        "the cases compute at the times of the study, straight in between, by the time since the "
        "beginning of both. rms: root mean square of computed less measured pressure at the "
        "study's times within the record. Nothing is fitted or shifted here."
    )
    return save(figure, path, caption)
