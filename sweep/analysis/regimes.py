"""Flow regimes of a pressure transient, and the permeability of its radial plateau.

A regime shows as a straight piece of the derivative on log-log axes: slope 1 while the
wellbore fills or when the closed boundary is felt everywhere, 1/2 for linear and 1/4 for
bilinear flow, 0 for radial flow; at steady state the derivative falls to nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from demflow.model.transient import bourdet_derivative

SLOPES = {"unit slope": 1.0, "linear": 0.5, "bilinear": 0.25, "radial": 0.0}
SLOPE_TOLERANCE = 0.05
SHORTEST = 1.0  # natural-log units of time that a regime must last (0.43 decades)
STEADY = 0.01  # derivative over pressure change below which nothing changes any more
_SLOPE_WINDOW = 0.3  # smoothing of the slope itself, natural-log units


class Regime(NamedTuple):
    """A stretch of a transient with one slope."""

    name: str  # wellbore storage, bilinear, linear, radial, pseudo-steady or steady
    start: float  # s since the rate change
    end: float  # s
    level: float  # median derivative over the stretch, Pa


def detect_regimes(elapsed: ArrayLike, change: ArrayLike, derivative: ArrayLike) -> list[Regime]:
    """Flow regimes in the order of time.

    Parameters
    ----------
    elapsed : (t,) s since the rate change, increasing.
    change, derivative : (t,) Pa, of one flow period (`model.transient`).

    Returns
    -------
    Every stretch of at least `SHORTEST` whose log-log slope stays within `SLOPE_TOLERANCE`
    of a regime's. Slope 1 is wellbore storage where it comes first and the derivative equals
    the change, pseudo-steady flow otherwise.
    """
    t, dp, slope_p = (np.asarray(a, dtype=float) for a in (elapsed, change, derivative))
    good = np.isfinite(dp) & np.isfinite(slope_p) & (dp > 0)
    t, dp, slope_p = t[good], dp[good], slope_p[good]
    if len(t) < 3:
        return []
    names = np.full(len(t), "", dtype=object)
    rising = slope_p > 0
    log_slope = np.full(len(t), np.nan)
    log_slope[rising] = bourdet_derivative(
        t[rising], np.log(slope_p[rising]), smoothing=_SLOPE_WINDOW
    )
    for name, slope in SLOPES.items():
        names[np.abs(log_slope - slope) <= SLOPE_TOLERANCE] = name
    names[slope_p < STEADY * dp] = "steady"
    regimes: list[Regime] = []
    for run in np.split(np.arange(len(t)), np.flatnonzero(names[1:] != names[:-1]) + 1):
        name, start, end = names[run[0]], t[run[0]], t[run[-1]]
        if not name or math.log(end / start) < SHORTEST:
            continue
        if name == "unit slope":
            filling = not regimes and slope_p[run[0]] > 0.9 * dp[run[0]]
            name = "wellbore storage" if filling else "pseudo-steady"
        regimes.append(Regime(name, float(start), float(end), float(np.median(slope_p[run]))))
    return regimes


def fit_permeability(
    elapsed: ArrayLike,
    change: ArrayLike,
    derivative: ArrayLike,
    rate_change: float,
    viscosity: float,
) -> float:
    """Permeability from the longest radial plateau, k = |Δq| μ / (4π Δp'), in m².

    For unit depth Δp = (q μ / 4πk) (ln t + …), so the plateau's level is q μ / (4πk).

    Parameters
    ----------
    elapsed, change, derivative : (t,) of one flow period, as in `detect_regimes`.
    rate_change : m³/s for one metre of depth.
    viscosity : Pa s.

    Returns
    -------
    k, or NaN where the transient shows no radial flow.
    """
    plateaus = [r for r in detect_regimes(elapsed, change, derivative) if r.name == "radial"]
    if not plateaus:
        return math.nan
    longest = max(plateaus, key=lambda r: r.end / r.start)
    return abs(rate_change) * viscosity / (4.0 * math.pi * longest.level)


def fitted_permeability(dataset: xr.Dataset, viscosity: xr.DataArray | float) -> xr.DataArray:
    """`fit_permeability` for every case and well of a dataset.

    Uses the flow period that begins at time zero, up to the first rate change; NaN for wells
    that do not flow from the start, and where there is no radial plateau.

    Parameters
    ----------
    dataset : with `pressure_change`, `pressure_derivative` and `well_rate`.
    viscosity : Pa s, one number or an array over the axes that vary it.
    """
    time = dataset["elapsed_time"].values

    def one(change: np.ndarray, slope: np.ndarray, rate: np.ndarray, mu: float) -> float:
        if not (np.isfinite(rate[0]) and rate[0] != 0):
            return math.nan
        other = np.flatnonzero(rate != rate[0])
        first = slice(0, other[0] if len(other) else len(rate))
        return fit_permeability(time[first], change[first], slope[first], rate[0], mu)

    core = ["elapsed_time"]
    fitted = xr.apply_ufunc(
        one,
        dataset["pressure_change"],
        dataset["pressure_derivative"],
        dataset["well_rate"],
        viscosity,
        input_core_dims=[core, core, core, []],
        vectorize=True,
        output_dtypes=[float],
    )
    found: xr.DataArray = fitted.assign_attrs(
        units="m2", long_name="permeability from the radial plateau"
    )
    return found
