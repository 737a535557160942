"""Small rocks with a hole in them that fluid is injected into, until it breaks."""

from functools import cache

import numpy as np

from demflow.model.coupling.fracture import Fracturing, fracture
from demflow.model.coupling.told import BreakingFluid, BreakingRock, Leg
from demflow.model.mechanics.packing.packing import pack
from demflow.model.products import Packing
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, Joint, JointLine, Matrix, Stress, Well

KN = 20e9
BONDS = {
    "parallel": Bonds(kind="parallel", tensile_strength=10e6, shear_strength=30e6),
    "contact": Bonds(kind="contact", tensile_strength=10e6, shear_strength=30e6),
}
REGION = Rectangle(2.0, 2.0)


@cache
def packed(count: int = 250, seed: int = 1, kind: str = "random") -> Packing:
    porosity = 0.16 if kind == "random" else None
    return pack(
        region=REGION, count=count, mean_radius=None, packing=kind, radius_ratio=1.66,
        porosity=porosity, seed=seed, specimen=True,
    )  # fmt: skip


def rock(
    bonds: Bonds | None = None,
    *,
    stress: tuple[float, float] = (10e6, 10e6),
    joints: tuple[JointLine, ...] = (),
    friction: float = 0.5,
) -> BreakingRock:
    held = BONDS["parallel"] if bonds is None else bonds
    return BreakingRock(KN, 2.5, friction, held, joints, 1, Stress(xx=stress[0], yy=stress[1]))


def wet(
    *,
    bulk_modulus: float = 2.2e9,
    gap_factor: float = 1.0,
    least_pressure: float | None = None,
    sides: tuple[tuple[str, float], ...] = (("outer", 0.0),),
    aperture: float = 2e-5,
    half_force: float | None = None,
) -> BreakingFluid:
    matrix = Matrix(aperture=aperture, gap_factor=gap_factor, half_force=half_force)
    return BreakingFluid(1e-3, bulk_modulus, matrix, 0.0, least_pressure, sides)


def well(packing: Packing, radii: float = 3.0, rate: float = -1e-3) -> Well:
    return Well(name="w", at=(0.0, 0.0), radius=radii * float(packing.radius.mean()), rate=rate)


def joint(angle: float, **more: float) -> JointLine:
    reach = np.array([np.cos(angle), np.sin(angle)])
    plane = Joint(normal_stiffness=10 * KN, shear_stiffness=4 * KN, friction=0.6, **more)
    return JointLine((-reach[0], -reach[1]), (reach[0], reach[1]), plane)


def run(
    packing: Packing,
    grains: BreakingRock,
    fluid: BreakingFluid,
    *,
    rate: float = -4e-3,
    radii: float = 3.0,
    times: tuple[float, ...] = (1.0, 1.9),
    before: Fracturing | None = None,
    start: float = 0.0,
    pressure: float | None = None,
    record_map: bool = False,
) -> Fracturing:
    site = well(packing, radii, rate)
    if pressure is not None:
        site = Well(name="w", at=site.at, radius=site.radius, pressure=pressure)
    leg = Leg(start, times[-1], (rate if pressure is None else None,), times, False)
    return fracture(
        packing, None, before, rock=grains, wet=fluid, wells=(site,), probes=(), tolerance=1e-2,
        record_map=record_map, leg=leg,
    )  # fmt: skip
