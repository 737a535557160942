"""Stresses around an excavated hole are Kirsch's, under equal and unequal stresses at an angle."""

from __future__ import annotations

import numpy as np
from scipy import stats

from demflow.model.scene import Bonds, Circle, CircularHole, Fluid, Grains, Matrix, Scene, Stress
from demflow.model.stages import run_stages
from tests.benchmarks.result import Result
from tests.shells import PARTS_OF_STRESS, kirsch_rings, ring_stresses

PACKINGS, GRAINS, RADIUS, HOLE = 12, 5_000, 10.0, 1.5  # a hole of some 12 grains' width
FAR = 20e6
EDGES = HOLE * np.array([1.15, 1.5, 2.0, 2.5, 3.0])
STATES = {
    "1:1": {"greatest": FAR, "least": FAR, "angle": 0.0, "pressure": 0.0},
    "1:1, pressed from within by the half": {
        "greatest": FAR, "least": FAR, "angle": 0.0, "pressure": 0.5 * FAR
    },
    "2:1 at 35°": {
        "greatest": FAR, "least": 0.5 * FAR, "angle": np.radians(35.0), "pressure": 0.0
    },
}  # fmt: skip
BOUND = 0.03  # of σ1, root mean square over rings and parts of the mean's error


def scene(seed: int, state: dict[str, float]) -> Scene:
    """A round rock of strong cement with a hole in its middle."""
    return Scene(
        region=Circle(RADIUS),
        grains=Grains(count=GRAINS, seed=seed, porosity=0.17, modulus=62e9),
        bonds=Bonds(kind="parallel", tensile_strength=1e10, shear_strength=1e10),
        stress=Stress(xx=state["greatest"], yy=state["least"], angle=state["angle"]),
        excavate=(CircularHole(at=(0.0, 0.0), radius=HOLE, pressure=state["pressure"]),),
        matrix=Matrix(permeability=1e-15),
        fluid=Fluid(viscosity=1e-3, bulk_modulus=2e9),
        boundaries=(("outer", 1e6), ("hole[0]", 0.0)),
        observe=("boundary_flow",),
    )


def run() -> Result:
    """Means over packings against the law's over the same rings, and their standard errors."""
    worst, beyond, compared, lines = 0.0, 0, 0, []
    sure = float(stats.t.ppf(0.975, PACKINGS - 1))
    for name, state in STATES.items():
        found = np.array(
            [
                ring_stresses(run_stages(scene(seed, state))["stress"], EDGES, state["angle"])
                for seed in range(1, PACKINGS + 1)
            ]
        )
        law = kirsch_rings(EDGES, radius=HOLE, **state) / FAR
        found /= FAR
        off = found.mean(axis=0) - law
        error = found.std(axis=0, ddof=1) / np.sqrt(PACKINGS)
        worst = max(worst, float(np.sqrt(np.mean(off**2))))
        beyond += int(np.count_nonzero(np.abs(off) > sure * error))
        compared += off.size
        lines.append(f"{name}, over σ1, rings {np.round(EDGES / HOLE, 2)} radii:")
        for k, part in enumerate(PARTS_OF_STRESS):
            values = zip(law[:, k], off[:, k], error[:, k], strict=True)
            told = ", ".join(f"{a:+.3f} {b:+.3f} ± {c:.3f}" for a, b, c in values)
            lines.append(f"  {part:9s} law, found less law ± standard error: {told}")
    lines.append(f"{beyond} of {compared} means lie beyond their 95 % intervals")
    return Result(
        f"root mean square error {worst:.3f} σ1, {beyond} of {compared} beyond 95 %",
        f"≤ {BOUND} σ1 for each state",
        worst <= BOUND,
        "\n".join(lines),
    )
