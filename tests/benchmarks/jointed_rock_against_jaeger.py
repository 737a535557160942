"""A jointed rock slides where its joint's friction is mobilised, as Jaeger says, and only there."""

from __future__ import annotations

import numpy as np

from demflow.model.analytic.jaeger import jaeger_strength, mobilised_friction
from demflow.model.products import Packing
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, FailureTest, Joint, JointLine
from demflow.model.stages import pack, strength
from tests.benchmarks.result import Result

BONDS = Bonds(kind="parallel", tensile_strength=157e6, shear_strength=157e6)
FRICTION, CONFINING = 20.0, 10e6  # degrees, Pa
SLIDES, HOLDS = (35, 40, 45, 50, 55, 60), (0, 15, 90)
PACKINGS, GRAINS, WITHIN = 3, 900, 1.5  # degrees of friction


def peak(rock: Packing, degrees: float, seed: int) -> float:
    """Largest axial stress with a joint at an angle to the platens, Pa."""
    way = 0.2 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    slides = degrees in SLIDES
    test = FailureTest(
        confining_stress=CONFINING,
        confinement="membrane",
        strain_step=1e-7 if slides else 4e-7,
        largest_strain=1.5e-3 if slides else 1e-2,
    )
    joint = Joint(
        normal_stiffness=2e13, shear_stiffness=2e13, friction=float(np.tan(np.radians(FRICTION)))
    )
    found = strength(
        rock,
        normal_stiffness=62e9,
        stiffness_ratio=2.5,
        friction=0.5,
        bonds=BONDS,
        joints=(JointLine((-way[0], -way[1]), (way[0], way[1]), joint),),
        test=test,
        seed=seed,
    )
    return float(found.peak_strength)


def run() -> Result:
    """Means over packings; the worst of the angles at which the joint slides."""
    rocks = [
        pack(
            region=Rectangle(0.034, 0.1),
            count=GRAINS,
            mean_radius=None,
            packing="random",
            radius_ratio=1.66,
            porosity=0.16,
            seed=seed,
            floaters="fit",
            specimen=True,
        )
        for seed in range(1, PACKINGS + 1)
    ]
    worst, weakest, strongest, lines = 0.0, np.inf, 0.0, []
    for degrees in sorted(SLIDES + HOLDS):
        angle = np.radians(degrees)
        found = [peak(rock, degrees, seed) for seed, rock in enumerate(rocks)]
        mean = float(np.mean(found))
        wanted = float(jaeger_strength(CONFINING, angle, np.tan(np.radians(FRICTION))))
        mobilised = float(np.degrees(mobilised_friction(mean, CONFINING, float(angle))))
        if degrees in SLIDES:
            worst = max(worst, abs(mobilised - FRICTION))
            strongest = max(strongest, mean)
        else:
            weakest = min(weakest, mean)
        lines.append(
            f"{degrees:3} degrees: {mean / 1e6:6.1f} MPa (range {np.ptp(found) / 1e6:.1f}), "
            f"Jaeger {wanted / 1e6:.1f}, friction mobilised {mobilised:.1f} degrees"
        )
    return Result(
        f"friction of {FRICTION:g} degrees within {worst:.1f}; where the joint cannot slide "
        f"{weakest / strongest:.1f} times as strong",
        f"≤ {WITHIN:g} degrees; ≥ 2 times",
        worst <= WITHIN and weakest >= 2.0 * strongest,
        "\n".join(lines),
    )
