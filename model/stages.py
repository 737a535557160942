"""The stages of a case and how they are wired: pack → stress → network → open → flow → observe.

Each stage is a pure function. Its positional arguments are the products of earlier
stages, its keyword arguments the parts of the scene that it reads; it can read nothing
else, which is what lets a sweep share a product between all cases that agree on them.

The functions are named, and imported when they are first asked for: a sweep is planned
without the kernels and solvers that only its workers need.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from demflow.model.amounts import (
    held_by_flow,
    held_by_observe,
    kept_by_flow,
    kept_by_observe,
)
from demflow.model.controls import active_sources, controls_of, sites, step_decades
from demflow.model.coupling.told import BreakingFluid, BreakingRock, march_legs, stretches
from demflow.model.families import (
    MEASURED,
    alike,
    asked,
    may_be_emulated,
    may_be_measured,
    member,
    place,
)
from demflow.model.flow.equation.sites import WellPlace
from demflow.model.flow.solvers.time_error import REFERENCE_METHOD, REFERENCE_TOLERANCE
from demflow.model.products import (
    Apertures,
    BarPermeability,
    Emulator,
    FractureNetwork,
    Moduli,
    Network,
    Packing,
    PeriodicPermeability,
    Permeability,
    Responses,
    StrengthTest,
    StressState,
    UnitLoads,
    Walk,
)
from demflow.model.quantities import checked
from demflow.model.scene import (
    Bonds,
    Ground,
    Joint,
    JointLine,
    Scene,
    Well,
    flow_lines,
    joint_lines,
    refined_places,
)

if TYPE_CHECKING:
    from demflow.model.coupling.consolidation import consolidate
    from demflow.model.coupling.following import follow
    from demflow.model.flow.solvers.registry import flow
    from demflow.model.mechanics.loading.strength import strength
    from demflow.model.mechanics.loading.stress import load as stress
    from demflow.model.mechanics.loading.stress import unit_loads
    from demflow.model.mechanics.packing.packing import pack
    from demflow.model.network.apertures import open_pipes as open  # noqa: A004 (the stage)
    from demflow.model.network.domains import network
    from demflow.model.network.fractures.walk import walk
    from demflow.model.observe import observe

__all__ = [
    "STAGES",
    "Stage",
    "consolidate",
    "flow",
    "follow",
    "network",
    "observe",
    "open",
    "pack",
    "simulate",
    "strength",
    "stress",
    "unit_loads",
    "walk",
]


def grain_count(scene: Scene) -> float:
    """Number of grains in the region; about that number where a radius is given instead."""
    if scene.grains.count is not None:
        return float(scene.grains.count)
    disc = math.pi * (scene.grains.mean_radius or 1.0) ** 2
    return max(1.0, scene.region.area / disc)


def _line_count(scene: Scene) -> float:
    """Number of straight pieces of fractures that act on flow, in the region."""
    return float(max(1, len(flow_lines(scene.fractures, scene.rock))))


def _nothing(_scene: Scene) -> float:
    return 0.0


def _plain(_scene: Scene) -> str:
    return ""


def _traces(scene: Scene) -> str:
    return "traces" if flow_lines(scene.fractures, scene.rock) else ""


@dataclass(frozen=True)
class Stage:
    """One row of the table of stages."""

    name: str
    function: str  # where it lies, as `module:name`
    version: int  # raise it whenever the stage's results change
    parents: tuple[str, ...]  # stages whose products are the positional arguments (None if not run)
    reads: Mapping[str, Callable[[Scene], Any]]  # keyword argument -> the part of the scene
    wanted: Callable[[Scene], bool]  # whether a scene needs this stage
    product: type | str  # the NamedTuple it returns, or where that lies; or dict
    # of a stage that marches, one of its own parents: what each of its runs is to do, and takes
    # as `leg`, beside the product of the run before (None at first)
    legs: Callable[[Scene], tuple[Any, ...]] | None = None
    size: Callable[[Scene], float] = grain_count  # with which its cost grows
    manner: Callable[[Scene], str] = _plain  # what there is in a scene that costs more, a word
    # numbers of its product, and that it holds at once, which times and rate changes make
    kept: Callable[[Scene], float] = _nothing
    held: Callable[[Scene], float] = _nothing
    # of a stage whose run serves several cases, a family, and which none wants by itself: whether
    # a scene may be one of them, the same function of all stages that serve it; what each brings,
    # as one of the `members` that it takes, and how many a run takes at most; where a case lies in
    # its family, if a few are chosen that lie apart
    family: Callable[[Scene], bool] | None = None
    brings: Callable[[Scene], Any] | None = None
    block: int = 512
    place: Callable[[Scene], tuple[float, ...]] | None = None
    # why what it returned stops early, "" where it does not; ModelError where it is no result
    check: Callable[[Any], str] | None = None
    # what it reads besides of a scene that has it; where that is None nothing is passed, and
    # nothing enters the identity
    options: Mapping[str, Callable[[Scene], Any]] = field(default_factory=dict)
    observed: bool = False  # whether its product is what a study asks of a case
    sources: str = ""  # what tells its sources from others of the same version, where they differ

    @property
    def run(self) -> Callable[..., Any]:
        """The function; asking for it imports what it needs."""
        function: Callable[..., Any] = _at(self.function)
        return function

    @property
    def returns(self) -> type:
        """The type of its product; asking for it may import what defines it."""
        return _at(self.product) if isinstance(self.product, str) else self.product

    def legs_of(self, scene: Scene) -> tuple[Any, ...]:
        """The legs of a march, in order; of any other stage one, which is nothing.

        ValueError where a march has none: the case would end without what it asks for.
        """
        legs = (None,) if self.legs is None else self.legs(scene)
        if not legs:
            raise ValueError(f"stage {self.name} has no legs in a scene that wants it")
        return legs

    def given(self, scene: Scene, leg: int = 0) -> dict[str, Any]:
        """The keyword arguments of its run for a scene, or of one of them by its number."""
        parts = {name: part(scene) for name, part in self.reads.items()}
        options = {name: part(scene) for name, part in self.options.items()}
        parts |= {name: value for name, value in options.items() if value is not None}
        return parts if self.legs is None else {**parts, "leg": self.legs_of(scene)[leg]}


def _at(place: str) -> Any:
    """What lies at `module:name`."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def __getattr__(name: str) -> Any:
    for stage in STAGES:
        if stage.name == name:
            return stage.run
    raise AttributeError(f"module 'demflow.model.stages' has no attribute {name!r}")


