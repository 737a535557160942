"""A barrier by thickness and permeability is worth its resistance, whatever the grains."""

from __future__ import annotations

import numpy as np

from demflow.model import simulate
from demflow.model.scene import Fluid, Grains, Matrix, Rectangle, Scene, Trace
from tests.benchmarks.result import Result

WIDTH, HEIGHT, PERMEABILITY = 20.0, 16.0, 1e-14
SIZES, SEEDS, WORTH = (300, 1_200, 5_000, 20_000), (1, 2, 3), (0.5, 5.0, 50.0)
BOUND = 0.03


def flow(grains: int, seed: int, barrier: tuple[Trace, ...]) -> float:
    """Steady flow from left to right."""
    found = simulate(
        Scene(
            region=Rectangle(WIDTH, HEIGHT),
            grains=Grains(count=grains, seed=seed, porosity=0.17),
            matrix=Matrix(permeability=PERMEABILITY),
            fluid=Fluid(viscosity=1e-3, bulk_modulus=2e9),
            fractures=barrier,
            boundaries=(("left", 1e6), ("right", 0.0)),
            observe=("boundary_flow",),
        )
    )
    return float(found["boundary_flow"][0])


def run() -> Result:
    """Mean over packings of the series formula's error, the largest over sizes and barriers."""
    worst, lines = 0.0, []
    for grains in SIZES:
        ratio = np.empty((len(SEEDS), len(WORTH)))
        for row, seed in enumerate(SEEDS):
            whole = flow(grains, seed, ())
            for column, worth in enumerate(WORTH):
                k = PERMEABILITY * 0.05 / worth
                ends = {"start": (0.3, -HEIGHT), "end": (0.3, HEIGHT)}
                wall = Trace(name="wall", thickness=0.05, permeability=k, **ends)
                ratio[row, column] = whole / flow(grains, seed, (wall,))
        off = ratio.mean(axis=0) / (1.0 + np.array(WORTH) / WIDTH) - 1.0
        worst = max(worst, float(np.abs(off).max()))
        lines.append(f"{grains} grains: {np.round(off, 4)} for barriers worth {WORTH} m of rock")
    return Result(f"largest error {worst:.1%}", f"≤ {BOUND:.0%}", worst <= BOUND, "\n".join(lines))
