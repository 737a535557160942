"""How much: the part of a scene that scales unit responses, and the steps of each source."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

from demflow.model.flow.equation.sites import InflowSite, Site, WellSite
from demflow.model.scene import InflowSide, InitialField, Scene, Well

Terminal = Well | InflowSide

Steps = list[list[tuple[float, float]]]  # of each source: time (s), size (Pa or m³/s)


class Controls(NamedTuple):
    """How much: the part of a scene that scales responses, in the order of the sources."""

    reference: float  # Pa, the pressure from which changes count
    initial: float  # Pa, of pores that no source reaches; NaN where none is one for all
    side_pressures: tuple[float, ...]  # Pa, of the sides at fixed pressure
    wells: tuple[Terminal, ...]  # and behind them the sides with an inflow, which act like one
    times: tuple[float, ...]  # s
    transient: bool
    start: str = "uniform"  # or gradient, steady: see `model.flow.solvers.registry.flow`
    gradient: tuple[float, float] = (0.0, 0.0)  # Pa/m, of a start from a gradient

    @property
    def drilled(self) -> tuple[Well, ...]:
        """The wells without the sides that act like one."""
        return tuple(well for well in self.wells if isinstance(well, Well))

    @property
    def fixed_pressures(self) -> tuple[float, ...]:
        """First pressures of the sides and wells that keep one, in the order of the sources, Pa."""
        return (*self.side_pressures, *(w.pressure_changes[0][1] for w in self.wells if w.held))

    @property
    def initial_weights(self) -> tuple[float, ...]:
        """How much of each unit initial field the start holds."""
        if self.start == "gradient":
            return self.gradient
        if self.start == "steady":
            return tuple(p - self.reference for p in self.fixed_pressures)
        return ()


def sites(wells: tuple[Terminal, ...]) -> tuple[Site, ...]:
    """What the flow stage may know of the wells: all but how much they produce."""
    return tuple(
        InflowSite(w.name, tuple(t for t, _ in w.rate_changes))
        if isinstance(w, InflowSide)
        else WellSite(
            name=w.name,
            at=w.at,
            radius=w.effective_radius,
            fixed_pressure=w.held,
            change_times=tuple(t for t, _ in w.rate_changes or w.pressure_changes[1:]),
            skin=max(w.skin_factor, 0.0),
            storage=w.wellbore_storage,
        )
        for w in wells
    )


def controls_of(scene: Scene) -> Controls:
    """The controls of a scene."""
    transient = scene.method != "steady"
    uniform = scene.uniform_pressure
    field = scene.initial_pressure
    held = [p for _, p in scene.held_sides]
    held += [w.pressure_changes[0][1] for w in scene.wells if w.held]
    reference = held[0] if held else 0.0
    gradient = (0.0, 0.0)
    if transient and uniform is not None:
        reference = uniform
    elif transient and isinstance(field, InitialField):
        reference, gradient = field.at_origin, field.gradient
    return Controls(
        reference,
        math.nan if uniform is None else uniform,
        tuple(p for _, p in scene.held_sides),
        (*scene.wells, *scene.inflow_sides),
        scene.times if transient else (),
        transient,
        scene.start,
        gradient,
    )


def active_sources(scene: Scene) -> tuple[bool, ...]:
    """Which sources act at all, in their order, as the stage `flow` takes them.

    All wells of a group do, whatever their rates: they share out the sum, and flow crosses from one
    to another where it is zero.
    """
    controls = controls_of(scene)
    rates = [any(q != 0.0 for _, q in w.rate_changes) for w in controls.wells if not w.held]
    for block in limited_blocks(controls.wells):
        if len(block.members) > 1:
            rates = [acts or k in block.members for k, acts in enumerate(rates)]
    fields = [g != 0.0 for g in controls.gradient] if controls.start == "gradient" else []
    first = len(controls.side_pressures)
    held = [p != controls.reference for p in controls.fixed_pressures[:first]]
    held += [
        any(p != controls.reference for _, p in w.pressure_changes)
        for w in controls.wells
        if w.held
    ]
    return (*held, *rates, *fields)


def step_decades(scene: Scene) -> tuple[int, ...] | None:
    """How large a step of each source is beside the first that acts, for the stage `flow`.

    Even powers of ten, in the order of the sources; 0 of those that do not act, None where one acts
    alone, or nothing goes on in time: what differs in the size of steps alone shares its responses,
    to within ten times either way.
    """
    controls, active = controls_of(scene), active_sources(scene)
    largest = [max((abs(size) for _, size in steps), default=0.0) for steps in step_sizes(controls)]
    largest += [abs(g) for g in controls.gradient] if controls.start == "gradient" else []
    acting = [size for size, acts in zip(largest, active, strict=True) if acts and size > 0.0]
    if len(acting) < 2 or not controls.transient:
        return None
    return tuple(
        2 * round(0.5 * math.log10(size / acting[0])) if acts and size > 0.0 else 0
        for size, acts in zip(largest, active, strict=True)
    )


class Block(NamedTuple):
    """Wells with one pressure, by their places among the wells at a rate."""

    members: tuple[int, ...]
    least: float  # Pa, −∞ without a limit
    largest: float  # Pa, ∞ without one


def limited_blocks(wells: tuple[Terminal, ...]) -> list[Block]:
    """Wells whose rate a limit of pressure may decide, and groups of those that share one."""
    groups: dict[tuple[str, str], list[int]] = {}
    rated = [wells[k] for k in at_rates(wells)]
    for number, well in enumerate(rated):
        if isinstance(well, Well) and well.decides:
            key = ("well", well.name) if well.group is None else ("group", well.group)
            groups.setdefault(key, []).append(number)
    blocks = []
    for members in groups.values():
        own = [well for k in members if isinstance(well := rated[k], Well)]
        least = [w.least_pressure for w in own if w.least_pressure is not None]
        largest = [w.largest_pressure for w in own if w.largest_pressure is not None]
        block = Block(tuple(members), max(least, default=-math.inf), min(largest, default=math.inf))
        blocks.append(block)
    return blocks


def at_rates(wells: tuple[Terminal, ...]) -> list[int]:
    """Numbers of the wells at a rate, in the order of their sources."""
    return [k for k, well in enumerate(wells) if not well.held]


def step_sizes(controls: Controls) -> Steps:
    """Steps (time in s, size) of every source: Pa for a fixed pressure, m³/s for a rate."""
    steps = [[(0.0, pressure - controls.reference)] for pressure in controls.fixed_pressures]
    if controls.start == "steady":  # they have acted for ever
        steps = [[] for _ in steps]
    held = [well for well in controls.wells if well.held]
    for own, well in zip(steps[len(controls.side_pressures) :], held, strict=True):
        changes = itertools.pairwise(well.pressure_changes)
        own += [(t, new - old) for (_, old), (t, new) in changes]
    for well in controls.wells:
        if not well.held:
            rates = [0.0, *(q for _, q in well.rate_changes)]
            steps.append(
                [(t, new - old) for (t, new), old in zip(well.rate_changes, rates, strict=False)]
            )
    return steps
