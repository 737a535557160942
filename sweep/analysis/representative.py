"""From which size of a region on its permeability is that of the rock, if there is such a size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

TOLERANCE = 0.2  # of ln k: 20 %


class SizeEffect(NamedTuple):
    """How a permeability settles with the size of the region."""

    size: np.ndarray  # (n,) m, increasing
    mean: np.ndarray  # (n, 2) m², geometric mean of k_xx and k_yy over the realisations
    spread: np.ndarray  # (n, 2) standard deviation of ln k over them
    drift: np.ndarray  # (n, 2) ln of the mean over that of the largest size
    members: np.ndarray  # (n,) realisations that count
    representative: float | None  # m; None: no size that was tried is


def size_effect(
    permeability: xr.DataArray,
    size: xr.DataArray,
    over: Sequence[str],
    tolerance: float = TOLERANCE,
) -> SizeEffect:
    """Mean and spread of permeabilities by size, and the least size that is representative.

    A size is so where, at it and at every larger one, ln k_xx and ln k_yy spread between the
    realisations by no more than the tolerance and have moved by no more from those of the
    largest. The largest alone shows nothing: at least two sizes must agree.

    Parameters
    ----------
    permeability : tensors (..., row, column) in m²; beside `over` and the size no other axis.
    size : length of the region along the axis of sizes, m.
    over : axes of realisations.
    tolerance : of ln k.
    """
    (axis,) = size.dims
    order = np.argsort(size.values)
    diagonal = [permeability.isel(row=i, column=i, drop=True) for i in (0, 1)]
    logs = [
        np.log(k.where(k > 0.0).transpose(axis, *over).values.reshape(len(order), -1)[order])
        for k in diagonal
    ]
    good = np.isfinite(logs[0]) & np.isfinite(logs[1])
    members = good.sum(axis=1)
    stacked = np.where(good, np.array(logs), np.nan)  # (2, sizes, realisations)
    enough = members > 1
    mean = np.full((len(order), 2), np.nan)
    spread = np.full((len(order), 2), np.nan)
    for k in np.flatnonzero(members > 0):
        mean[k] = np.nanmean(stacked[:, k], axis=1)
    for k in np.flatnonzero(enough):
        spread[k] = np.nanstd(stacked[:, k], axis=1, ddof=1)
    drift = mean - mean[-1]
    stable = (spread <= tolerance).all(axis=1) & (np.abs(drift) <= tolerance).all(axis=1)
    from_there = np.logical_and.accumulate(stable[::-1])[::-1]
    sizes = size.values[order]
    first = int(np.argmax(from_there)) if from_there.any() else len(order)
    found = float(sizes[first]) if first < len(order) - 1 else None
    return SizeEffect(sizes, np.exp(mean), spread, drift, members, found)