def _needs_permeability(scene: Scene) -> bool:
    return scene.porous and (
        (scene.pipes is not None and scene.pipes.permeability is not None)
        or any(fracture.permeability is not None for fracture in scene.fractures)
    )


def _viscosity(scene: Scene) -> float | None:
    return scene.fluid.viscosity if scene.fluid is not None else None


def _observes_flows(scene: Scene) -> bool:
    return "boundary_flow" in scene.observe or any(w.held for w in scene.wells)


def _superposes(scene: Scene) -> bool:
    stress, jointed = scene.stress, any(f.joint is not None for f in scene.fractures)
    plain = scene.grains.contact_law is None and not jointed
    return bool(
        stress and scene.bonds and stress.method != "explicit" and plain and not scene.breaks
    )


def _cement(scene: Scene) -> Bonds | None:
    """The bonds as far as their elastic response tells, in units of k_n."""
    if scene.bonds is None or scene.grains.contact_stiffness is None:
        return scene.bonds
    return scene.bonds.elastic(scene.grains.contact_stiffness)


def _stuck_joints(scene: Scene) -> tuple[JointLine, ...] | None:
    """Smooth joints as far as they are springs, in units of k_n; None where there are none."""
    lines, kn = joint_lines(scene.fractures, scene.region), scene.grains.contact_stiffness
    if not lines or kn is None:
        return None

    def over(one: Joint) -> Joint:
        return Joint(one.normal_stiffness / kn, one.shear_stiffness / kn, friction=0.0)

    return tuple(line._replace(joint=over(line.joint)) for line in lines)


def _scaled_ground(scene: Scene) -> Ground | None:
    """Weight and holes over k_n."""
    if scene.ground is None or scene.grains.contact_stiffness is None:
        return None
    return scene.ground.over(scene.grains.contact_stiffness)


def _walled(scene: Scene) -> bool | None:
    """True where the region is the specimen between its walls; None leaves identities alone."""
    return True if scene.coupled else None


def _evened(scene: Scene) -> bool | None:
    """True where the rock is one; what opens between walls has its grains' own lengths."""
    even = scene.grains.scatter == "even" or scene.grains.refine
    return True if even and not scene.coupled else None


def _load_times(scene: Scene) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(time for time, _ in changes) for changes in scene.loads or ())


