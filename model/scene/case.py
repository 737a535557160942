"""The whole of one case, its parts checked against each other when it is made."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache

from demflow.model.parameters import Problems, SceneError, check_fields, parameter
from demflow.model.region import Pierced, Rectangle, Region, Shape, side_length
from demflow.model.scene.coupling import (
    COUPLED,
    Coupling,
    Reckoned,
    coupling_problems,
    reckoned,
)
from demflow.model.scene.flow import (
    STANDARD_GRAVITY,
    Boundary,
    Fluid,
    Inflow,
    InflowSide,
    InitialField,
    Matrix,
    Probe,
    Solver,
    Well,
    boundary_problems,
    conductivity_problems,
    permeable,
    probe_problems,
    storage_problems,
    time_problems,
    well_problems,
)
from demflow.model.scene.fractures import Fracture, fracture_problems, joint_problems
from demflow.model.scene.ground import Excavation, Ground, ground_problems, holes_of
from demflow.model.scene.rock import (
    Bonds,
    FailureTest,
    Grains,
    Stress,
    grain_problems,
    loading_problems,
)

__all__ = ["MEASURED_BY_A_TEST", "OBSERVABLES", "OF_BREAKING", "OF_COUPLING", "Scene"]

_PORES = ("network", "open")  # pores and their pipes

# What can be observed, and the stages beside the packing that it needs: what decides what is run.
OBSERVABLES: dict[str, tuple[str, ...]] = {
    "well_pressure": (*_PORES, "flow"),
    "permeability": (*_PORES, "measure"),
    "bar_permeability": (*_PORES, "measure_bar"),
    "periodic_permeability": (*_PORES, "measure_periodic"),
    "pressure_map": (*_PORES, "flow"),
    "boundary_flow": (*_PORES, "flow"),
    "boundary_pressure": (*_PORES, "flow"),
    "probe_pressure": (*_PORES, "flow"),
    "wall_displacement": (*_PORES, "consolidate"),
    "effective_stress": (*_PORES, "consolidate"),
    "crack_length": (*_PORES, "fracture"),
    "injected_volume": (*_PORES, "fracture"),
    "joint_slip": (*_PORES, "fracture"),
    "permeability_in_time": (*_PORES, "fracture"),
    "grain_map": _PORES,
    "time_error": (*_PORES, "flow", "reference"),
    "youngs_modulus": ("strength",),
    "poissons_ratio": ("strength",),
    "peak_strength": ("strength",),
    "crack_count": ("strength",),
    "energy": ("strength",),
    "fracture_network": ("fractures",),
    "elastic_moduli": ("moduli",),
    "force_chains": ("stress",),
}
OF_COUPLING = tuple(name for name, stages in OBSERVABLES.items() if "consolidate" in stages)
OF_BREAKING = tuple(name for name, stages in OBSERVABLES.items() if "fracture" in stages)
MEASURED_BY_A_TEST = tuple(name for name, stages in OBSERVABLES.items() if "strength" in stages)

# Outputs, and the part of the scene without which there is nothing to observe.
_OBSERVED = {
    "well_pressure": ("wells", "there is no well"),
    "probe_pressure": ("probes", "there is no probe"),
    "boundary_flow": ("boundaries", "every side is sealed"),
    "boundary_pressure": ("boundaries", "every side is sealed"),
    "elastic_moduli": ("bonds", "there are no bonds"),
    "force_chains": ("stress", "there is no stress"),
    "crack_length": ("breaks", "nothing breaks; add coupling: breaking"),
    "injected_volume": ("breaks", "nothing breaks; add coupling: breaking"),
    "joint_slip": (
        "slides",
        "no joint slides; add coupling: breaking, and a fracture with a joint",
    ),
    "permeability_in_time": (
        "breaks",
        "apertures stay; add coupling: breaking, or take permeability",
    ),
    "wall_displacement": ("coupled", "nothing moves the walls; add coupling: linear"),
    "effective_stress": ("coupled", "nothing changes it; add coupling: linear"),
}


@lru_cache(maxsize=1024)
def _needed(observe: tuple[str, ...]) -> frozenset[str]:
    """The stages that outputs need: asked for some ten times a scene."""
    return frozenset(stage for name in observe for stage in OBSERVABLES.get(name, ()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything that one case needs. `observe` decides what is computed.

    Raises `SceneError`, listing every contradiction between its parts. A rule stands beside the
    block that it judges, and takes the parts that it needs; those on what is observed stand here.
    """

    region: Shape
    grains: Grains
    observe: tuple[str, ...]
    matrix: Matrix | None = None
    fluid: Fluid | None = None
    bonds: Bonds | None = None
    stress: Stress | None = None
    gravity: float | None = parameter(
        "m/s2", default=None, above=0, help="acceleration by which grains weigh, towards −y"
    )
    excavate: tuple[Excavation, ...] = ()
    test: FailureTest | None = None
    fractures: tuple[Fracture, ...] = ()
    wells: tuple[Well, ...] = ()
    boundaries: tuple[Boundary, ...] = ()
    probes: tuple[Probe, ...] = ()
    initial_pressure: float | InitialField | str | None = parameter(
        "Pa",
        default=None,
        help="pressure at time zero: one everywhere, a linear field, or steady: the steady state "
        "of all that keeps its pressure",
    )
    coupling: Coupling | None = None
    times: tuple[float, ...] = ()
    solver: Solver = Solver()

    def __post_init__(self) -> None:
        check_fields(self)
        rock = self.rock
        problems = [
            *grain_problems(self.grains, self.region),
            *loading_problems(
                self.grains, self.bonds, self.stress, self.test, coupled=self.coupled
            ),
            *ground_problems(
                self.excavate,
                self.gravity,
                rock,
                density=self.grains.density,
                stress=self.stress,
                tested=self.test is not None,
            ),
            *joint_problems(self.fractures, self.stress, self.test),
            *well_problems(self.wells, rock),
            *fracture_problems(self.fractures, rock),
            *probe_problems(self.probes, rock),
            *boundary_problems(self.boundaries, rock),
            *conductivity_problems(self.matrix, self.fluid),
            *storage_problems(self.matrix, self.fluid, coupled=self.coupled),
            *self._name_problems(),
            *self._observed_problems(),
            *self._part_problems(),
            *time_problems(self.times),
            *self._transient_problems(),
            *self._steady_problems(),
            *self._coupling_problems(),
        ]
        if problems:
            raise SceneError(problems)

    @property
    def rock(self) -> Region:
        """The region without what is excavated."""
        return Pierced(self.region, holes_of(self.excavate)) if self.excavate else self.region

    @property
    def pipes(self) -> Matrix | None:
        """The matrix by its permeability or aperture, also where a conductivity was given."""
        return None if self.matrix is None else permeable(self.matrix, self.fluid)

    @property
    def storativity(self) -> float | None:
        """Fluid that a unit volume of rock gives per pressure fall, 1/Pa, S_s / (ρ g).

        None where the fluid's bulk modulus says it, pore by pore.
        """
        matrix, fluid = self.matrix, self.fluid
        if matrix is None or matrix.specific_storage is None:
            return None
        if fluid is None or fluid.density is None:
            return None
        return matrix.specific_storage / (fluid.density * STANDARD_GRAVITY)

    def stores(self, porosity: float) -> float:
        """Fluid that a unit volume of rock of a porosity gives per pressure fall, 1/Pa.

        NaN without a fluid.

        Parameters
        ----------
        porosity : of the region
        """
        if self.storativity is not None:
            return self.storativity
        modulus = None if self.fluid is None else self.fluid.modulus
        return math.nan if modulus is None else porosity / modulus

    @property
    def ground(self) -> Ground | None:
        """Weight and holes; None where the scene has neither."""
        if self.gravity is None and not self.excavate:
            return None
        density = self.grains.density
        if self.coupled and self.fluid is not None:  # pressures are those beyond the hydrostatic
            density -= self.fluid.density or 0.0
        weight = density * (self.gravity or 0.0)
        pressures = tuple(one.pressure for one in self.excavate)
        return Ground(weight, holes_of(self.excavate), pressures)

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

    def needs(self, stage: str) -> bool:
        """Whether an output is wanted that needs a stage."""
        return stage in _needed(tuple(self.observe))

    @property
    def flows(self) -> bool:
        """Whether an output is wanted that needs the pressure field of wells, sides and loads."""
        return any(map(self.needs, ("flow", "consolidate", "fracture")))

    @property
    def tests(self) -> bool:
        """Whether an output is wanted that a test to failure gives."""
        return self.needs("strength")

    @property
    def porous(self) -> bool:
        """Whether an output is wanted that needs the pores and their pipes."""
        return self.needs("network")

    @property
    def transient(self) -> bool:
        """Whether pressures are followed in time."""
        return self.flows and self.method != "steady"

    @property
    def coupled(self) -> bool:
        """Whether pressure moves grains, and grains squeeze pores."""
        return self.coupling is not None and self.coupling.method != "none"

    @property
    def breaks(self) -> bool:
        """Whether bonds break as pressure moves grains."""
        return self.coupling is not None and self.coupling.method == "breaking"

    @property
    def slides(self) -> bool:
        """Whether joints slide as pressure moves grains."""
        return self.breaks and any(fracture.joint is not None for fracture in self.fractures)

    @property
    def reckoned(self) -> Reckoned:
        """What is known beforehand of apertures that follow forces; what coupling: auto takes."""
        start = self.uniform_pressure or 0.0
        kept = [p for _, p in self.held_sides]
        kept += [well.pressure for well in self.wells if well.pressure is not None]
        changes = [p - start for p in kept] if self.uniform_pressure is not None else []
        changes += [0.5 * load for changes in self.loads or () for _, load in changes]
        return reckoned(
            self.region, self.grains, self.pipes, self.fluid, self.stress, tuple(changes),
            self.wells,
        )  # fmt: skip

    @property
    def coupling_method(self) -> str:
        """How fluid and rock are coupled: none, linear or apertures; auto is decided."""
        if self.coupling is None:
            return "none"
        method = self.coupling.method
        return self.reckoned.method if method == "auto" else method

    @property
    def loads(self) -> tuple[tuple[tuple[float, float], ...], ...] | None:
        """Changes of stress (s, Pa) on the right and on the top wall; None without coupling."""
        return self.coupling.load_changes if self.coupling is not None and self.coupled else None

    @property
    def keeps_a_pressure(self) -> bool:
        """Whether a side or a well has a fixed pressure."""
        return bool(self.held_sides) or any(well.held for well in self.wells)

    @property
    def held_sides(self) -> tuple[tuple[str, float], ...]:
        """The sides that keep a pressure, with it in Pa."""
        return tuple((name, p) for name, p in self.boundaries if not isinstance(p, Inflow))

    @property
    def inflow_sides(self) -> tuple[InflowSide, ...]:
        """The sides with a given inflow."""
        return tuple(
            InflowSide(name, tuple((t, -q) for t, q in given.changes(side_length(self.rock, name))))
            for name, given in self.boundaries
            if isinstance(given, Inflow) and name in (*self.rock.sides, "outer")
        )

    @property
    def side_names(self) -> tuple[str, ...]:
        """Names of the sides that are not sealed, in the order of results: held ones first."""
        return (*(name for name, _ in self.held_sides), *(side.name for side in self.inflow_sides))

    def _name_problems(self) -> Problems:
        """Names that stand for two things."""
        for kind, names in (
            ("wells", [well.name for well in self.wells]),
            ("fractures", [fracture.name for fracture in self.fractures]),
            ("probes", [probe.name for probe in self.probes]),
            ("boundaries", [name for name, _ in self.boundaries]),
        ):
            if len(set(names)) < len(names):
                for name, times in Counter(names).items():
                    if times > 1:
                        yield f"{kind}.{name}", "the name is used twice"

    def _observed_problems(self) -> Problems:
        """What is observed where there is nothing to see."""
        if not self.observe:
            yield "observe", "the list is empty, so nothing would be computed"
        for name in self.observe:
            if name not in OBSERVABLES:
                yield "observe", f"{name} is none of {', '.join(OBSERVABLES)}"
        for name, (part, lacking) in _OBSERVED.items():
            if name in self.observe and not getattr(self, part):
                yield "observe", f"{name} is asked for, but {lacking}"
        if self.flows and not (self.wells or self.boundaries or any(self.loads or ())):
            yield "wells", "nothing moves the fluid: add a well or a boundary pressure"

    def _part_problems(self) -> Problems:
        """Blocks that what is observed needs, or that nothing needs."""
        if self.tests and self.test is None:
            what = "moduli, strength and cracks are measured by a test; describe it, for instance "
            yield "test", what + "{kind: biaxial, confining_stress: 1 MPa}"
        for name, of_a in (("bar", "that of a bar"), ("periodic", "of a region that repeats")):
            if self.needs(f"measure_{name}") and (
                self.coupled or not isinstance(self.rock, Rectangle)
            ):
                what = f"{name}_permeability is {of_a}, a rectangle without holes or coupling"
                yield "observe", f"{what}; take permeability elsewhere"
        if "energy" in self.observe and self.test is not None and self.test.kind == "tension":
            yield "observe", "energy is counted in biaxial tests, where walls put it in"
        if self.needs("moduli"):
            yield from self._moduli_problems()
        for name, part in (("matrix", self.matrix), ("fluid", self.fluid)):
            if self.porous and part is None:
                yield name, f"what is observed needs a {name}"
        if self.matrix is not None and self.matrix.half_force is not None and self.stress is None:
            yield "matrix.half_force", "apertures follow forces only under a stress"
        if self.matrix is not None and self.matrix.half_stress is not None and self.stress is None:
            yield "matrix.half_stress", "apertures follow forces only under a stress"

    def _moduli_problems(self) -> Problems:
        """What the elastic moduli of cemented grains cannot tell."""
        if self.grains.contact_stiffness is None:
            yield "grains.modulus", "elastic_moduli need modulus or normal_stiffness"
        if self.grains.contact_law is not None:
            yield "observe", "elastic_moduli are of linear contacts that do not resist rolling"

    def _transient_problems(self) -> Problems:
        """What a transient lacks, and what is wrong with its start."""
        if self.transient and not self.times:
            yield "times", f"solver.method {self.method} needs times; give some, or take steady"
        if self.transient and self.initial_pressure is None:
            yield "initial_pressure", "a transient starts from a pressure; give it"
        if self.start == "uniform":
            return
        if self.flows and not self.transient:
            what = "a steady state starts from nothing; give one pressure, or leave it out"
            yield "initial_pressure", what
        elif self.start == "steady":
            yield from self._steady_start_problems()

    def _coupling_problems(self) -> Problems:
        """What does not go with coupling."""
        if not self.coupled:
            return
        if self.gravity is not None:
            yield from self._weight_problems()
        for side in self.inflow_sides:
            what = "a side with an inflow is for rock without coupling; give it a pressure"
            yield f"boundaries.{side.name}", what
        yield from self._coupled_time_problems()
        for well in self.wells:
            if well.decides or well.pressure_schedule is not None:
                what = "limits, groups and schedules of pressures are for wells without coupling"
                yield f"wells.{well.name}", what
        yield from coupling_problems(
            self.region,
            self.grains,
            self.bonds,
            self.fractures,
            breaks=self.breaks,
            linear=self.coupling_method == "linear",
        )
        if self.breaks:
            yield from self._breaking_problems()
        if self.coupling_method == "apertures":
            yield from self._aperture_problems()
        if "time_error" in self.observe:
            what = "time_error is measured on rigid rock; estimated_error stands in every result"
            yield "observe", what
        if "permeability" in self.observe and self.fractures:
            yield "observe", "permeability of a coupled specimen is measured without fractures"

    def _weight_problems(self) -> Problems:
        """What the weight of grains in a fluid needs."""
        lies_in = None if self.fluid is None else self.fluid.density
        if lies_in is None:
            what = "grains weigh less by the fluid that they displace; give its density"
            yield "fluid.density", what
        elif lies_in >= self.grains.density:
            what = f"grains of {self.grains.density:g} kg/m3 would float; give that of the fluid"
            yield "fluid.density", what

    def _coupled_time_problems(self) -> Problems:
        """What does not go with coupling, of how it goes on in time."""
        if self.flows and not self.transient:
            yield "coupling", "grains move while fluid does; give times, or leave coupling out"
        if self.solver.method not in ("auto", *COUPLED, "steady"):
            what = f"{self.solver.method} solves no coupled transient; take auto, or krylov"
            yield "solver.method", what
        if self.start == "steady":
            what = "a coupled transient starts from one pressure, or a linear field"
            yield "initial_pressure", what

    def _breaking_problems(self) -> Problems:
        """What does not go with bonds that break."""
        if self.stress is None:
            yield "stress", "where bonds break the rock is loaded; give its stresses"
        elif self.stress.components[2] != 0.0:
            what = "a rock whose bonds break is loaded along its walls; turn the rest instead"
            yield "stress.angle", what
        for number, one in enumerate(self.excavate):
            if one.side not in dict(self.held_sides):
                what = "where bonds break a hole keeps a pressure: give it a name, and boundaries "
                what += "that; one that fluid is injected into is a well of its radius"
                yield f"excavate.{number}.name", what
        if self.solver.method != "auto":
            what = "steps in which bonds break are found by one method; leave it out"
            yield "solver.method", what
        if self.flows and self.start != "uniform":
            yield "initial_pressure", "where bonds break the start is one pressure everywhere"
        for name in (*OF_COUPLING, "force_chains"):
            if name in self.observe:
                yield "observe", f"{name} is not observed where bonds break"
        for well in self.wells:
            if well.skin_factor != 0.0:
                what = "a well that may break its rock has no skin; leave it out"
                yield f"wells.{well.name}.skin_factor", what

    def _aperture_problems(self) -> Problems:
        """What apertures that follow forces need."""
        if self.stress is None:
            what = "apertures follow forces only under a stress; give one, or take linear"
            yield "coupling.method", what
        if self.start != "uniform":
            what = "a march with apertures that follow forces starts from one pressure"
            yield "initial_pressure", what
        if self.solver.method not in ("auto", "implicit"):
            what = f"{self.solver.method} is for conductances that stay; take auto or implicit"
            yield "solver.method", what

    def _steady_start_problems(self) -> Problems:
        """What is wrong with a start from the steady state."""
        if self.initial_pressure != "steady":
            what = f"{self.initial_pressure!r} is neither a pressure nor steady"
            yield "initial_pressure", what
        elif not self.keeps_a_pressure:
            what = "without a fixed pressure anywhere there is no steady state to start from"
            yield "initial_pressure", what
        elif self.flows and not self.inflow_sides and all(well.held for well in self.wells):
            what = "from the steady state nothing changes; give a well at a rate, or no times"
            yield "initial_pressure", what

    def _steady_problems(self) -> Problems:
        """What a steady state cannot have."""
        if not self.flows or self.method != "steady":
            return
        if self.times:
            what = "a steady state has no times; leave them out, or choose another solver.method"
            yield "times", what
        if not self.keeps_a_pressure:
            yield "boundaries", "without a fixed pressure anywhere no steady state exists"
        for well in self.wells:
            for key in ("schedule", "pressure_schedule"):
                if len(getattr(well, key) or ()) > 1:
                    yield f"wells.{well.name}.{key}", "a schedule has no steady state"
        for side in self.inflow_sides:
            if len(side.rate_changes) > 1:
                yield f"boundaries.{side.name}.schedule", "a schedule has no steady state"
