"""Rates of wells that a pressure limit or a group decides, found on the responses of all wells.

A well at a rate may have a least and a largest bottom-hole pressure: where its rate would take it
beyond, the pressure stays at the limit, and the rate is what the rock gives there, until the rate
that was asked for keeps within it again. A well does not turn round: what a limit leaves of a
rate lies between it and none. Wells of one group share one pressure, as on an open manifold, and
produce the sum of their rates together, within the limits of all.

Flow is linear, so the pressure of each well is that of all else plus a convolution of the rates
with the responses between these wells (Duhamel). Time goes in steps; a rate that is found changes
evenly in each, by as much as puts the pressure at the step's end where it has to be. The even
change is a few sudden ones, closer together towards the end of the step, where responses bend.
Steps grow as the time since something last changed; where another condition begins to hold within
a step, the time at which it does is found by bisection, and steps begin anew there, with a short
one that takes what jumps.
"""

from __future__ import annotations

import bisect
import math
from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.controls import Block, Controls, Steps, at_rates, limited_blocks
from demflow.model.flow.equation.sites import time_since
from demflow.model.outcome import ModelError
from demflow.model.products import Responses

Array = np.ndarray

FINE, COARSE = 80, 16  # steps a decade while rates are found, and while all are given
MOST_SWITCHES = 500
HALVINGS, CLOSE = 60, 1e-10  # how near the time of a switch is found, relative
SLACK = 1e-7  # part of a rate or a pressure change below which nothing is beyond a limit
_EDGES = np.array([0.0, 0.02, 0.1, 0.35, 1.0])  # from the end of a step
_GAUSS = np.array([0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0)])
# when parts of an even change are made, over the length of the step, and how large they are
PLACES = 1.0 - (_EDGES[:-1, None] + np.diff(_EDGES)[:, None] * _GAUSS).ravel()
SHARES = np.repeat(0.5 * np.diff(_EDGES), 2)
GIVEN, HELD, SHUT = 0, 1, 2  # what holds of a block: its rate, its limit, or no flow


class Settled(NamedTuple):
    """Rates that were found, w wells at t times."""

    steps: Steps  # of every source
    rate: Array  # (w, t) m³/s, NaN of wells that have no part in it
    pressure: Array  # (w, t) Pa at a limit, NaN where none acts
    limited: Array  # (w, t) 1 where a limit acts, else 0
    switches: tuple[float, ...]  # s, when a limit takes over or gives back


class Table:
    """Responses of the found wells' pressures to every source, at any time since a step."""

    def __init__(self, lag: Array, response: Array):
        later = lag > 0.0
        self.steady = response[:, later][:, 0] if np.count_nonzero(later) == 1 else None
        if self.steady is None:
            self.spline = _spline(lag[later], np.moveaxis(response[:, later], 0, 1))

    def summed(self, since: Array, source: Array, size: Array) -> Array:
        """What steps (k,) of some sources do together, times `since` them, to each well (wells,).

        None does anything before its time.
        """
        if self.steady is not None:
            return np.asarray((size * (since > 0.0)) @ self.steady[source])
        return np.asarray(_summed(*self.spline, since, source, size))


def _spline(lag: Array, values: Array) -> tuple[Array, Array]:
    """A cubic spline over ln t of values (l, sources, …): places (l,), pieces (4, l − 1, …)."""
    from scipy.interpolate import CubicSpline

    found = CubicSpline(np.log(lag), values)
    return found.x, np.ascontiguousarray(found.c)


@kernel
def _summed(place: Array, piece: Array, since: Array, source: Array, size: Array) -> Array:
    """Sum of splines (see `_spline`) of some sources, each times a size, at some times > 0."""
    found = np.zeros(piece.shape[3])
    for k in range(len(since)):
        if not since[k] > 0.0:
            continue
        at = max(np.log(since[k]), place[0])
        low, high = 0, len(place) - 1
        while high - low > 1:
            middle = (low + high) // 2
            if at < place[middle]:
                high = middle
            else:
                low = middle
        d, p = at - place[low], piece[:, low, source[k]]
        for c in range(len(found)):
            found[c] += size[k] * (((p[0, c] * d + p[1, c]) * d + p[2, c]) * d + p[3, c])
    return found


