"""The error in time of what one case records, against a better solution of the same network."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# What the reference is computed with; round-off leaves a dense eigen-solution at 1e-10 too.
REFERENCE_METHOD, REFERENCE_TOLERANCE = "krylov", 1e-10

# Part of the largest pressure change, and of the largest flow, below which an output's own size
# no longer counts.
FAINT, FAINT_FLOW = 0.1, 1e-6


class Recorded(NamedTuple):
    """What a case records at t times, as far as it is held to the tolerance."""

    change: np.ndarray  # (w, t) Pa, of wells at a rate since their last change of rate, else NaN
    so_far: np.ndarray  # (w, t) Pa, the largest of these in the same flow period until then
    flow: np.ndarray  # (k, t) m³/s let in at each fixed pressure
    pressure: np.ndarray  # (p, t) Pa, change at wells at a rate and probes since the start
    field: np.ndarray  # (t, m) Pa, change of maps


def time_error(
    found: Recorded,
    exact: Recorded,
    *,
    least_pressure: float,
    least_flow: np.ndarray | float,
    flows: bool = True,
) -> float:
    """Largest relative error of what was recorded, infinite where something is no number.

    The pressure change of a well counts against the largest of its flow period so far, a flow
    against the largest that it takes, or `FAINT_FLOW` of the largest of all, or what is none; the
    pressure of a
    well or probe against its own largest change, or `FAINT` of the largest of any, or of a side;
    maps against the largest change of any pore.

    Parameters
    ----------
    found, exact : the same quantities of the same case.
    least_pressure : Pa, the largest change of a fixed pressure, to which `FAINT` refers too.
    least_flow : (k,) or one for all, m³/s: what is no flow at each fixed pressure.
    flows : whether flows count.
    """
    largest = np.abs(exact.pressure).max(initial=least_pressure)
    own = np.abs(exact.pressure).max(axis=1, keepdims=True, initial=0.0)
    worst = [
        _largest(found.change, exact.change, exact.so_far),
        _largest(found.pressure, exact.pressure, np.maximum(own, FAINT * largest)),
        _largest(found.field, exact.field, np.abs(exact.field).max(initial=0.0)),
    ]
    if flows:
        own = np.abs(exact.flow).max(axis=1, keepdims=True, initial=0.0)
        least = np.maximum(least_flow, FAINT_FLOW * np.abs(exact.flow).max(initial=0.0))
        worst.append(_largest(found.flow, exact.flow, np.maximum(own, np.c_[least])))
    return max(worst)


def _largest(found: np.ndarray, exact: np.ndarray, size: np.ndarray | float) -> float:
    """Largest error over a size, where the exact value is a number and the size is not zero."""
    size = np.broadcast_to(size, exact.shape)
    counts = np.isfinite(exact) & (size > 0.0)
    ratio = np.abs(found - exact)[counts] / size[counts]
    return float(np.max(np.where(np.isnan(ratio), np.inf, ratio), initial=0.0))
