"""The stages of a case and how they are wired: pack → stress → network → open → flow → observe.

Each stage is a pure function. Its positional arguments are the products of earlier
stages, its keyword arguments the parts of the scene that it reads; it can read nothing
else, which is what lets a sweep share a product between all cases that agree on them.

The functions are named, and imported when they are first asked for: a sweep is planned
without the kernels and solvers that only its workers need.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from model.flow.errors import REFERENCE_METHOD, REFERENCE_TOLERANCE, time_error
from model.observe import (
    Controls,
    active_sources,
    controls,
    observe_flow,
    pressure_map,
    sites,
)
from model.products import (
    Apertures,
    Network,
    Packing,
    Permeability,
    Responses,
    StrengthTest,
    StressState,
    UnitLoads,
)
from model.quantities import MAPS, TESTS
from model.region import Region, contains
from model.scene import MEASURED_BY_A_TEST, Bonds, Scene, joint_lines

if TYPE_CHECKING:
    from model.flow.solvers import flow
    from model.mechanics.packing import pack
    from model.mechanics.strength import strength
    from model.mechanics.stress import load as stress
    from model.mechanics.stress import unit_loads
    from model.network.apertures import open_pipes as open
    from model.network.domains import network

__all__ = [
    "STAGES",
    "Stage",
    "case_maps",
    "flow",
    "network",
    "observe",
    "open",
    "pack",
    "simulate",
    "strength",
    "stress",
    "unit_loads",
]


CONFINEMENT = ("confining_stress_achieved", "confining_deviation", "confinement_held")


@dataclass(frozen=True)
class Stage:
    """One row of the table of stages."""

    name: str
    function: str  # where it lies, as `module:name`
    version: int  # raise it whenever the stage's results change
    parents: tuple[str, ...]  # stages whose products are the positional arguments (None if not run)
    reads: Mapping[str, Callable[[Scene], Any]]  # keyword argument -> the part of the scene
    wanted: Callable[[Scene], bool]  # whether a scene needs this stage
    product: type  # the NamedTuple it returns, or dict

    @property
    def run(self) -> Callable[..., Any]:
        """The function; asking for it imports what it needs."""
        module, _, name = self.function.partition(":")
        function: Callable[..., Any] = getattr(import_module(module), name)
        return function


def __getattr__(name: str) -> Any:
    for stage in STAGES:
        if stage.name == name:
            return stage.run
    raise AttributeError(f"module 'model.stages' has no attribute {name!r}")


def observe(
    packing: Packing,
    stress: StressState | None,
    tested: StrengthTest | None,
    network: Network | None,
    apertures: Apertures | None,
    permeability: Permeability | None,
    responses: Responses | None,
    reference: Responses | None,
    *,
    region: Region,
    told: Controls,
    wanted: tuple[str, ...],
) -> dict[str, np.ndarray]:
    """Everything that a study asks of one case, under its names in `model.quantities.CASE`."""
    from model.mechanics.measures import packing_quality

    grains = contains(region, np.column_stack([packing.x, packing.y]))
    found = {
        "porosity": packing.porosity,
        **packing_quality(packing),
        "grain_count": np.asarray(np.count_nonzero(grains)),
        "floaters": packing.floaters,
    }
    if network is not None and apertures is not None:
        found |= {
            "porosity": network.porosity,
            "matrix_aperture": apertures.matrix_aperture,
            "domain_count": np.asarray(np.count_nonzero(network.inside)),
            "floaters": network.floaters,
            "slivers": network.slivers,
            "smallest_pore": _smallest(apertures.volume[network.inside]),
            "idle_traces": np.asarray(np.count_nonzero(apertures.trace_acts == 0)),
            "parted_pipes": _parted(network, stress),
        }
    if tested is not None:
        found |= {name: getattr(tested, name) for name in MEASURED_BY_A_TEST if name in wanted}
        found |= {name: getattr(tested, name) for name in CONFINEMENT}
    if stress is not None:
        found["stress_achieved"] = stress.stress
        found["unbalanced_ratio"] = stress.unbalanced_ratio
        found["broken_bonds"] = stress.broken_bonds
        found["static_solver"] = stress.static
        found["mechanical_steps"] = stress.steps
        found["tension_cracks"] = np.asarray(np.count_nonzero(stress.crack_mode == 1))
        found["shear_cracks"] = np.asarray(np.count_nonzero(stress.crack_mode == 2))
        found["joint_contacts"] = np.asarray(np.count_nonzero(~np.isnan(stress.joint_gap)))
        found["idle_joints"] = stress.idle_joints
    if permeability is not None:
        found["permeability"] = permeability.tensor
    if responses is not None:
        found |= observe_flow(responses, told)
        for name, needs in (
            ("well_pressure", ("well_pressure", "well_rate")),
            ("well_pressure", ("pressure_change", "pressure_derivative")),
            ("boundary_flow", ("boundary_flow",)),
            ("probe_pressure", ("probe_pressure",)),
        ):
            if name not in wanted:
                for key in needs:
                    found.pop(key, None)
    if responses is not None and reference is not None:
        found["reference_error"] = reference.time_error
        held = sum(well.pressure is not None for well in told.wells)
        found["time_error"] = np.asarray(
            time_error(
                responses,
                reference,
                fixed=len(told.side_pressures) + held,
                wells=len(told.wells) - held,
                flows="boundary_flow" in wanted or held > 0,
            )
        )
    return {name: np.asarray(value) for name, value in found.items()}


def _smallest(volume: np.ndarray) -> np.ndarray:
    """The smallest of some volumes over their mean."""
    return np.asarray(volume.min() / volume.mean())


def _parted(network: Network, stress: StressState | None) -> np.ndarray:
    """Number of pipes of the region whose grains have parted under the stress."""
    if stress is None:
        return np.asarray(0)
    from model.network.apertures import pipe_gaps

    inside = network.inside[network.pipe_from] | network.inside[network.pipe_to]
    return np.asarray(np.count_nonzero(inside & (pipe_gaps(network, stress) > 0.0)))


def _needs_permeability(scene: Scene) -> bool:
    return scene.porous and (
        (scene.matrix is not None and scene.matrix.permeability is not None)
        or any(fracture.permeability is not None for fracture in scene.fractures)
    )


def _viscosity(scene: Scene) -> float | None:
    return scene.fluid.viscosity if scene.fluid is not None else None


def _observes_flows(scene: Scene) -> bool:
    return "boundary_flow" in scene.observe or any(w.pressure is not None for w in scene.wells)


def _superposes(scene: Scene) -> bool:
    stress, jointed = scene.stress, any(f.joint is not None for f in scene.fractures)
    return bool(stress and scene.bonds and stress.method != "explicit" and not jointed)


def _cement(scene: Scene) -> Bonds | None:
    """The bonds as far as their elastic response tells, in units of k_n."""
    if scene.bonds is None or scene.grains.contact_stiffness is None:
        return scene.bonds
    return scene.bonds.elastic(scene.grains.contact_stiffness)


def _always(scene: Scene) -> bool:
    return True


_FLOW_READS: Mapping[str, Callable[[Scene], Any]] = {
    "region": lambda s: s.region,
    "bulk_modulus": lambda s: s.fluid and s.fluid.bulk_modulus,
    "wells": lambda s: sites(s.wells),
    "sides": lambda s: tuple(name for name, _ in s.boundaries),
    "active": active_sources,
    "probes": lambda s: s.probes if "probe_pressure" in s.observe else (),
    "times": lambda s: controls(s).times,
    "method": lambda s: s.method,
    "tolerance": lambda s: s.solver.tolerance,
    "safety_factor": lambda s: s.solver.safety_factor,
    "step": lambda s: s.solver.step,
    "record_map": lambda s: "pressure_map" in s.observe,
    "check_flows": _observes_flows,
    "initial": lambda s: s.start,
}

STAGES: tuple[Stage, ...] = (
    Stage(
        name="pack",
        function="model.mechanics.packing:pack",
        version=6,
        parents=(),
        reads={
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
        },
        wanted=_always,
        product=Packing,
    ),
    Stage(
        name="unit_loads",
        function="model.mechanics.stress:unit_loads",
        version=5,
        parents=("pack",),
        reads={
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": _cement,
        },
        wanted=_superposes,
        product=UnitLoads,
    ),
    Stage(
        name="stress",
        function="model.mechanics.stress:load",
        version=8,
        parents=("pack", "unit_loads"),
        reads={
            "normal_stiffness": lambda s: s.grains.contact_stiffness,
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": lambda s: s.bonds,
            "joints": lambda s: joint_lines(s.fractures, s.region),
            "seed": lambda s: s.grains.seed,
            "stress": lambda s: s.stress,
        },
        wanted=lambda s: s.stress is not None,
        product=StressState,
    ),
    Stage(
        name="strength",
        function="model.mechanics.strength:strength",
        version=5,
        parents=("pack",),
        reads={
            "normal_stiffness": lambda s: s.grains.contact_stiffness,
            "stiffness_ratio": lambda s: s.grains.stiffness_ratio,
            "friction": lambda s: s.grains.friction,
            "bonds": lambda s: s.bonds,
            "joints": lambda s: joint_lines(s.fractures, s.region),
            "test": lambda s: s.test,
            "seed": lambda s: s.grains.seed,
        },
        wanted=lambda s: s.tests,
        product=StrengthTest,
    ),
    Stage(
        name="network",
        function="model.network.domains:network",
        version=1,
        parents=("pack",),
        reads={"region": lambda s: s.region},
        wanted=lambda s: s.porous,
        product=Network,
    ),
    Stage(
        name="calibrate",
        function="model.permeability:calibrate",
        version=2,
        parents=("network",),
        reads={},
        wanted=_needs_permeability,
        product=Permeability,
    ),
    Stage(
        name="open",
        function="model.network.apertures:open_pipes",
        version=1,
        parents=("network", "stress", "calibrate"),
        reads={
            "region": lambda s: s.region,
            "matrix": lambda s: s.matrix,
            "fractures": lambda s: s.fractures,
            "viscosity": _viscosity,
        },
        wanted=lambda s: s.porous,
        product=Apertures,
    ),
    Stage(
        name="measure",
        function="model.permeability:measure",
        version=2,
        parents=("network", "open"),
        reads={"viscosity": _viscosity},
        wanted=lambda s: "permeability" in s.observe,
        product=Permeability,
    ),
    Stage(
        name="flow",
        function="model.flow.solvers:flow",
        version=12,
        parents=("network", "open"),
        reads=_FLOW_READS,
        wanted=lambda s: s.flows,
        product=Responses,
    ),
    Stage(
        name="reference",
        function="model.flow.solvers:flow",
        version=8,
        parents=("network", "open"),
        reads={
            **_FLOW_READS,
            "method": lambda s: REFERENCE_METHOD,
            "tolerance": lambda s: REFERENCE_TOLERANCE,
            "safety_factor": lambda s: 1.0,
            "step": lambda s: "corrected",
        },
        wanted=lambda s: s.flows and "time_error" in s.observe and s.method != "steady",
        product=Responses,
    ),
    Stage(
        name="observe",
        function="model.stages:observe",
        version=5,
        parents=("pack", "stress", "strength", "network", "open", "measure", "flow", "reference"),
        reads={
            "region": lambda s: s.region,
            "told": controls,
            "wanted": lambda s: s.observe,
        },
        wanted=_always,
        product=dict,
    ),
)


def run_stages(scene: Scene) -> dict[str, Any]:
    """Run every stage that a scene wants, in order; the products by name of stage."""
    products: dict[str, Any] = {}
    for stage in STAGES:
        if stage.wanted(scene):
            parents = [products.get(name) for name in stage.parents]
            parts = {name: part(scene) for name, part in stage.reads.items()}
            products[stage.name] = stage.run(*parents, **parts)
    return products


def simulate(scene: Scene) -> dict[str, np.ndarray]:
    """Run one case: the quantities of `model.quantities.CASE` that the scene observes.

    A pure function: same scene, same bits. Raises `ModelError` where a stage cannot reach
    its result.
    """
    return run_stages(scene)["observe"]


def case_maps(scene: Scene, products: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Fields of one case under their names in `model.quantities.MAPS`, with its polygons.

    `products` are those of `run_stages`. Domains are those inside the region, pipes those
    with an end among them. `mesh_node_x`, `mesh_node_y` are the corners of the domains'
    polygons and `mesh_face_nodes` (domain, most corners) their indices, −1 where a domain
    has fewer. A test to failure adds its curves and cracks, `model.quantities.TESTS`.
    """
    tested = {name: getattr(products["strength"], name) for name in TESTS} if scene.tests else {}
    return tested | _pore_maps(scene, products) if scene.porous else tested