def settled(responses: Responses, controls: Controls, given: Steps) -> Settled | None:
    """The rates that limits and groups decide, None where all rates are given.

    Parameters
    ----------
    responses : step responses of all sources
    controls : rates and pressures of the case as they are asked for
    given : steps of every source if no limit acted

    Raises `ModelError` where limits take over and give back without end.
    """
    blocks = limited_blocks(controls.wells)
    if not blocks:
        return None
    return _Search(responses, controls, given, blocks).run()


def interpolating(
    lag: Array, changes: list[tuple[float, float]], at: Array, *, volumes: bool = False
) -> Array:
    """Weights (t, l) of responses at lags (l,) in the sum of steps at other times.

    Parameters
    ----------
    lag : (l,) s
    changes : times of changes, s
    at : times, (t,) s
    volumes : whether the responses are volumes: their mean rates since the step are interpolated,
        so that together they stay what a step moves in the time
    """
    later = np.flatnonzero(lag > 0.0)
    spline = _spline(lag[later], np.eye(len(later))[:, None])
    when, size = (np.array(column) for column in zip(*changes, strict=True))
    source = np.zeros(len(when), dtype=int)
    weights = np.zeros((len(at), len(lag)))
    for k, time in enumerate(at):
        since = time_since(when, np.asarray(time))
        each = size * since if volumes else size
        weights[k, later] = _summed(*spline, since, source, each)
    if volumes:
        weights[:, later] /= lag[later]
    return weights


def _sum(response: Array, change: Array) -> Array:
    """What changes (wells,) of the rates do to the pressures, by responses (wells, wells)."""
    return np.asarray((response * change[:, None]).sum(axis=0))


