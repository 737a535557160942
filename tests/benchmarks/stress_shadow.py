"""The second of two stages in the stress shadow of the first, between bounds from Sneddon's.

The study *multistage*: the second hole breaks down later once the plane below is filled.
Above the middle of a crack of half-length L under net pressure p, at a distance z, stresses
rise by Δσyy = p (1 − z³ / r³), Δσxx = p (1 − 2 z / r + z³ / r³), r² = z² + L² (Sneddon 1946, Proc.
R. Soc. A 187, 229). The wall of a hole that is round and large beside grains parts across the plane
at 3 σyy − σxx (Hubbert & Willis 1957), so that what it takes more is 3 Δσyy − Δσxx; where the wall
concentrates nothing it is Δσyy. A hole of a few grains lies between, at the first break above.
"""

from __future__ import annotations

import math

import numpy as np

from demflow.model.scene import Scene
from demflow.model.stages import simulate
from demflow.sweep.study.load import load_study
from demflow.sweep.study.scenes import SceneBuilder
from tests.benchmarks.result import Result


def shadow(net_pressure: float, half_length: float, distance: float) -> tuple[float, float]:
    """Rise of the stresses across and along the plane above a filled crack, Pa."""
    r = math.hypot(distance, half_length)
    across = net_pressure * (1.0 - (distance / r) ** 3)
    return across, net_pressure * (1.0 - 2.0 * distance / r + (distance / r) ** 3)


def first_break(found: dict[str, np.ndarray], times: np.ndarray) -> tuple[float, float]:
    """When cement of the plane above first breaks, s, and the pressure of its well then, Pa."""
    breaks = (found["event_y"] > 0.0) & np.isin(found["event_mode"], (1, 2))
    time = float(found["event_time"][breaks].min())
    return time, float(np.interp(time, times, found["well_pressure"][1]))


def run() -> Result:
    """The study's two cases."""
    study = load_study("studies/multistage.yaml")
    built = SceneBuilder(study.values, study.axes)
    scenes: list[Scene] = [built.scene(index) for index in np.ndindex(*study.shape)]
    after, alone = (simulate(scene) for scene in scenes)
    scene, times = scenes[0], np.array(scenes[0].times)
    assert scene.stress is not None
    time, second = first_break(after, times)
    _, by_itself = first_break(alone, times)
    net = float(np.interp(time, times, after["well_pressure"][0])) - scene.stress.yy
    below = (after["event_time"] <= time) & (after["event_y"] < 0.0)
    reach = 0.5 * float(np.ptp(after["event_x"][below]))
    distance = abs(scene.wells[1].at[1] - scene.wells[0].at[1])
    across, along = shadow(net, reach, distance)
    rise, most = second - by_itself, 3.0 * across - along
    peaks = [float(found["highest_well_pressure"][1]) / 1e6 for found in (after, alone)]
    return Result(
        f"first break of the second stage {rise / 1e6:+.2f} MPa in the shadow of the first",
        f"{across / 1e6:.2f} to {most / 1e6:.2f} MPa",
        across <= rise <= most,
        f"{by_itself / 1e6:.2f} MPa alone, {second / 1e6:.2f} after the first: a crack of half-"
        f"length {reach:.3f} m at {net / 1e6:.2f} MPa over the stress, {distance:g} m below; "
        f"highest pressures {peaks[1]:.2f} and {peaks[0]:.2f} MPa",
    )
