"""Transients by rational Krylov projection: a few factorisations for all times at once.

The pores obey C dp/dt = −G p + f with p(0) = 0. On a `Subspace` of shift-and-invert images
the Galerkin projection is solved exactly in time through its eigenvalues (Güttel 2013,
GAMM-Mitt. 36). A factor costs as much as many solves, so that two poles, each used again
and again, serve most windows of time: one at its slow end, whose images are nearly steady
states, and one near its fast end.

The error is estimated from how the recorded outputs move while the space grows. The change
over a few vectors is the error that the space had before them; a reduction as slow as the
slowest of late gives the error that it has now.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from demflow.model.compile import Array, kernel
from demflow.model.flow.equation.algebraic import algebraic
from demflow.model.flow.equation.balance import steady_flow, transient_misfit
from demflow.model.flow.equation.problem import (
    LOST,
    Answer,
    Problem,
    empty_answer,
    fill_map,
    fill_maps,
    flow_noise,
)
from demflow.model.flow.equation.system import System
from demflow.model.flow.linear.factor import Factor, Symbolic, analyse, factorise
from demflow.model.flow.solvers.share import Rough, shared_out, told
from demflow.model.flow.solvers.subspace import MOST_VECTORS, Basis, Subspace
from demflow.model.network.connectivity import reached
from demflow.model.outcome import ModelError


class Tuning(NamedTuple):
    """What a space is grown by; no result depends on it but within its error."""

    # poles
    poles: int = 2  # used in turn; what one of them adds says nothing of the other
    ladder: float = 2.0  # poles are powers of this, that sources may share their factors
    above: float = 2.0  # the fast pole lies above the fast end of the window by this times …
    slope: float = 0.25  # … the window's width to this power: lower the wider the window is

    # estimate of the error
    shortest: int = 3  # vectors before the first estimate
    widths: tuple[int, ...] = (1, 2, 3, 5)  # vectors over which changes are taken; the worst counts
    late: int = 8  # sizes over which the slowest reduction counts: errors fall by stairs at times
    caution: float = 2.5  # reductions are not even; the estimate is taken this much larger
    fall: float = 0.1  # an estimate is at least this part of the one before: stairs again
    lag_checks: int = 6  # lags of a decade at which outputs are compared, …
    map_checks: int = 8  # … and of all these at which maps are; errors change slowly in time

    # when to estimate
    stride: float = 0.3  # part of the way to the tolerance, at the rate seen, between estimates …
    most_wait: int = 4  # … that cost as much as several vectors, and the most vectors between them
    few_pores: int = 2000  # up to which an estimate costs little more than a vector

    # round-off
    noise_share: float = 0.5  # that the projection may have, of the tolerance; what is found is a
    # tenth of it
    last_noise: float = 1e-3  # the same for the answer, which keeps volume and is differentiated
    load_noise: float = 1e-2  # that the load of a slow mode may have, of the tolerance: beyond, the
    # space of a fixed pressure starts from the steady state, …
    least_load_noise: float = 1e-8  # … and beyond this: a window that is short beside the slow
    # modes is better served by the source
    idle: int = 12  # vectors without any gain after which what is left is round-off, …
    round_off: float = 10.0  # … how much larger than the projection's own it may look, …
    most_round_off: float = 1e-7  # … and the most of it that an answer may have


TUNED = Tuning()


# Bytes of spaces that are kept between the rough responses and the answer; beyond, they grow anew.
KEPT_BYTES = 256_000_000


def krylov(problem: Problem) -> Answer:
    """Step responses to the tolerance, source by source, the factors shared between them.

    Raises `ModelError` where `MOST_VECTORS` do not bring the estimated error of a source below the
    tolerance.
    """
    grown = Grown(problem)
    return grown.answer(shared_out(problem, grown.rough))


def rough(problem: Problem) -> Rough:
    """Outputs and maps alone, by spaces as they grow. Raises `ModelError` as `krylov` does."""
    return Grown(problem).rough(problem)


class Grown:
    """The spaces of a problem's sources: what was grown for a rough answer serves the next."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.system = problem, problem.system
        self.wells = algebraic(problem.system)
        ends = (self.system.edge_i, self.system.edge_j)
        self.drained = reached(self.system.n, *ends, self.system.fixed_node)
        self.factors = Factors(self.system, self.drained)
        self._kept: dict[int, Growth] = {}

    def rough(self, problem: Problem) -> Rough:
        """Outputs and maps to the tolerance of a problem that differs in no more than that."""
        shape = problem.system.source_count, len(problem.lag), problem.records.rows.shape[0]
        found, bytes_kept = Rough(np.zeros(shape), {}), 0
        for k in problem.active_sources:
            growth = self._growth(k)
            growth.to_tolerance(problem)
            growth.fill(found)
            bytes_kept += growth.space.bytes
            if bytes_kept <= KEPT_BYTES:
                self._kept[k] = growth
        return found

    def answer(self, problem: Problem) -> Answer:
        """All to the tolerance, every source held to what the problem says of its share."""
        system, answer = self.system, empty_answer(problem)
        error = residual = 0.0
        work = 0
        for k in problem.active_sources:
            growth = self._kept.pop(k, None) or self._growth(k)
            error = max(error, growth.to_tolerance(problem))
            basis = growth.space.close(TUNED.last_noise * problem.tolerance)
            last, repaired = _record(problem, k, basis, growth.direct, growth.own_flow, answer)
            if growth.own_flow is None:
                error = max(error, flow_noise(problem, k, answer.output[k]))
            shift, factor = self.factors.near(1.0 / (problem.lag[-1] or 1.0))
            rate = basis.vectors @ basis.modes.rate(problem.lag[-1:])[0]
            misfit = transient_misfit(system, factor, shift, k, last, rate)
            residual = float(np.max([residual, misfit, repaired]))
            work += growth.space.solves
        return answer._replace(time_error=error, residual=residual, work=work + self.factors.made)

    def _growth(self, k: int) -> Growth:
        """The space of a source as it begins."""
        problem, system = self.problem, self.system
        source = system.source(k)
        space = Subspace(system, self.wells, problem.records, source, self.drained)
        fast = space.first_decay()
        own = None
        if k < system.fixed_count and _drowned(problem, fast):
            rest = steady_flow(system, self.factors.at_rest(), k)
            start = rest.pressure
            space = Subspace(system, self.wells, problem.records, source, self.drained, start)
            own = float(rest.inflow(system, k)[k])
        direct = np.zeros(system.n)
        direct[system.pores :] = self.wells.direct(source)
        return Growth(problem, k, space, Poles(self.factors, space, problem.lag, fast), direct, own)


