"""One case: everything that the model reads, frozen, in SI units, checked when it is made.

The dataclasses mirror the blocks of a study file, so that a path such as
`wells.producer.rate` means the same in both. Angles are in radians, stresses
positive in compression, rates positive when a well produces. The model is two
dimensional with unit depth: rates are m³/s for one metre of rock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from model.parameters import SceneError, check_fields, parameter
from model.region import (
    Circle,
    Polygon,
    Rectangle,
    Region,
    clip_segment,
    contains,
    distance_to_rim,
)

__all__ = [
    "OBSERVABLES",
    "BiWing",
    "Bonds",
    "Circle",
    "Fluid",
    "Fracture",
    "FractureSet",
    "Grains",
    "Matrix",
    "Polygon",
    "Probe",
    "Rectangle",
    "Region",
    "Scene",
    "SceneError",
    "Solver",
    "Stress",
    "Trace",
    "Well",
]

OBSERVABLES = (
    "well_pressure",
    "permeability",
    "pressure_map",
    "boundary_flow",
    "probe_pressure",
    "grain_map",
)

# Traces that one set may have: beyond, its spacing is a slip of the unit.
MOST_TRACES = 100_000

# What packings of discs at rest reach at all: equal grains 0.136 at the least, a ratio of
# 1.66 from 0.157 to 0.22. Packing says which part of it a radius ratio can have.
LEAST_POROSITY, GREATEST_POROSITY = 0.135, 0.22


@dataclass(frozen=True, slots=True)
class Grains:
    """The discs: how many, how large, how packed, and how their contacts respond.

    Give `count` or `mean_radius`, and `modulus` or `normal_stiffness`.
    """

    count: int | None = parameter(
        default=None, at_least=1, at_most=2_000_000, help="grains inside the region"
    )
    mean_radius: float | None = parameter(
        "m", default=None, above=0, help="mean grain radius, instead of a count"
    )
    packing: str = parameter(
        default="random", choices=("random", "square", "hexagonal"), help="arrangement of grains"
    )
    radius_ratio: float = parameter(
        default=1.66, at_least=1, at_most=10, help="largest over smallest radius, uniform between"
    )
    porosity: float | None = parameter(
        default=None,
        at_least=LEAST_POROSITY,
        at_most=GREATEST_POROSITY,
        help="porosity of a random packing",
    )
    seed: int = parameter(default=1, at_least=0, help="seed of the random packing")
    modulus: float | None = parameter(
        "Pa", default=None, above=0, help="grain contact modulus E_c; k_n = 2 E_c for unit depth"
    )
    normal_stiffness: float | None = parameter(
        "N/m", default=None, above=0, help="normal contact stiffness k_n, instead of a modulus"
    )
    stiffness_ratio: float = parameter(
        default=2.5, above=0, help="normal over shear contact stiffness, k_n / k_s"
    )
    friction: float = parameter(default=0.5, at_least=0, help="contact friction coefficient")
    density: float = parameter(
        "kg/m3", default=2650.0, above=0, help="grain density (quasi-static results ignore it)"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        problems = []
        if (self.count is None) == (self.mean_radius is None):
            problems.append(("count", "give either count or mean_radius"))
        if self.modulus is not None and self.normal_stiffness is not None:
            problems.append(("modulus", "give either modulus or normal_stiffness"))
        if self.packing == "random" and self.porosity is None:
            problems.append(("porosity", "a random packing needs a porosity, for instance 0.17"))
        if self.packing != "random" and self.porosity is not None:
            problems.append(("porosity", f"a {self.packing} packing has a porosity of its own"))
        if problems:
            raise SceneError(problems)

    @property
    def contact_stiffness(self) -> float | None:
        """Normal stiffness k_n of a contact, N/m per metre of depth.

        k_n = 2 E_c t with t = 1 m (Potyondy & Cundall 2004, Eq. 21). None where
        neither modulus nor stiffness is given.
        """
        return 2.0 * self.modulus if self.modulus is not None else self.normal_stiffness


@dataclass(frozen=True, slots=True)
class Bonds:
    """Cement at the contacts. Strengths are stresses over the bond's cross-section."""

    kind: str = parameter(choices=("contact", "parallel"), help="force only, or force and moment")
    tensile_strength: float = parameter("Pa", at_least=0, help="tensile strength")
    shear_strength: float = parameter("Pa", at_least=0, help="shear strength")
    radius_multiplier: float = parameter(
        default=1.0, above=0, at_most=1, help="bond half-width over the smaller grain radius"
    )

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True)
class Stress:
    """Principal stresses that the walls apply, positive in compression."""

    xx: float = parameter("Pa", above=0, help="stress on the left and right walls")
    yy: float = parameter("Pa", above=0, help="stress on the bottom and top walls")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True)