def _active(scene: Scene) -> tuple[bool, ...]:
    """Which sources of a coupled rock act: those of the flow, then the loads."""
    loads = (any(size != 0.0 for _, size in changes) for changes in scene.loads or ())
    return (*active_sources(scene), *loads)


def _breaking_rock(scene: Scene) -> Any:
    """The rock of a march through breaking bonds."""
    if scene.bonds is None or scene.stress is None or scene.grains.contact_stiffness is None:
        return None
    return BreakingRock(
        scene.grains.contact_stiffness,
        scene.grains.stiffness_ratio,
        scene.grains.friction,
        scene.bonds,
        joint_lines(scene.fractures, scene.region),
        scene.grains.seed,
        scene.stress,
        scene.ground,
    )


def _breaking_fluid(scene: Scene) -> Any:
    """Its fluid and the pipes of its matrix."""
    fluid = scene.fluid
    if fluid is None or fluid.modulus is None or scene.pipes is None or scene.coupling is None:
        return None
    return BreakingFluid(
        fluid.viscosity,
        fluid.modulus,
        scene.pipes,
        scene.uniform_pressure or 0.0,
        scene.coupling.least_pressure,
        scene.held_sides,
        _largest_rate(scene.wells),
    )


def _largest_rate(wells: tuple[Well, ...]) -> float | None:
    """That of any well at any time, m³/s; None where a well keeps a pressure."""
    if any(well.pressure is not None for well in wells):
        return None
    return max((abs(q) for well in wells for _, q in well.rate_changes), default=None)


def _placed(well: Well) -> Well:
    """A well without its rates."""
    return well if well.pressure is not None else replace(well, rate=0.0, schedule=None)


def _told_coupling(scene: Scene) -> tuple[str, str] | None:
    """How a scene whose bonds hold is coupled, and why."""
    if not scene.coupled or scene.breaks:
        return None
    return scene.coupling_method, scene.reckoned.reason


def _may_be_loaded(scene: Scene) -> bool:
    """Whether a scene may be one of a family of states of stress that unit loads give.

    The static solver is asked for, so that no state takes long, and what is observed of the rock
    are permeabilities.
    """
    static = scene.stress is not None and scene.stress.method == "static"
    measured = bool(scene.observe) and MEASURED.issuperset(scene.observe)
    return static and measured and _superposes(scene) and not scene.coupled


def _own_stages(scene: Scene) -> dict[str, dict[str, Any]]:
    """What the stages of a scene read that no other state of stress shares, by their names."""
    own = ("stress", "open", "measure", "measure_bar", "measure_periodic", "observe")
    return {s.name: s.given(scene) for s in STAGES if s.name in own and s.wanted(scene)}


def _always(_scene: Scene) -> bool:
    return True


def _never(_: Scene) -> bool:
    return False


_FLOW_READS: Mapping[str, Callable[[Scene], Any]] = {
    "region": lambda s: s.rock,
    "bulk_modulus": lambda s: s.fluid and s.fluid.modulus,
    "wells": lambda s: sites(controls_of(s).wells),
    "sides": lambda s: tuple(name for name, _ in s.held_sides),
    "active": active_sources,
    "probes": lambda s: s.probes if "probe_pressure" in s.observe else (),
    "times": lambda s: controls_of(s).times,
    "method": lambda s: s.method,
    "tolerance": lambda s: s.solver.tolerance,
    "safety_factor": lambda s: s.solver.safety_factor,
    "step": lambda s: s.solver.step,
    "record_map": lambda s: "pressure_map" in s.observe,
    "check_flows": _observes_flows,
    "initial": lambda s: s.start,
    "decades": step_decades,
    "fine": lambda s: True if any(w.decides for w in s.wells) else None,
}

_ROCK_READS: Mapping[str, Callable[[Scene], Any]] = {
    "region": lambda s: s.rock,
    "matrix": lambda s: s.pipes,
    "viscosity": _viscosity,
    "fractures": lambda s: alike(s.fractures),
}

_FAMILY_READS: Mapping[str, Callable[[Scene], Any]] = {**_ROCK_READS, "asked": asked}

