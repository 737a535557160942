"""The pores and what flows in them: pipes of the matrix, the fluid, wells, probes, the solver."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from demflow.model.parameters import Problems, SceneError, check_fields, parameter
from demflow.model.region import Region, box_pairs, contains, distance_to_rim, outer_shape

__all__ = [
    "LEAST_TOLERANCE",
    "STANDARD_GRAVITY",
    "Boundary",
    "Fluid",
    "Inflow",
    "InflowSide",
    "InitialField",
    "Matrix",
    "Probe",
    "Solver",
    "Well",
    "boundary_problems",
    "conductivity_problems",
    "permeable",
    "probe_problems",
    "storage_problems",
    "time_problems",
    "well_problems",
]

Changes = tuple[tuple[float, float], ...]  # times (s) and what is new from each on

STANDARD_GRAVITY = 9.80665  # m/s², by which a hydraulic conductivity is one

# Round-off of the factor and the projection leaves some thirteen digits.
LEAST_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True)
class Matrix:
    """The pipes of the rock between fractures.

    Give `permeability`, `hydraulic_conductivity` or `aperture`. A permeability fixes the aperture
    w0 of every pipe in the unstressed state. A conductivity K is that of the scene's fluid:
    k = K μ / (ρ g), at standard gravity (Bear 1972, Dynamics of Fluids in Porous Media, 5.5).
    """

    permeability: float | None = parameter(
        "m2", default=None, above=0, help="matrix permeability, unstressed"
    )
    hydraulic_conductivity: float | None = parameter(
        "m/s",
        default=None,
        above=0,
        example="1e-7 m/s",
        help="hydraulic conductivity K of the matrix for this fluid, unstressed: permeability "
        "k = K μ / (ρ g), with the fluid's viscosity and density and g = 9.80665 m/s²",
    )
    aperture: float | None = parameter(
        "m",
        default=None,
        at_least=0,
        example="10 um",
        bare_at_most=0.1,
        help="pipe aperture w0, unstressed; 0 seals the matrix",
    )
    half_force: float | None = parameter(
        "N/m",
        default=None,
        above=0,
        help="contact force F0 that halves an aperture (Eq. 2); forces are about 2 r times the "
        "stress, so it belongs to a grain size",
    )
    half_stress: float | None = parameter(
        "Pa",
        default=None,
        above=0,
        help="stress that halves an aperture: half_force is 2 r times it at each contact, whatever "
        "the size of the grains",
    )
    gap_factor: float = parameter(
        default=0.5, at_least=0, at_most=1, help="aperture gained per gap between grains, m (Eq. 3)"
    )
    specific_storage: float | None = parameter(
        "1/m",
        default=None,
        above=0,
        example="1e-6 1/m",
        help="specific storage S_s of rock and fluid, instead of the fluid's bulk_modulus: "
        "volume that a unit volume of rock gives per metre of head; needs the fluid's density",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        ways = (self.permeability, self.hydraulic_conductivity, self.aperture)
        if sum(way is not None for way in ways) != 1:
            what = "give one of permeability, hydraulic_conductivity or aperture"
            raise SceneError([("permeability", what)])
        if self.half_force is not None and self.half_stress is not None:
            raise SceneError([("half_stress", "give either half_force or half_stress")])


@dataclass(frozen=True, slots=True)
class Fluid:
    """A slightly compressible liquid."""

    viscosity: float = parameter("Pa s", above=0, help="dynamic viscosity")
    bulk_modulus: float | None = parameter(
        "Pa",
        default=None,
        above=0,
        example="2.2 GPa",
        help="bulk modulus K_f = 1 / compressibility",
    )
    density: float | None = parameter(
        "kg/m3",
        default=None,
        above=0,
        example="1000 kg/m3",
        help="density ρ, which a hydraulic conductivity and a specific storage need",
    )
    compressibility: float | None = parameter(
        "1/Pa",
        default=None,
        above=0,
        example="4.5e-10 1/Pa",
        help="compressibility c = 1 / bulk_modulus, instead of it; a total one counts the rock's "
        "pores too",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.bulk_modulus is not None and self.compressibility is not None:
            what = "give either bulk_modulus or compressibility, which is 1 / bulk_modulus"
            raise SceneError([("compressibility", what)])

    @property
    def modulus(self) -> float | None:
        """Bulk modulus, Pa, however it is given; None where the rock's specific storage stands."""
        given = self.compressibility
        return self.bulk_modulus if given is None else 1.0 / given


