"""Drawdown of a well scatters less from packing to packing where grains are finer around it.

The paper's radial scene at its five times, twelve packings of 5,000 grains each way: alike
everywhere, or eight times finer at the well's wall. P_D over Eq. 29 at each packing's own t_D.
"""

from __future__ import annotations

import numpy as np

from demflow.model import simulate
from demflow.model.analytic.radial import radial_dimensionless_pressure
from demflow.model.scene import Circle, Fluid, Grains, Matrix, Refinement, Scene, Well
from tests.benchmarks.result import Result

PACKINGS, GRAINS, BOUND = 12, 5_000, 1 / 3
T_D = np.array([1.67, 5.84, 19.75, 38.29, 334.97])
RADIUS, RIM, PERMEABILITY, RATE, PRESSURE = 0.964, 13.8, 2.41e-12, 2e-5, 7e6
FINER = (Refinement(around="wells", within=0.05, factor=8.0),)


def error(seed: int, refine: tuple[Refinement, ...] | None) -> np.ndarray:
    """P_D over Eq. 29, less one, at each time."""
    scene = Scene(
        region=Circle(RIM),
        grains=Grains(count=GRAINS, porosity=0.19, seed=seed, refine=refine),
        matrix=Matrix(permeability=PERMEABILITY),
        fluid=Fluid(viscosity=1.0, bulk_modulus=1e9),
        wells=(Well(name="w", at=(0.0, 0.0), radius=RADIUS, rate=RATE),),
        boundaries=(("outer", PRESSURE),),
        initial_pressure=PRESSURE,
        times=tuple(T_D * 0.19 * 1e-9 * RADIUS**2 / PERMEABILITY),
        observe=("well_pressure",),
    )
    found = simulate(scene)
    reach = RIM / RADIUS
    fall = RATE * np.log(reach) / (2 * np.pi * PERMEABILITY)
    own = T_D * 0.19 / float(found["porosity"])
    expected = radial_dimensionless_pressure(1.0, own, reach)
    off: np.ndarray = (PRESSURE - found["well_pressure"].ravel()) / fall / expected - 1.0
    return off


def run() -> Result:
    """Standard deviation over packings, the graded over the even ones, at each time."""
    spread, lines = [], []
    for name, refine in (("even", None), ("graded", FINER)):
        off = 100 * np.array([error(seed + 1, refine) for seed in range(PACKINGS)])
        spread.append(off.std(axis=0, ddof=1))
        lines.append(f"{name}: mean {off.mean(axis=0).round(2)} %, spread {spread[-1].round(2)} %")
    ratio = spread[1] / spread[0]
    return Result(
        f"spread {', '.join(f'{r:.2f}' for r in ratio)} of that of even grains",
        f"≤ {BOUND:.2f} at each time",
        bool(np.all(ratio <= BOUND)),
        "\n".join(lines),
    )