def _drowned(problem: Problem, fast: float) -> bool:
    """Whether round-off of what a source's own pores exchange hides what is slow."""
    share = np.finfo(float).eps * fast * float(problem.lag[-1])
    return bool(share > max(TUNED.load_noise * problem.tolerance, TUNED.least_load_noise))


class Factors:
    """Factors of G + s C, made when first asked for on one symbolic analysis.

    Shifts are rounded to a ladder, so that sources find those of one another, while the
    shifts of each depend on itself alone.
    """

    def __init__(self, system: System, drained: np.ndarray) -> None:
        self.system, self.drained = system, drained
        self.symbolic: Symbolic = analyse(system.n, system.edge_i, system.edge_j)
        self._made: dict[int, Factor] = {}
        self._rest: Factor | None = None

    @property
    def made(self) -> int:
        """Number of factors made so far."""
        return len(self._made) + (self._rest is not None)

    def at_rest(self) -> Factor:
        """Factor of G; parts that reach no fixed pressure are held, since nothing flows there."""
        if self._rest is None:
            excess = self.system.excess + np.where(self.drained, 0.0, self.system.edge_g.max())
            self._rest = factorise(self.symbolic, self.system.edge_g, excess)
        return self._rest

    def near(self, shift: float) -> tuple[float, Factor]:
        """The shift of the ladder nearest to `shift` > 0, and its factor."""
        rung = round(math.log(shift) / math.log(TUNED.ladder))
        shift = TUNED.ladder**rung
        if rung not in self._made:
            excess = self.system.excess + shift * self.system.storage
            self._made[rung] = factorise(self.symbolic, self.system.edge_g, excess)
        return shift, self._made[rung]


