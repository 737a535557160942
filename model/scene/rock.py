"""The rock: its grains, the cement between them and the stresses on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from demflow.model.parameters import Problems, SceneError, check_fields, parameter
from demflow.model.region import Region

__all__ = [
    "Bonds",
    "Contact",
    "FailureTest",
    "Grains",
    "Refinement",
    "Stress",
    "grain_problems",
    "loading_problems",
]

LATTICES = ("square", "hexagonal")
MOST_GRAINS = 2_000_000
# What packings of discs at rest reach at all: equal grains 0.136 at the least, a ratio of
# 1.66 from 0.157 to 0.22. Packing says which part of it a radius ratio can have.
LEAST_POROSITY, GREATEST_POROSITY = 0.135, 0.22
PACKING_PRESSURES = 1e-5, 1e-2  # over k_n, between which grains are packed


@dataclass(frozen=True, slots=True)
class Contact:
    """A law of contact other than the linear one without rolling resistance."""

    law: str  # hertz | rolling
    poissons_ratio: float | None = None  # of the grains, for Hertz-Mindlin
    rolling_friction: float | None = None


@dataclass(frozen=True, slots=True)
class Refinement:
    """A place around which grains are finer; beyond it they grow to their size elsewhere."""

    around: str | tuple[float, float] = parameter(
        "m", help="wells, traces, or a point around which grains are finer"
    )
    within: float = parameter("m", at_least=0, help="distance up to which they are finest")
    factor: float = parameter(
        above=1, at_most=64, help="radius of the grains elsewhere over that of the finest"
    )

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True)
class Grains:
    """The discs: how many, how large, how packed, and how their contacts respond.

    Give `count` or `mean_radius`, and `modulus` or `normal_stiffness`; of a random packing a
    porosity or a packing friction, and one of the packing's three targets beside it at most.
    """

    count: int | None = parameter(
        default=None, at_least=1, at_most=MOST_GRAINS, help="grains inside the region"
    )
    mean_radius: float | None = parameter(
        "m", default=None, above=0, example="10 cm", help="mean grain radius, instead of a count"
    )
    packing: str = parameter(
        default="random",
        choices=("random", "periodic", "square", "hexagonal"),
        help="arrangement of grains; periodic repeats a random tile that has no walls",
    )
    tile: int = parameter(
        default=2000, at_least=100, at_most=200_000, help="grains in the tile of periodic packing"
    )
    radius_ratio: float = parameter(
        default=1.66, at_least=1, at_most=10, help="largest over smallest radius, uniform between"
    )
    sizes: str = parameter(
        default="uniform",
        choices=("uniform", "log-normal", "list"),
        help="law of the radii; uniform reads radius_ratio",
    )
    radius_deviation: float | None = parameter(
        default=None, above=0, at_most=0.46, help="standard deviation of ln r, log-normal sizes"
    )
    radii: tuple[float, ...] | None = parameter(
        "m", default=None, above=0, help="a list of radii in equal parts; their ratios count"
    )
    porosity: float | None = parameter(
        default=None,
        at_least=LEAST_POROSITY,
        at_most=GREATEST_POROSITY,
        reason="discs at rest that touch reach no other porosity: about 0.16 where they are "
        "pressed hard, 0.22 at the loosest",
        help="porosity of a random packing",
    )
    packing_stress: float | None = parameter(
        "Pa",
        default=None,
        above=0,
        help="isotropic stress at which grains are packed; default: 2e-4 k_n, or what porosity "
        "and packing_friction together need",
    )
    packing_friction: float | None = parameter(
        default=None,
        at_least=0,
        at_most=1,
        help="friction while packing, instead of a porosity, or of a stress beside one",
    )
    floaters: str = parameter(
        default="leave",
        choices=("leave", "fit"),
        help="grains without load stay as they lie, or are fitted into their voids and bonded",
    )
    seed: int = parameter(default=1, at_least=0, help="seed of the random packing")
    refine: tuple[Refinement, ...] | None = parameter(
        default=None, help="places around which grains of a random packing are finer"
    )
    scatter: str = parameter(
        default="leave",
        choices=("leave", "even"),
        help="permeability and porosity differ from place to place as grains happen to lie, or are "
        "evened over some 16 pores; always so where grains are refined",
    )
    modulus: float | None = parameter(
        "Pa", default=None, above=0, help="modulus E_c of grains at a contact, whose k_n is E_c"
    )
    normal_stiffness: float | None = parameter(
        "N/m", default=None, above=0, help="normal contact stiffness k_n, instead of a modulus"
    )
    stiffness_ratio: float = parameter(
        default=2.5, above=0, help="normal over shear contact stiffness, k_n / k_s"
    )
    friction: float = parameter(default=0.5, at_least=0, help="contact friction coefficient")
    contact: str = parameter(
        default="linear",
        choices=("linear", "hertz"),
        help="law of contact: linear, or Hertz-Mindlin, for which modulus is the grains' Young's",
    )
    poissons_ratio: float = parameter(
        default=0.25, at_least=0, at_most=0.5, help="of the grains; only Hertz-Mindlin reads it"
    )
    rolling_friction: float = parameter(
        default=0.0,
        at_least=0,
        help="moment that a linear contact bears, over its normal force and relative radius",
    )
    density: float = parameter(
        "kg/m3",
        default=2650.0,
        above=0,
        help="density of the grains, by which they weigh under gravity",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        problems = []
        if (self.count is None) == (self.mean_radius is None):
            problems.append(("count", "give either count or mean_radius"))
        if self.modulus is not None and self.normal_stiffness is not None:
            problems.append(("modulus", "give either modulus or normal_stiffness"))
        for kind, name in (("log-normal", "radius_deviation"), ("list", "radii")):
            if (self.sizes == kind) != bool(getattr(self, name)):
                problems.append((name, f"sizes {kind} and {name} go together"))
        if self.radii and max(self.radii) > 10.0 * min(self.radii):
            problems.append(("radii", "the largest radius is more than ten times the smallest"))
        if self.refine and self.packing != "random":
            what = f"grains of a {self.packing} packing are alike; take packing: random"
            problems.append(("refine", what))
        problems += self._packing_problems()
        problems += self._contact_problems()
        if problems:
            raise SceneError(problems)

    def _contact_problems(self) -> list[tuple[str, str]]:
        """What is wrong with the law of contact."""
        if self.contact == "linear":
            return []
        problems = []
        if self.normal_stiffness is not None:
            what = f"a {self.contact} contact has no stiffness of its own; give modulus instead"
            problems.append(("normal_stiffness", what))
        if self.rolling_friction > 0.0:
            what = "rolling resistance goes with contact: linear"
            problems.append(("rolling_friction", what))
        return problems

    @property
    def contact_law(self) -> Contact | None:
        """The law of contact, None for the linear one without rolling resistance."""
        if self.contact == "hertz":
            return Contact("hertz", poissons_ratio=self.poissons_ratio)
        if self.rolling_friction > 0.0:
            return Contact("rolling", rolling_friction=self.rolling_friction)
        return None

    def _packing_problems(self) -> list[tuple[str, str]]:
        """What is wrong with the targets of the packing."""
        names = ("porosity", "packing_stress", "packing_friction")
        given = [name for name in names if getattr(self, name) is not None]
        if self.packing in LATTICES:
            what = f"a {self.packing} packing has a porosity of its own, and no stress or friction"
            return [(name, what) for name in given]
        problems = []
        if len(given) == 3:
            what = "porosity, packing_stress and packing_friction are one relation; give two"
            problems.append(("packing_friction", what))
        elif self.porosity is None and self.packing_friction is None:
            what = f"a {self.packing} packing needs a porosity, for instance 0.17, or a "
            what += "packing_friction"
            problems.append(("porosity", what))
        if self.packing_stress is not None and self.contact_stiffness is None:
            problems.append(("packing_stress", "a stress needs modulus or normal_stiffness"))
        pressure, stiffness = self.packing_pressure, self.contact_stiffness
        low, high = PACKING_PRESSURES
        if pressure is not None and stiffness is not None and not low <= pressure <= high:
            what = f"{pressure:.3g} of k_n, where grains are loose or crushed; choose "
            what += f"{low * stiffness:.3g} to {high * stiffness:.3g} Pa"
            problems.append(("packing_stress", what))
        return problems

    @property
    def packing_pressure(self) -> float | None:
        """The packing stress over the normal stiffness, None where either is not given."""
        if self.packing_stress is None or self.contact_stiffness is None:
            return None
        return self.packing_stress / self.contact_stiffness

    @property
    def contact_stiffness(self) -> float | None:
        """Normal stiffness k_n of a contact, N/m per metre of depth.

        A grain has 2 E_c t (Potyondy & Cundall 2004, Eq. 21) and a contact two grains in
        series, which makes E_c t, with t = 1 m. None where neither modulus nor stiffness is
        given.
        """
        return self.modulus if self.modulus is not None else self.normal_stiffness


@dataclass(frozen=True, slots=True)
class Bonds:
    """Cement at the contacts. Strengths are stresses over the bond's cross-section.

    With a deviation they are normally distributed from bond to bond, tension and shear apart,
    drawn from the seed of the grains; what would be negative is zero.
    """

    kind: str = parameter(choices=("contact", "parallel"), help="force only, or force and moment")
    tensile_strength: float = parameter("Pa", at_least=0, help="tensile strength")
    shear_strength: float = parameter("Pa", at_least=0, help="shear strength")
    tensile_deviation: float = parameter(
        "Pa", default=0.0, at_least=0, help="standard deviation of the tensile strength"
    )
    shear_deviation: float = parameter(
        "Pa", default=0.0, at_least=0, help="standard deviation of the shear strength"
    )
    friction: float = parameter(
        default=0.0, at_least=0, help="shear strength that a bond gains per compression on it"
    )
    radius_multiplier: float = parameter(
        default=1.0, above=0, at_most=1, help="bond half-width over the smaller grain radius"
    )
    modulus: float | None = parameter(
        "Pa", default=None, above=0, help="modulus of a parallel bond; default: the grains'"
    )
    stiffness_ratio: float | None = parameter(
        default=None, above=0, help="normal over shear stiffness of a parallel bond; as modulus"
    )
    installation_gap: float = parameter(
        default=0.0,
        at_least=0,
        at_most=0.1,
        help="gap up to which cement joins grains that do not touch, over the mean radius",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.kind == "contact":
            given = [n for n in ("modulus", "stiffness_ratio") if getattr(self, n) is not None]
            if given:
                raise SceneError([(n, "a contact bond is as stiff as its contact") for n in given])

    def elastic(self, stiffness: float) -> Bonds:
        """The same cement without its strengths, its modulus over a contact's stiffness k_n."""
        return replace(
            self,
            tensile_strength=0.0,
            shear_strength=0.0,
            tensile_deviation=0.0,
            shear_deviation=0.0,
            friction=0.0,
            modulus=None if self.modulus is None else self.modulus / stiffness,
        )


