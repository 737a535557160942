"""From bond to bond: rock and fluid until the next one breaks, and what then follows at once.

A contact of a joint that begins to slide is an event too, located in time like a break; nothing
jumps there, so that nothing follows at once.

Time goes in implicit steps (`balance`) whose size follows the change of the pressures' rate. Where
cement would be beyond its strength at the end of a step, the step is shortened by secants until the
most loaded is at it; that one breaks, and with every pore's fluid held where it is the rock finds
its new balance, in which the next may break, until none is beyond its strength. No step of time is
chosen by what a crack conducts, and no fluid is lost while it opens.

What ends a march early is a value, `State.stopped`: a part of the rock that nothing holds any more,
grains that move by a good part of their size, a pore that is squeezed to nothing, or a step that is
not found however short.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from demflow.model.coupling.balance import Balanced, Fluid, balanced, by_turns, flow, through_oil
from demflow.model.coupling.setting import Setting
from demflow.model.coupling.skeleton import (
    FIRM,
    NEVER,
    SLID,
    Borne,
    Hold,
    Skeleton,
    borne,
    broken,
    damped_energy,
    forces,
    gripped,
    load_factors,
    remembered,
    slide_factors,
    stored_energy,
)
from demflow.model.mechanics.contact.bonds import BROKEN_IN_SHEAR, BROKEN_IN_TENSION, INTACT
from demflow.model.mechanics.contact.grains import Array

AT_STRENGTH = 1e-3  # how near to its strength cement is when it breaks, relative
BEYOND = 1.1  # how far a step goes over where a bond is thought to break
BISECTIONS = 12  # of when that is
JUMP = 1e-4  # of a step, in which a load that jumps beyond the strength is not looked for further
MOST_SECANTS = 25
MOST_STEPS = 20_000  # of one leg
MOST_BREAKS = 100_000  # of one march
PATIENT = 2  # how often a step is shortened before it is looked for by all means
HALVINGS = 30  # of a step that is not found
GROWTH = 4.0  # of a step over the one before
AFTER = 0.1  # the first step after a break over the one before it
FIRST = 1e-2  # pressure that a march's first step adds to its wells, over the stress
RUNAWAY = 0.3  # displacement since the start, in mean radii, at which small ones are left behind
MOST_LOOSE = 5  # grains of a fragment that stays wedged in its crack
SQUEEZED = 1e-3  # of its volume that a pore keeps at the least


class Ledger(NamedTuple):
    """What went where since the start; volumes and energies in the units of the case."""

    injected: float  # by wells at a rate
    let_in: Array  # (k,) by the sides, then by the wells, that keep a pressure
    work: float  # put in by wells, sides, walls
    viscous: float  # what the fluid's friction took
    slip: float  # and that of the grains
    jerks: float  # what the trapezoidal rule misses where contacts open or close in a step
    released: float  # set free by breaks
    astray: float  # Σ |error| of the balance of energy of each step
    unbalanced: float  # largest |C p + Aᵀ u − M| of a pore in any state
    off: float  # largest force out of balance over the mean contact force


class Event(NamedTuple):
    """A bond or joint contact that broke, or a joint contact that began to slide."""

    time: float  # s
    contact: int
    mode: int  # BROKEN_IN_TENSION, BROKEN_IN_SHEAR, SLID
    energy: float  # set free
    pore: int  # beside it, of the higher pressure; −1 none


class State(NamedTuple):
    """Where a march stands."""

    time: float  # s
    dt: float  # s: of the next step; 0: not known yet
    u: Array  # (m,)
    p: Array  # (d,)
    mass: Array  # (d,)
    vapour: Array  # (d,) bool
    hold: Hold
    rate: Array  # (d,) of the pressures in the step before; empty after a break
    ledger: Ledger
    stopped: str


class Wells(NamedTuple):
    """What wells do."""

    inflow: Array  # (d,) a second, of those at a rate
    held: Array  # (d,) bool: pores of those at a pressure
    pressure: Array  # (d,) theirs
    keepers: Array  # (k,) pores of those at a pressure, in their order


def start(given: Setting, keepers: int) -> State:
    """The state at time zero: the loaded rock at the initial pressure.

    `keepers` is the number of sides and wells that keep a pressure.
    """
    case = given.case
    d = len(case.storage)
    ledger = Ledger(0.0, np.zeros(keepers), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return State(
        0.0, 0.0, given.u, np.zeros(d), case.pull @ given.u, np.zeros(d, bool), given.hold,
        np.empty(0), ledger, "",
    )  # fmt: skip


class March:
    """A march of one case; `events` are those since it was made."""

    def __init__(self, given: Setting, origin: Array, keepers: int, tolerance: float):
        """`origin` (m,) are the displacements of time zero, `keepers` as for `start`."""
        self.given, self.case, self.origin = given, given.case, origin
        self.tolerance = tolerance
        self.events: list[Event] = []
        self.solves = self.steps = 0
        self.given_rate = np.zeros(len(given.case.storage))  # by wells at a pressure, last step
        self.highest = np.full(len(given.well), -np.inf)  # pressure of each well after any step
        self.keepers = keepers
        self.before: tuple[float, tuple[Array, ...]] | None = None  # a step, and where from
        walls = np.abs(self.case.load[-2:]) / np.sqrt(given.area)
        self.scale = max(float(walls.max()), 1e-9)  # of the pressures

    def drained(self, state: State) -> State:
        """Let bonds break that do not bear the loaded rock at the initial pressure.

        What slid while the rock was loaded began to do so at time zero.
        """
        d = len(state.p)
        fluid = Fluid(0.0, np.zeros(d), np.ones(d, bool))
        book = state.ledger
        nothing = Wells(np.zeros(d), fluid.held, state.p, np.empty(0, np.int64))
        state = self._begun(state, state.hold.mode == SLID)
        state = self._ruptured(state, fluid, None, nothing)
        return state._replace(ledger=book)

    def to(self, state: State, end: float, wells: Wells) -> State:
        """March to a time, or to why it stops.

        Parameters
        ----------
        state : where it stands
        end : time to reach, s
        wells : the wells
        """
        d = len(state.p)
        if wells.held.any():
            jump = np.where(wells.held, wells.pressure, state.p)
            if not np.array_equal(jump, state.p):
                state = self._at_once(state, jump, wells)
        if state.dt == 0.0:
            state = state._replace(dt=self._first(state, end, wells))
        while not state.stopped and state.time < end:
            self.steps += 1
            if self.steps > MOST_STEPS:
                what = f"{MOST_STEPS} steps reached {state.time:.6g} s only; ask for shorter times"
                return state._replace(stopped=what)
            left = end - state.time
            dt = left if state.dt >= 0.999 * left else min(state.dt, 0.5 * left + 0.25 * state.dt)
            fluid = Fluid(dt, wells.inflow, wells.held)
            state = self._step(state, fluid, wells)
            assert len(state.p) == d
        return state

    def _first(self, state: State, end: float, wells: Wells) -> float:
        """A first step, by what the wells and all around them take with no flow."""
        rate = float(np.abs(wells.inflow).max(initial=0.0))
        if rate == 0.0:
            return 1e-6 * (end - state.time)
        unit = wells.inflow / rate
        found = self._found(state, Fluid(0.0, wells.inflow, wells.held), state.mass + unit * 1e-6)
        rise = float(np.abs(found.p - state.p).max(initial=0.0)) / 1e-6
        return min(FIRST * self.scale / max(rise * rate, 1e-300), end - state.time)

    def _found(
        self,
        state: State,
        fluid: Fluid,
        mass: Array,
        guess: tuple[Array, Array] | None = None,
        hold: Hold | None = None,
        patient: bool = True,
    ) -> Balanced:
        """The balance after a step; where not found at once, by turns, then through thicker oil.

        A shorter step is often found where a longer one is not, so that one that is not `patient`
        ends early and without that.
        """
        self.solves += 1
        first = state.hold if hold is None else hold
        u, p = guess or (state.u, state.p)
        p = np.where(fluid.held, state.p, p)
        now = balanced(self.case, first, u, p, mass, fluid, state.vapour, patient=patient)
        if now.reached or not patient:
            return now
        if hold is None:  # once cement broke, rock that only friction holds comes apart
            turned = by_turns(self.case, first, state.u, p, mass, fluid, state.vapour)
            if turned.reached:
                return turned
        return through_oil(self.case, first, state.u, state.p, mass, fluid, state.vapour, now)

    def _step(self, state: State, fluid: Fluid, wells: Wells) -> State:
        """One step, to a break or without one; shorter where it is not good enough."""
        s = self.case.skeleton
        way = Way(s, state.hold, state.u, state.p)
        reached, reached_dt, shortened = self._located(state, fluid, way)
        if reached is None:
            return state._replace(
                stopped=f"no balance of rock and fluid is found after {state.time:.6g} s, however "
                "short the step; try a smaller rate, a lower matrix.gap_factor or stronger bonds"
            )
        breaks = _worst(s, state.hold, reached.found) >= 1.0 - AT_STRENGTH
        after = self._moved_on(state, reached, reached_dt, wells)
        if shortened:
            after = after._replace(dt=min(after.dt, reached_dt))
        self.before = None if breaks else (reached_dt, way.found[0][1])
        if breaks and not after.stopped:
            slides = slide_factors(s, state.hold, reached.found) >= 1.0 - AT_STRENGTH
            after = self._begun(after, slides)
            if _most_loaded(s, state.hold, reached.found) < 1.0 - AT_STRENGTH:
                return after._replace(dt=max(after.dt, fluid.dt))
            after = self._ruptured(after, fluid._replace(dt=0.0), reached.found, wells)
            after = after._replace(dt=AFTER * fluid.dt, rate=np.empty(0))
        return after

    def _located(self, state: State, fluid: Fluid, way: Way) -> tuple[Balanced | None, float, bool]:
        """What a step leads to, to the first break at the most; its length, s; if it was halved."""
        s = self.case.skeleton
        dt, low, high, shortened, reached_dt = fluid.dt, 0.0, np.inf, 0, 0.0
        reached: Balanced | None = None
        guess: tuple[Array, Array] | None = None
        if self.before is not None:  # what broke nothing goes on as it did
            ahead = Way(s, state.hold, state.u, state.p)
            ahead.found.append((-self.before[0], self.before[1]))
            dt = min(dt, BEYOND * ahead.break_within(0.0, dt))
            guess = ahead.guess(dt)
        for attempt in range(HALVINGS + MOST_SECANTS):
            patient = shortened >= PATIENT
            now = self._found(state, fluid._replace(dt=dt), state.mass, guess, patient=patient)
            if not now.reached:
                shortened += 1
                if shortened > HALVINGS:
                    break
                dt, guess = low + 0.3 * (dt - low), None
                continue
            way.add(dt, now)
            error = self._error(state, now, dt)
            if error > 2.0 * self.tolerance and high == np.inf:
                dt *= max(0.2, 0.8 * np.sqrt(self.tolerance / error))
                guess = way.guess(dt)
                continue
            load = _worst(s, state.hold, now.found)
            reached, reached_dt = now, dt
            if load <= 1.0 + AT_STRENGTH and (high == np.inf or load >= 1.0 - AT_STRENGTH):
                break
            if load > 1.0:
                high = dt
                if high - low <= JUMP * high:  # it jumps beyond its strength
                    break
            else:
                low = dt
            # a load that jumps is not where a parabola has it
            tried = 0.5 * (low + high) if attempt % 4 == 3 else way.break_within(low, high)
            dt, guess = tried, way.guess(tried)
        return reached, reached_dt, shortened > 0

    def _begun(self, state: State, sliding: Array) -> State:
        """The state with joint contacts noted that are about to slide (c,) bool, or just did."""
        hold = state.hold
        sliding = sliding | (self.case.skeleton.joint & (hold.mode == NEVER) & (hold.slip > 0.0))
        for k in np.flatnonzero(sliding).tolist():
            self.events.append(Event(state.time, k, SLID, 0.0, self._pore(k, state.p)))
        mode = np.where(sliding, SLID, hold.mode).astype(np.int8)
        return state._replace(hold=hold._replace(mode=mode))

    def _error(self, state: State, now: Balanced, dt: float) -> float:
        """Error of a step: half of what the rates of pressure changed, over the largest pressure.

        That of the wells, or the root mean square over the pores: what goes on in the pore at a
        crack's tip just after a break is over before it counts.
        """
        if not len(state.rate):
            return 0.0
        largest = max(float(np.abs(now.p).max(initial=0.0)), 0.1 * self.scale)
        change = np.abs(now.p - state.p - dt * state.rate)
        wells = float(change[self.given.well].max(initial=0.0))
        return 0.5 * max(wells, float(np.sqrt(np.mean(change**2)))) / largest

    def _moved_on(self, state: State, now: Balanced, dt: float, wells: Wells) -> State:
        """The state after a step that was found, with its ledger."""
        case, s = self.case, self.case.skeleton
        moved = flow(case, now.hold, now.found, now.p)
        mass = state.mass + now.net
        given = np.where(wells.held, case.storage * now.p + case.pull @ now.u - mass, 0.0)
        mass = mass + given
        self.highest = np.maximum(self.highest, now.p[self.given.well])
        ledger = self._booked(state, now, dt, wells, moved.pipe, moved.link, given, mass)
        error = self._error(state, now, dt)
        grow = GROWTH
        if error > 0.0:
            grow = float(np.clip(0.8 * np.sqrt(self.tolerance / error), 0.2, GROWTH))
        after = state._replace(
            time=float(state.time + dt),
            dt=dt * grow,
            u=now.u,
            p=now.p,
            mass=mass,
            vapour=now.vapour,
            hold=remembered(s, now.hold, now.found, now.u),
            rate=(now.p - state.p) / dt,
            ledger=ledger,
        )
        return after._replace(stopped=self._ends(after))

    def _booked(
        self,
        state: State,
        now: Balanced,
        dt: float,
        wells: Wells,
        pipe: Array,
        link: Array,
        given: Array,
        mass: Array,
    ) -> Ledger:
        case, s, c = self.case, self.case.skeleton, self.case.conduits
        book = state.ledger
        middle = 0.5 * (state.p + now.p)
        before = borne(s, state.hold, state.u)
        work = float(middle @ (dt * wells.inflow + given)) - dt * float(c.link_pressure @ link)
        work += float(case.load @ (now.u - state.u))
        if state.time == 0.0:  # pressures of sides begin to act: put on by and by, so that none
            begins = case.load + forces(s, state.hold, before, state.u) + case.push @ state.p
            begins -= state.hold.oil  # of their work sets grains in motion
            work -= 0.5 * float(begins @ (now.u - state.u))
        viscous = dt * float(pipe @ (middle[c.i] - middle[c.j]))
        viscous += dt * float(link @ (middle[c.link] - c.link_pressure))
        slip = _slipped(s, before, now.found) + damped_energy(state.hold, now.u)
        lifted = now.hold.overlap + s.dilation * now.found.slid - state.hold.overlap
        slip -= _lifting(before, now.found, lifted)
        jerks = _jerks(s, before, now.found)
        gain = self._energy(state.hold, now.found, now.u, now.p, mass) - self._energy(
            state.hold, before, state.u, state.p, state.mass
        )
        let_in = self._let_in(wells, given)
        let_in -= np.bincount(self.given.link_side, weights=dt * link, minlength=len(let_in))
        self.given_rate = given / dt
        off = np.where(now.vapour, 0.0, case.storage * now.p + case.pull @ now.u - mass)
        return book._replace(
            injected=book.injected + dt * float(wells.inflow.sum()),
            let_in=book.let_in + let_in,
            work=book.work + work,
            viscous=book.viscous + viscous,
            slip=book.slip + slip,
            jerks=book.jerks + jerks,
            astray=book.astray + abs(gain + viscous + slip + jerks - work),
            off=max(book.off, now.off),
            unbalanced=max(book.unbalanced, float(np.abs(off).max(initial=0.0))),
        )

    def _let_in(self, wells: Wells, given: Array) -> Array:
        """What wells that keep a pressure gave (d,), behind the sides, which gave nothing, (k,)."""
        found = np.zeros(self.keepers)
        if len(wells.keepers):
            found[-len(wells.keepers) :] = given[wells.keepers]
        return found

    def _energy(self, hold: Hold, found: Borne, u: Array, p: Array, mass: Array) -> float:
        """Energy stored in rock and fluid; a vapour's is the work that made room for it."""
        case = self.case
        vapour = case.storage * p + case.pull @ u - mass
        fluid = 0.5 * float(case.storage @ p**2)
        if np.isfinite(case.least_pressure):
            fluid -= case.least_pressure * float(vapour[p <= case.least_pressure].sum())
        return stored_energy(case.skeleton, hold, found, u) + fluid

    def _ruptured(self, state: State, fluid: Fluid, found: Borne | None, wells: Wells) -> State:
        """Break what is beyond its strength, one after the other; `found`: one has reached it."""
        s = self.case.skeleton
        while not state.stopped:
            now = borne(s, state.hold, state.u)
            tension, shear = load_factors(s, state.hold, now)
            worst = np.maximum(tension, shear)
            k = int(np.argmax(worst)) if len(worst) else -1
            if k < 0 or (worst[k] <= 1.0 and found is None):
                break
            found = None
            if len(self.events) >= MOST_BREAKS:
                what = f"more than {MOST_BREAKS} bonds broke by {state.time:.6g} s"
                return state._replace(stopped=what)
            mode = BROKEN_IN_TENSION if tension[k] >= shear[k] else BROKEN_IN_SHEAR
            held = broken(s, state.hold, now, state.u, k, mode)
            after = self._found(state, fluid, state.mass, hold=held)
            if not after.reached:
                return state._replace(
                    hold=held,
                    stopped=f"the rock finds no new balance once a bond breaks at {state.time:.6g} "
                    f"s, {self._place(k)}: it came apart there",
                )
            before = self._energy(state.hold, now, state.u, state.p, state.mass)
            mass = np.where(
                fluid.held, self.case.storage * after.p + self.case.pull @ after.u, state.mass
            )
            work = float(self.case.load @ (after.u - state.u))
            work += float(after.p @ (mass - state.mass))
            free = before + work - self._energy(held, after.found, after.u, after.p, mass)
            book = state.ledger
            state = state._replace(
                u=after.u,
                p=after.p,
                vapour=after.vapour,
                mass=mass,
                hold=remembered(s, after.hold, after.found, after.u),
                ledger=book._replace(
                    let_in=book.let_in + self._let_in(wells, mass - state.mass),
                    work=book.work + work,
                    released=book.released + free,
                    off=max(book.off, after.off),
                ),
            )
            self.events.append(Event(state.time, k, mode, free, self._pore(k, state.p)))
            state = self._begun(state, np.zeros(len(s.a), bool))
            state = self._held_together(state)
        return state

    def _held_together(self, state: State) -> State:
        """The state with what came free gripped, where that is little; else it stops."""
        s = self.case.skeleton
        free = _free(s, state.hold, borne(s, state.hold, state.u), self.given.grains)
        free &= state.hold.grip[:-2:3] < FIRM
        count = int(free.sum())
        if count > MOST_LOOSE:
            k, when = int(np.flatnonzero(free)[0]), f"at {state.time:.6g} s"
            what = f"a fragment came free {when}: {count} grains, number {k} among them"
            if count > 0.1 * len(free):
                what = f"the specimen came apart {when}: nothing holds {count} of its grains"
            return state._replace(stopped=what)
        if count:
            state = state._replace(hold=gripped(state.hold, free, state.u))
        return state._replace(stopped=self._ends(state))

    def _at_once(self, state: State, pressure: Array, wells: Wells) -> State:
        """Give wells that keep a pressure theirs."""
        return state._replace(p=pressure, rate=np.empty(0))

    def _pore(self, k: int, p: Array) -> int:
        """The pore of higher pressure beside a contact, −1 where no pipe runs there."""
        c = self.case.conduits
        (pipe,) = np.nonzero(c.contact == k)
        if not len(pipe):
            return -1
        i, j = int(c.i[pipe[0]]), int(c.j[pipe[0]])
        return i if p[i] >= p[j] else j

    def _place(self, k: int) -> str:
        s, unit = self.case.skeleton, self.case.unit
        return f"at ({unit * s.x[k]:.4g} m, {unit * s.y[k]:.4g} m) from the middle of the specimen"

    def _ends(self, state: State) -> str:
        """Why a march cannot go on from a state, or an empty word."""
        when = f"at {state.time:.6g} s"
        moved = np.abs(state.u - self.origin)
        moved[2:-2:3] = 0.0
        if moved.max() > RUNAWAY:
            return (
                f"the rock ran away {when}: grains moved by {moved.max():.2g} mean radii, more "
                "than displacements that are small beside grains"
            )
        volume = self._volume(state.u)
        if volume.min(initial=np.inf) < SQUEEZED:
            return f"a pore was squeezed to nothing {when}"
        return ""

    def _volume(self, u: Array) -> Array:
        """Volume of each pore over that at the start."""
        given = self.given
        own = given.network.volume[given.pore] / self.case.unit**2
        return np.asarray(1.0 + (self.case.pull @ (u - self.origin)) / own)