class Matrix:
    """The pipes of the rock between fractures. Give either `permeability` or `aperture`.

    A permeability fixes the aperture w0 of every pipe in the unstressed state.
    """

    permeability: float | None = parameter(
        "m2", default=None, above=0, help="matrix permeability, unstressed"
    )
    aperture: float | None = parameter(
        "m", default=None, at_least=0, help="pipe aperture w0, unstressed; 0 seals the matrix"
    )
    half_force: float | None = parameter(
        "N/m",
        default=None,
        above=0,
        help="contact force F0 that halves an aperture (Eq. 2); forces are about 2 r times the "
        "stress, so it belongs to a grain size",
    )
    gap_factor: float = parameter(
        default=0.5, at_least=0, at_most=1, help="aperture gained per gap between grains, m (Eq. 3)"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if (self.permeability is None) == (self.aperture is None):
            raise SceneError([("permeability", "give either permeability or aperture")])


@dataclass(frozen=True, slots=True)
class Fluid:
    """A slightly compressible liquid."""

    viscosity: float = parameter("Pa s", above=0, help="dynamic viscosity")
    bulk_modulus: float = parameter("Pa", above=0, help="bulk modulus K_f = 1 / compressibility")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True)
class _FractureProperties:
    """What a fracture does to flow; exactly one of the first three.

    `permeability`: its pipes get the aperture of a medium of that permeability (the
    paper's meaning). `aperture`: a hydraulic aperture whose transmissivity along the
    trace is w³ / (12 μ) (the engineer's). `transmissibility_multiplier`: a barrier;
    the pipes that run across the trace keep this fraction of their conductance.
    """

    name: str
    permeability: float | None = parameter(
        "m2", default=None, above=0, help="permeability of a medium with the fracture's aperture"
    )
    aperture: float | None = parameter(
        "m", default=None, above=0, help="hydraulic aperture; transmissivity w³ / (12 μ)"
    )
    transmissibility_multiplier: float | None = parameter(
        default=None, at_least=0, at_most=1, help="barrier: fraction of the flow that it lets cross"
    )
    pore_storage: str | None = parameter(
        default=None,
        choices=("matrix", "fracture"),
        help="who owns the storage of the pores along the trace; "
        "default: matrix for an aperture, fracture for a permeability",
    )

    def _problems(self) -> list[tuple[str, str]]:
        given = [
            key
            for key in ("permeability", "aperture", "transmissibility_multiplier")
            if getattr(self, key) is not None
        ]
        if len(given) != 1:
            return [
                (
                    given[0] if given else "",
                    "give exactly one of permeability, aperture, transmissibility_multiplier",
                )
            ]
        return []


@dataclass(frozen=True, slots=True, kw_only=True)
class BiWing(_FractureProperties):
    """A straight fracture with two equal wings, as hydraulic fracturing makes from a well."""

    at: tuple[float, float] = parameter("m", help="centre")
    angle: float = parameter("rad", help="angle from the x axis, counter-clockwise")
    half_length: float = parameter("m", above=0, help="length of each wing")

    def __post_init__(self) -> None:
        check_fields(self)
        if problems := self._problems():
            raise SceneError(problems)

    @property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The two tips, m."""
        dx = self.half_length * math.cos(self.angle)
        dy = self.half_length * math.sin(self.angle)
        return (self.at[0] - dx, self.at[1] - dy), (self.at[0] + dx, self.at[1] + dy)


@dataclass(frozen=True, slots=True, kw_only=True)
class FractureSet(_FractureProperties):
    """Parallel natural fractures over the whole region.

    Rows lie `spacing` apart, one of them through the origin. Along a row, fractures of
    `length` follow each other with a `gap` between them (default: the spacing), and
    every second row is shifted by half a period.
    """

    angle: float = parameter("rad", help="angle from the x axis, counter-clockwise")
    length: float = parameter("m", above=0, help="length of each fracture")
    spacing: float = parameter("m", above=0, help="distance between rows, across the fractures")
    gap: float | None = parameter(
        "m", default=None, above=0, help="distance between the fractures of a row"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if problems := self._problems():
            raise SceneError(problems)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace(_FractureProperties):
    """A single straight fracture from point to point."""

    start: tuple[float, float] = parameter("m", key="from", help="one end")
    end: tuple[float, float] = parameter("m", key="to", help="other end")

    def __post_init__(self) -> None:
        check_fields(self)
        problems = self._problems()
        if self.start == self.end:
            problems.append(("to", "the fracture has zero length"))
        if problems:
            raise SceneError(problems)

    @property
    def ends(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The two ends, m."""
        return self.start, self.end


