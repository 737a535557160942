"""How much: the part of a scene that scales unit responses, and the steps of each source."""

from __future__ import annotations

import math
from typing import NamedTuple

from demflow.model.flow.equation.sites import WellSite
from demflow.model.scene import InitialField, Scene, Well


class Controls(NamedTuple):
    """How much: the part of a scene that scales responses, in the order of the sources."""

    reference: float  # Pa, the pressure from which changes count
    initial: float  # Pa, of pores that no source reaches; NaN where none is one for all
    side_pressures: tuple[float, ...]  # Pa, of the sides at fixed pressure
    wells: tuple[Well, ...]
    times: tuple[float, ...]  # s
    transient: bool
    start: str = "uniform"  # or gradient, steady: see `model.flow.solvers.registry.flow`
    gradient: tuple[float, float] = (0.0, 0.0)  # Pa/m, of a start from a gradient

    @property
    def fixed_pressures(self) -> tuple[float, ...]:
        """Pressures of the sides and wells that keep one, in the order of the sources, Pa."""
        return (*self.side_pressures, *(w.pressure for w in self.wells if w.pressure is not None))

    @property
    def initial_weights(self) -> tuple[float, ...]:
        """How much of each unit initial field the start holds."""
        if self.start == "gradient":
            return self.gradient
        if self.start == "steady":
            return tuple(p - self.reference for p in self.fixed_pressures)
        return ()


def sites(wells: tuple[Well, ...]) -> tuple[WellSite, ...]:
    """What the flow stage may know of the wells: all but how much they produce."""
    return tuple(
        WellSite(
            name=w.name,
            at=w.at,
            radius=w.effective_radius,
            fixed_pressure=w.pressure is not None,
            change_times=tuple(t for t, _ in w.rate_changes),
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
    held = [p for _, p in scene.boundaries]
    held += [w.pressure for w in scene.wells if w.pressure is not None]
    reference = held[0] if held else 0.0
    gradient = (0.0, 0.0)
    if transient and uniform is not None:
        reference = uniform
    elif transient and isinstance(field, InitialField):
        reference, gradient = field.at_origin, field.gradient
    return Controls(
        reference,
        math.nan if uniform is None else uniform,
        tuple(p for _, p in scene.boundaries),
        scene.wells,
        scene.times if transient else (),
        transient,
        scene.start,
        gradient,
    )


def active_sources(scene: Scene) -> tuple[bool, ...]:
    """Which sources act at all, in their order, as the stage `flow` takes them."""
    controls = controls_of(scene)
    rates = [any(q != 0.0 for _, q in w.rate_changes) for w in controls.wells if w.pressure is None]
    fields = [g != 0.0 for g in controls.gradient] if controls.start == "gradient" else []
    return (*(p != controls.reference for p in controls.fixed_pressures), *rates, *fields)


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


def step_sizes(controls: Controls) -> list[list[tuple[float, float]]]:
    """Steps (time in s, size) of every source: Pa for a fixed pressure, m³/s for a rate."""
    steps = [[(0.0, pressure - controls.reference)] for pressure in controls.fixed_pressures]
    if controls.start == "steady":  # they have acted for ever
        steps = [[] for _ in steps]
    for well in controls.wells:
        if well.pressure is None:
            rates = [0.0, *(q for _, q in well.rate_changes)]
            steps.append(
                [(t, new - old) for (t, new), old in zip(well.rate_changes, rates, strict=False)]
            )
    return steps