BORNE = ("cement_n", "cement_s", "cement_m", "slide", "normal")  # what load factors read


class Way:
    """Steps of any length from a state, by a parabola through those that were found nearest.

    Cement, slides and closed contacts are linear in the displacements, so that a parabola of what
    they bear tells of each when it breaks or begins to slide; the largest load factor of all has
    kinks where one takes over from another.
    """

    def __init__(self, skeleton: Skeleton, hold: Hold, u: Array, p: Array):
        self.skeleton, self.hold = skeleton, hold
        self.start = borne(skeleton, hold, u)
        self.found: list[tuple[float, tuple[Array, ...]]] = [(0.0, _seen(u, p, self.start))]

    def add(self, dt: float, now: Balanced) -> None:
        """Keep what a step of length dt, s, led to."""
        self.found.append((dt, _seen(now.u, now.p, now.found)))

    def _at(self, dt: float, which: slice) -> list[Array]:
        near = sorted(self.found, key=lambda one: abs(one[0] - dt))[:3]
        times = [one[0] for one in near]
        share = [
            float(np.prod([(dt - other) / (time - other) for other in times if other != time]))
            for time in times
        ]
        columns = zip(*(one[1][which] for one in near), strict=True)
        return [sum(w * f for w, f in zip(share, column, strict=True)) for column in columns]

    def guess(self, dt: float) -> tuple[Array, Array]:
        """Displacements and pressures after a step of length dt, s."""
        u, p = self._at(dt, slice(0, 2))
        return u, p

    def break_within(self, low: float, high: float) -> float:
        """When the first contact reaches its strength, s; `high` where none does by then."""
        for part in range(BISECTIONS + 1):
            dt = 0.5 * (low + high) if part else high
            seen = self.start._replace(
                **dict(zip(BORNE, self._at(dt, slice(2, None)), strict=True))
            )
            if _worst(self.skeleton, self.hold, seen) > 1.0:
                high = dt
            elif part:
                low = dt
            else:
                return high
        return 0.5 * (low + high)


