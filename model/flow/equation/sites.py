"""Where wells are and when they act: all of them that is known before there is a network."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Times nearer to each other than this part of them are the same time.
ROUND_OFF = 1e-12

# Lags at which responses are kept where steps come at any time, and the first of them beside the
# first one that is asked for.
LAGS_A_DECADE = 48
FIRST_LAG = 1e-2


class WellPlace(NamedTuple):
    """Where a well stands."""

    at: tuple[float, float]  # m
    radius: float  # m


class WellSite(NamedTuple):
    """What the flow stage knows of a well: not its rate."""

    name: str
    at: tuple[float, float]  # m
    radius: float  # m
    fixed_pressure: bool
    change_times: tuple[float, ...]  # s, when its rate changes
    skin: float = 0.0  # ≥ 0; a negative one is in the radius
    storage: float = 0.0  # m³/Pa for unit depth


class InflowSite(NamedTuple):
    """What the flow stage knows of a side with an inflow: it acts as a well at a rate."""

    name: str
    change_times: tuple[float, ...]  # s, when its inflow changes
    fixed_pressure: bool = False
    storage: float = 0.0  # m³/Pa


Site = WellSite | InflowSite


def time_since(change: np.ndarray | float, times: np.ndarray) -> np.ndarray:
    """Time since a change, s; exactly 0 where only round-off parts the two."""
    since = times - change
    same = np.isfinite(times) & (np.abs(since) <= ROUND_OFF * np.abs(times))
    return np.where(same, 0.0, since)


def change_times(wells: tuple[Site, ...]) -> np.ndarray:
    """Times at which something changes: the start and every rate change, increasing, s."""
    return np.unique([0.0, *(t for well in wells for t in well.change_times)])
