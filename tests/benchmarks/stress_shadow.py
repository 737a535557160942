"""A second stage in the stress shadow of a first, against Sneddon's.

The study *multistage*: the second hole breaks down later once the plane below is open and filled.
Around a hole the wall first parts across the plane at 3 σyy − σxx (Hubbert & Willis 1957), so that
the rise is 3 Δσyy − Δσxx of what the first fracture adds in the middle above it, a distance z from
a straight crack of half-length L under net pressure p (Sneddon 1946, Proc. R. Soc. A 187, 229):
Δσyy = p (1 − z³ / r³), Δσxx = p (1 − 2 z / r + z³ / r³), r² = z² + L².
"""

from __future__ import annotations

import math

import numpy as np

from demflow.model.scene import Scene
from demflow.model.stages import simulate
from demflow.sweep.study.load import load_study
from demflow.sweep.study.scenes import SceneBuilder
from tests.benchmarks.result import Result

LOW, HIGH = 0.6, 1.4


def rise(net_pressure: float, half_length: float, distance: float) -> float:
    """Of the breakdown pressure above a filled crack, Pa."""
    r = math.hypot(distance, half_length)
    across = net_pressure * (1.0 - (distance / r) ** 3)
    along = net_pressure * (1.0 - 2.0 * distance / r + (distance / r) ** 3)
    return 3.0 * across - along


def run() -> Result:
    """The study's two cases."""
    study = load_study("studies/multistage.yaml")
    built = SceneBuilder(study.values, study.axes)
    scenes: list[Scene] = [built.scene(index) for index in np.ndindex(*study.shape)]
    after, alone = (simulate(scene) for scene in scenes)
    scene = scenes[0]
    assert scene.stress is not None
    assert scene.wells[1].schedule is not None
    begins = scene.wells[1].schedule[1][0]
    times = np.array(scene.times)
    filled = int(np.searchsorted(times, begins))  # just before the second is filled
    net = float(after["well_pressure"][0, filled]) - scene.stress.yy
    first = after["event_time"] <= begins
    x = after["event_x"][first]
    reach = 0.5 * float(x.max() - x.min())
    distance = abs(scene.wells[1].at[1] - scene.wells[0].at[1])
    peaks = [float(found["highest_well_pressure"][1]) for found in (after, alone)]
    found, expected = peaks[0] - peaks[1], rise(net, reach, distance)
    ratio = found / expected
    return Result(
        f"breakdown of the second stage {found / 1e6:+.2f} MPa, {ratio:.2f} of Sneddon's shadow",
        f"{LOW} to {HIGH}",
        LOW <= ratio <= HIGH,
        f"{peaks[1] / 1e6:.2f} MPa alone, {peaks[0] / 1e6:.2f} after the first: a crack of "
        f"half-length {reach:.3f} m at {net / 1e6:.2f} MPa over σyy, {distance:g} m below",
    )
