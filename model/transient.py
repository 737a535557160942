"""What well-test analysis reads from a pressure record: Δp and the Bourdet derivative.

Both restart at every change of the rate. Periods are given by the times at which they
start; a time belongs to the last period that starts strictly before it. The derivative of a
shut-in is taken by the equivalent time, or the flow before it would halve it by Δt = t_p.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

SMOOTHING = 0.1  # L, the window of the Bourdet derivative on each side, natural-log units

ABSCISSAE = ("equivalent", "elapsed", "superposition")

# A neighbour this many natural-log units away, and so many times farther than the one on the
# other side, lies across a gap: the slope to it says nothing of the point.
GAP, UNEVEN = 1.0, 4.0


def flow_periods(rate_changes: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Start (s) and sign of each flow period of a well at the given rates, shapes (k,), (k,).

    `rate_changes` are (time in s, new rate in m³/s), in order; the rate before the first is
    zero. The sign is +1 where the rate rises (pressure falls) and −1 where it falls; entries
    that leave the rate as it is start no period.
    """
    start, rate = np.asarray(rate_changes, dtype=float).reshape(-1, 2).T
    step = np.diff(rate, prepend=0.0)
    return start[step != 0.0], np.sign(step[step != 0.0])


def _period(times: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Index of the flow period of each time, −1 before the first; both sorted."""
    return np.searchsorted(start, times, side="left") - 1


def pressure_change(
    times: ArrayLike,
    pressure: ArrayLike,
    start: ArrayLike,
    start_pressure: ArrayLike,
    sign: ArrayLike,
) -> np.ndarray:
    """Pressure change since the last rate change, positive in the sense of the change.

    Δp(t) = sign_k (p(t_k) − p(t)) for t_k < t ≤ t_{k+1}: a rising rate lowers the pressure
    and a shut-in raises it, and both give a positive Δp.

    Parameters
    ----------
    times : (t,) s, increasing.
    pressure : (..., t) Pa.
    start : (k,) s, when each flow period starts, increasing (`flow_periods`).
    start_pressure : (..., k) Pa, pressure at those times.
    sign : (k,) +1 or −1 (`flow_periods`).

    Returns
    -------
    (..., t) Pa; NaN up to and including the start of the first period.
    """
    times, start = np.asarray(times, dtype=float), np.asarray(start, dtype=float)
    pressure = np.asarray(pressure, dtype=float)
    period = _period(times, start)
    change = np.full(pressure.shape, np.nan)
    flowing = period >= 0
    k = period[flowing]
    reference = np.asarray(start_pressure, dtype=float)[..., k]
    change[..., flowing] = np.asarray(sign, dtype=float)[k] * (reference - pressure[..., flowing])
    return change


def log_time(
    times: ArrayLike,
    rate_changes: Sequence[tuple[float, float]],
    by: str = "equivalent",
) -> np.ndarray:
    """Abscissa x by which the derivative of each flow period is taken, (t,).

    `elapsed`
        ln Δt of the time since the last rate change.
    `superposition`
        ln Δt + Σ (Δqᵢ / Δq_k) ln((t − tᵢ) / (t_k − tᵢ)) over the changes Δqᵢ at tᵢ before the last
        one, Δq_k at t_k: by it every period of a well in radial flow is a straight line of the
        drawdown's slope, whatever the rates before.
    `equivalent`
        the same while the well is shut in, ln Δt while it flows: after one rate it is the
        logarithm of t_p Δt / (t_p + Δt) (Agarwal 1980, SPE 9289).

    A period in which the sum falls somewhere, as it does when a small change follows a large
    one of the other sign, has no such abscissa and takes ln Δt. NaN before the first period.

    Parameters
    ----------
    times : (t,) s, increasing.
    rate_changes : (time in s, new rate in m³/s) in order, as for `flow_periods`.
    by : equivalent, elapsed or superposition.

    Raises
    ------
    ValueError : another word.
    """
    if by not in ABSCISSAE:
        raise ValueError(f"{by!r} is none of {', '.join(ABSCISSAE)}")
    times = np.asarray(times, dtype=float)
    start, rate = np.asarray(rate_changes, dtype=float).reshape(-1, 2).T
    step = np.diff(rate, prepend=0.0)
    start, rate, step = start[step != 0.0], rate[step != 0.0], step[step != 0.0]
    period = _period(times, start)
    x = np.full(times.shape, np.nan)
    for k in range(len(start)):
        now = period == k
        x[now] = np.log(times[now] - start[k])
        if by == "superposition" or (by == "equivalent" and rate[k] == 0.0):
            since, before = times[now][:, None] - start[:k], start[k] - start[:k]
            superposed = x[now] + np.log(since / before) @ (step[:k] / step[k])
            if np.all(np.diff(superposed) > 0.0):
                x[now] = superposed
    return x


def bourdet_derivative(
    times: ArrayLike,
    change: ArrayLike,
    start: ArrayLike = (0.0,),
    smoothing: float = SMOOTHING,
    *,
    x: ArrayLike | None = None,
) -> np.ndarray:
    """Derivative of the pressure change by the logarithm of the time since the rate change.

    With x = ln(t − t_k), or the abscissa given, the nearest points at least L away on either
    side and the slopes m₁, m₂ over the distances h₁, h₂ to them,
    dΔp/dx = (m₁ h₂ + m₂ h₁) / (h₁ + h₂): Bourdet,
    Ayoub & Pirard (1989), SPE Formation Evaluation 4, 293–302. This is the slope, at the
    point, of the parabola through the three; the first and last point of a period take both
    neighbours from the same side. Near the ends the window shrinks to what there is. Exact
    for Δp = a + b x + c x². Where one neighbour lies across a gap in the times (`GAP`, `UNEVEN`)
    the slope to the other counts alone, and at an end, where the parabola would turn although all
    three points rise or all fall, the slope to the nearest.

    Parameters
    ----------
    times : (t,) s, increasing.
    change : (..., t) Pa, from `pressure_change`.
    start : (k,) s, when each flow period starts, increasing.
    smoothing : L, not negative.
    x : (t,) abscissa in place of ln(t − t_k), increasing within each period (`log_time`).

    Returns
    -------
    (..., t) Pa; NaN before the first period and where a period has a single time.

    Raises
    ------
    ValueError : a negative L, or times that do not increase.
    """
    times, start = np.asarray(times, dtype=float), np.asarray(start, dtype=float)
    change = np.asarray(change, dtype=float)
    if smoothing < 0:
        raise ValueError(f"the smoothing window must not be negative: {smoothing}")
    if np.any(np.diff(times) <= 0) or np.any(np.diff(start) <= 0):
        raise ValueError("times and the starts of flow periods must increase")
    period = _period(times, start)
    derivative = np.full(change.shape, np.nan)
    for k in range(len(start)):
        (members,) = np.nonzero(period == k)
        if len(members) >= 2:
            at = np.log(times[members] - start[k]) if x is None else np.asarray(x)[members]
            derivative[..., members] = _three_point(at, change[..., members], smoothing)
    return derivative


def _three_point(x: np.ndarray, values: np.ndarray, smoothing: float) -> np.ndarray:
    """Derivative at each x, (..., n), from the parabola through it and two points L away."""
    n = len(x)
    if n == 2:
        slope: np.ndarray = (values[..., 1] - values[..., 0]) / (x[1] - x[0])
        return np.stack([slope, slope], axis=-1)
    window = smoothing * (1.0 - 1e-9)  # a neighbour that is L away but for round-off counts
    here = np.arange(n)
    left = np.searchsorted(x, x - window, side="right") - 1
    right = np.searchsorted(x, x + window, side="left")
    left = np.clip(np.minimum(left, here - 1), 0, None)
    right = np.clip(np.maximum(right, here + 1), None, n - 1)
    # an end has no neighbour on one side: take a second one beyond the first
    right[0] = min(right[0], n - 2)
    left[0] = max(min(int(np.searchsorted(x, x[right[0]] + window)), n - 1), right[0] + 1)
    left[-1] = max(left[-1], 1)
    beyond = int(np.searchsorted(x, x[left[-1]] - window, side="right")) - 1
    right[-1] = min(max(beyond, 0), left[-1] - 1)
    h1, h2 = x - x[left], x[right] - x
    m1 = (values - values[..., left]) / h1
    m2 = (values[..., right] - values) / h2
    slope = (m1 * h2 + m2 * h1) / (h1 + h2)
    before, after = np.abs(h1), np.abs(h2)
    slope = np.where((before > GAP) & (before > UNEVEN * after), m2, slope)
    slope = np.where((after > GAP) & (after > UNEVEN * before), m1, slope)
    for end, near, beyond in ((0, m2[..., 0], left[0]), (-1, m1[..., -1], right[-1])):
        inner = right[0] if end == 0 else left[-1]
        further = (values[..., beyond] - values[..., inner]) / (x[beyond] - x[inner])
        turns = (near * further > 0.0) & (near * slope[..., end] < 0.0)
        slope[..., end] = np.where(turns, near, slope[..., end])
    return slope
