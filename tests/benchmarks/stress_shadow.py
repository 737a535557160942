"""The second of two stages in the stress shadow of the first, against its hole under that stress.

The study *multistage*: the second hole breaks down later once the plane below is filled.
Beside a crack of half-length L under net pressure p stresses rise by Δσyy = −Re Z − y Im Z' and
Δσxx = −Re Z + y Im Z', Z = p (ζ / √(ζ² − L²) − 1), ζ = x + i y from its middle (Sneddon 1946, Proc.
R. Soc. A 187, 229; Westergaard 1939, J. Appl. Mech. 6, A49). What a hole of a few grains makes of
stresses is not Kirsch's, so that it is measured: the second hole alone, with the stresses on the
walls raised by the shadow's, breaks as much later as it should behind the first. Between them lie
the change of the shadow over the hole, its shear beside the middle of a crack that grew further on
one side, and the nearness of the walls.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from demflow.model.scene import Scene, Stress
from demflow.model.stages import simulate
from demflow.sweep.study.load import load_study
from demflow.sweep.study.scenes import SceneBuilder
from tests.benchmarks.result import Result

SEEDS = (1, 2, 3)
BOUND = 0.25  # of the rise, in the mean over packings


def shadow(net_pressure: float, half_length: float, x: float, y: float) -> tuple[float, float]:
    """Rise of the stresses across and along the plane at a place beside a filled crack, Pa."""
    place = complex(x, y)
    root = np.sqrt(place - half_length) * np.sqrt(place + half_length)
    z, slope = net_pressure * (place / root - 1.0), -net_pressure * half_length**2 / root**3
    return -(z.real + y * slope.imag), -(z.real - y * slope.imag)


def first_break(found: dict[str, np.ndarray], times: np.ndarray) -> tuple[float, float]:
    """When cement of the plane above first breaks, s, and the pressure of its well then, Pa.

    A hole that is filled at a constant rate has a pressure that rises evenly until then.
    """
    breaks = (found["event_y"] > 0.0) & np.isin(found["event_mode"], (1, 2))
    time = float(found["event_time"][breaks].min())
    last = int(np.searchsorted(times, time)) - 1
    (t0, t1), (p0, p1) = times[last - 1 : last + 1], found["well_pressure"][1][last - 1 : last + 1]
    return time, float(p1 + (p1 - p0) / (t1 - t0) * (time - t1))


def rises(scenes: list[Scene]) -> tuple[float, float, str]:
    """By how much the second hole breaks later behind the first, and under its shadow, Pa."""
    scene, times = scenes[0], np.array(scenes[0].times)
    assert scene.stress is not None
    after, alone = (simulate(one) for one in scenes)
    time, second = first_break(after, times)
    _, by_itself = first_break(alone, times)
    net = float(np.interp(time, times, after["well_pressure"][0])) - scene.stress.yy
    below = (after["event_time"] <= time) & (after["event_y"] < 0.0)
    left, right = (
        float(end) for end in (after["event_x"][below].min(), after["event_x"][below].max())
    )
    middle, reach = 0.5 * (left + right), 0.5 * (right - left)
    distance = scene.wells[1].at[1] - scene.wells[0].at[1]
    across, along = shadow(net, reach, scene.wells[1].at[0] - middle, distance)
    stress = Stress(scene.stress.xx + along, scene.stress.yy + across)
    _, shaded = first_break(simulate(dataclasses.replace(scenes[1], stress=stress)), times)
    line = (
        f"{by_itself / 1e6:.2f} MPa alone, {second / 1e6:.2f} after the first, {shaded / 1e6:.2f} "
        f"under its shadow of {across / 1e6:.2f} MPa across and {along / 1e6:.2f} along: a crack "
        f"from {left:.3f} to {right:.3f} m at {net / 1e6:.2f} MPa over the stress, {distance:g} m "
        "below"
    )
    return second - by_itself, shaded - by_itself, line


def run() -> Result:
    """The study's two cases in several packings."""
    study = load_study("studies/multistage.yaml")
    built = SceneBuilder(study.values, study.axes)
    scenes: list[Scene] = [built.scene(index) for index in np.ndindex(*study.shape)]
    found, lines = [], []
    for seed in SEEDS:
        behind, under, line = rises(
            [
                dataclasses.replace(one, grains=dataclasses.replace(one.grains, seed=seed))
                for one in scenes
            ]
        )
        found.append((behind, under))
        lines.append(f"packing {seed}: {line}")
    behind, under = np.mean(found, axis=0)
    return Result(
        f"first break of the second stage {behind / 1e6:+.2f} MPa behind the first, "
        f"{under / 1e6:+.2f} under its shadow alone: {behind / under - 1.0:+.0%} in the mean of "
        f"{len(SEEDS)} packings",
        f"later, within {BOUND:.0%}",
        bool(under > 0.0 and abs(behind / under - 1.0) <= BOUND),
        "\n".join(lines),
    )