Fracture = BiWing | FractureSet | Trace


@dataclass(frozen=True, slots=True, kw_only=True)
class Well:
    """A well of finite radius at a rate, a pressure or a schedule of rates.

    All pores whose centroid lies within the radius share the well's pressure; a well
    narrower than the pores stands in the nearest one (Peaceman's equivalent radius).
    """

    name: str
    at: tuple[float, float] = parameter("m", help="position")
    radius: float = parameter("m", above=0, help="wellbore radius")
    rate: float | None = parameter(
        "m3/s", default=None, help="constant rate; positive produces, negative injects"
    )
    pressure: float | None = parameter("Pa", default=None, help="constant bottom-hole pressure")
    schedule: tuple[tuple[float, float], ...] | None = parameter(
        "s, m3/s", default=None, help="rate changes [[time, rate], …]; rate 0 shuts the well in"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        given = [k for k in ("rate", "pressure", "schedule") if getattr(self, k) is not None]
        if len(given) != 1:
            where = given[0] if given else ""
            raise SceneError([(where, "give exactly one of rate, pressure, schedule")])
        if self.schedule is not None:
            starts = [t for t, _ in self.schedule]
            if not starts:
                raise SceneError([("schedule", "the schedule is empty")])
            if not all(math.isfinite(v) for entry in self.schedule for v in entry):
                raise SceneError([("schedule", "times and rates must be finite")])
            if starts[0] < 0 or any(b <= a for a, b in zip(starts, starts[1:], strict=False)):
                raise SceneError([("schedule", "times must increase, from 0 s on")])

    @property
    def rate_changes(self) -> tuple[tuple[float, float], ...]:
        """Times (s) and new rates (m³/s) of the well; empty at constant pressure."""
        if self.schedule is not None:
            return self.schedule
        return () if self.rate is None else ((0.0, self.rate),)


@dataclass(frozen=True, slots=True)
class Probe:
    """A point at which pressure is recorded: that of the pore in which it lies."""

    name: str
    at: tuple[float, float] = parameter("m", help="position")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True)
