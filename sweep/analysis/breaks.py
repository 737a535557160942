"""Flow periods of a record that came without rates, or with rates of another clock."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

_BEFORE, _AFTER = 5, 4  # points that tell the course before a place and after it
_FLOOR = 1e-4  # of the record's range: what is less is no change of rate
MANY = 10  # points by which one change alone must be off to tell of two clocks


class Break(NamedTuple):
    """A place at which the pressure turns or gathers speed, as it does where a rate changes."""

    time: float  # s, the last point before
    place: int  # its index
    confidence: float  # that it is none of the scatter's, for the record as a whole


def find_breaks(time: ArrayLike, pressure: ArrayLike, least: float = 0.999) -> list[Break]:
    """Changes of rate by the pressure alone.

    Left alone, a pressure goes on in its direction and slows down: after a place it lies between
    where it is and where its course before leads in a straight line. What leaves that room by
    more than the scatter does is a change of rate; of neighbours the plainest is taken.

    Parameters
    ----------
    time, pressure : (n,) s, increasing, and Pa.
    least : confidence that is asked for; among n points chance is allowed for n times.
    """
    t, p = np.asarray(time, dtype=float), np.asarray(pressure, dtype=float)
    n = len(t)
    if n < _BEFORE + _AFTER + 2:
        return []
    scatter = max(_scatter(t, p), _FLOOR * float(np.ptp(p)), 1e-12)
    places = np.arange(_BEFORE - 1, n - _AFTER)
    excess = np.zeros(n)
    for i in places.tolist():
        early = slice(i - _BEFORE + 1, i + 1)
        dt = t[early] - t[early].mean()
        whole = float(dt @ dt)
        slope = float(dt @ p[early]) / whole
        ahead = float(np.mean(t[i + 1 : i + 1 + _AFTER]) - t[i])
        moved = float(np.mean(p[i + 1 : i + 1 + _AFTER]) - p[i])
        straight = slope * ahead
        low, high = min(0.0, straight), max(0.0, straight)
        # that it turns needs the two levels; that it gathers speed, the slope before as well
        turns = moved * slope < 0.0
        lever = 0.0 if turns else ahead**2 / whole
        error = scatter * np.sqrt(1.0 / _AFTER + 1.0 + lever)
        excess[i] = max(low - moved, moved - high, 0.0) / error
    chance = 2.0 * n * stats.norm.sf(excess)
    found = []
    sure = np.flatnonzero((1.0 - chance >= least) & (excess > 0.0))
    for group in np.split(sure, np.flatnonzero(np.diff(sure) > _AFTER) + 1):
        if len(group):
            best = int(group[np.argmax(excess[group])])
            found.append(Break(float(t[best]), best, float(max(0.0, 1.0 - chance[best]))))
    return found


def _scatter(t: np.ndarray, p: np.ndarray) -> float:
    """Standard deviation of single points, by how far each lies off the line of its neighbours."""
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    off = p[1:-1] - p[:-2] - share * (p[2:] - p[:-2])
    size = np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
    return float(1.4826 * np.median(np.abs(off) / size))


def clock_shift(
    breaks: Sequence[Break], rates: Sequence[tuple[float, float]], time: ArrayLike
) -> float | None:
    """How much later the pressure answers than its rates change, s, or None where it agrees.

    The median over the changes that have a break of their own, where all of them are late (or
    early) by more than the times leave open. Storage and noise hide the begin of an answer too:
    one change alone must be off by `MANY` points.
    """
    t = np.asarray(time, dtype=float)
    starts = np.array([start for start, _ in rates])
    starts = starts[(starts > t[0]) & (starts < t[-1])]
    if not len(starts) or len(breaks) != len(starts):
        return None
    ends = np.array([t[min(one.place + 1, len(t) - 1)] for one in breaks])
    begins = np.array([one.time for one in breaks])
    late, early = begins - starts, starts - ends
    if len(starts) == 1 and abs(breaks[0].place - np.searchsorted(t, starts[0])) < MANY:
        return None
    if np.all(late > 0.0) or np.all(early > 0.0):
        return float(np.median(0.5 * (begins + ends) - starts))
    return None
