"""Fewer points of a long record, chosen so that pressure and derivative of each period stay."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike


def thinned(
    time: ArrayLike,
    pressure: ArrayLike,
    rates: Sequence[tuple[float, float]] | None,
    most: int,
) -> np.ndarray:
    """Indices of at most so many points, increasing.

    Each flow period gets its share by its decades of time since the change. In each cell of equal
    log time the point nearest to the mean of the cell, in time and in pressure off the line
    through the cell, is taken: a point of the record, and not one off its neighbours. Ends of
    periods always stay.

    Parameters
    ----------
    time, pressure : (n,) s, increasing, and Pa.
    rates : (s, m³/s) in order; None for one period from time zero.
    most : at least 8.
    """
    t, p = np.asarray(time, dtype=float), np.asarray(pressure, dtype=float)
    if len(t) <= most:
        return np.arange(len(t))
    starts = np.array([start for start, _ in rates] if rates else [0.0])
    period = np.searchsorted(starts, t, side="left") - 1
    groups = [np.flatnonzero(period == k) for k in range(-1, len(starts))]
    groups = [one for one in groups if len(one)]
    decades = []
    for one in groups:
        k = period[one[0]]
        since = t[one] - (starts[k] if k >= 0 else t[one[0]] - 1.0)
        decades.append(max(np.log10(since[-1] / since[0]), 0.1) if len(one) > 1 else 0.0)
    room = max(most - 2 * len(groups), len(groups))
    share = np.array(decades) / max(sum(decades), 1e-30) * room
    chosen: list[np.ndarray] = []
    for one, part in zip(groups, share, strict=True):
        k = period[one[0]]
        x = np.log(t[one] - (starts[k] if k >= 0 else t[one[0]] - 1.0))
        count = int(part)
        kept = {0, len(one) - 1}
        if count >= 1 and len(one) > 2:
            cell = np.minimum(((x - x[0]) / (x[-1] - x[0]) * count).astype(int), count - 1)
            for c in np.unique(cell):
                inside = np.flatnonzero(cell == c)
                kept.add(int(inside[_typical(x[inside], p[one][inside])]))
        chosen.append(one[sorted(kept)])
    return np.concatenate(chosen)


def _typical(x: np.ndarray, p: np.ndarray) -> int:
    """The point of a cell that lies nearest to its middle and to the line through it."""
    n = len(x)
    if n <= 2:
        return n // 2
    dx = x - x.mean()
    spread = float(dx @ dx)
    slope = float(dx @ p) / spread if spread > 0.0 else 0.0
    off = p - p.mean() - slope * dx
    scatter = float(np.sqrt(off @ off / n)) or 1.0
    width = float(np.sqrt(spread / n)) or 1.0
    return int(np.argmin((off / scatter) ** 2 + (dx / width) ** 2))
