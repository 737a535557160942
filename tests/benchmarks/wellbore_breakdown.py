"""Breakdown pressure of a wellbore against 3 σ3 − σ1 + T (Hubbert & Willis 1957).

Fluid is injected slowly into a hole of five and of ten mean radii under equal stresses until a
fracture runs from it; T is what a test in direct tension measures on grains of the same packing and
cement. The highest pressure of the well after any step is taken, and a march ends once the well has
fallen by a tenth. The formula is of a fluid that stays in the hole and of rock without grains:
what lowers the ratio is fluid that leaks into the wall, and bonds of the wall that the stresses
broke as it was drilled. Where T is several times the stress, the wall, which is stretched over a
grain's size alone, bears more than T, and the ratio is above 1.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from demflow.model.scene import FailureTest
from demflow.model.stages import STAGES, run_stages
from tests.benchmarks.breaking_keeps_its_books import bored
from tests.benchmarks.result import Result

SEEDS = tuple(range(1, 11))
STRESS, RATE = 10e6, -1e-3
HOLES = {5.0: 1000, 10.0: 2000}  # radii of the hole in mean radii: grains, some 12 and 9 radii wide
LOW, HIGH = 0.8, 1.1
TIMES = tuple(np.round(np.arange(1, 201) * 0.03, 3).tolist())
FALLEN = 0.9


def ratio(seed: int, radii: float) -> float:
    """Breakdown over 2 σ + T of one packing."""
    scene = bored(seed, count=HOLES[radii], stress=(STRESS, STRESS), times=TIMES)
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
    products = run_stages(tested)
    packed, strength = products["pack"], float(products["observe"]["peak_strength"])
    well = dataclasses.replace(
        scene.wells[0], radius=radii * float(packed.radius.mean()), rate=RATE
    )
    scene = dataclasses.replace(scene, wells=(well,))
    stage, found = next(s for s in STAGES if s.name == "fracture"), None
    for leg in range(len(stage.legs_of(scene))):
        found = stage.run(packed, None, found, **stage.given(scene, leg))
        now = found.records.well_pressure[-1:, 0]
        if str(found.state.stopped) or (len(now) and now[0] < FALLEN * found.highest[0]):
            break
    assert found is not None
    return float(found.highest[0]) / (2.0 * STRESS + strength)


def run(seeds: tuple[int, ...] = SEEDS) -> Result:
    """The mean over packings, of each hole."""
    found = {radii: [ratio(seed, radii) for seed in seeds] for radii in HOLES}
    means = {radii: float(np.mean(ratios)) for radii, ratios in found.items()}
    return Result(
        "breakdown over 3 σ3 − σ1 + T at 1:1: "
        + "; ".join(
            f"{means[radii]:.2f} ({min(each):.2f} to {max(each):.2f}) at r_w = {radii:g} R"
            for radii, each in found.items()
        )
        + f", {len(seeds)} packings",
        f"{LOW} to {HIGH} in the mean",
        all(LOW <= mean <= HIGH for mean in means.values()),
        "\n".join(
            f"r_w = {radii:g} R, packing {seed}: {one:.3f}"
            for radii, each in found.items()
            for seed, one in zip(seeds, each, strict=True)
        ),
    )
