"""Breakdown pressure of a wellbore against 3 σ3 − σ1 + T (Hubbert & Willis 1957).

Fluid is injected slowly into a hole of five mean radii under equal stresses until a fracture runs
from it; T is what a test in direct tension measures on grains of the same packing and cement. The
highest pressure of the well after any step is taken. The box is some 15 radii of the hole wide: in
one of 10, of other packings, the ratio was lower by a tenth; whether walls are the cause is open.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from demflow.model.scene import FailureTest
from demflow.model.stages import run_stages, simulate
from tests.benchmarks.breaking_keeps_its_books import bored
from tests.benchmarks.result import Result

SEEDS = tuple(range(1, 11))
STRESS, RADII, COUNT, RATE = 10e6, 5.0, 1500, -5e-4
LOW, HIGH = 0.8, 1.1
TIMES = tuple(np.round(np.arange(0.1, 2.01, 0.05), 3).tolist())


def ratio(seed: int) -> float:
    """Breakdown over 2 σ + T of one packing."""
    scene = bored(seed, count=COUNT, stress=(STRESS, STRESS), times=TIMES)
    tested = dataclasses.replace(
        scene,
        stress=None,
        wells=(),
        boundaries=(),
        coupling=None,
        matrix=None,
        fluid=None,
        initial_pressure=None,
        times=(),
        test=FailureTest(kind="tension"),
        observe=("peak_strength",),
    )
    strength = float(simulate(tested)["peak_strength"])
    radius = float(run_stages(tested)["pack"].radius.mean())
    well = dataclasses.replace(scene.wells[0], radius=RADII * radius, rate=RATE)
    found = simulate(dataclasses.replace(scene, wells=(well,)))
    return float(found["highest_well_pressure"][0]) / (2.0 * STRESS + strength)


def run(seeds: tuple[int, ...] = SEEDS) -> Result:
    """The mean over packings."""
    found = [ratio(seed) for seed in seeds]
    mean = float(np.mean(found))
    return Result(
        f"breakdown over 3 σ3 − σ1 + T at 1:1, r_w = {RADII:g} R: {mean:.2f} in the mean of "
        f"{len(found)} packings ({min(found):.2f} to {max(found):.2f})",
        f"{LOW} to {HIGH}",
        LOW <= mean <= HIGH,
        "\n".join(f"packing {seed}: {one:.3f}" for seed, one in zip(seeds, found, strict=True)),
    )