class Poles:
    """The poles of one source's space, used in turn."""

    def __init__(self, factors: Factors, space: Subspace, lag: np.ndarray, fast: float) -> None:
        self.factors, self.space, self.fast = factors, space, fast
        self.first = float(lag[lag > 0][0]) if lag.any() else 1.0
        self.last = float(lag[-1]) if lag.any() else 1.0
        self._known: list[tuple[float, Factor]] = []

    def __len__(self) -> int:
        return len(self._known)

    def next(self) -> tuple[float, Factor]:
        """The pole of the next image and its factor: a slow one, then a fast one, then in turn."""
        if not self._known:
            self._add(1.0 / self.last)
        elif len(self) == 1:
            slow, fast = self._window()
            self._add(TUNED.above * fast * (slow / fast) ** TUNED.slope)
        return self._known[self.space.solves % len(self)]

    def _window(self) -> tuple[float, float]:
        """Slow and fast end of the rates that the space and the times have in common, 1/s."""
        slow = max(1.0 / self.last, self.space.slowest())
        fast = min(1.0 / self.first, self.fast)
        return min(slow, fast), max(slow, fast)

    def _add(self, pole: float) -> None:
        self._known.append(self.factors.near(pole))


# Largest change of something between a size of a space and a smaller one
Change = Callable[[int, int], float]


