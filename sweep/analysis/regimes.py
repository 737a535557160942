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

SLOPES = {"unit slope": 1.0, "linear": 0.5, "bilinear": 0.25, "radial": 0.0}
SLOPE_TOLERANCE = 0.07
SHORTEST = 1.0  # natural-log units of time that a regime must last (0.43 decades)
STEADY = 0.01  # derivative over pressure change below which nothing changes any more
FALLEN = 0.25  # of the plateau, below which the derivative of a supported well has fallen
SURE = 0.8  # confidence from which on a regime may be relied on
_SLOPE_WINDOW = 0.4  # half width of the lines whose slopes are taken, natural-log units
_BRIDGED = 0.35  # natural-log units between two stretches of one regime that noise has parted
# level of a later plateau over the first: one fault doubles it, two at right angles make it four
_PLATEAUS = {"one fault": (1.6, 2.5), "corner": (3.2, 4.8)}


class Regime(NamedTuple):
    """A stretch of a transient with one slope."""

    # wellbore storage, bilinear, linear, radial, one fault, corner, channel, pseudo-steady, steady
    name: str
    start: float  # s since the rate change
    end: float  # s
    level: float  # median derivative over the stretch, Pa
    confidence: float = 1.0  # 0 to 1, by its length and how well the slope is kept


def detect_regimes(elapsed: ArrayLike, change: ArrayLike, derivative: ArrayLike) -> list[Regime]:
    """Flow regimes in the order of time, each with a confidence.

    Every stretch of at least `SHORTEST` whose log-log slope stays within `SLOPE_TOLERANCE` of a
    regime's, the scatter of the slope allowed for. Slope 1 is wellbore storage where it comes first
    and the derivative equals the change, pseudo-steady flow (a closed reservoir) otherwise; slope
    1/2 is a fracture before radial flow and a channel after it; a second plateau is one fault or a
    corner by its level; a derivative that has fallen away is steady flow (constant pressure).

    Parameters
    ----------
    elapsed : (t,) s since the rate change, increasing.
    change, derivative : (t,) Pa, of one flow period (`model.transient`).
    """
    t, dp, slope_p = (np.asarray(a, dtype=float) for a in (elapsed, change, derivative))
    good = np.isfinite(dp) & np.isfinite(slope_p) & (dp > 0)
    t, dp, slope_p = t[good], dp[good], slope_p[good]
    if len(t) < 3:
        return []
    names = np.full(len(t), "", dtype=object)
    off = np.zeros(len(t))
    rising = slope_p > 0
    if rising.sum() >= 3:
        slope, error = np.full(len(t), np.nan), np.zeros(len(t))
        slope[rising], error[rising] = _slopes(np.log(t[rising]), np.log(slope_p[rising]))
        distance = np.abs(slope[:, None] - np.array([*SLOPES.values()]))
        distance = np.where(np.isfinite(distance), distance, np.inf)
        nearest = np.argmin(distance, axis=1)
        off = np.min(distance, axis=1)
        inside = off <= SLOPE_TOLERANCE + np.minimum(2.0 * error, 0.05)
        names[inside] = np.array([*SLOPES], dtype=object)[nearest[inside]]
    names[slope_p < STEADY * dp] = "steady"
    _bridge(np.log(t), names)
    runs = [
        run
        for run in np.split(np.arange(len(t)), np.flatnonzero(names[1:] != names[:-1]) + 1)
        if names[run[0]] and math.log(t[run[-1]] / t[run[0]]) >= SHORTEST
    ]
    regimes: list[Regime] = []
    for run in runs:
        level = float(np.median(slope_p[run]))
        name = _in_context(names[run[0]], level, bool(slope_p[run[0]] > 0.9 * dp[run[0]]), regimes)
        if name:
            missed = 0.0 if name == "steady" else float(np.mean(off[run])) / SLOPE_TOLERANCE
            lasts = math.log(t[run[-1]] / t[run[0]])
            sure = (1.0 - math.exp(-lasts / 0.8)) * math.exp(-0.5 * missed**2)
            one = Regime(name, float(t[run[0]]), float(t[run[-1]]), level, sure)
            if regimes and regimes[-1].name == name:
                one = _joined(regimes.pop(), one)
            regimes.append(one)
    if any(one.name in _PLATEAUS for one in regimes):  # a passage between plateaus is no channel
        regimes = [one for one in regimes if one.name != "channel"]
    return _with_support(t, slope_p, regimes)


