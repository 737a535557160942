"""Cases that differ in how wide their fractures are and in what is done at the wells: families.

One small model answers a family of transients (`flow.solvers.emulator`); permeabilities of a family
are measured on one graph (`model.tensors`). Here is what decides whether a scene belongs to a
family, what all of it share, and what each brings; nothing is computed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

from demflow.model.controls import Controls, active_sources, controls_of, sites, step_decades
from demflow.model.scene import Fracture, Scene

# What an emulator can record: numbers of wells, sides and probes, but no field.
EMULATED = frozenset({"well_pressure", "boundary_flow", "probe_pressure"})

# What is measured of many cases on one graph.
MEASURED = frozenset({"permeability", "bar_permeability", "periodic_permeability"})


class Member(NamedTuple):
    """What one case of a family brings."""

    fractures: tuple[Fracture, ...]
    controls: Controls


def may_be_emulated(scene: Scene) -> bool:
    """Whether a scene may be one of a family.

    A transient of whole, uncoupled rock with wells at a rate whose solver is left open, from one
    pressure everywhere, with fractures that have an aperture, and nothing recorded but in wells,
    sides and probes.
    """
    held = any(well.held or well.decides for well in scene.wells)
    others = any(p != scene.uniform_pressure for _, p in scene.held_sides)
    return (
        scene.transient
        and scene.method == "auto"
        and scene.start == "uniform"
        and EMULATED.issuperset(scene.observe)
        and not scene.coupled
        and scene.rock == scene.region
        and not (held or others or scene.inflow_sides or scene.storativity)
        and any(fracture.part == "trace" for fracture in scene.fractures)
    )


def may_be_measured(scene: Scene) -> bool:
    """Whether a scene may be one of a family whose permeabilities are measured together.

    Uncoupled rock with fractures that have an aperture, of which permeabilities are observed and
    nothing else.
    """
    return (
        MEASURED.issuperset(scene.observe)
        and not scene.coupled
        and any(fracture.part == "trace" for fracture in scene.fractures)
    )


def member(scene: Scene) -> Member:
    """What a scene brings to its family."""
    return Member(scene.fractures, controls_of(scene))


def alike(fractures: tuple[Fracture, ...]) -> tuple[Any, ...]:
    """All of the fractures but how wide they are: the same in a family."""
    return tuple(
        (type(one).__name__, *(getattr(one, f.name) for f in fields(one) if f.name != "aperture"))
        for one in fractures
    )


def place(scene: Scene) -> tuple[float, ...]:
    """Where a scene lies in its family: logarithms of what says how wide fractures are."""
    return tuple(
        math.log(number)
        for fracture in scene.fractures
        for number in _numbers(fracture.aperture)
        if number > 0.0
    )


def _numbers(aperture: Any) -> Iterator[float]:
    if is_dataclass(aperture):
        for one in fields(aperture):
            yield from _numbers(getattr(aperture, one.name))
    elif aperture is not None:
        yield abs(float(aperture))


def asked(scene: Scene) -> dict[str, Any]:
    """What is asked of the flow, all that `flow.solvers.registry.pose` takes beside the network."""
    return {
        "bulk_modulus": scene.fluid and scene.fluid.modulus,
        "wells": sites(scene.wells),
        "sides": tuple(name for name, _ in scene.held_sides),
        "active": active_sources(scene),
        "probes": scene.probes if "probe_pressure" in scene.observe else (),
        "times": controls_of(scene).times,
        "tolerance": scene.solver.tolerance,
        "check_flows": "boundary_flow" in scene.observe,
        "decades": step_decades(scene),
    }
