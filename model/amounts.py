"""How many numbers the outputs of a scene are: what times, rate changes and probes cost.

Grains decide what most stages take. The flow keeps a response for every lag, the observations a
value for every time: with many of these, they decide about memory and disk, and are counted
before anything runs.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from demflow.model.controls import Controls, controls_of, sites
from demflow.model.flow.equation.sites import (
    FIRST_LAG,
    LAGS_A_DECADE,
    change_times,
    time_since,
)
from demflow.model.scene import Scene

COUNTED = 2_000_000  # pairs of a time and a change up to which equal lags are found
WORKING = 6  # copies of the times since every change that are made to find the lags
PER_LAG = 500  # numbers of a lag while responses are put together: some hundred modes, five times
DERIVED = 4  # of a well's pressure: its rate, its change and that's derivative beside it


def kept_by_flow(scene: Scene) -> float:
    """Numbers of the responses that do not grow with the grains, and of the maps that do."""
    if not scene.flows:
        return 0.0
    controls = controls_of(scene)
    lags, _ = _lags(scene)
    sources, per_lag = _sources(controls), float(_recorded(scene, controls))
    if "pressure_map" in scene.observe:
        per_lag += _pores(scene)
    return float(sources * lags * per_lag)


def held_by_flow(scene: Scene) -> float:
    """Numbers held at once while responses are made: beside themselves, what they are made of."""
    lags, pairs = _lags(scene) if scene.flows else (0.0, 0.0)
    return kept_by_flow(scene) + PER_LAG * lags + WORKING * pairs


def kept_by_observe(scene: Scene) -> float:
    """Numbers of the observations in time."""
    if not scene.flows:
        return 0.0
    each = DERIVED * len(scene.wells) + len(scene.boundaries) + len(scene.probes)
    return float(each * max(1, len(scene.times)))


def held_by_observe(scene: Scene) -> float:
    """Numbers held at once while they are made: the responses beside them."""
    return kept_by_flow(scene) + kept_by_observe(scene)


def _sources(controls: Controls) -> int:
    """Sources, and fields that the start is made of."""
    at_rate = sum(not well.held for well in controls.wells)
    return len(controls.fixed_pressures) + at_rate + len(controls.initial_weights)


def _recorded(scene: Scene, controls: Controls) -> int:
    """Numbers that are recorded of a source at each lag: outputs, and volumes that went in."""
    outputs = len(controls.wells) + len(controls.side_pressures) + len(scene.probes)
    return outputs + len(controls.fixed_pressures) + 1


def _pores(scene: Scene) -> float:
    """About the number of pores in the region: disc packings have one for each grain or so."""
    if scene.grains.count is not None:
        return float(scene.grains.count)
    return scene.region.area / (np.pi * (scene.grains.mean_radius or 1.0) ** 2)


def _lags(scene: Scene) -> tuple[float, float]:
    """Number of different lags at which responses are kept, and of pairs they are found in."""
    if scene.method == "steady":
        return 1.0, 1.0
    changes = change_times(sites(controls_of(scene).wells))
    found, pairs = _lags_of(scene.times, tuple(changes.tolist()))
    if any(well.decides for well in scene.wells):
        decades = np.log10(scene.times[-1] / scene.times[0]) - np.log10(FIRST_LAG)
        found += LAGS_A_DECADE * float(decades)
    return found, pairs


@lru_cache(maxsize=64)
def _lags_of(times: tuple[float, ...], changes: tuple[float, ...]) -> tuple[float, float]:
    start = np.array(changes)
    wanted = np.concatenate([np.array(times), start])
    pairs = float(len(wanted) * len(start))
    if pairs <= COUNTED:
        lag = time_since(start[None, :], wanted[:, None])
        return float(len(np.unique(lag[lag >= 0.0]))), pairs
    # of a part of the times, each with all changes: equal lags are as frequent among them
    some = np.sort(wanted)[:: -(-len(wanted) // max(1, COUNTED // len(start)))]
    lag = time_since(start[None, :], some[:, None])
    lag = lag[lag >= 0.0]
    after = float(np.searchsorted(start, wanted, side="right").sum())
    different = len(np.unique(lag))
    if different < 0.5 * len(lag):  # steps of one length: lags are their multiples
        return float(max(different, len(wanted))), pairs
    return after * different / max(1, len(lag)), pairs