@dataclass(frozen=True, slots=True)
class Stress:
    """Principal stresses that the walls apply, positive in compression, and how rest is found.

    With an angle, `xx` acts along that direction and `yy` across it.
    """

    xx: float = parameter("Pa", above=0, help="stress on the left and right walls")
    yy: float = parameter("Pa", above=0, help="stress on the bottom and top walls")
    angle: float = parameter(
        "rad", default=0.0, help="direction of the principal stress xx, from the x axis"
    )
    method: str = parameter(
        default="auto",
        choices=("auto", "static", "explicit"),
        help="auto takes static for bonded grains, explicit where bonds break or there are none",
    )
    tolerance: float = parameter(
        default=1e-3,
        at_least=1e-10,
        at_most=0.1,
        help="mean unbalanced over mean contact force, relative error of the stresses",
    )

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def components(self) -> tuple[float, float, float]:
        """Stresses xx, yy, xy along the axes, Pa."""
        mean, half = 0.5 * (self.xx + self.yy), 0.5 * (self.xx - self.yy)
        turn = 2.0 * self.angle
        along, shear = half * math.cos(turn), half * math.sin(turn)
        if abs(shear) < 1e-12 * mean:  # quarter turns, in round numbers
            shear = 0.0
        return mean + along, mean - along, shear


