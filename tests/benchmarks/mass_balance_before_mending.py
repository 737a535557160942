"""Volume balances before any solver puts it right, in 200 random scenes; nothing where none flows.

`mass_imbalance` is what a study is told of the balance before it was mended, of `krylov` and
`implicit` at 1e-4; where it is above the bound it says so by its size. Of each scene there
is a second one in which nothing can flow: all wells and sides keep the pressure of the start.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from demflow.model.outcome import ModelError
from demflow.model.scene import Scene, Solver, Well
from tests.benchmarks.result import Result
from tests.benchmarks.tolerance_means_error import Recorded, products_of, solvable
from tests.scenes import START

SCENES, BOUND, TOLERANCE = 200, 1e-10, 1e-4
METHODS = ("krylov", "implicit")
BALANCES = ("mass_balance_error", "mass_imbalance", "flow_balance_error", "residual")


def at_rest(scene: Scene) -> Scene:
    """The same rock, whose wells and sides all keep the pressure of the start."""
    wells = tuple(
        Well(name=w.name, at=w.at, radius=w.radius, skin_factor=w.skin_factor, pressure=START)
        for w in scene.wells
    )
    sides = tuple((name, START) for name, _ in scene.boundaries)
    return dataclasses.replace(scene, wells=wells, boundaries=sides)


def told(scene: Scene, rock: Recorded, method: str) -> dict[str, float]:
    """The measures of balance that a study is told."""
    asked = dataclasses.replace(scene, solver=Solver(method=method, tolerance=TOLERANCE))
    found = products_of(asked, rock, "flow", "observe")["observe"]
    return {name: float(found[name]) for name in BALANCES}


def run(scenes: int = SCENES, first: int = 1) -> Result:
    """Imbalance of each scene and solver, and the largest measure of those at rest."""
    lines, moving, resting, refused = [], [], [], 0
    for seed, scene, rock in solvable(scenes, first):
        for method in METHODS:
            try:
                found = told(scene, rock, method)
                rest = max(told(at_rest(scene), rock, method).values())
            except ModelError as error:
                refused += 1
                lines.append(f"scene {seed}, {method}: refused: {error}")
                continue
            moving.append(found["mass_imbalance"])
            resting.append(rest)
            if moving[-1] > BOUND or rest > 0.0:
                lines.append(f"scene {seed}, {method}: {found}, at rest {rest:.2g}")
    within = float(np.mean(np.array(moving) <= BOUND))
    return Result(
        f"imbalance ≤ {BOUND:g} in {within:.1%} of {len(moving)}, largest {max(moving):.2g}, told "
        f"each; at rest {max(resting):.2g}; {refused} refused",
        f"≤ {BOUND:g} or told; 0 at rest",
        max(resting) == 0.0 and np.isfinite(moving).all(),
        "\n".join(lines[:40]),
    )
