"""The error in time of one answer against a better one of the same network."""

from __future__ import annotations

import numpy as np

from demflow.model.products import Responses

# What the reference is computed with; round-off leaves a dense eigen-solution at 1e-10 too.
REFERENCE_METHOD, REFERENCE_TOLERANCE = "krylov", 1e-10

# Part of the largest value of its kind below which an output's own size no longer counts.
FAINT = 0.1


def time_error(found: Responses, exact: Responses, *, fixed: int, wells: int, flows: bool) -> float:
    """Largest relative error of the unit step responses that were recorded.

    A well that is the source is compared at every lag with its own pressure change there; any
    other pressure, inflow or map with the largest value that it takes, or with a tenth of the
    largest of its kind where it takes next to none. What is not a number counts as infinite.

    Parameters
    ----------
    found, exact : responses of the same sources at the same lags.
    fixed, wells : number of fixed pressures and of wells at a rate, in this order the first
        sources; what comes after them moves every pore at once.
    flows : whether inflows at fixed pressures count.
    """
    later = exact.lag > 0.0
    is_flow = np.zeros(exact.output.shape[2], dtype=bool)
    is_flow[wells : wells + fixed] = True
    worst = 0.0
    for source in range(exact.output.shape[0]):
        right, given = exact.output[source, later], found.output[source, later]
        size = np.broadcast_to(np.abs(right).max(axis=0, initial=0.0), right.shape).copy()
        is_well = fixed <= source < fixed + wells
        for kind, own_is_one in ((is_flow, is_well), (~is_flow, source < fixed)):
            largest = np.max(size[:, kind], initial=float(own_is_one))
            size[:, kind] = np.maximum(size[:, kind], FAINT * largest)
        if is_well:
            size[:, source - fixed] = np.abs(right[:, source - fixed])
        counts = size > 0.0
        counts &= ~is_flow | flows
        worst = max(worst, _largest(given - right, size, counts))
        field = exact.pressure[source, later]
        size = np.full(field.shape, np.abs(field).max(initial=0.0))
        worst = max(worst, _largest(found.pressure[source, later] - field, size, size > 0.0))
    return worst


def _largest(difference: np.ndarray, size: np.ndarray, counts: np.ndarray) -> float:
    ratio = np.abs(difference)[counts] / size[counts]
    return float(np.max(np.where(np.isnan(ratio), np.inf, ratio), initial=0.0))