@dataclass(frozen=True, slots=True)
class FailureTest:
    """A test to failure of the whole packing, in the direction y."""

    kind: str = parameter(
        default="biaxial",
        choices=("biaxial", "tension"),
        help="platens approach between confining walls, or grips part without walls",
    )
    confining_stress: float = parameter(
        "Pa", default=1e5, at_least=0, help="stress on the lateral walls of a biaxial test"
    )
    confinement: str = parameter(
        default="walls",
        choices=("walls", "membrane"),
        help="rigid lateral walls, or a membrane that lets parts of the specimen slide apart",
    )
    strain_step: float = parameter(
        default=1e-7, at_least=1e-8, at_most=2e-5, help="axial strain of one time step"
    )
    largest_strain: float = parameter(
        default=0.02, above=0, at_most=0.2, help="axial strain at which a test gives up"
    )

    def __post_init__(self) -> None:
        check_fields(self)


def grain_problems(grains: Grains, region: Region) -> Problems:
    """What is wrong with the size of grains in a region: a radius stands for a count."""
    if grains.mean_radius is None:
        return
    count = region.area / (math.pi * grains.mean_radius**2)
    if count > MOST_GRAINS:
        what = f"about {count:.2g} grains in the region, more than {MOST_GRAINS:,}"
        yield "grains.mean_radius", what
    elif count < 1.0:
        what = f"a grain of {grains.mean_radius:g} m is larger than the region"
        yield "grains.mean_radius", what


