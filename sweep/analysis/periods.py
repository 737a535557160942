"""When the flow periods of wells start, and the transient of one in a record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from demflow.model.scene import Scene
from demflow.model.transient import bourdet_derivative, flow_periods, log_time

Rates = Sequence[tuple[float, float]]


class Period(NamedTuple):
    """A flow period of a record."""

    start: float  # s
    sign: float  # +1 where the rate rose, −1 where it fell
    members: np.ndarray  # (n,) which points of the record lie in it


def period_starts(scene: Scene, wells: Sequence[str]) -> list[list[float]]:
    """Times (s) at which the rate of each named well changes; none of a well that is not there."""
    own = {well.name: well for well in scene.wells}
    return [
        flow_periods(own[name].rate_changes)[0].tolist()
        if name in own and own[name].pressure is None
        else []
        for name in wells
    ]


def longest_period(time: np.ndarray, rates: Rates) -> Period:
    """The flow period with most points.

    Parameters
    ----------
    time : (n,) s, increasing.
    rates : (s, m³/s) in order.
    """
    starts, signs = flow_periods(rates)
    period = np.searchsorted(starts, time, side="left") - 1
    counts = np.bincount(period[period >= 0], minlength=len(starts))
    k = int(np.argmax(counts))
    return Period(float(starts[k]), float(signs[k]), period == k)


def transient(
    time: np.ndarray, pressure: np.ndarray, rates: Rates, period: Period, smoothing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pressure change and Bourdet derivative of a flow period, (m,) Pa each.

    The change counts from the last point before the period, or from the farthest in it where there
    is none; the derivative is by superposition time.

    Parameters
    ----------
    time, pressure : (n,) s, increasing, and Pa.
    rates : (s, m³/s) in order.
    period : one of the record's, with m points.
    smoothing : L, in natural logarithms.
    """
    before = np.flatnonzero(time <= period.start)
    level = pressure[before[-1]] if len(before) else np.max(pressure * period.sign) * period.sign
    change = period.sign * (level - pressure[period.members])
    at = time[period.members]
    x = log_time(at, rates, "superposition")
    return change, bourdet_derivative(at, change, (period.start,), smoothing, x=x)