@dataclass(frozen=True, slots=True, kw_only=True)
class Well:
    """A well of finite radius at a rate or a pressure, or a schedule of these.

    All pores whose centroid lies within the radius share the well's pressure; a well narrower
    than the pores stands in its own and has the drawdown of its radius all the same. A skin S
    adds q μ S / (2π k) to the fall of its pressure; a negative one acts as a well of radius
    r_w e^(−S). With a wellbore storage C the rate is that at the surface, of which C dp/dt comes
    from the wellbore.
    """

    name: str
    at: tuple[float, float] = parameter("m", help="position")
    radius: float = parameter("m", above=0, example="0.1 m", help="wellbore radius")
    rate: float | None = parameter(
        "m3/s", default=None, help="constant rate; positive produces, negative injects"
    )
    pressure: float | None = parameter("Pa", default=None, help="constant bottom-hole pressure")
    schedule: tuple[tuple[float, float], ...] | None = parameter(
        "s, m3/s", default=None, help="rate changes [[time, rate], …]; rate 0 shuts the well in"
    )
    pressure_schedule: tuple[tuple[float, float], ...] | None = parameter(
        "s, Pa", default=None, help="bottom-hole pressures [[time, pressure], …], from 0 s on"
    )
    least_pressure: float | None = parameter(
        "Pa", default=None, help="of a producer: takes over where its rate would fall below it"
    )
    largest_pressure: float | None = parameter(
        "Pa", default=None, help="of an injector: takes over where its rate would rise above it"
    )
    group: str | None = parameter(
        default=None,
        help="wells of one group share one pressure and produce the sum of their rates together",
    )
    skin_factor: float = parameter(
        default=0.0,
        at_least=-20.0,
        help="skin S; above 0 damaged rock around the well, below 0 stimulated",
    )
    wellbore_storage: float = parameter(
        "m3/Pa", default=0.0, at_least=0, help="volume that the wellbore gives per pressure fall"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        ways = ("rate", "pressure", "schedule", "pressure_schedule")
        given = [k for k in ways if getattr(self, k) is not None]
        if len(given) != 1:
            where = given[0] if given else ""
            raise SceneError([(where, f"give exactly one of {', '.join(ways)}")])
        for key in ("least_pressure", "largest_pressure", "group"):
            if self.held and getattr(self, key) is not None:
                raise SceneError([(key, "a well at a pressure has no rate to limit or to share")])
        least, largest = self.least_pressure, self.largest_pressure
        if least is not None and largest is not None and least >= largest:
            raise SceneError([("least_pressure", "it is not below the largest pressure")])
        if self.held and self.wellbore_storage > 0.0:
            what = "a well at constant pressure takes nothing from its wellbore; leave it out"
            raise SceneError([("wellbore_storage", what)])
        check_schedule("schedule", self.schedule, "rates")
        check_schedule("pressure_schedule", self.pressure_schedule, "pressures")
        if self.pressure_schedule is not None and self.pressure_schedule[0][0] > 0:
            what = "a well at a pressure has one from the start; begin at 0 s"
            raise SceneError([("pressure_schedule", what)])

    @property
    def held(self) -> bool:
        """Whether the well keeps a pressure, and not a rate."""
        return self.pressure is not None or self.pressure_schedule is not None

    @property
    def pressure_changes(self) -> tuple[tuple[float, float], ...]:
        """Times (s) and new pressures (Pa) of the well; empty at a rate."""
        if self.pressure_schedule is not None:
            return self.pressure_schedule
        return () if self.pressure is None else ((0.0, self.pressure),)

    @property
    def decides(self) -> bool:
        """Whether its rate may be another than the one that is asked for."""
        limits = (self.least_pressure, self.largest_pressure, self.group)
        return any(limit is not None for limit in limits)

    @property
    def effective_radius(self) -> float:
        """Radius of the well without skin that acts as a stimulated well does, r_w e^(−S), m."""
        return self.radius * math.exp(max(0.0, -self.skin_factor))

    @property
    def rate_changes(self) -> tuple[tuple[float, float], ...]:
        """Times (s) and new rates (m³/s) of the well; empty at a pressure."""
        if self.schedule is not None:
            return self.schedule
        return () if self.rate is None else ((0.0, self.rate),)


@dataclass(frozen=True, slots=True)
class Inflow:
    """A flow through a side of the region, in place of a pressure that the side keeps.

    The pressure is one along the side, as in a gallery, and what the flow makes of it.
    """

    inflow: float | None = parameter(
        "m3/s",
        default=None,
        help="constant flow into the region through the whole side; negative flows out",
    )
    flux: float | None = parameter(
        "m/s",
        default=None,
        example="200 mm/year",
        help="the same per area of the side, as recharge is given",
    )
    schedule: tuple[tuple[float, float], ...] | None = parameter(
        "s, m3/s", default=None, help="changes of the inflow [[time, inflow], …]"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        ways = ("inflow", "flux", "schedule")
        given = [k for k in ways if getattr(self, k) is not None]
        if len(given) != 1:
            where = given[0] if given else ""
            raise SceneError([(where, f"give exactly one of {', '.join(ways)}")])
        check_schedule("schedule", self.schedule, "inflows")

    def changes(self, length: float) -> Changes:
        """Times (s) and new inflows (m³/s) of a side of a length (m)."""
        rate = self.inflow if self.flux is None else self.flux * length
        return self.schedule or ((0.0, rate or 0.0),)


Boundary = tuple[str, float | Inflow]  # name of a side, and the pressure (Pa) that it keeps


@dataclass(frozen=True, slots=True)
class InflowSide:
    """A side with an inflow; it acts as a well at a rate whose wall is the side."""

    name: str
    rate_changes: Changes  # s, m³/s out of the region, as a well's
    pressure_changes: ClassVar[Changes] = ()
    held: ClassVar[bool] = False
    decides: ClassVar[bool] = False


def check_schedule(key: str, schedule: Changes | None, what: str) -> None:
    """Raise `SceneError` for a schedule of some quantity that cannot be."""
    if schedule is None:
        return
    starts = [t for t, _ in schedule]
    if not starts:
        raise SceneError([(key, "the schedule is empty")])
    if not all(math.isfinite(v) for entry in schedule for v in entry):
        raise SceneError([(key, f"times and {what} must be finite")])
    if starts[0] < 0 or any(b <= a for a, b in itertools.pairwise(starts)):
        raise SceneError([(key, "times must increase, from 0 s on")])


@dataclass(frozen=True, slots=True)
class Probe:
    """A point at which pressure is recorded, linear between the pores around it."""

    name: str
    at: tuple[float, float] = parameter("m", help="position")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True)
class InitialField:
    """A pressure at one point that changes along a line: p + g · (x − x₀)."""

    pressure: float = parameter("Pa", help="initial pressure at that point")
    gradient: tuple[float, float] = parameter("Pa/m", help="rise of the pressure along x and y")
    at: tuple[float, float] = parameter("m", default=(0.0, 0.0), help="the point")

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def at_origin(self) -> float:
        """Pressure at (0, 0), Pa."""
        (gx, gy), (x, y) = self.gradient, self.at
        return self.pressure - gx * x - gy * y


@dataclass(frozen=True, slots=True)
class Solver:
    """How the pressure is found."""

    method: str = parameter(
        default="auto",
        choices=("auto", "explicit", "implicit", "krylov", "steady"),
        help="auto takes the solver of least predicted time, steady where no times are given",
    )
    tolerance: float = parameter(
        default=1e-4,
        at_least=LEAST_TOLERANCE,
        below=1,
        help="relative error in time of all that is recorded (krylov, implicit): of a well's "
        "pressure change beside the largest of its flow period so far, of flows and probes beside "
        "their own largest, of maps beside the largest of any pore",
    )
    safety_factor: float = parameter(
        default=0.9, above=0, at_most=4, help="explicit step over its limit (Eq. 14)"
    )
    step: str = parameter(
        default="corrected",
        choices=("corrected", "paper"),
        help="limit of the explicit step: corrected is C / Σg of each pore, which keeps pressures "
        "positive; paper is Eq. 14 as printed, with one aperture per pore",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.step == "paper" and self.method != "explicit":
            what = f"paper is a step of method explicit, not of {self.method}; ask for explicit, or"
            raise SceneError([("step", f"{what} leave the step out")])


def well_problems(wells: tuple[Well, ...], region: Region) -> Problems:
    """What is wrong with where wells stand."""
    if not wells:
        return
    at = np.array([well.at for well in wells])
    radius = np.array([well.effective_radius for well in wells])
    inside, room = _room(tuple(well.at for well in wells), region)
    for k in np.flatnonzero(~inside | (room < radius)):
        well, path = wells[k], f"wells.{wells[k].name}"
        if not inside[k]:
            yield f"{path}.at", "the well lies outside the region"
            continue
        stimulated = well.radius <= room[k]
        what = f"the well reaches beyond the rim, which is {room[k]:.3g} m away"
        if stimulated:
            what = f"with the radius r_w e^(−S) = {radius[k]:.3g} m {what}"
        yield f"{path}.{'skin_factor' if stimulated else 'radius'}", what
    if len(wells) == 1:
        return
    i, j = box_pairs(at - radius[:, None], at + radius[:, None])
    near = np.hypot(*(at[i] - at[j]).T) < radius[i] + radius[j]
    later, which = np.unique(j[near], return_index=True)  # each well, and one that it overlaps
    for k, other in zip(later, i[near][which], strict=True):
        yield f"wells.{wells[k].name}.at", f"the well overlaps {wells[other].name}"


@functools.lru_cache(maxsize=64)  # the cases of a study mostly differ in something else
def _room(at: tuple[tuple[float, float], ...], region: Region) -> tuple[np.ndarray, np.ndarray]:
    """Whether each point lies in the region, and how far from its rim, m; infinite outside."""
    points = np.array(at)
    inside = contains(region, points)
    room = np.full(len(at), np.inf)
    room[inside] = distance_to_rim(region, points[inside])
    return inside, room


def probe_problems(probes: tuple[Probe, ...], region: Region) -> Problems:
    """What is wrong with where probes lie."""
    within = contains(region, np.array([probe.at for probe in probes]).reshape(-1, 2))
    for probe, is_within in zip(probes, within, strict=True):
        if not is_within:
            yield f"probes.{probe.name}.at", "the probe lies outside the region"


def permeable(matrix: Matrix, fluid: Fluid | None) -> Matrix:
    """The matrix as its pipes are: by permeability where it was given by a hydraulic conductivity.

    Parameters
    ----------
    matrix : as it was given
    fluid : the one that the conductivity is of; without its density there is no permeability
    """
    matrix = replace(matrix, specific_storage=None)
    conductivity = matrix.hydraulic_conductivity
    if conductivity is None or fluid is None or fluid.density is None:
        return matrix
    permeability = conductivity * fluid.viscosity / (fluid.density * STANDARD_GRAVITY)
    return replace(matrix, permeability=permeability, hydraulic_conductivity=None)


def conductivity_problems(matrix: Matrix | None, fluid: Fluid | None) -> Problems:
    """A hydraulic conductivity of a fluid whose weight is not known."""
    given = matrix is not None and matrix.hydraulic_conductivity is not None
    if given and (fluid is None or fluid.density is None):
        what = "matrix.hydraulic_conductivity is K = k ρ g / μ; give the fluid's density, or "
        yield "fluid.density", what + "matrix.permeability instead"


def storage_problems(matrix: Matrix | None, fluid: Fluid | None, *, coupled: bool) -> Problems:
    """What is wrong with how the rock stores its fluid."""
    given = None if matrix is None else matrix.specific_storage
    if given is None:
        if fluid is not None and fluid.modulus is None:
            what = (
                "a fluid stores by its bulk_modulus, for instance 2.2 GPa, or its compressibility"
            )
            yield "fluid.bulk_modulus", f"{what}; or give matrix.specific_storage"
        return
    path = "matrix.specific_storage"
    if fluid is not None and fluid.modulus is not None:
        twice = "bulk_modulus" if fluid.compressibility is None else "compressibility"
        yield path, f"it says what fluid.{twice} says too; give one of them"
    if fluid is None or fluid.density is None:
        what = "matrix.specific_storage is ρ g φ / K; give the fluid's density, or "
        yield "fluid.density", what + "its bulk_modulus instead"
    if coupled:
        yield path, "a rock whose grains move stores by itself; give the fluid's bulk_modulus"


def boundary_problems(boundaries: tuple[Boundary, ...], region: Region) -> Problems:
    """What is wrong with what is given at sides."""
    sides = {*region.sides, "outer"}
    for name, given in boundaries:
        if name not in sides:
            known = ", ".join(sorted(sides))
            yield f"boundaries.{name}", f"the region has no such side, only {known}"
        if not isinstance(given, Inflow) and not math.isfinite(given):
            yield f"boundaries.{name}", "the pressure is not a finite number"
    outer = {name for name, _ in boundaries} & set(outer_shape(region).sides) - {"outer"}
    if outer and any(name == "outer" for name, _ in boundaries):
        what = f"outer names every side of the region; name no other beside it, as {min(outer)}"
        yield "boundaries.outer", what


def time_problems(times: tuple[float, ...]) -> Problems:
    """What is wrong with the output times by themselves."""
    if times and times[0] <= 0:
        yield "times", "times must be positive"
    if any(b <= a for a, b in itertools.pairwise(times)):
        yield "times", "times must increase"
    if not all(math.isfinite(t) for t in times):
        yield "times", "times must be finite"