def _joined(first: Regime, second: Regime) -> Regime:
    """Two stretches of one regime as one; what lies between them makes it no surer."""
    longer = max(first, second, key=lambda one: one.end / one.start)
    return Regime(first.name, first.start, second.end, longer.level, longer.confidence)


def _slopes(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slope of the line through the points around each, and its standard error."""
    slope, error = np.zeros(len(x)), np.zeros(len(x))
    for k in range(len(x)):
        near = np.abs(x - x[k]) <= _SLOPE_WINDOW
        if near.sum() < 3:
            near[max(k - 1, 0) : k + 2] = True
            near[max(len(x) - 3, 0) if k == len(x) - 1 else 0 : 3 if k == 0 else 0] = True
        dx, dy = x[near] - x[near].mean(), y[near] - y[near].mean()
        whole = float(dx @ dx)
        slope[k] = float(dx @ dy) / whole
        left = dy - slope[k] * dx
        error[k] = math.sqrt(float(left @ left) / max(near.sum() - 2, 1) / whole)
    return slope, error


def _bridge(x: np.ndarray, names: np.ndarray) -> None:
    """Join stretches of one regime that a few points part."""
    stops = [0, *(np.flatnonzero(names[1:] != names[:-1]) + 1).tolist(), len(names)]
    for k in range(1, len(stops) - 2):
        begin, end = stops[k], stops[k + 1]
        same = names[begin - 1] and names[begin - 1] == names[end]
        if same and x[end] - x[begin - 1] <= _BRIDGED:
            names[begin:end] = names[end]


def _in_context(slope: str, level: float, filling: bool, before: list[Regime]) -> str:
    """What a slope means after what came before it; "" where it is a passage only."""
    plateaus = [one for one in before if one.name in ("radial", *_PLATEAUS)]
    if slope == "unit slope":
        return "wellbore storage" if filling and not before else "pseudo-steady"
    if slope == "linear":
        return "channel" if plateaus else "linear"
    if slope == "bilinear":
        return "" if plateaus or any(one.name == "linear" for one in before) else "bilinear"
    if slope == "radial" and plateaus:
        ratio = level / plateaus[0].level
        found = [name for name, (low, high) in _PLATEAUS.items() if low <= ratio <= high]
        return found[0] if found else ("" if ratio < 1.0 / 1.6 or ratio > 1.6 else "radial")
    return slope


def _with_support(t: np.ndarray, slope_p: np.ndarray, regimes: list[Regime]) -> list[Regime]:
    """Add steady flow where the derivative has fallen off its plateau and does not come back."""
    plateaus = [one for one in regimes if one.name in ("radial", "linear", "one fault", "corner")]
    if not plateaus or any(one.name == "steady" for one in regimes):
        return regimes
    last = plateaus[-1]
    if regimes[-1] is not last:
        return regimes
    above = np.flatnonzero((slope_p > FALLEN * last.level) & (t > last.end))
    begin = int(above[-1]) + 1 if len(above) else int(np.searchsorted(t, last.end, side="right"))
    if len(t) - begin < 3:
        return regimes
    lasts = math.log(t[-1] / t[begin])
    if lasts < 0.5 * SHORTEST:
        return regimes
    level = float(np.median(slope_p[begin:]))
    sure = 1.0 - math.exp(-2.0 * lasts)
    return [*regimes, Regime("steady", float(t[begin]), float(t[-1]), level, sure)]


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
