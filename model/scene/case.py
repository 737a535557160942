"""The whole of one case, its parts checked against each other when it is made."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from demflow.model.parameters import SceneError, check_fields, parameter
from demflow.model.region import Region, clip_segment, contains, distance_to_rim
from demflow.model.scene.flow import Fluid, InitialField, Matrix, Probe, Solver, Well
from demflow.model.scene.fractures import BiWing, Fracture, FractureSet
from demflow.model.scene.rock import Bonds, FailureTest, Grains, Stress

__all__ = ["MEASURED_BY_A_TEST", "OBSERVABLES", "Scene"]

OBSERVABLES = (
    "well_pressure",
    "permeability",
    "pressure_map",
    "boundary_flow",
    "probe_pressure",
    "grain_map",
    "time_error",
    "youngs_modulus",
    "poissons_ratio",
    "peak_strength",
    "crack_count",
)
MEASURED_BY_A_TEST = ("youngs_modulus", "poissons_ratio", "peak_strength", "crack_count")

# Traces that one set may have: beyond, its spacing is a slip of the unit.
MOST_TRACES = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything that one case needs. `observe` decides what is computed.

    Raises `SceneError`, listing every contradiction between its parts.
    """

    region: Region
    grains: Grains
    observe: tuple[str, ...]
    matrix: Matrix | None = None
    fluid: Fluid | None = None
    bonds: Bonds | None = None
    stress: Stress | None = None
    test: FailureTest | None = None
    fractures: tuple[Fracture, ...] = ()
    wells: tuple[Well, ...] = ()
    boundaries: tuple[tuple[str, float], ...] = ()
    probes: tuple[Probe, ...] = ()
    initial_pressure: float | InitialField | str | None = parameter(
        "Pa",
        default=None,
        help="pressure at time zero: one everywhere, a linear field, or steady: the steady state "
        "of all that keeps its pressure",
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
        """The flow solver asked for: `solver.method`, steady for `auto` without times."""
        if self.solver.method == "auto" and not self.times:
            return "steady"
        return self.solver.method

    @property
    def start(self) -> str:
        """What a transient starts from: `uniform`, `gradient` or `steady`."""
        if isinstance(self.initial_pressure, InitialField):
            return "gradient"
        return "steady" if isinstance(self.initial_pressure, str) else "uniform"

    @property
    def uniform_pressure(self) -> float | None:
        """The initial pressure where it is one everywhere, Pa; else None."""
        given = self.initial_pressure
        return None if isinstance(given, InitialField | str) else given

    @property
    def flows(self) -> bool:
        """Whether an output is wanted that needs the pressure field of the wells."""
        return any(
            name in self.observe
            for name in OBSERVABLES
            if name not in ("permeability", "grain_map", *MEASURED_BY_A_TEST)
        )

    @property
    def tests(self) -> bool:
        """Whether an output is wanted that a test to failure gives."""
        return any(name in self.observe for name in MEASURED_BY_A_TEST)

    @property
    def porous(self) -> bool:
        """Whether an output is wanted that needs the pores and their pipes."""
        return any(name not in MEASURED_BY_A_TEST for name in self.observe)

    def _mechanical_problems(self) -> list[tuple[str, str]]:
        problems = []
        if (self.stress or self.test) is not None and self.grains.contact_stiffness is None:
            problems.append(("grains.modulus", "a stress needs modulus or normal_stiffness"))
        if self.tests and self.test is None:
            what = "moduli, strength and cracks are measured by a test; describe it, for instance "
            problems.append(("test", what + "{kind: biaxial, confining_stress: 1 MPa}"))
        if self.test is not None and self.test.kind == "tension" and self.bonds is None:
            problems.append(("test.kind", "unbonded grains bear no tension; add bonds"))
        if self.porous:
            problems += [
                (name, f"what is observed needs a {name}")
                for name, part in (("matrix", self.matrix), ("fluid", self.fluid))
                if part is None
            ]
        for name, part in (("stress", self.stress), ("test", self.test)):
            if part is not None and self.grains.packing == "periodic":
                what = f"a periodic packing has no walls for a {name}; take grains.packing: random"
                problems.append((name, what))
        lattice = self.grains.packing in ("square", "hexagonal")
        if self.stress is not None and lattice and self.bonds is None:
            problems.append(
                ("stress", f"an unbonded {self.grains.packing} lattice cannot be loaded; add bonds")
            )
        if self.stress is not None and self.bonds is None:
            if self.stress.method == "static":
                what = "static solves bonded grains; add bonds, or take explicit"
                problems.append(("stress.method", what))
            if abs(self.stress.components[2]) > 0.0:
                what = (
                    "unbonded grains are loaded along the axes only; leave the angle out and turn "
                    "fractures, wells and probes by minus the angle instead, or add bonds"
                )
                problems.append(("stress.angle", what))
        if self.bonds is not None and self.stress is None and self.test is None:
            problems.append(("bonds", "bonds act only where the scene names a stress or a test"))
        for fracture in self.fractures:
            if fracture.joint is not None and self.stress is None and self.test is None:
                what = "a joint acts only where the scene names a stress or a test"
                problems.append((f"fractures.{fracture.name}.joint", what))
            if fracture.joint is not None and self.stress and self.stress.method == "static":
                what = "static knows no joints; take explicit or auto"
                problems.append(("stress.method", what))
        if self.matrix is not None and self.matrix.half_force is not None and self.stress is None:
            problems.append(("matrix.half_force", "apertures follow forces only under a stress"))
        return problems

    def _placement_problems(self) -> list[tuple[str, str]]:
        problems = []
        for well in self.wells:
            at = np.array([well.at])
            if not contains(self.region, at)[0]:
                problems.append((f"wells.{well.name}.at", "the well lies outside the region"))
            elif (room := distance_to_rim(self.region, at)[0]) < well.effective_radius:
                stimulated = well.radius <= room
                what = f"the well reaches beyond the rim, which is {room:.3g} m away"
                if stimulated:
                    what = f"with the radius r_w e^(−S) = {well.effective_radius:.3g} m {what}"
                key = "skin_factor" if stimulated else "radius"
                problems.append((f"wells.{well.name}.{key}", what))
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
                if math.dist(a.at, b.at) < a.effective_radius + b.effective_radius:
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
            what = f"solver.method {self.method} needs times; give some, or take steady"
            problems.append(("times", what))
        if transient and self.initial_pressure is None:
            problems.append(("initial_pressure", "a transient starts from a pressure; give it"))
        if self.start != "uniform":
            problems += self._start_problems(transient)
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

    def _start_problems(self, transient: bool) -> list[tuple[str, str]]:
        """What is wrong with a start that is not one pressure everywhere."""
        what = ""
        if self.flows and not transient:
            what = "a steady state starts from nothing; give one pressure, or leave it out"
        elif self.start == "steady" and self.initial_pressure != "steady":
            what = f"{self.initial_pressure!r} is neither a pressure nor steady"
        elif self.start == "steady":
            if not self.boundaries and all(w.pressure is None for w in self.wells):
                what = "without a fixed pressure anywhere there is no steady state to start from"
            elif self.flows and all(w.pressure is not None for w in self.wells):
                what = "from the steady state nothing changes; give a well at a rate, or no times"
        return [("initial_pressure", what)] if what else []