class Solver:
    """How the pressure is found."""

    method: str = parameter(
        default="auto",
        choices=("auto", "explicit", "implicit", "krylov", "steady"),
        help="auto takes krylov for a transient, steady where no times are given",
    )
    tolerance: float = parameter(
        default=1e-4,
        above=0,
        below=1,
        help="relative error in time of the well pressure change (krylov, implicit)",
    )
    safety_factor: float = parameter(
        default=0.9, above=0, at_most=4, help="explicit step over its positivity limit (Eq. 14)"
    )

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything that one case needs. `observe` decides what is computed.

    Raises `SceneError`, listing every contradiction between its parts.
    """

    region: Region
    grains: Grains
    matrix: Matrix
    fluid: Fluid
    observe: tuple[str, ...]
    bonds: Bonds | None = None
    stress: Stress | None = None
    fractures: tuple[Fracture, ...] = ()
    wells: tuple[Well, ...] = ()
    boundaries: tuple[tuple[str, float], ...] = ()
    probes: tuple[Probe, ...] = ()
    initial_pressure: float | None = parameter(
        "Pa", default=None, help="pressure everywhere at time zero"
    )
    times: tuple[float, ...] = ()
    solver: Solver = Solver()

    def __post_init__(self) -> None:
        check_fields(self)
        problems = [
            *self._mechanical_problems(),
            *self._placement_problems(),
            *self._flow_problems(),
        ]
        if problems:
            raise SceneError(problems)

    @property
    def method(self) -> str:
        """The flow solver that runs: `solver.method`, with `auto` decided."""
        if self.solver.method != "auto":
            return self.solver.method
        return "krylov" if self.times else "steady"

    @property
    def flows(self) -> bool:
        """Whether an output is wanted that needs the pressure field of the wells."""
        return any(
            name in self.observe
            for name in ("well_pressure", "pressure_map", "boundary_flow", "probe_pressure")
        )

    def _mechanical_problems(self) -> list[tuple[str, str]]:
        problems = []
        if self.stress is not None and self.grains.contact_stiffness is None:
            problems.append(("grains.modulus", "a stress needs modulus or normal_stiffness"))
        if self.stress is not None and self.grains.packing != "random" and self.bonds is None:
            problems.append(
                ("stress", f"an unbonded {self.grains.packing} lattice cannot be loaded; add bonds")
            )
        if self.bonds is not None and self.stress is None:
            problems.append(("bonds", "bonds act only where the scene names a stress"))
        if self.matrix.half_force is not None and self.stress is None:
            problems.append(("matrix.half_force", "apertures follow forces only under a stress"))
        return problems

    def _placement_problems(self) -> list[tuple[str, str]]:
        problems = []
        for well in self.wells:
            at = np.array([well.at])
            if not contains(self.region, at)[0]:
                problems.append((f"wells.{well.name}.at", "the well lies outside the region"))
            elif (room := distance_to_rim(self.region, at)[0]) < well.radius:
                what = f"the well reaches beyond the rim, which is {room:.3g} m away"
                problems.append((f"wells.{well.name}.radius", what))
        for fracture in self.fractures:
            if isinstance(fracture, FractureSet):
                gap = fracture.spacing if fracture.gap is None else fracture.gap
                count = self.region.area / (fracture.spacing * (fracture.length + gap))
                if count > MOST_TRACES:
                    what = f"about {count:.2g} fractures in the region, more than {MOST_TRACES}"
                    problems.append((f"fractures.{fracture.name}.spacing", what))
            elif not clip_segment(self.region, *fracture.ends):
                what = "the fracture lies outside the region"
                key = "at" if isinstance(fracture, BiWing) else "from"
                problems.append((f"fractures.{fracture.name}.{key}", what))
        for i, a in enumerate(self.wells):
            for b in self.wells[:i]:
                if math.dist(a.at, b.at) < a.radius + b.radius:
                    problems.append((f"wells.{a.name}.at", f"the well overlaps {b.name}"))
        within = contains(self.region, np.array([p.at for p in self.probes]).reshape(-1, 2))
        for probe, is_within in zip(self.probes, within, strict=True):
            if not is_within:
                problems.append((f"probes.{probe.name}.at", "the probe lies outside the region"))
        sides = {*self.region.sides, "outer"}
        for name, pressure in self.boundaries:
            if name not in sides:
                known = ", ".join(sorted(sides))
                problems.append(
                    (f"boundaries.{name}", f"the region has no such side, only {known}")
                )
            if not math.isfinite(pressure):
                problems.append((f"boundaries.{name}", "the pressure is not a finite number"))
        if len(self.boundaries) > 1 and any(name == "outer" for name, _ in self.boundaries):
            problems.append(("boundaries.outer", "outer names every side; name no other beside it"))
        for kind, names in (
            ("wells", [w.name for w in self.wells]),
            ("fractures", [f.name for f in self.fractures]),
            ("probes", [p.name for p in self.probes]),
            ("boundaries", [n for n, _ in self.boundaries]),
        ):
            for name in {n for n in names if names.count(n) > 1}:
                problems.append((f"{kind}.{name}", "the name is used twice"))
        return problems

    def _flow_problems(self) -> list[tuple[str, str]]:
        problems = []
        if not self.observe:
            problems.append(("observe", "the list is empty, so nothing would be computed"))
        for name in self.observe:
            if name not in OBSERVABLES:
                problems.append(("observe", f"{name} is none of {', '.join(OBSERVABLES)}"))
        if "well_pressure" in self.observe and not self.wells:
            problems.append(("observe", "well_pressure is asked for, but there is no well"))
        if "probe_pressure" in self.observe and not self.probes:
            problems.append(("observe", "probe_pressure is asked for, but there is no probe"))
        if "boundary_flow" in self.observe and not self.boundaries:
            problems.append(("observe", "boundary_flow is asked for, but every side is sealed"))
        if self.flows and not self.wells and not self.boundaries:
            problems.append(("wells", "nothing moves the fluid: add a well or a boundary pressure"))
        if self.times and self.times[0] <= 0:
            problems.append(("times", "times must be positive"))
        if any(b <= a for a, b in zip(self.times, self.times[1:], strict=False)):
            problems.append(("times", "times must increase"))
        if not all(math.isfinite(t) for t in self.times):
            problems.append(("times", "times must be finite"))
        transient = self.flows and self.method != "steady"
        if transient and not self.times:
            problems.append(("times", f"solver.method {self.method} needs times"))
        if transient and self.initial_pressure is None:
            problems.append(("initial_pressure", "a transient starts from a pressure; give it"))
        if self.flows and self.method == "steady" and self.times:
            what = "a steady state has no times; leave them out, or choose another solver.method"
            problems.append(("times", what))
        if self.flows and self.method == "steady":
            if not self.boundaries and all(w.pressure is None for w in self.wells):
                problems.append(
                    ("boundaries", "without a fixed pressure anywhere no steady state exists")
                )
            for well in self.wells:
                if well.schedule is not None and len(well.schedule) > 1:
                    problems.append(
                        (f"wells.{well.name}.schedule", "a schedule has no steady state")
                    )
        return problems
