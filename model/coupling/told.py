"""What the stage *fracture* is told: parts of a scene, and what each of its runs is to do."""

from __future__ import annotations

from typing import NamedTuple

from demflow.model.controls import controls_of, sites
from demflow.model.flow.equation.sites import change_times
from demflow.model.scene import Bonds, JointLine, Matrix, Scene, Stress

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


class BreakingFluid(NamedTuple):
    """The fluid, the pipes of the matrix and the sides that keep a pressure."""

    viscosity: float  # Pa s
    bulk_modulus: float  # Pa
    matrix: Matrix
    initial: float  # Pa
    least_pressure: float | None  # Pa
    sides: tuple[tuple[str, float], ...]  # name, Pa


class Leg(NamedTuple):
    """What a run is to do."""

    start: float  # s
    end: float
    rates: tuple[float | None, ...]  # m³/s, of the wells; None where one keeps its pressure
    times: tuple[float, ...]  # s, of the outputs in it
    changes: bool  # a rate changes at its end


def march_legs(scene: Scene) -> tuple[Leg, ...]:
    """What the runs of a scene are to do, in order."""
    controls = controls_of(scene)
    changes = [t for t in change_times(sites(controls.wells)).tolist() if t > 0.0]
    last = controls.times[-1]
    found: list[Leg] = []
    begin = 0.0
    for end in [*[t for t in changes if t < last], last]:
        rates = tuple(
            None if w.pressure is not None else _rate(w.rate_changes, begin)
            for w in controls.drilled
        )
        times = [t for t in controls.times if begin < t <= end]
        for first in range(0, max(len(times), 1), LEG):
            some = tuple(times[first : first + LEG])
            ends_it = first + LEG >= len(times)
            stop = end if ends_it else some[-1]
            found.append(Leg(begin, stop, rates, some, ends_it and end in changes))
            begin = stop
    return tuple(found)


def _rate(changes: tuple[tuple[float, float], ...], time: float) -> float:
    return next((q for t, q in reversed(changes) if t <= time), 0.0)