_PACK_READS: Mapping[str, Callable[[Scene], Any]] = {
    "region": lambda s: s.region,
    "count": lambda s: s.grains.count,
    "mean_radius": lambda s: s.grains.mean_radius,
    "packing": lambda s: s.grains.packing,
    "radius_ratio": lambda s: s.grains.radius_ratio,
    "porosity": lambda s: s.grains.porosity,
    "tile": lambda s: s.grains.tile if s.grains.packing == "periodic" else 0,
    "packing_pressure": lambda s: s.grains.packing_pressure,
    "packing_friction": lambda s: s.grains.packing_friction,
    "seed": lambda s: s.grains.seed,
    "floaters": lambda s: s.grains.floaters,
    "sizes": lambda s: s.grains.sizes,
    "radius_deviation": lambda s: s.grains.radius_deviation,
    "radii": lambda s: s.grains.radii,
    "refine": lambda s: refined_places(s.grains.refine, s.wells, s.fractures, s.region),
}

STAGES: tuple[Stage, ...] = (
    Stage(
        name="pack",
        function="demflow.model.mechanics.packing.packing:pack",
        version=8,
        parents=(),
        reads={
            **_PACK_READS,
            "specimen": lambda s: (s.tests and not s.porous) or s.coupled or None,
        },
        wanted=_always,
        product=Packing,
    ),
    Stage(
        name="specimen",
        function="demflow.model.mechanics.packing.packing:pack",
        version=2,
        parents=(),
        reads={**_PACK_READS, "specimen": lambda s: True},
        wanted=lambda s: s.tests and s.porous,
        product=Packing,
    ),
    Stage(
        name="unit_loads",
        function="demflow.model.mechanics.loading.stress:unit_loads",
        version=5,
        parents=("pack",),
        reads={
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": _cement,
        },
        options={"ground": _scaled_ground},
        wanted=_superposes,
        product=UnitLoads,
    ),
    Stage(
        name="stress",
        function="demflow.model.mechanics.loading.stress:load",
        version=12,
        parents=("pack", "unit_loads"),
        reads={
            "normal_stiffness": lambda s: s.grains.contact_stiffness,
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": lambda s: s.bonds,
            "contact": lambda s: s.grains.contact_law,
            "joints": lambda s: joint_lines(s.fractures, s.region),
            "seed": lambda s: s.grains.seed,
            "stress": lambda s: s.stress,
        },
        options={"ground": lambda s: s.ground},
        wanted=lambda s: s.stress is not None and not s.breaks,
        product=StressState,
    ),
    Stage(
        name="moduli",
        function="demflow.model.mechanics.static.moduli:elastic_moduli",
        version=1,
        parents=("pack",),
        reads={
            "normal_stiffness": lambda s: s.grains.contact_stiffness,
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": lambda s: s.bonds,
        },
        wanted=lambda s: s.needs("moduli"),
        product=Moduli,
    ),
    Stage(
        name="strength",
        function="demflow.model.mechanics.loading.strength:strength",
        version=10,
        parents=("pack", "specimen"),
        reads={
            "normal_stiffness": lambda s: s.grains.contact_stiffness,
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": lambda s: s.bonds,
            "contact": lambda s: s.grains.contact_law,
            "joints": lambda s: joint_lines(s.fractures, s.region),
            "test": lambda s: s.test,
            "seed": lambda s: s.grains.seed,
            "energy": lambda s: True if "energy" in s.observe else None,
        },
        wanted=lambda s: s.tests,
        product=StrengthTest,
    ),
    Stage(
        name="network",
        function="demflow.model.network.domains:network",
        version=3,
        parents=("pack",),
        reads={"region": lambda s: s.rock, "walled": _walled},
        options={"even": _evened},
        wanted=lambda s: s.porous,
        product=Network,
    ),
    Stage(
        name="calibrate",
        function="demflow.model.permeability:calibrate",
        version=3,
        parents=("network",),
        reads={},
        wanted=_needs_permeability,
        product=Permeability,
    ),
    Stage(
        name="walk",
        function="demflow.model.network.fractures.walk:walk",
        version=2,
        parents=("network",),
        reads={
            "region": lambda s: s.rock,
            "lines": lambda s: flow_lines(s.fractures, s.rock),
        },
        wanted=lambda s: s.porous and any(f.acts_on_flow for f in s.fractures),
        product=Walk,
    ),
    Stage(
        name="open",
        function="demflow.model.network.apertures:open_pipes",
        version=3,
        parents=("network", "walk", "stress", "calibrate"),
        reads={
            "region": lambda s: s.rock,
            "matrix": lambda s: s.pipes,
            "fractures": lambda s: s.fractures,
            "viscosity": _viscosity,
        },
        wanted=lambda s: s.porous,
        product=Apertures,
        manner=_traces,
    ),
    Stage(
        name="measure",
        function="demflow.model.permeability:measure",
        version=3,
        parents=("network", "open"),
        reads={"viscosity": _viscosity},
        wanted=lambda s: s.needs("measure"),
        product=Permeability,
    ),
    Stage(
        name="measure_bar",
        function="demflow.model.permeability:measure_bar",
        version=1,
        parents=("network", "open"),
        reads={"region": lambda s: s.rock, "viscosity": _viscosity},
        wanted=lambda s: s.needs("measure_bar"),
        product=BarPermeability,
    ),
    Stage(
        name="measure_periodic",
        function="demflow.model.permeability:measure_periodic",
        version=1,
        parents=("network", "open"),
        reads={"viscosity": _viscosity},
        wanted=lambda s: s.needs("measure_periodic"),
        product=PeriodicPermeability,
    ),
    Stage(
        name="flow",
        function="demflow.model.flow.solvers.registry:flow",
        version=24,
        parents=("network", "open"),
        reads=_FLOW_READS,
        wanted=lambda s: s.flows and not s.coupled,
        product=Responses,
        manner=_traces,
        kept=kept_by_flow,
        held=held_by_flow,
        options={"storativity": lambda s: s.storativity},
    ),
    Stage(
        name="reference",
        function="demflow.model.flow.solvers.registry:flow",
        version=18,
        parents=("network", "open"),
        reads={
            **_FLOW_READS,
            "method": lambda s: REFERENCE_METHOD,
            "tolerance": lambda s: REFERENCE_TOLERANCE,
            "safety_factor": lambda s: 1.0,
            "step": lambda s: "corrected",
        },
        wanted=lambda s: s.needs("reference") and s.method != "steady",
        product=Responses,
        manner=_traces,
        kept=kept_by_flow,
        held=held_by_flow,
        options={"storativity": lambda s: s.storativity},
    ),
    Stage(
        name="consolidate",
        function="demflow.model.coupling.consolidation:consolidate",
        version=5,
        parents=("pack", "network", "open"),
        reads={
            "region": lambda s: s.rock,
            "normal_stiffness": lambda s: s.grains.contact_stiffness,
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": _cement,
            "held": lambda s: s.coupling and s.coupling.held_walls,
            "load_times": _load_times,
            "bulk_modulus": lambda s: s.fluid and s.fluid.modulus,
            "wells": lambda s: sites(s.wells),
            "sides": lambda s: tuple(name for name, _ in s.held_sides),
            "active": _active,
            "probes": lambda s: s.probes if "probe_pressure" in s.observe else (),
            "times": lambda s: controls_of(s).times,
            "method": lambda s: s.method,
            "tolerance": lambda s: s.solver.tolerance,
            "record_map": lambda s: "pressure_map" in s.observe,
            "initial": lambda s: s.start,
        },
        options={"joints": _stuck_joints},
        wanted=lambda s: s.flows and s.coupling_method == "linear",
        product="demflow.model.coupling.consolidation:Consolidation",
        kept=kept_by_flow,
        held=held_by_flow,
    ),
    Stage(
        name="follow",
        function="demflow.model.coupling.following:follow",
        version=5,
        parents=("pack", "network", "walk", "stress", "calibrate", "follow"),
        reads={
            "region": lambda s: s.rock,
            "matrix": lambda s: s.pipes,
            "fractures": lambda s: s.fractures,
            "viscosity": _viscosity,
            "normal_stiffness": lambda s: s.grains.contact_stiffness,
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": _cement,
            "held": lambda s: s.coupling and s.coupling.held_walls,
            "bulk_modulus": lambda s: s.fluid and s.fluid.modulus,
            "wells": lambda s: sites(tuple(map(_placed, s.wells))),
            "sides": lambda s: tuple(name for name, _ in s.held_sides),
            "initial": lambda s: s.uniform_pressure,
            "kept": lambda s: controls_of(s).fixed_pressures,
            "probes": lambda s: s.probes if "probe_pressure" in s.observe else (),
            "tolerance": lambda s: s.solver.tolerance,
            "record_map": lambda s: "pressure_map" in s.observe,
        },
        wanted=lambda s: s.flows and s.coupling_method == "apertures",
        product="demflow.model.coupling.following:Followed",
        legs=stretches,
        kept=kept_by_flow,
        held=held_by_flow,
    ),
    Stage(
        name="fracture",
        function="demflow.model.coupling.fracture:fracture",
        version=6,
        parents=("pack", "calibrate", "fracture"),
        reads={
            "rock": _breaking_rock,
            "wet": _breaking_fluid,
            "wells": lambda s: tuple(map(_placed, s.wells)),
            "probes": lambda s: s.probes if "probe_pressure" in s.observe else (),
            "tolerance": lambda s: s.coupling and s.coupling.step_error,
            "record_map": lambda s: "pressure_map" in s.observe,
        },
        options={
            "record_permeability": lambda s: "permeability_in_time" in s.observe or None,
        },
        wanted=lambda s: s.flows and s.breaks,
        product="demflow.model.coupling.fracture:Fracturing",
        legs=march_legs,
        kept=kept_by_observe,
        held=held_by_observe,
    ),
    Stage(
        name="fractures",
        function="demflow.model.fracture_network:describe",
        version=1,
        parents=(),
        reads={
            "region": lambda s: s.rock,
            "fractures": lambda s: s.fractures,
            "viscosity": _viscosity,
            "wells": lambda s: tuple(WellPlace(w.at, w.effective_radius) for w in s.wells),
            "sides": lambda s: s.side_names,
        },
        wanted=lambda s: s.needs("fractures"),
        product=FractureNetwork,
        size=_line_count,  # no grain has a part in it
    ),
    Stage(
        name="emulator",
        function="demflow.model.emulation:emulator",
        version=5,
        parents=("network", "walk", "stress", "calibrate"),
        reads=_FAMILY_READS,
        wanted=_never,
        product=Emulator,
        family=may_be_emulated,
        brings=lambda s: s.fractures,
        place=place,
    ),
    Stage(
        name="emulate",
        function="demflow.model.emulation:emulate",
        version=4,
        parents=("pack", "stress", "network", "walk", "calibrate", "emulator"),
        reads={**_FAMILY_READS, "wanted": lambda s: s.observe},
        wanted=_never,
        product=dict,
        kept=kept_by_observe,
        held=held_by_observe,
        family=may_be_emulated,
        brings=member,
    ),
    Stage(
        name="tensors",
        function="demflow.model.tensors:tensors",
        version=1,
        parents=("pack", "stress", "network", "walk", "calibrate"),
        reads={**_ROCK_READS, "wanted": lambda s: s.observe},
        wanted=_never,
        product=dict,
        manner=_traces,
        family=may_be_measured,
        brings=lambda s: s.fractures,
        block=64,
    ),
    Stage(
        name="states",
        function="demflow.model.states:states",
        version=1,
        parents=("pack", "unit_loads", "network", "walk", "calibrate"),
        reads={},
        wanted=_never,
        product=dict,
        manner=_traces,
        family=_may_be_loaded,
        brings=_own_stages,
        block=16,
    ),
    Stage(
        name="observe",
        function="demflow.model.observe:observe",
        version=11,
        parents=(
            *("pack", "stress", "strength", "network", "open"),
            *("measure", "flow", "reference", "fractures", "moduli", "consolidate"),
            *("fracture", "follow", "measure_bar", "measure_periodic"),
        ),
        reads={
            "region": lambda s: s.rock,
            "controls": controls_of,
            "wanted": lambda s: s.observe,
            "loads": lambda s: s.loads,
            "coupled": _told_coupling,
        },
        wanted=_always,
        product=dict,
        kept=kept_by_observe,
        held=held_by_observe,
        check=checked,
        observed=True,
    ),
)


def run_stages(scene: Scene) -> dict[str, Any]:
    """Run every stage that a scene wants by itself, in order; the products by name of stage."""
    products: dict[str, Any] = {}
    for stage in STAGES:
        if stage.wanted(scene):
            for leg in range(len(stage.legs_of(scene))):
                parents = [products.get(name) for name in stage.parents]
                products[stage.name] = stage.run(*parents, **stage.given(scene, leg))
    return products


def simulate(scene: Scene) -> dict[str, np.ndarray]:
    """Run one case: the quantities of `model.quantities.CASE` that the scene observes.

    A pure function: same scene, same bits. Raises `ModelError` where a stage cannot reach
    its result.
    """
    found: dict[str, np.ndarray] = run_stages(scene)["observe"]
    return found
