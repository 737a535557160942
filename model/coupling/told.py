"""What the stages that march are told: parts of a scene, and what each of their runs is to do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from demflow.model.controls import controls_of, sites
from demflow.model.flow.equation.sites import change_times
from demflow.model.scene import Bonds, Ground, JointLine, Matrix, Scene, Stress

LEG = 10  # outputs


class BreakingRock(NamedTuple):
    """The rock."""

    normal_stiffness: float  # k_n, Pa
    stiffness_ratio: float  # k_n / k_s
    friction: float
    bonds: Bonds
    joints: tuple[JointLine, ...]
    seed: int  # of the bonds' strengths
    stress: Stress
    ground: Ground | None = None  # weight in the fluid, and holes


class BreakingFluid(NamedTuple):
    """The fluid, the pipes of the matrix and the sides that keep a pressure."""

    viscosity: float  # Pa s
    bulk_modulus: float  # Pa
    matrix: Matrix
    initial: float  # Pa
    least_pressure: float | None  # Pa
    sides: tuple[tuple[str, float], ...]  # name, Pa
    largest_rate: float | None = None  # m³/s, of any well at any time; None where one has none


class Leg(NamedTuple):
    """What a run is to do."""

    start: float  # s
    end: float
    rates: tuple[float | None, ...]  # m³/s, of the wells; None where one keeps its pressure
    times: tuple[float, ...]  # s, of the outputs in it
    changes: bool  # a rate changes at its end


class Stretch(NamedTuple):
    """What a run of a march whose apertures follow forces is to do; nothing changes in it."""

    start: float  # s
    end: float
    rates: tuple[float, ...]  # m³/s, of each well at a rate
    loads: tuple[float, ...]  # Pa, on the right and on the top wall
    times: tuple[float, ...]  # s, of the outputs in it
    changes: bool  # a rate changes at its end


def march_legs(scene: Scene) -> tuple[Leg, ...]:
    """What the runs of a scene whose bonds break are to do, in order."""
    controls = controls_of(scene)
    changes = change_times(sites(controls.wells)).tolist()
    found = []
    for begin, end, times in _parts(changes, controls.times):
        rates = tuple(
            None if w.pressure is not None else _at(w.rate_changes, begin) for w in controls.drilled
        )
        found.append(Leg(begin, end, rates, times, end in changes))
    return tuple(found)


def stretches(scene: Scene) -> tuple[Stretch, ...]:
    """What the runs of a scene whose apertures follow forces are to do, in order."""
    controls = controls_of(scene)
    changes = change_times(sites(controls.wells)).tolist()
    rates = [w.rate_changes for w in controls.drilled if w.pressure is None]
    loads = scene.loads or ()
    every = sorted({*changes, *(t for one in (*rates, *loads) for t, _ in one)})
    found = []
    for begin, end, times in _parts(every, controls.times):
        flows, pressed = (tuple(_at(one, begin) for one in given) for given in (rates, loads))
        found.append(Stretch(begin, end, flows, pressed, times, end in changes))
    return tuple(found)


def _parts(
    changes: list[float], times: tuple[float, ...]
) -> Iterator[tuple[float, float, tuple[float, ...]]]:
    """Spans of time that end at a change or after LEG outputs, and the outputs in each."""
    begin = 0.0
    for end in [*[t for t in changes if 0.0 < t < times[-1]], times[-1]]:
        inside = [t for t in times if begin < t <= end]
        for first in range(0, max(len(inside), 1), LEG):
            some = tuple(inside[first : first + LEG])
            stop = end if first + LEG >= len(inside) else some[-1]
            yield begin, stop, some
            begin = stop


def _at(changes: tuple[tuple[float, float], ...], time: float) -> float:
    return next((q for t, q in reversed(changes) if t <= time), 0.0)
