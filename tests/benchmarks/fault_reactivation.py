"""A fault at 60 degrees under rising pressure slides where Mohr and Coulomb say.

From corner to corner of a sealed rock, so that walls hold neither half; water is injected slowly.
As it slides the fault dilates, which takes up what is injected: the pressure rises no further than
to where the fault slides as a whole. By Mohr and Coulomb that is σn − |τ| / μ. Injection goes on
for a tenth longer, so that a fault that did not slide would be off by as much.
"""

from __future__ import annotations

import math

import numpy as np

from demflow.model.analytic.mohr_coulomb import slip_pressure
from demflow.model.region import Rectangle
from demflow.model.scene import BiWing, Bonds, Fluid, Grains, Joint, Matrix, Scene, Stress, Well
from demflow.model.scene.coupling import Coupling
from demflow.model.stages import simulate
from tests.benchmarks.result import Result

ANGLE, LEAST, COUNT, RATE = math.radians(60.0), 10e6, 500, -1e-3
CASES = (
    *((seed, 20e6, 0.6) for seed in range(1, 9)),
    *((seed, 24e6, friction) for seed in (1, 2, 4, 5) for friction in (0.6, 0.7)),
)
BOUND = 0.05
PER_SECOND = 2.75e6  # about what the injected volume raises the pressure by, Pa/s


def faulted(seed: int, largest: float, friction: float) -> Scene:
    """The rock; its times reach a tenth beyond the pressure at which it is to slide."""
    expected = float(slip_pressure(LEAST, largest, ANGLE, friction))
    joint = Joint(
        normal_stiffness=50e9,
        shear_stiffness=50e9,
        friction=friction,
        dilation_angle=math.radians(10.0),
    )
    return Scene(
        region=Rectangle(1.0, math.tan(ANGLE)),
        grains=Grains(count=COUNT, porosity=0.16, seed=seed, modulus=20e9),
        bonds=Bonds(kind="parallel", tensile_strength=200e6, shear_strength=200e6),
        stress=Stress(xx=LEAST, yy=largest),
        matrix=Matrix(aperture=3e-4, gap_factor=1.0),
        fluid=Fluid(1e-3, 2.2e9),
        fractures=(BiWing(name="fault", at=(0.0, 0.0), angle=ANGLE, half_length=1.1, joint=joint),),
        wells=(Well(name="injector", at=(0.0, 0.0), radius=0.01, rate=RATE),),
        initial_pressure=0.0,
        coupling=Coupling(method="breaking"),
        times=tuple(np.linspace(0.0, 1.1 * expected / PER_SECOND, 45)[1:].tolist()),
        observe=("well_pressure", "joint_slip"),
    )


def onset(scene: Scene) -> tuple[float, float]:
    """Pressure where the fault slides as a whole (Pa), and the slip until the end (m)."""
    found = simulate(scene)
    return float(np.nanmax(found["well_pressure"])), float(np.nanmax(found["joint_slip"]))


def run() -> Result:
    """Packings, stresses and frictions."""
    ratios, lines = [], []
    for seed, largest, friction in CASES:
        pressure, slip = onset(faulted(seed, largest, friction))
        expected = float(slip_pressure(LEAST, largest, ANGLE, friction))
        ratios.append(pressure / expected)
        lines.append(
            f"packing {seed}, {largest / LEAST:.1f}:1, friction {friction}: slides at "
            f"{pressure / 1e6:.3f} MPa of {expected / 1e6:.3f} MPa, {ratios[-1]:.3f}; slip until "
            f"the end {slip * 1e3:.3f} mm"
        )
    worst = max(abs(ratio - 1.0) for ratio in ratios)
    return Result(
        f"pressure off Mohr and Coulomb's by {worst:.1%} at most, mean {np.mean(ratios):.3f} of it",
        f"≤ {BOUND:.0%}",
        bool(worst <= BOUND),
        "\n".join(lines),
    )
