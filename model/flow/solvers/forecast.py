"""The predicted time of each solver at the wanted accuracy, and the cheapest that delivers it.

Times are those of one core of a common machine, fitted to runs on random networks; what
counts is their ratio. Each model takes the sizes that rule its solver: unknowns, sources,
vectors or steps. A solver without error control qualifies only where a bound says that it
delivers the tolerance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.algebraic import Algebraic, algebraic
from demflow.model.flow.equation.problem import FAINT, Answer, Problem
from demflow.model.flow.solvers.explicit import SECONDS_PER_UPDATE, step_limit

EULER = 0.648  # the largest value of z² / (e^z − 1)
FIELD = 16.0 * math.exp(-2.0)  # the largest value of z² e^(−z/2)

# Seconds: ordering, a factor and a solve of n unknowns, and what each vector or step costs
# besides. The powers are those of planar graphs under a minimum-degree order.
ORDER, FACTOR, SOLVE = (4.5e-7, 1.08), (2.5e-8, 1.25), (9e-9, 1.15)
START = 1e-3
VECTOR = 1.5e-4
STAGE = 2e-5

# Where explicit's error is told from its answer: the steps to the first lag and the ratio of two
# lags that this needs, and how much larger it is taken.
FEW_STEPS, DENSE, CAUTION = 10.0, 1.5, 2.0


class Forecast(NamedTuple):
    """What a solver is predicted to take, and the step of one that needs to be told."""

    seconds: float  # infinite where it does not deliver the tolerance
    safety_factor: float | None = None
    proven: bool = True  # else the answer has to be looked at, see `euler_error`


class Course(NamedTuple):
    """How fast the responses of the sources bend, the worst of all."""

    error_rate: float  # of forward Euler, over half its step, 1/s; of a source's own response
    field_rate: float  # the same of any pore's


def course(problem: Problem) -> Course:
    """What every forecast needs to know."""
    if not math.isfinite(problem.lag[-1]):  # the steady state alone
        return Course(0.0, 0.0)
    wells = algebraic(problem.system)
    found = [_course(problem, k, wells) for k in problem.active_sources]
    return Course(
        max((one.error_rate for one in found), default=0.0),
        max((one.field_rate for one in found), default=0.0),
    )


def _power(law: tuple[float, float], n: int) -> float:
    found: float = law[0] * n ** law[1]
    return found


def _window(problem: Problem) -> tuple[float, float, float]:
    """First and last lag above zero, s, and the decades between."""
    lag = problem.lag[problem.lag > 0.0]
    if not len(lag):
        return 1.0, 1.0, 0.0
    return float(lag[0]), float(lag[-1]), math.log10(lag[-1] / lag[0])


def krylov_forecast(problem: Problem, course: Course) -> Forecast:
    """Two factors, and vectors by the decades that have settled and the digits asked for.

    Fitted, as the steps of implicit are, to random networks of 1e3 to 4e4 pores: within some 30 %.
    A small network has few modes, and a well's own response is found to twice the digits at
    which the field is known, its error being a square.
    """
    n, sources = problem.system.n, len(problem.active_sources)
    _, last, _ = _window(problem)
    settled = min(2.0 * math.log10(1.0 + course.error_rate * last), 0.62 * n**0.28)
    far = any(problem.far(k) for k in problem.active_sources)
    vectors = 5.0 - math.log10(problem.tolerance) * settled * (1.0 if far else 0.5)
    maps = len(problem.domain) * (vectors * 1e-8 + len(problem.lag) * vectors * 4e-10)
    each = _power(SOLVE, n) + VECTOR + vectors * (8e-6 + n * 5e-10) + len(problem.lag) * 1e-6
    common = START + _power(ORDER, n) + 2.0 * _power(FACTOR, n)
    return Forecast(common + sources * (vectors * each + maps))


def implicit_forecast(problem: Problem, course: Course) -> Forecast:
    """Steps of a fourth-order method while modes settle, and a factor for each octave of time."""
    n, sources = problem.system.n, len(problem.active_sources)
    _, last, decades = _window(problem)
    settled = 0.85 * math.log10(1.0 + 6.0 * course.error_rate * last)
    if len(problem.domain) or problem.flows_count:
        settled *= 1.6  # they bend more than pressures do
    steps = 2.4 + settled * (1.3 + problem.tolerance**-0.25)
    factors = min(3.3 * (decades + 2.0), steps)
    maps = len(problem.domain) * len(problem.lag) * 4e-9
    each = 5.0 * (_power(SOLVE, n) + STAGE + n * 1e-8)
    common = START + _power(ORDER, n) + factors * _power(FACTOR, n)
    return Forecast(common + sources * (steps * each + maps))


def explicit_forecast(problem: Problem, course: Course) -> Forecast:
    """Steps of forward Euler, short enough for the tolerance at every lag.

    With steps Δt ≪ t the response of a mode of decay rate λ is off by (Δt / 2) λt e^(−λt). A
    source's own response is a sum of modes with positive weights, growing as (1 − e^(−z)) / λ
    with z = λt, and of what answers at once. Its relative error is then at most
    (Δt / 2t) max z² / (e^z − 1), and at most Δt / 2 times the mean rate at which its modes
    start to settle, by their share in the response. The smaller counts.

    Far from the source no sum has weights of one sign. The inflow of a fixed pressure is one
    that falls: off by at most (Δt / 2t) max z² e^(−z/2) of what it was at t / 2. A field keeps
    the source's own bound in the norm of the volume; in single pores of random networks the
    error came to twice that, which is below the flow's. And as no step enlarges the largest
    difference of pressure, no pore is ever off by more than (Δt / 2) t max |d²p/dt²| at the start.
    """
    system, lags = problem.system, len(problem.lag)
    first, last, _ = _window(problem)
    if course.error_rate == 0.0:
        return Forecast(math.inf)
    far = any(problem.far(k) for k in problem.active_sources)
    near = 2.0 * problem.tolerance / min(course.error_rate, EULER / first)
    step = near
    if far:
        rate = FIELD / first
        if not problem.flows_count:
            rate = min(rate, course.field_rate)
        step = min(near, 2.0 * problem.tolerance / rate)
    hoped = min(near, first / FEW_STEPS)
    proven = hoped <= step or not _lies_apart(problem)
    if not proven:
        step = hoped
    limit = step_limit(system)
    safety = min(problem.safety_factor, 1.0, step / limit)
    steps = last / (safety * limit) + lags
    march = steps * (system.n * SECONDS_PER_UPDATE + 1e-7) + lags * (1.4e-5 + system.n * 4e-9)
    start = START + system.n * 6e-7
    return Forecast(start + len(problem.active_sources) * march, safety, proven)


def _lies_apart(problem: Problem) -> bool:
    """Whether what is recorded has hardly moved, likely, and lags tell how it bends.

    In so short a window that explicit pays, a source has seldom come to other wells and sides, nor
    a well to a probe. Some pore of a map has always moved.
    """
    lag = problem.lag[problem.lag > 0.0]
    if len(problem.domain) or len(lag) < 3 or np.any(lag[1:] > DENSE * lag[:-1]):
        return False
    probes = problem.records.rows.shape[0] - problem.records.well_rows - problem.records.flow_rows
    return probes == 0 or all(problem.own_well(k) is not None for k in problem.active_sources)


def euler_error(problem: Problem, answer: Answer) -> float:
    """Relative error of explicit's outputs as their second differences tell it.

    It is (Δt / 2) t d²p/dt² to leading order. Lags have to be `DENSE`, the first `FEW_STEPS` off.
    """
    step = problem.safety_factor * step_limit(problem.system)
    later = problem.lag > 0.0
    t = problem.lag[later, None]
    worst = 0.0
    for source in problem.active_sources:
        output = answer.output[source, later]
        slope = np.diff(output, axis=0) / np.diff(t, axis=0)
        bend = 2.0 * np.diff(slope, axis=0) / (t[2:] - t[:-2])
        bend = t * np.abs(np.concatenate([bend[:1], bend, bend[-1:]]))
        size = problem.scale(source, output)
        counts = size > 0.0
        worst = max(worst, float(np.max(bend[counts] / size[counts], initial=0.0)))
    return CAUTION * 0.5 * step * worst


def _course(problem: Problem, source: int, wells: Algebraic) -> Course:
    """The modes' mean decay, by their share in the response, and a bound for any pore.

    At once come the pressure of a well that stores nothing and the flow from a fixed pressure.
    A pore's error is compared with the largest pressure of the map, or with what counts of that
    of the source (`Problem.scale`).
    """
    system, rhs = problem.system, problem.system.source(source)
    _, last, _ = _window(problem)
    load = wells.reduce_source(rhs)
    start = load / system.storage[: system.pores]  # of dp/dt
    grows = float(load @ start)  # of the source's own response, per second
    if grows == 0.0:
        return Course(0.0, 0.0)
    net = -system.net_inflow(wells.lift(start))[: system.pores]
    decay = float(start @ net) / grows
    at_once = abs(float(rhs[system.pores :] @ wells.direct(rhs)))
    # the mean pore at the source has come to at least so much at last
    moved = -grows * math.expm1(-decay * last) / decay if decay > 0.0 else grows * last
    bend = float(np.max(np.abs(net / system.storage[: system.pores])))
    if len(problem.domain):
        largest = moved / float(np.abs(load).sum())
    elif source < system.fixed_count:
        largest = FAINT
    else:
        largest = FAINT * (at_once + moved) if problem.own_well(source) is not None else 0.0
    if source < system.fixed_count:
        at_once = abs(float(problem.records.direct[source, problem.records.well_rows + source]))
    share = min(1.0, grows * last / at_once) if at_once > 0.0 else 1.0
    return Course(decay * share, bend * last / largest if largest > 0.0 else math.inf)


def steady_forecast(problem: Problem, _course: Course) -> Forecast:
    """One factor, one solve for each source."""
    n = problem.system.n
    each = len(problem.active_sources) * _power(SOLVE, n)
    return Forecast(START + _power(ORDER, n) + _power(FACTOR, n) + each)