def loading_problems(
    grains: Grains,
    bonds: Bonds | None,
    stress: Stress | None,
    test: FailureTest | None,
    *,
    coupled: bool = False,
) -> Problems:
    """What is wrong with a rock and the loads on it, taken together.

    Parameters
    ----------
    coupled : whether fluid and grains are coupled
    grains : how the grains are packed, and how stiff they are
    bonds : cement at the contacts, or None
    stress : stress on the rock, or None
    test : test to failure, or None
    """
    if (stress or test) is not None and grains.contact_stiffness is None:
        yield "grains.modulus", "a stress needs modulus or normal_stiffness"
    for name, load in (("stress", stress), ("test", test)):
        if load is not None and grains.packing == "periodic":
            what = f"a periodic packing has no walls for a {name}; take grains.packing: random"
            yield name, what
    if grains.contact_law is not None:
        yield from _nonlinear_problems(grains, bonds, stress)
    if bonds is not None:
        if stress is None and test is None and not coupled:
            yield "bonds", "bonds act only where the scene names a stress or a test"
        return
    if test is not None and test.kind == "tension":
        yield "test.kind", "unbonded grains bear no tension; add bonds"
    if stress is not None:
        yield from _unbonded_problems(grains, stress)


def _nonlinear_problems(grains: Grains, bonds: Bonds | None, stress: Stress | None) -> Problems:
    """What is wrong with loads on grains whose contacts are not linear, or resist rolling."""
    if grains.contact != "linear" and bonds is not None and bonds.kind == "contact":
        what = "a contact bond is as stiff as its contact, which is not linear; take parallel"
        yield "bonds.kind", what
    if stress is not None and stress.method == "static":
        what = "static solves linear contacts that do not resist rolling; take explicit"
        yield "stress.method", what
    if stress is not None and abs(stress.components[2]) > 0.0:
        what = "such contacts are loaded along the axes only; leave the angle out and turn "
        what += "fractures, wells and probes by minus the angle instead"
        yield "stress.angle", what


def _unbonded_problems(grains: Grains, stress: Stress) -> Problems:
    """What is wrong with a stress on grains without cement."""
    if grains.packing in LATTICES:
        yield "stress", f"an unbonded {grains.packing} lattice cannot be loaded; add bonds"
    if stress.method == "static":
        yield "stress.method", "static solves bonded grains; add bonds, or take explicit"
    if abs(stress.components[2]) > 0.0:
        what = "unbonded grains are loaded along the axes only; leave the angle out and turn "
        what += "fractures, wells and probes by minus the angle instead, or add bonds"
        yield "stress.angle", what
