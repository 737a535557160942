"""Transients by an adaptive, L-stable Runge–Kutta method, its factors reused.

ESDIRK4(3)6L[2]SA of Kennedy & Carpenter (2003), Appl. Numer. Math. 44, 139–181: fourth
order, every implicit stage with one matrix G + C / (γ h), stiffly accurate, so that wells
without storage, which are algebraic rows, hold at the end of each step. Steps are taken
from a ladder of fixed ratio, so that a factor serves many steps and every source.

What is recorded within a step is a mixture of its stages, `weights_at`. The slope at a step's
start takes no part in it: a pore that stores next to nothing keeps a trace of an old imbalance
there, harmless in its pressure and enormous in its rate.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from demflow.model.compile import Array, kernel
from demflow.model.flow.equation.algebraic import Algebraic, algebraic
from demflow.model.flow.equation.balance import transient_misfit
from demflow.model.flow.equation.outputs import map_rows
from demflow.model.flow.equation.problem import (
    Answer,
    Problem,
    empty_answer,
    fill_map,
    flow_noise,
)
from demflow.model.flow.equation.system import System
from demflow.model.flow.linear.factor import Factor, Symbolic, analyse, factorise, substitute
from demflow.model.flow.solvers.krylov import rough
from demflow.model.flow.solvers.share import shared_out
from demflow.model.outcome import ModelError

GAMMA = 0.25  # the diagonal of the implicit stages
STAGES = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 4, 1 / 4, 0, 0, 0, 0],
        [8611 / 62500, -1743 / 31250, 1 / 4, 0, 0, 0],
        [5012029 / 34652500, -654441 / 2922500, 174375 / 388108, 1 / 4, 0, 0],
        [
            15267082809 / 155376265600,
            -71443401 / 120774400,
            730878875 / 902184768,
            2285395 / 8070912,
            1 / 4,
            0,
        ],
        [82889 / 524892, 0, 15625 / 83664, 69875 / 102672, -2260 / 8211, 1 / 4],
    ]
)
WEIGHTS = STAGES[-1]
EMBEDDED = np.array(
    [
        4586570599 / 29645900160,
        0,
        178811875 / 945068544,
        814220225 / 1159782912,
        -3700637 / 11593932,
        61727 / 225920,
    ]
)
ESTIMATE = WEIGHTS - EMBEDDED

RUNGS_PER_OCTAVE = 1  # steps are 2^k s

# Local error of a step, as the embedded method sees it, over the tolerance to the power of
# 9/8. The estimate is of the order of the step to the fourth power, as the error gathered over
# a decade of time is; the steps of a decade, whose number goes with the tolerance to the power
# of -1/4, add up as the square root of their number.
LOCAL_SHARE = 0.45

SAFETY = 0.9
LEAST_GROWTH, MOST_GROWTH = 0.1, 4.0
LEAST_STEP = 2.0**-40  # of the first step: an error that lasts there is round-off
MOST_STEPS = 200_000

# Part of the largest flow below which a boundary's own flow no longer counts.
FAINT = 0.1

# Part of its share in a sum that a source may use: errors of one step do not go on into the next as
# those of the response do, and the derivative by ln t of a difference enlarges them.
DERIVED = 0.5

# In the fit of what lies within a step: the least error that counts, and how much size costs.
LEAST_ERROR, RIDGE = 1e-6, 1e-2

# Memory that kept factors may take, bytes.
CACHE_BYTES = 1 << 29


class State(NamedTuple):
    """Where a march stands."""

    time: float  # s
    pressure: np.ndarray  # (n,)
    rate: np.ndarray  # (n,) dp/dt
    volume: np.ndarray  # (fixed,) let in by each fixed pressure so far
    missing: float = 0.0  # m³ that were out of balance so far, before that was mended


class Step(NamedTuple):
    """One step: values and increments h dp/dt at its stages."""

    size: float  # s
    value: np.ndarray  # (6, n)
    increment: np.ndarray  # (6, n)
    missing: float  # m³ out of balance in its stages, before that was mended


class Ladder:
    """Factors of G + C / (γ h) for the steps of a ladder, made when first asked for."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.symbolic: Symbolic = analyse(system.n, system.edge_i, system.edge_j)
        self.made = 0
        self._kept: dict[int, Factor] = {}
        self._most = max(4, CACHE_BYTES // max(1, self.symbolic.factor_bytes))

    @staticmethod
    def rung(step: float) -> int:
        """The highest rung whose step is not longer than this."""
        return math.floor(RUNGS_PER_OCTAVE * math.log2(step) + 1e-9)

    @staticmethod
    def step(rung: int) -> float:
        """Length of a rung's step, s."""
        return float(2.0 ** (rung / RUNGS_PER_OCTAVE))

    @staticmethod
    def shift(rung: int) -> float:
        """The s of a rung's matrix G + s C, 1/s."""
        return 1.0 / (GAMMA * Ladder.step(rung))

    def factor(self, rung: int) -> Factor:
        """Factor for the step of a rung; the oldest goes where memory runs short."""
        if rung not in self._kept:
            if len(self._kept) >= self._most:
                del self._kept[next(iter(self._kept))]
            excess = self.system.excess + self.shift(rung) * self.system.storage
            self._kept[rung] = factorise(self.symbolic, self.system.edge_g, excess)
            self.made += 1
        return self._kept[rung]


def implicit(problem: Problem) -> Answer:
    """March every active source through the lags under error control.

    Raises `ModelError` where `MOST_STEPS` steps do not reach the last lag, or where no step is
    short enough for the tolerance.
    """
    problem = shared_out(problem, rough)
    system = problem.system
    wells = algebraic(system)
    ladder = Ladder(system)
    answer = empty_answer(problem)
    error = residual = 0.0
    work = 0
    for k in problem.active_sources:
        estimate, last, rung, solves = _march(problem, k, wells, ladder, answer)
        noise = flow_noise(problem, k, answer.output[k])
        error = max(error, estimate, noise)
        shift, factor = ladder.shift(rung), ladder.factor(rung)
        misfit = transient_misfit(system, factor, shift, k, last.pressure, last.rate)
        residual = float(np.maximum(residual, misfit))
        work += solves
    return answer._replace(time_error=error, residual=residual, work=work + ladder.made)


def initial_state(system: System, wells: Algebraic, rhs: np.ndarray) -> State:
    """Pores at rest; wells follow the source and the pores at once.

    Parameters
    ----------
    system : the flow equation C dp/dt = −G p + f
    wells : the unknowns without storage
    rhs : f (n,), m³/s
    """
    pores = system.pores
    pressure = np.zeros(system.n)
    pressure[pores:] = wells.direct(rhs)
    rate = wells.lift(wells.reduce_source(rhs) / system.storage[:pores])
    return State(0.0, pressure, rate, np.zeros(system.fixed_count))


def take_step(system: System, factor: Factor, rhs: np.ndarray, state: State, size: float) -> Step:
    """Stages of one step of `size` s, whose matrix G + C / (γ h) is factored.

    The increments come from differences of stage values, not from f − G p, whose round-off
    a stiff pore would magnify. Every stage is brought back into balance (`_rebalance`).

    Parameters
    ----------
    system : the flow equation C dp/dt = −G p + f
    factor : that of G + C / (γ h)
    rhs : f (n,), m³/s
    state : pressures before
    size : h, s
    """
    equation = system.storage, system.excess, rhs
    value, increment, missing = _stages(
        *factor.parts, factor.symbolic.order, STAGES, *equation, state.pressure, state.rate, size
    )
    return Step(size, value, increment, missing)


@kernel
def _stages(
    first: Array,
    row_start: Array,
    row: Array,
    place: Array,
    lower: Array,
    pivot: Array,
    order: Array,
    table: Array,
    storage: Array,
    excess: Array,
    rhs: Array,
    pressure: Array,
    rate: Array,
    size: float,
) -> tuple[Array, Array, float]:
    """Values and increments of all stages, and m³ out of balance; see `take_step`."""
    n, count, gamma = pressure.size, len(table), table[-1, -1]
    value, increment = np.empty((count, n)), np.empty((count, n))
    scaled, drain = np.empty(n), np.empty(n)
    known, right, x = np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        scaled[k] = storage[k] / (gamma * size)
        drain[k] = excess[k] + scaled[k]
        value[0, k] = pressure[k]
        increment[0, k] = size * rate[k]
    missing = 0.0
    for i in range(1, count):
        known[:] = pressure
        for j in range(i):
            a = table[i, j]
            for k in range(n):
                known[k] += a * increment[j, k]
        for k in range(n):
            right[k] = rhs[k] + scaled[k] * known[k]
        for k in range(n):
            x[k] = right[order[k]]
        substitute(first, row_start, row, place, lower, pivot, x)
        for k in range(n):
            value[i, order[k]] = x[k]
        missing = max(missing, size * abs(_rebalance(value[i], drain, right)))
        for k in range(n):
            increment[i, k] = (value[i, k] - known[k]) / gamma
    return value, increment, missing


@kernel
def _rebalance(value: Array, drain: Array, right: Array) -> float:
    """Have the sum over all equations, the volume balance, hold to round-off; what was missing.

    The errors of a factor lean one way, so that what a march stores would part from what it lets
    in; the last digits of every value (n,), in proportion to it, make up for that. `drain` (n,) are
    the sums of the matrix's columns, `right` (n,) is the right-hand side, m³/s.
    """
    n = value.size
    missing = size = 0.0
    for begin in range(0, n, 64):  # sums of sums, which lose fewer digits
        some_missing = some_size = 0.0
        for k in range(begin, min(begin + 64, n)):
            held = drain[k] * value[k]
            some_missing += right[k] - held
            some_size += abs(held)
        missing += some_missing
        size += some_size
    if size > 0.0:
        for k in range(n):
            value[k] += missing / size * abs(value[k])
    return missing


class Within(NamedTuple):
    """What mixes the stages of a step, see `weights_at`."""

    decay: np.ndarray  # (z,) rates λ h
    from_decay: np.ndarray  # (7, z)
    from_moments: np.ndarray  # (7, 4)
    conditions: np.ndarray  # (4, 7) of third order, on the moments 1, t, t² / 2, t³ / 3
    kept: np.ndarray  # (7, 4) their pseudo-inverse


@cache
def _within() -> Within:
    """Least squares over decay rates, under the conditions of third order."""
    decay = np.logspace(-2.0, 6.0, 321)
    ones, node = np.ones(len(STAGES)), STAGES.sum(axis=1)
    matrices = np.eye(len(STAGES)) + decay[:, None, None] * STAGES
    value = np.linalg.solve(matrices, ones[:, None])[..., 0]
    seen = np.maximum(np.abs(value @ ESTIMATE) * decay, LEAST_ERROR)
    mixed = np.column_stack([value, -decay * value[:, -1]]) / seen[:, None]
    slope = [0.0, 1.0, 1.0, 1.0]  # of 1, t, t² / 2, t³ / 3 at the end
    conditions = np.column_stack([[ones, node, STAGES @ node, STAGES @ node**2], slope])
    kept = np.linalg.pinv(conditions)
    free = np.linalg.svd(conditions)[2][len(conditions) :].T
    # two mixtures of the stages are nearly the same: of these the smaller
    ridge = RIDGE * np.sqrt(len(decay))
    found = free @ np.linalg.pinv(np.vstack([mixed @ free, ridge * free]))
    at_decay, at_size = found[:, : len(decay)], found[:, len(decay) :]
    return Within(
        decay=decay,
        from_decay=at_decay / seen,
        from_moments=kept - (at_decay @ mixed + ridge * at_size) @ kept,
        conditions=conditions,
        kept=kept,
    )


def weights_at(part: float) -> tuple[np.ndarray, np.ndarray]:
    """Mixture of a step's stages that gives the pressure after a part 0 … 1 of the step.

    Weights (7,) of the values of the six stages and of the last increment; and the same as
    weights (6,) of all increments, which give what was let in. Of third order for slow decays;
    for those that the step is too long to follow, chosen by least squares such that the error of
    e^(−λt) is small beside the error which the embedded method sees in the step: at most 4 times
    it within, 5 times at the end, whatever the rate. Error control of the step thus covers what
    lies within.
    """
    if part >= 1.0:
        return np.eye(len(STAGES) + 1)[len(STAGES) - 1], WEIGHTS
    within = _within()
    moments = np.array([1.0, part, part**2 / 2.0, part**3 / 3.0])
    values = within.from_moments @ moments + within.from_decay @ np.exp(-part * within.decay)
    values += within.kept @ (moments - within.conditions @ values)  # volume, to the last digit
    increments = values[:-1] @ STAGES
    increments[-1] += values[-1]
    return values, increments


def _march(
    problem: Problem, source: int, wells: Algebraic, ladder: Ladder, answer: Answer
) -> tuple[float, State, int, int]:
    """Fill one source's part of the answer (in place); error estimate, end, last rung, solves."""
    system, lags = problem.system, problem.lag
    rhs = system.source(source)
    gauge = _Gauge(problem, source)
    state = initial_state(system, wells, rhs)
    rung = last = ladder.rung(_first_step(problem, state))
    shortest = LEAST_STEP * ladder.step(rung)
    share = LOCAL_SHARE * problem.tolerance**0.125
    allowed = share * problem.tolerance
    worst, tried, done = 0.0, 0, 0
    least = math.inf  # error of the steps tried from the present state
    done = _reach(problem, source, state, None, done, answer)
    while done < len(lags):
        tried += 1
        if tried > MOST_STEPS:
            raise ModelError(
                f"implicit came to {state.time:.3g} s of {lags[-1]:.3g} s in {MOST_STEPS} steps; "
                "raise solver.tolerance, or use solver.method krylov"
            )
        size = ladder.step(rung)
        if size < max(shortest, np.finfo(float).eps * state.time):
            raise ModelError(
                f"implicit cannot keep a tolerance of {problem.tolerance:g} at {state.time:.3g} s: "
                f"however short the step, its error comes to {least / share:.1g}; raise "
                "solver.tolerance above that, or use solver.method krylov"
            )
        step = take_step(system, ladder.factor(rung), rhs, state, size)
        error = gauge.relative(ESTIMATE @ step.increment, step.value[-1], state.time + size)
        growth = MOST_GROWTH if error == 0.0 else SAFETY * (allowed / error) ** 0.25
        growth = min(max(growth, LEAST_GROWTH), MOST_GROWTH)
        least = min(least, error)
        if error > allowed:
            rung = min(rung - 1, ladder.rung(size * growth))
            continue
        worst, least = max(worst, error / share), math.inf
        gauge.accept(step.value[-1], state.time + size)
        done = _reach(problem, source, state, step, done, answer)
        state = State(
            state.time + size,
            step.value[-1],
            step.increment[-1] / size,
            state.volume + _let_in(problem, source, step, WEIGHTS),
            state.missing + step.missing,
        )
        last, rung = rung, ladder.rung(size * growth)
    return worst, state, last, tried * (len(STAGES) - 1)


def _first_step(problem: Problem, state: State) -> float:
    """Step in which the pressure changes by about the fourth root of the tolerance, s."""
    last = problem.lag[-1]
    change = np.abs(state.rate).max(initial=0.0)
    size = np.abs(state.pressure).max(initial=0.0)
    if change == 0.0:
        return float(last) or 1.0
    return float(min(last or 1.0, problem.tolerance**0.25 * (size or 1.0) / change))


def _reach(
    problem: Problem,
    source: int,
    state: State,
    step: Step | None,
    done: int,
    answer: Answer,
) -> int:
    """Record the lags up to the end of a step (none: the present); how many are done."""
    records, system = problem.records, problem.system
    end = state.time + (step.size if step else 0.0)
    while done < len(problem.lag) and problem.lag[done] <= end:
        pressure, volume = state.pressure, state.volume
        if step:
            values, weights = weights_at(float((problem.lag[done] - state.time) / step.size))
            pressure = values[:-1] @ step.value + values[-1] * step.increment[-1]
            volume = volume + _let_in(problem, source, step, weights)
        answer.output[source, done] = records.rows @ pressure + records.direct[source]
        answer.cumulative[source, done] = np.append(volume, system.storage @ pressure)
        answer.missing[source, done] = state.missing + (step.missing if step else 0.0)
        if len(problem.domain):
            answer.pressure[source, done] = fill_map(problem, source, pressure[None])[0]
        done += 1
    return done


def _let_in(problem: Problem, source: int, step: Step, weights: np.ndarray) -> np.ndarray:
    """Volume that each fixed pressure lets in over the weighted stages, (fixed,) m³."""
    records = problem.records
    flows = slice(records.well_rows, records.well_rows + records.flow_rows)
    mean = _times(*_rows_of(records.rows), weights @ step.value)
    found: np.ndarray = step.size * (mean + weights.sum() * records.direct[source])[flows]
    return found


class _Gauge:
    """Relative size of an error of the pressure.

    Pressures count against the largest pressure change; by the maximum principle that is
    the source's own. Those of a map count against the largest of the map too, which a well
    that stores nothing may leave far behind. Where several sources act, or flows are recorded
    elsewhere than at the source, every output counts as `Problem.share` says. A source's own
    flow alone counts against the largest that it has been since the first lag.
    """

    def __init__(self, problem: Problem, source: int) -> None:
        records = problem.records
        self.lag = problem.lag
        self.first = problem.lag[problem.lag > 0][0] if problem.lag.any() else 0.0
        flows = slice(records.well_rows, records.well_rows + records.flow_rows)
        self.rows = _rows_of(records.rows)
        self.flow_rows = _rows_of(records.rows[flows])
        self.direct = records.direct[source][flows]
        self.check_flows = problem.check_flows and problem.share is None
        share = problem.share
        self.share = None if share is None else DERIVED * share.output[source]
        self.least_pressure, self.least_flow = problem.own_size(source)
        self.seen = np.zeros(len(self.direct))
        node, fixed = map_rows(problem.system, problem.domain)
        self.mapped = node[node >= 0]
        self.least_mapped = float(np.any(fixed == source))

    def accept(self, pressure: np.ndarray, time: float) -> None:
        """Remember the flows from the first lag on."""
        if self.check_flows and time >= self.first:
            self.seen = np.maximum(
                self.seen, np.abs(_times(*self.flow_rows, pressure) + self.direct)
            )

    def relative(self, error: np.ndarray, pressure: np.ndarray, time: float) -> float:
        """The error (n,) against the pressure (n,) and the flows that it goes with at a time.

        Infinity where either is no finite number.
        """
        mapped, off, size = self.mapped, _largest(error), _largest(pressure)
        if not (off < math.inf and size < math.inf):
            return math.inf
        worst = _over(off, max(size, self.least_pressure))
        if len(mapped):
            size = max(_largest(pressure[mapped]), self.least_mapped)
            worst = max(worst, _over(_largest(error[mapped]), size))
        if self.share is not None:
            sizes = self.share[min(int(np.searchsorted(self.lag, time)), len(self.lag) - 1)]
            return max(worst, _worst(_times(*self.rows, error), sizes))
        if not self.check_flows:
            return worst
        flow = np.maximum(self.seen, np.abs(_times(*self.flow_rows, pressure) + self.direct))
        flow = np.maximum(flow, FAINT * flow.max(initial=self.least_flow))
        return max(worst, _worst(_times(*self.flow_rows, error), flow))


def _over(error: float, size: float) -> float:
    """An error over a size, 0 where there is none."""
    return error / size if size > 0.0 else 0.0


def _rows_of(matrix: csr_array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What kernels are given of a sparse matrix."""
    return matrix.indptr, matrix.indices, matrix.data


@kernel
def _times(start: Array, column: Array, value: Array, x: Array) -> Array:
    """A sparse matrix (o, n), given by its rows, times x (n,)."""
    found = np.zeros(len(start) - 1)
    for o in range(len(found)):
        for k in range(start[o], start[o + 1]):
            found[o] += value[k] * x[column[k]]
    return found


@kernel
def _largest(values: Array) -> float:
    """The largest of them (n,) whatever its sign, infinity where one is no finite number."""
    found = 0.0
    for value in values:
        if not np.isfinite(value):
            return np.inf
        found = max(found, abs(value))
    return found


@kernel
def _worst(error: Array, size: Array) -> float:
    """The largest error (o,) over the size (o,) it goes with, of those that have one."""
    found = 0.0
    for o in range(len(size)):
        if size[o] > 0.0:
            found = max(found, abs(error[o]) / size[o])
    return found