class _Search:
    """The state of all blocks, step after step."""

    def __init__(self, responses: Responses, controls: Controls, given: Steps, blocks: list[Block]):
        self.blocks = blocks
        self.controls = controls
        rated = at_rates(controls.wells)
        self.found = sorted(k for block in blocks for k in block.members)
        place = {k: n for n, k in enumerate(self.found)}
        self.blocks = [b._replace(members=tuple(place[k] for k in b.members)) for b in blocks]
        fixed = len(controls.fixed_pressures)
        self.own = [fixed + k for k in self.found]  # their sources
        self.wells = [rated[k] for k in self.found]
        self.table = Table(responses.lag, responses.output[:, :, self.found])
        self.soonest = float(responses.lag[responses.lag > 0.0][0])
        fields = responses.initial_output[:, :, self.found]
        still = fields.shape[1] == 1
        self.fields = None if still or not len(fields) else Table(responses.lag, fields)
        self.at_start = fields[:, 0]
        self.steps = [list(changes) for changes in given]
        known = [
            (time, source, size)
            for source, changes in enumerate(self.steps)
            if source not in self.own
            for time, size in changes
        ]
        self.known = None
        if known:
            when, source, size = zip(*known, strict=True)
            self.known = np.array(when), np.array(source), np.array(size)
        self.end = controls.times[-1] if controls.transient else math.inf
        self.targets = [controls.wells[k].rate_changes for k in self.wells]
        starts = {0.0, *(t for changes in self.steps for t, _ in changes)}
        starts |= {t for changes in self.targets for t, _ in changes}
        self.starts = sorted(t for t in starts if t < self.end)
        self.stops = sorted({*self.starts, *controls.times})
        count = len(self.found)
        # changes of the rates that were found: when, of which source, how large
        self.when, self.of, self.jump = np.empty(0), np.empty(0, dtype=int), np.empty(0)
        self.begin = 0.0  # when something last changed
        self.rate = np.zeros(count)
        self.holds = tuple(GIVEN for _ in blocks)
        largest = [max((abs(q) for _, q in t), default=0.0) for t in self.targets]
        self.size = max(*largest, 1e-300)
        self.log: list[tuple[float, float, Array, tuple[int, ...], float]] = []

    def run(self) -> Settled:
        """Go through the times."""
        if not self.controls.transient:
            rate, holds = self._choose(0.0, math.inf)
            self._accept(0.0, math.inf, rate, holds)
            return self._result(())
        now = 0.0
        switches: list[float] = []
        while now < self.end:
            then = self._next(now)
            rate, holds = self._choose(now, then)
            if holds != self.holds:
                soon = now + min(self.soonest, 0.5 * (then - now))
                _, at_once = self._choose(now, soon)
                if at_once != self.holds:
                    if now > 0.0 or any(h == HELD for h in at_once):
                        switches.append(now)
                    self.holds, self.begin = at_once, now
                else:
                    then = self._when(now, soon, then)
                    rate, _ = self._solve(now, then, self.holds)
                    self._accept(now, then, rate, self.holds)
                    self.begin = now = then
                    _, self.holds = self._choose(now, now + self.soonest)
                    switches.append(now)
                if len(switches) > MOST_SWITCHES:
                    raise ModelError(
                        f"pressure limits of wells took over and gave back {MOST_SWITCHES} times "
                        f"by {now:.3g} s; look for limits that contradict each other"
                    )
                continue
            self._accept(now, then, rate, holds)
            now = then
            if now in self.starts:
                self.begin = now
        return self._result(tuple(dict.fromkeys(switches)))

    def _next(self, now: float) -> float:
        """The end of the next step."""
        busy = HELD in self.holds or any(len(b.members) > 1 for b in self.blocks)
        growth = 10.0 ** (1.0 / (FINE if busy else COARSE))
        past = now - self.begin
        then = self.begin + max(self.soonest, past * growth, past + self.soonest)
        # what is recorded is at the end of a step, where conditions hold
        stops = self.stops if busy else self.starts
        later = bisect.bisect_right(stops, now)
        found: float = min(then, stops[later] if later < len(stops) else self.end)
        return found

    def _when(self, now: float, low: float, high: float) -> float:
        """The time at which another condition begins to hold within a step."""
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if high - low <= CLOSE * high:
                break
            if self._choose(now, middle)[1] == self.holds:
                low = middle
            else:
                high = middle
        return high

    def _choose(self, now: float, then: float) -> tuple[Array, tuple[int, ...]]:
        """Rates of the step, and what holds of each block so that nothing is beyond a limit."""
        holds = tuple(
            hold if self._bounded(block, now) else GIVEN
            for block, hold in zip(self.blocks, self.holds, strict=True)
        )
        for _ in range(4 * len(self.blocks) + 4):
            before, response = self._before(now, then, holds)
            rate = self._rates(now, before, response, holds)
            pressure = before + _sum(response, rate - self.rate)
            better = tuple(
                self._condition(block, now, hold, rate, pressure)
                for block, hold in zip(self.blocks, holds, strict=True)
            )
            if better == holds:
                break
            holds = better
        return rate, holds

    def _solve(self, now: float, then: float, holds: tuple[int, ...]) -> tuple[Array, Array]:
        """Rates (wells,) and pressures of a step in which these conditions hold."""
        before, response = self._before(now, then, holds)
        rate = self._rates(now, before, response, holds)
        return rate, before + _sum(response, rate - self.rate)

    def _changing(self, now: float, then: float, holds: tuple[int, ...]) -> Array:
        """When the parts of each well's change are made in a step, (wells, parts)."""
        when = np.full((len(self.found), len(SHARES)), now)
        if now > self.begin and math.isfinite(then):
            for block, hold in zip(self.blocks, holds, strict=True):
                if hold == HELD or len(block.members) > 1:
                    when[list(block.members)] = now + PLACES * (then - now)
        return when

    def _before(self, now: float, then: float, holds: tuple[int, ...]) -> tuple[Array, Array]:
        """Pressures at the end of a step if rates stayed, and what a change of them does."""
        total = np.full(len(self.found), float(self.controls.reference))
        if self.known is not None:
            when, source, size = self.known
            since = then - when if math.isfinite(then) else np.full(len(when), math.inf)
            total += self.table.summed(since, source, size)
        for k, weight in enumerate(self.controls.initial_weights):
            if self.fields is None:
                total += weight * self.at_start[k]
            else:
                total += self.fields.summed(np.array([then]), np.array([k]), np.array([weight]))
        total += self.table.summed(then - self.when, self.of, self.jump)
        since = then - self._changing(now, then, holds)
        every = zip(since, self.own, strict=True)
        response = [
            self.table.summed(part, np.full(len(part), source), SHARES) for part, source in every
        ]
        return total, np.array(response)

    def _rates(self, now: float, before: Array, response: Array, holds: tuple[int, ...]) -> Array:
        """Rates under which the conditions hold at the end of a step."""
        count = len(self.found)
        matrix, given = np.zeros((count, count)), np.zeros(count)
        at_old = before - _sum(response, self.rate)
        row = 0
        for block, hold in zip(self.blocks, holds, strict=True):
            first = block.members[0]
            for member in block.members[1:]:  # one pressure
                matrix[row] = response[:, member] - response[:, first]
                given[row] = at_old[first] - at_old[member]
                row += 1
            if hold == HELD:
                matrix[row], given[row] = (
                    response[:, first],
                    self._limit(block, now) - at_old[first],
                )
            else:
                matrix[row, list(block.members)] = 1.0
                given[row] = self._target(block, now) if hold == GIVEN else 0.0
            row += 1
        scale = np.abs(matrix).max(axis=1)
        return np.linalg.solve(matrix / scale[:, None], given / scale)

    def _target(self, block: Block, now: float) -> float:
        """Rate that is asked for after a time."""
        return sum(
            next((q for t, q in reversed(self.targets[k]) if t <= now), 0.0) for k in block.members
        )

    def _limit(self, block: Block, now: float) -> float:
        return block.least if self._target(block, now) > 0.0 else block.largest

    def _bounded(self, block: Block, now: float) -> bool:
        """Whether a limit may decide the rate that is asked for."""
        return self._target(block, now) != 0.0 and math.isfinite(self._limit(block, now))

    def _condition(self, block: Block, now: float, hold: int, rate: Array, pressure: Array) -> int:
        """What holds instead where a rate or a pressure is beyond a limit."""
        if not self._bounded(block, now):
            return GIVEN
        target, limit = self._target(block, now), self._limit(block, now)
        sign = math.copysign(1.0, target)
        room = sign * (pressure[block.members[0]] - limit)  # above zero: within the limit
        flow = sign * rate[list(block.members)].sum()
        slack = SLACK * max(abs(self.controls.reference - limit), SLACK * abs(limit))
        if hold == GIVEN:
            return HELD if room < -slack else GIVEN
        if hold == SHUT:
            return HELD if room > slack else SHUT
        if flow > abs(target) * (1.0 + SLACK):
            return GIVEN
        return SHUT if flow < -SLACK * self.size else HELD

    def _accept(self, now: float, then: float, rate: Array, holds: tuple[int, ...]) -> None:
        when = self._changing(now, then, holds)
        for k in np.flatnonzero(rate != self.rate):
            at_once = when[k, 0] == now
            parts = slice(1) if at_once else slice(None)
            shares = np.ones(1) if at_once else SHARES
            self.when = np.append(self.when, when[k, parts])
            self.of = np.append(self.of, np.full(len(shares), self.own[k]))
            self.jump = np.append(self.jump, (rate[k] - self.rate[k]) * shares)
        self.rate, self.holds = rate, holds
        self.log.append((now, then, rate, holds, self.begin))

    def _result(self, switches: tuple[float, ...]) -> Settled:
        controls = self.controls
        times = np.asarray(controls.times) if controls.transient else np.array([math.inf])
        shape = (len(controls.wells), len(times))
        rate, pressure, limited = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape)
        ends = np.array([entry[1] for entry in self.log])
        at = np.minimum(np.searchsorted(ends, times * (1.0 - 1e-12)), len(ends) - 1)
        for block_number, block in enumerate(self.blocks):
            for member in block.members:
                well = self.wells[member]
                for k, step in enumerate(at):
                    begin, _, _, holds, _ = self.log[step]
                    hold = holds[block_number]
                    limited[well, k] = hold != GIVEN
                    if hold == HELD:
                        pressure[well, k] = self._limit(block, begin)
                    rate[well, k] = self._rate_at(times[k], step, member, hold, block)
        for source in self.own:
            self.steps[source] = []
        for time, source, size in zip(self.when, self.of, self.jump, strict=True):
            self.steps[source].append((float(time), float(size)))
        return Settled(self.steps, rate, pressure, limited, switches)

    def _rate_at(self, time: float, step: int, member: int, hold: int, block: Block) -> float:
        """The rate of a well at a time: where it is found, between the ends of steps."""
        now, then, rate, _, begin = self.log[step]
        at_end = float(rate[member])
        if (hold != HELD and len(block.members) == 1) or now == begin or not math.isfinite(then):
            return at_end
        before = float(self.log[step - 1][2][member])
        return before + (time - now) / (then - now) * (at_end - before)