def _pore_maps(scene: Scene, products: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Pores, pipes and grains of a case."""
    net: Network = products["network"]
    opened: Apertures = products["open"]
    domain = np.flatnonzero(net.inside)
    number = np.full(len(net.x), -1)
    number[domain] = np.arange(len(domain))
    pipe = np.flatnonzero(net.inside[net.pipe_from] | net.inside[net.pipe_to])
    swap = ~net.inside[net.pipe_from[pipe]]
    start = np.where(swap, net.pipe_to[pipe], net.pipe_from[pipe])
    end = np.where(swap, net.pipe_from[pipe], net.pipe_to[pipe])
    trace = opened.on_fracture[pipe]
    fracture = np.full(len(pipe), -1)
    fracture[trace >= 0] = opened.trace_fracture[trace[trace >= 0]]
    maps = {
        "x": net.x[domain],
        "y": net.y[domain],
        "volume": opened.volume[domain],
        "aperture": opened.aperture[pipe],
        "conductance": opened.conductance[pipe],
        "from_domain": number[start],
        "to_domain": number[end],
        "on_fracture": fracture,
        **_mesh(net, domain),
    }
    if "pressure_map" in scene.observe:
        told = controls(scene)
        pressure = pressure_map(products["flow"], told)
        maps["pressure"] = pressure if told.transient else pressure[0]
    if "grain_map" in scene.observe:
        state: StressState | None = products.get("stress")
        packing: Packing = products["pack"]
        held = state if state is not None else packing
        stiffness = 1.0 if state is not None else (scene.grains.contact_stiffness or np.nan)
        maps |= {
            "grain_x": held.x,
            "grain_y": held.y,
            "radius": packing.radius,
            "normal_force": held.normal_force * stiffness,
            "shear_force": held.shear_force * stiffness,
            "grain_a": held.contact_a,
            "grain_b": held.contact_b,
        }
        if state is not None:
            maps |= {name: getattr(state, name) for name in MAPS if name.startswith("crack_")}
    return maps


def _mesh(net: Network, domain: np.ndarray) -> dict[str, np.ndarray]:
    """The polygons of some domains: their corners, and the corners of each, padded with −1."""
    corners = np.diff(net.corner_start)[domain]
    faces = np.full((len(domain), corners.max()), -1)
    filled = np.arange(faces.shape[1]) < corners[:, None]
    first = np.repeat(net.corner_start[:-1][domain], corners)
    within = np.arange(corners.sum()) - np.repeat(np.cumsum(corners) - corners, corners)
    grains, nodes = np.unique(net.corner_grain[first + within], return_inverse=True)
    faces[filled] = nodes
    return {
        "mesh_node_x": net.grain_x[grains],
        "mesh_node_y": net.grain_y[grains],
        "mesh_face_nodes": faces,
    }