class Growth:
    """The growth of one source's space until the recorded outputs have converged."""

    def __init__(
        self,
        problem: Problem,
        source: int,
        space: Subspace,
        poles: Poles,
        direct: np.ndarray,
        own_flow: float | None,
    ) -> None:
        """Of a space that starts from the source, or at rest with its flow there, m³/s."""
        self.problem, self.source, self.space, self.poles = problem, source, space, poles
        self.direct, self.own_flow = direct, own_flow
        self.recorded = problem.records.rows @ direct + problem.records.direct[source]
        self.at = _judged(problem.lag)
        self.lag = problem.lag[self.at]
        some = np.unique(np.linspace(0, len(self.lag) - 1, TUNED.map_checks).astype(int))
        self.map_lag = some if len(problem.domain) else some[:0]  # of these lags
        self.far = problem.far(source)
        self._coefficients: dict[int, np.ndarray] = {}
        self._outputs: dict[int, np.ndarray] = {}
        self._highest: dict[int, float] = {}  # pressure of any map, by size
        self._reductions: dict[tuple[str, int], dict[int, float]] = {}
        self._error = 1.0  # of no vectors: the first estimate may stand on a stair
        self._judge_by(problem)

    def _judge_by(self, problem: Problem) -> None:
        """Take the scales of errors from a problem from now on; how fast they fell stays."""
        self.problem = problem
        self._scales: dict[int, np.ndarray] = {}
        self._changes: dict[str, dict[tuple[int, int], float]] = {}

    def to_tolerance(self, problem: Problem) -> float:
        """Grow the space to a problem's tolerance; the estimated error. Raises `ModelError`.

        A space that has grown so far already is first judged as it is, by the problem's scales.
        Where rates lie so far apart that round-off hides the tolerance, the space grows until
        nothing is gained any more; the error is then that which the last vectors show.
        """
        space, tolerance = self.space, problem.tolerance
        if space.size == 0:
            return 0.0  # nothing that the source could move
        self._judge_by(problem)
        wait, error = 0, self._error
        grown = space.size >= TUNED.shortest and error <= tolerance
        seen: dict[int, float] = {}
        while grown or space.size < MOST_VECTORS:
            if not grown:
                if not space.extend(*self.poles.next()):
                    return 0.0  # the space holds all that the source can reach
                wait -= 1
                if space.size < TUNED.shortest or wait > 0:
                    continue
            grown, size = False, space.size
            found, rate, cheap = self._estimate(size)
            if not math.isfinite(found):
                raise ModelError(
                    f"krylov lost its numbers at {size} vectors; look for apertures that lie too "
                    "far apart, or use solver.method implicit"
                )
            error, self._error = max(found, TUNED.fall * self._error), found
            if error <= tolerance:
                return error
            seen[size] = error
            if error <= TUNED.most_round_off and (left := self._at_round_off(seen)) is not None:
                return left
            further = math.log(tolerance / error) / math.log(rate)
            cheap |= problem.system.pores <= TUNED.few_pores
            wait = 1 if cheap else min(TUNED.most_wait, math.ceil(TUNED.stride * further))
        raise ModelError(
            f"krylov reached a relative error of {error:.2g} in {MOST_VECTORS} vectors, not "
            f"{tolerance:g}; raise solver.tolerance, or record fewer decades of time"
        )

    def _at_round_off(self, seen: dict[int, float]) -> float | None:
        """The largest of the last errors if they fall no more and are round-off, else None."""
        late = [e for when, e in seen.items() if when > max(seen) - TUNED.idle]
        early = list(seen.values())[: -len(late)]
        gained = not early or min(late) < 0.5 * min(early)
        most = min(TUNED.round_off * self.space.noise(), TUNED.most_round_off)
        return None if gained or max(late) > most else max(late)

    def fill(self, rough: Rough) -> None:
        """Fill the source's outputs and maps (in place), by the space as it is."""
        problem, k, later = self.problem, self.source, self.problem.lag > 0.0
        size, maps = self.space.size, told(self.problem, self.source)
        rough.pressure[k] = np.zeros((np.count_nonzero(maps), len(problem.domain)))
        if size == 0:
            rough.output[k, later] = self.recorded
            return
        known = self.space.modes(size).pressure(problem.lag[later])
        rough.output[k, later] = self._recorded(size, problem.lag[later], known)
        if len(problem.domain):
            fields = self.space.lifted(known[maps[later]]) + self.direct
            rough.pressure[k] = fill_map(problem, k, fields)

    def _estimate(self, size: int) -> tuple[float, float, bool]:
        """Error of a size, the factor by which each vector reduces it, and whether that is cheap.

        With d the largest change over the last w vectors and r the slowest of the latest
        reductions of such changes, the error is d · r. The largest estimate of all w counts.
        What lies far from the source may not have moved yet; where any of it is recorded,
        the whole field has to converge as well, in the C-norm, which the coefficients tell.
        Maps are looked at once all that has converged.
        """
        cheap = self.space.noise() <= TUNED.noise_share * self.problem.tolerance
        if not cheap and not self.space.measured:
            self.space.measure()
            for known in (
                self._outputs, self._coefficients, self._highest, self._scales, self._changes
            ):  # fmt: skip
                known.clear()
        error, rate = self._extrapolate(self._output_change, size)
        if self.far:
            error, rate = max((error, rate), self._extrapolate(self._field_change, size))
        if error <= self.problem.tolerance and len(self.map_lag):
            cheap = False
            error, rate = max((error, rate), self._extrapolate(self._map_change, size))
        return error, rate, cheap

    def _extrapolate(self, change: Change, size: int) -> tuple[float, float]:
        """Largest estimate and slowest rate, from the change between two sizes.

        The narrowest and one that sees both poles go without a change before; that is 1 then, the
        error of no vectors. Wider ones would make loose tolerances a hundred times too tight.
        """
        worst, slowest = 0.0, 0.0
        changes = self._changes.setdefault(change.__name__, {})  # several estimates ask for each

        def changed(size: int, before: int) -> float:
            if (found := changes.get((size, before))) is None:
                found = changes[size, before] = change(size, before)
            return found

        for width in TUNED.widths:
            if size <= (width if width <= TUNED.poles else 2 * width):
                continue
            half = size - width
            now = changed(size, half)
            before = changed(half, half - width) if size > 2 * width else 1.0
            seen = self._reductions.setdefault((change.__name__, width), {})
            seen[size] = min(1.0, now / before) if before > 0.0 else 1.0
            while (oldest := next(iter(seen))) <= size - TUNED.late:
                del seen[oldest]
            reduction = max(seen.values())
            worst = max(worst, TUNED.caution * now * reduction)
            slowest = max(slowest, reduction ** (1.0 / width))
        return worst, min(max(slowest, 0.05), 0.95)

    def _known(self, size: int) -> np.ndarray:
        """Coefficients (l, k) of the pressure in the space's first vectors."""
        if size not in self._coefficients:
            _keep(self._coefficients, size, self.space.modes(size).pressure(self.lag))
        return self._coefficients[size]

    def _seen(self, size: int) -> np.ndarray:
        """Recorded outputs (l, o) of the space's first vectors."""
        if size not in self._outputs:
            _keep(self._outputs, size, self._recorded(size, self.lag, self._known(size)))
        return self._outputs[size]

    def _recorded(self, size: int, lag: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Outputs (l, o) at lags of coefficients (l, k) of the space's first vectors."""
        outputs = self.space.outputs(coefficients) + self.recorded
        if self.own_flow is not None:
            own = self.problem.records.well_rows + self.source
            outputs[:, own] = self.own_flow + self.space.modes(size).own_flow(lag)
        return outputs

    def _output_change(self, size: int, before: int) -> float:
        """Largest relative change of an output between two sizes."""
        now = self._seen(size)
        if size not in self._scales:
            _keep(self._scales, size, self.problem.scale(self.source, now, self.at))
        return float(_largest_change(now, self._seen(before), self._scales[size]))

    def _field_change(self, size: int, before: int) -> float:
        """Largest change of the field between two sizes over the largest field, in the C-norm."""
        largest, change = _largest_squares(self._known(size), self._known(before))
        return math.sqrt(change / largest) if largest > 0.0 else 0.0

    def _map_change(self, size: int, before: int) -> float:
        """Largest change of a map between two sizes over the largest pressure."""
        now = self._known(size)[self.map_lag]
        share = self.problem.share
        if share is None and size not in self._highest:
            self._highest[size] = _largest(np.abs(self.space.fields(now)))
        largest = self._highest[size] if share is None else float(share.field[self.source])
        if largest == 0.0:
            return 0.0
        change = self.space.fields(_less(now, self._known(before)[self.map_lag]))
        return max(float(change.max()), -float(change.min())) / largest


def _largest(values: np.ndarray) -> float:
    """The largest of values ≥ 0; 0 of none."""
    return float(np.maximum.reduce(values, axis=None, initial=0.0))


@kernel
def _largest_change(now: Array, before: Array, scale: Array) -> float:
    """The largest change of values (l, o) over their scales, of those whose scale is above zero."""
    largest = 0.0
    for k in range(now.shape[0]):
        for o in range(now.shape[1]):
            if scale[k, o] > 0.0:
                change = abs(now[k, o] - before[k, o]) / scale[k, o]
                if not change <= largest:  # nor is one that is no number
                    largest = change
    return largest


@kernel
def _largest_squares(now: Array, before: Array) -> tuple[float, float]:
    """The largest square of rows (l, k), and of what they differ by from shorter ones."""
    largest = most = 0.0
    for k in range(now.shape[0]):
        square = change = 0.0
        for c in range(now.shape[1]):
            value = now[k, c]
            square += value * value
            if c < before.shape[1]:
                value -= before[k, c]
            change += value * value
        if not square <= largest:
            largest = square
        if not change <= most:
            most = change
    return largest, most


def _less(now: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Coefficients (l, k) less those of a smaller size (l, < k)."""
    change = now.copy()
    change[:, : before.shape[1]] -= before
    return change


def _judged(lag: np.ndarray) -> np.ndarray:
    """Which lags (l,) above zero are looked at for errors: some of each decade, and the last."""
    (later,) = np.nonzero(lag > 0.0)
    stretch = np.floor(TUNED.lag_checks * np.log10(lag[later]))
    first = np.flatnonzero(np.diff(stretch, prepend=-np.inf))
    return np.unique(np.append(later[first], later[-1:]))


def _keep(known: dict[int, np.ndarray], size: int, values: np.ndarray) -> None:
    """Keep what belongs to a size, and forget what lies too far before it to be asked for soon."""
    for old in [one for one in known if one < size - 2 * max(TUNED.widths)]:
        del known[old]
    known[size] = values


def _record(
    problem: Problem,
    source: int,
    basis: Basis,
    direct: np.ndarray,
    own_flow: float | None,
    answer: Answer,
) -> tuple[np.ndarray, float]:
    """Fill one source's part of the answer (in place).

    The flow of a source whose space starts at rest is what it lets in there, `own_flow`, and what
    its modes do; what is stored tells the volume.

    The pressure (n,) at the last lag, and the largest volume that had to be put right (see
    `balanced`) over the volume moved.
    """
    records, lag = problem.records, problem.lag
    alone = records.rows @ direct + records.direct[source]
    flows = slice(records.well_rows, records.well_rows + records.flow_rows)
    through = records.rows[flows] @ direct
    given = float(problem.system.source(source).sum() + through.sum())
    if own_flow is None:
        pressure, integral, stored, missing = balanced(
            problem.system, basis, lag, basis.rows[flows].sum(axis=0), given
        )
    else:
        pressure, integral = basis.modes.pressure(lag), basis.modes.integral(lag)
        stored = pressure @ basis.stored
    answer.output[source] = pressure @ basis.rows.T + alone
    answer.cumulative[source, :, :-1] = integral @ basis.rows[flows].T + lag[:, None] * alone[flows]
    answer.cumulative[source, :, -1] = stored
    if own_flow is not None:
        own = problem.records.well_rows + source
        answer.output[source, :, own] = own_flow + basis.modes.own_flow(lag)
        let_in = answer.cumulative[source, :, :-1]
        let_in[:, source] = own_flow * lag + basis.modes.own_volume(lag)
        missing = answer.cumulative[source, :, -1] - let_in.sum(axis=1)
        let_in[:, source] += missing
        missing = np.abs(missing)
    answer.missing[source] = missing
    fill_maps(problem, source, pressure, basis.vectors, direct, answer.pressure[source])
    moved = np.abs(answer.cumulative[source]).sum(axis=1)
    later = (lag > 0.0) & (moved > 0.0)
    repaired = np.max(missing[later] / moved[later], initial=0.0)
    return basis.vectors @ pressure[-1] + direct, float(repaired)


def balanced(
    system: System, basis: Basis, lag: np.ndarray, let_in: np.ndarray, given: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (l, m) of the pressure and of its integral, and the volume stored (l,), m³.

    The constants lie in the space, so that what the fixed pressures let in, `let_in` (m,) of
    each vector, is what is stored less what is `given`. Behind a barrier the pressures that
    drive it are nothing but round-off beside those before it. The smallest change in the
    C-norm restores it, up to what round-off of pressures may do to flows. Where tight rock lets in
    less than the round-off of its storage, the flows are right, and the volume follows from them.
    What was missing (l,), m³, comes with it: in volume, or in the present flow, had it been so all
    the time.

    Several spaces beside one another (…) have (…, m) and (…, 1) of the last two.

    Parameters
    ----------
    system : the flow equation C dp/dt = −G p + f
    basis : the closed Krylov space
    lag : (l,) s
    let_in : flow from the fixed pressures of each vector, (m,)
    given : flow that is given, m³/s
    """
    pressure, integral = basis.modes.pressure(lag), basis.modes.integral(lag)
    missing = _sum(pressure, basis.stored) - given * lag - _sum(integral, let_in)
    size = np.vecdot(let_in, let_in)[..., None]
    if not np.any(size):
        return pressure, integral, _sum(pressure, basis.stored), np.abs(missing)
    in_flow = _sum(basis.modes.rate(lag), basis.stored) - given - _sum(pressure, let_in)
    told = np.maximum(np.abs(missing), lag * np.abs(in_flow))
    highest = np.maximum(basis.vectors.max(axis=0), -basis.vectors.min(axis=0))
    largest = np.abs(pressure) @ highest
    noise = LOST * np.finfo(float).eps * float(system.fixed_g.sum()) * largest
    mend = (let_in / np.where(size > 0.0, size, np.inf))[..., None, :]
    pressure += np.clip(in_flow, -noise, noise)[..., None] * mend
    stored = _sum(pressure, basis.stored)
    missing = stored - given * lag - _sum(integral, let_in)
    mended = np.clip(missing, -noise * lag, noise * lag)
    integral += mended[..., None] * mend
    return pressure, integral, stored - (missing - mended), told


def _sum(coefficients: np.ndarray, each: np.ndarray) -> np.ndarray:
    """What vectors have of something, each (…, m), summed by their coefficients (…, l, m)."""
    return np.asarray(coefficients @ each if each.ndim == 1 else np.matvec(coefficients, each))