def _seen(u: Array, p: Array, found: Borne) -> tuple[Array, ...]:
    return u, p, *(getattr(found, name) for name in BORNE)


def _worst(s: Skeleton, hold: Hold, found: Borne) -> float:
    """The largest load factor of cement, and of joint contacts that stick."""
    slides = float(slide_factors(s, hold, found).max(initial=0.0))
    return max(slides, _most_loaded(s, hold, found))


def _most_loaded(s: Skeleton, hold: Hold, found: Borne) -> float:
    """The largest load factor of cement."""
    return max(float(f.max(initial=0.0)) for f in load_factors(s, hold, found))


def _slipped(s: Skeleton, before: Borne, after: Borne) -> float:
    """Energy that sliding contacts lost from one state to another (`contact.laws.spent`)."""
    lost = np.divide((before.shear - after.shear), s.ks, out=np.zeros(len(s.ks)), where=s.ks > 0.0)
    slide = after.slide - before.slide
    return float(np.sum(0.5 * (before.shear + after.shear) * np.where(s.ks > 0.0, lost - slide, 0)))


def _lifting(before: Borne, after: Borne, lifted: Array) -> float:
    """Work of joints that dilated (c,) on the way, against what presses on them."""
    both = before.closed & after.closed
    return 0.5 * float((before.normal + after.normal)[both] @ lifted[both])


def _jerks(s: Skeleton, before: Borne, after: Borne) -> float:
    """Work on contacts by the trapezoidal rule less the energy that they gained, signed.

    Of those that are closed all the way nothing; else the force begins or ends within the step.
    """
    turns = before.closed != after.closed
    work = 0.5 * (before.normal + after.normal) * (before.part - after.part)
    gained = 0.5 * (after.normal**2 - before.normal**2) / s.kn
    return float(np.sum((work - gained)[turns]))


def _free(s: Skeleton, hold: Hold, found: Borne, bears: Array) -> Array:
    """Grains that no chain of contacts joins to a wall, (n,) bool, of those that once were."""
    n = len(bears)
    holds = (hold.mode == INTACT) | found.closed
    a, b = s.a[holds], s.b[holds]
    ends = np.where(b < 0, n, b)  # the walls are one
    graph = coo_array((np.ones(len(a)), (a, ends)), shape=(n + 1, n + 1))
    _, label = connected_components(graph, directed=False)
    return np.asarray(bears & (label[:n] != label[n]))
