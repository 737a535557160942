"""Computed against analytical: dimensionless pressures of linear and of radial flow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from demflow.model.analytic.linear import linear_pressure
from demflow.model.analytic.radial import radial_dimensionless_pressure
from demflow.sweep.analysis.cases import plain_number
from demflow.sweep.analysis.linear_flow import LinearComparison
from demflow.sweep.analysis.radial_flow import RadialComparison
from demflow.sweep.figures.style import (
    BLACK,
    GREY,
    VERMILION,
    beside,
    heading,
    narrow,
    new_figure,
    pick,
    save,
    sequence,
)

MOST_TIMES = 8


def draw_linear(result: LinearComparison, path: Path) -> Path:
    """P_D along the flow: means over cases as markers, Eq. 24 as lines, and what is between."""
    shown = pick(result.times.shape[1], MOST_TIMES)
    cases = len(result.titles)
    figure = new_figure(7.6, 6.0)
    main, rest = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
    x = np.linspace(0.0, 1.0, 201)
    for i, colour in zip(shown, sequence(len(shown)), strict=True):
        t_D = float(result.t_D[:, i].mean())
        curve = linear_pressure(
            x,
            t_D,
            length=1.0,
            diffusivity=1.0,
            initial=float(result.initial.mean()),
            first=0.0,
            second=1.0,
        )
        main.plot(x, curve, color=colour, linewidth=1.2)
        computed, expected = result.computed[:, i], result.expected[:, i]
        _markers(main, result.x_D, computed, expected, colour, plain_number(t_D, 3))
        _difference(rest, result.x_D, 100 * (computed - expected), colour)
    main.set_ylabel("P_D = (P_1 − P) / (P_1 − P_2)")
    rest.axhline(0.0, color=BLACK, linewidth=0.8)
    rest.set(xlabel="x_D = x / L", ylabel="difference\n(% of P_1 − P_2)", xlim=(0, 1))
    handles, labels = main.get_legend_handles_labels()
    if narrow():
        figure.legend(handles, labels, title="t_D", loc="outside lower center", ncols=4)
    else:
        beside(figure, handles=handles, labels=labels, title="t_D")
    rms = 100 * result.rms
    heading(
        figure,
        f"Linear flow, {_cases(cases)}: markers computed, lines Eq. 24\n"
        f"RMS {rms.mean():.2f} % in the mean, {rms.max():.2f} % worst; "
        f"porosity {_range(result.porosity)}",
        fontsize=10.5,
    )
    bars = ", bars and bands one standard deviation" if cases > 1 else ""
    caption = (
        f"Dimensionless pressure in {len(result.x_D)} bins along the flow against Eq. 24, mean of "
        f"{_cases(cases)}{bars}. t_D follows from each case's own porosity "
        f"({_range(result.porosity)}). RMS over bins and times {rms.mean():.3f} % of P_1 − P_2 in "
        f"the mean, {rms.max():.3f} % for the worst case."
    )
    return save(figure, path, caption)


def draw_radial(result: RadialComparison, path: Path) -> Path:
    """P_D of the well in time, and along the radius, with Eq. 29 as lines."""
    cases = len(result.titles)
    profiles = result.R_D.size > 0
    parts = 2 if profiles else 1
    below = parts if narrow() else 1  # each other, else side by side
    figure = new_figure(10.4 if parts > below else 6.2, 5.8 * below)
    ratios = (3.0, 1.2) * below
    panels = figure.subplots(2 * below, parts // below, height_ratios=ratios, squeeze=False)
    pairs = [panels[2 * k : 2 * k + 2, 0] if below > 1 else panels[:, k] for k in range(parts)]
    for (main, rest), draw in zip(pairs, (_draw_well, _draw_profiles), strict=False):
        rest.sharex(main)
        draw(result, main, rest)
        main.tick_params(labelbottom=False)
    mean = result.error.mean(axis=0)
    steady = result.steady_error.mean()
    heading(
        figure,
        f"Radial flow, {_cases(cases)}: markers computed, lines Eq. 29\n"
        f"well: {100 * np.abs(mean).mean():.2f} % off Eq. 29 averaged over the times, "
        f"{100 * np.abs(mean).max():.2f} % at most; last well pressure "
        f"{result.steady_pressure.mean() / 1e6:.3f} MPa ({100 * steady:+.2f} % of the fall)",
        fontsize=10.5,
    )
    caption = (
        f"Dimensionless pressure of the well against Eq. 29, R_De = {result.R_De:.4g}: mean of "
        f"{_cases(cases)}" + (", bars and bands one standard deviation" if cases > 1 else "")
    )
    if profiles:
        caption += ", and along the radius at chosen times (pores in rings of equal ratio)"
    caption += (
        f". t_D follows from each case's own porosity ({_range(result.porosity)}). "
        f"Mean well pressure at the last time {result.steady_pressure.mean() / 1e6:.4g} MPa, "
        f"steady state by formula {result.expected_steady.mean() / 1e6:.4g} MPa."
    )
    return save(figure, path, caption)


def _draw_well(result: RadialComparison, main: Axes, rest: Axes) -> None:
    t_D = result.t_D.mean(axis=0)
    fine = np.geomspace(t_D.min() / 2, t_D.max() * 2, 300)
    main.plot(
        fine,
        radial_dimensionless_pressure(1.0, fine, result.R_De),
        color=BLACK,
        linewidth=1.2,
        label="Eq. 29",
    )
    if len(result.titles) > 1:
        main.plot(
            result.t_D.ravel(),
            result.well.ravel(),
            linestyle="none",
            marker=".",
            markersize=4,
            color=GREY,
            alpha=0.6,
            label="one case",
        )
        rest.plot(
            result.t_D.ravel(),
            100 * result.error.ravel(),
            linestyle="none",
            marker=".",
            markersize=4,
            color=GREY,
            alpha=0.6,
        )
    name = "mean of cases" if len(result.titles) > 1 else "computed"
    _markers(main, t_D, result.well, result.expected, VERMILION, name)
    _difference(rest, t_D, 100 * result.error, VERMILION)
    rest.axhline(0.0, color=BLACK, linewidth=0.8)
    main.set(title="well", ylabel="P_D = (P_i − P) / (P_i − P_w,steady)", xscale="log")
    main.legend(loc="upper left")
    rest.set(xlabel="t_D = k t / (φ μ c r_w²)", ylabel="difference\n(% of Eq. 29)")


def _draw_profiles(result: RadialComparison, main: Axes, rest: Axes) -> None:
    shown = pick(result.times.shape[1], MOST_TIMES)
    fine = np.geomspace(1.0, result.R_De, 200)
    for i, colour in zip(shown, sequence(len(shown)), strict=True):
        t_D = float(result.t_D[:, i].mean())
        main.plot(
            fine, radial_dimensionless_pressure(fine, t_D, result.R_De), color=colour, linewidth=1.2
        )
        profile, expected = result.profile[:, i], result.expected_profile[:, i]
        _markers(main, result.R_D, profile, expected, colour, plain_number(t_D, 3))
        _difference(rest, result.R_D, 100 * (profile - expected), colour)
    rest.axhline(0.0, color=BLACK, linewidth=0.8)
    main.set(title="along the radius", xscale="log")
    ticks = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]
    rest.set_xticks([t for t in ticks if t <= result.R_De], minor=False)
    rest.xaxis.set_major_formatter("{x:.4g}")
    rest.minorticks_off()
    main.legend(loc="upper right", title="t_D")
    rest.set(xlabel="R_D = R / r_w", ylabel="difference\n(% of steady fall)")


def _markers(
    panel: Axes,
    x: np.ndarray,
    computed: np.ndarray,
    expected: np.ndarray,
    colour: str,
    name: str,
) -> None:
    """Means over cases (c, n), bars of one standard deviation of their differences."""
    bars = _deviation(computed - expected) if len(computed) > 1 else None
    panel.errorbar(
        x,
        _mean(computed),
        yerr=bars,
        color=colour,
        linestyle="none",
        marker="o",
        markersize=4,
        capsize=2,
        elinewidth=0.9,
        label=name,
    )


def _difference(panel: Axes, x: np.ndarray, percent: np.ndarray, colour: str) -> None:
    """Mean difference over cases (c, n) as a line in a band of one standard deviation."""
    mean = _mean(percent)
    panel.plot(x, mean, color=colour, linewidth=1.2, marker="o", markersize=3)
    if len(percent) > 1:
        band = _deviation(percent)
        panel.fill_between(x, mean - band, mean + band, color=colour, alpha=0.15, linewidth=0)


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean over cases, of those that have pores in the bin; NaN where none has."""
    count = np.sum(np.isfinite(values), axis=0)
    found: np.ndarray = np.divide(
        np.nansum(values, axis=0), count, out=np.full(len(count), np.nan), where=count > 0
    )
    return found


def _deviation(values: np.ndarray) -> np.ndarray:
    """Standard deviation over the cases that have pores in the bin; 0 for a single one."""
    count = np.sum(np.isfinite(values), axis=0)
    squares = np.nansum((values - _mean(values)) ** 2, axis=0)
    found: np.ndarray = np.sqrt(
        np.divide(squares, count - 1, out=np.zeros(len(count)), where=count > 1)
    )
    return found


def _cases(count: int) -> str:
    return "one case" if count == 1 else f"{count} cases"


def _range(values: np.ndarray) -> str:
    low, high = f"{values.min():.3f}", f"{values.max():.3f}"
    return low if low == high else f"{low} to {high}"
