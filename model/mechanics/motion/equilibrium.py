"""Grains brought to rest: the loop over steps between walls, and the driver around any such loop.

`Assembly` calls a loop again and again, and keeps the list of pairs that it needs; `Specimen` is
one between walls, `cell.Cell` one that repeats itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import InitVar, dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.bonds import INTACT, NO_BONDS, BondState, no_bonds
from demflow.model.mechanics.contact.contacts import Sums, contact_forces
from demflow.model.mechanics.contact.energy import (
    KINETIC,
    MOVED,
    Energies,
    energies,
    half_work,
    kinetic_energy,
    new_ledger,
)
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.joints import (
    Joints,
    JointState,
    Trace,
    among,
    any_of,
    no_joints,
)
from demflow.model.mechanics.contact.law import Law
from demflow.model.mechanics.contact.neighbours import (
    RAN_AWAY,
    Pairs,
    find_pairs,
    largest_displacement,
    no_pairs,
)
from demflow.model.mechanics.motion.bounds import (
    Walls,
    follow,
    follows_path,
    movers,
    off_target,
    stretch_bounds,
    swings_for_ever,
    unbalance,
    walls_of,
)
from demflow.model.mechanics.motion.motion import (
    START_MIXING,
    Fire,
    damped_velocities,
    fire_velocities,
    move,
)
from demflow.model.mechanics.motion.servo import (
    LEAD,
    STANDING,
    Servo,
    advanced,
    setpoint,
    stretches,
)
from demflow.model.outcome import ModelError

TIME_STEP = 0.5  # √(m/k): stable for six contacts a grain (`grains.scaled_mass`); 0.6 is not
SKIN = 0.3  # of the first list of pairs, in mean radii
NARROWEST, WIDEST = 0.01, 0.6  # of later ones
FIRE = -1.0  # in place of a coefficient of local damping: any below zero

# how a run ended; the driver looks after the last two
AT_REST, OUT_OF_STEPS, STRAINED, OSCILLATES, LIST_STALE, NOT_FINITE = range(6)


class Stop(NamedTuple):
    """When grains count as at rest, or as lost."""

    ratio: float  # mean unbalanced over mean contact force
    stress: float  # relative error of wall and mean stresses; infinite where no servo acts
    force: float = 0.0  # mean contact force below which nothing counts as touching
    strain: float = np.inf  # of the box since the run began, in x or y, at which to give up


CALMEST = 1e-4  # unbalance, over the contact force, below which paths do not gain by more calm
START = 1e-3  # the same, at which a path may start at most
START_STEPS = 300  # at most, to come to rest there
NEVER = Stop(ratio=0.0, stress=-1.0)  # no error is negative: all steps are taken


class Run(NamedTuple):
    """Where a loop stands; handed from call to call."""

    fire: Fire
    step: int = 0  # steps taken since the grains were put together
    dt: float = 0.0  # the last step, whose shear displacement the contacts have not seen; 0: none
    stretch_x: float = 0.0  # strains of that step
    stretch_y: float = 0.0
    since_x: float = 1.0  # stretch since the list of pairs was made
    since_y: float = 1.0
    age: int = 0  # steps since then
    strain_x: float = 0.0  # strain since the run began
    strain_y: float = 0.0
    progress: float = 0.0  # fraction of the stress path
    lead_x: float = 0.0  # mean strains of its steps, with which it goes on
    lead_y: float = 0.0
    ratio: float = np.inf  # mean unbalanced over mean contact force, when the run ended
    error: float = np.inf  # relative error of the stresses


@kernel
def advance(  # noqa: C901 (a kernel)
    grains: Grains,
    pairs: Pairs,
    bonds: BondState,
    joints: JointState | None,
    law: Law,
    bounds: Any,
    servo: Servo,
    stop: Stop,
    run: Run,
    dt: float,
    damping: float,
    slack: float,
    reach: float,
    lasts: int,
    steps: int,
    swings: Array,
    ledger: Array | None,
) -> tuple[int, int, Run, Sums]:
    """Step until at rest, until the list of pairs may be stale, or until a bound is met.

    `bounds` are the walls, which the servo moves, or a cell (see `bounds`); `dt` is the time
    step, at most this with FIRE. `damping` is the coefficient of local damping, or FIRE. `slack`
    is the distance that grains may move before the list is looked at again, and `reach` the one
    over which a stretch draws two that are not in it together: the largest radius and the skin;
    after `lasts` steps it is looked at anyway. `steps` is the most that are taken. `swings` (2, 4)
    is the memory of `servo.oscillates`. A `ledger` (see `energy`) is kept where it is given, which
    local damping allows. Returns (how it ended, steps taken, run, sums).

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    pairs : pairs of grains near each other, (m,)
    bonds : bonds (b,)
    joints : contacts (j,) across joints, or None
    law : law of contact, a named tuple that chooses what is done by its type
    bounds : walls or a cell, a named tuple that chooses by its type
    servo : what the walls are to do
    stop : when grains count as at rest
    run : how far the path has come, and FIRE’s state
    dt : time step, at most this with FIRE
    damping : coefficient of local damping, or FIRE
    slack : distance that grains may move before the list is looked at again
    reach : over which a stretch draws two grains that are in no pair: largest radius and skin
    lasts : steps after which the list is looked at again
    steps : most that are taken
    swings : memory (2, 4), see `servo.oscillates`
    ledger : energies (13,), see `energy`, or None
    """
    fire, last, stretch_x, stretch_y = run.fire, run.dt, run.stretch_x, run.stretch_y
    since_x, since_y, strain_x, strain_y = run.since_x, run.since_y, run.strain_x, run.strain_y
    progress, lead_x, lead_y = run.progress, run.lead_x, run.lead_y
    ratio, error = run.ratio, run.error
    box, moving = bounds.box, movers(bounds, grains)
    if not follows_path(bounds):
        progress = 1.0
    taken = 0
    while True:
        follow(bounds, grains)
        sums = contact_forces(
            grains, pairs, bonds, joints, law, walls_of(bounds), run.step + taken,
            last, stretch_x, stretch_y, ledger,
        )  # fmt: skip
        unbalanced = unbalance(bounds, grains, sums)
        if ledger is not None:
            walls = (sums.left, sums.right, sums.bottom, sums.top)
            half_work(ledger, grains, walls, last, stretch_x, stretch_y, True)
            ledger[KINETIC] = kinetic_energy(grains, dt)
        if not np.isfinite(sums.virial_xx + sums.virial_yy):  # Σ x F sees every grain
            end = NOT_FINITE
            break
        wanted_xx, wanted_yy = setpoint(servo, progress)
        if servo.gain > 0.0:
            error = off_target(bounds, servo, sums, wanted_xx, wanted_yy)
            if swings_for_ever(bounds, servo, swings, sums, wanted_xx, wanted_yy):
                end = OSCILLATES
                break
        mean = sums.force / max(sums.contacts, 1)
        if progress < 1.0:
            if error < servo.band:
                off = unbalanced / max(max(stop.ratio, CALMEST) * mean, 1e-300)
                progress = min(1.0, progress + advanced(servo, wanted_xx, wanted_yy, off))
        elif error <= stop.stress and (unbalanced <= stop.ratio * mean or mean < stop.force):
            end = AT_REST
            break
        if max(abs(strain_x), abs(strain_y)) > stop.strain:
            end = STRAINED
            break
        if taken >= steps:
            end = OUT_OF_STEPS
            break
        before = (box[0], box[1], box[2], box[3])
        if servo.gain > 0.0:
            if progress == 1.0:
                lead_x = lead_y = 0.0
            stretch_x, stretch_y = stretches(servo, sums, box, wanted_xx, wanted_yy, lead_x, lead_y)
            lead_x += LEAD * (stretch_x - lead_x)
            lead_y += LEAD * (stretch_y - lead_y)
            stretch_bounds(bounds, servo, sums, law.kn, wanted_xx, wanted_yy, stretch_x, stretch_y)
        if damping < 0.0:
            fire = fire_velocities(moving, fire, dt)
            last = fire.dt
        else:
            damped_velocities(moving, dt, damping, ledger)
            last = dt
        if ledger is not None:
            for side in range(4):
                ledger[MOVED + side] = box[side] - before[side]
            half_work(ledger, grains, walls, last, stretch_x, stretch_y, False)
        fastest = move(moving, last, stretch_x, stretch_y)
        since_x *= 1.0 + stretch_x
        since_y *= 1.0 + stretch_y
        strain_x += stretch_x
        strain_y += stretch_y
        slack -= last * np.sqrt(fastest) + reach * max(abs(stretch_x), abs(stretch_y))
        taken += 1
        if taken >= lasts or not slack >= 0.0:
            end = LIST_STALE
            break
    if end != LIST_STALE:  # the contacts have seen the last step
        last = stretch_x = stretch_y = 0.0
        ratio = unbalanced * sums.contacts / max(sums.force, 1e-300)
    run = Run(
        fire=fire, step=run.step + taken, dt=last, stretch_x=stretch_x, stretch_y=stretch_y,
        since_x=since_x, since_y=since_y, age=run.age + taken,
        strain_x=strain_x, strain_y=strain_y,
        progress=progress, lead_x=lead_x, lead_y=lead_y, ratio=ratio, error=error,
    )  # fmt: skip
    return end, taken, run, sums


def forces(
    grains: Grains,
    pairs: Pairs,
    bonds: BondState,
    joints: JointState,
    law: Law,
    box: Array,
    *,
    step: int = 0,
    dt: float = 0.0,
) -> Sums:
    """Set the forces of all grains in the present state, which stays; as `contact_forces` does.

    By the loop that steps, of which none is taken, so that a fresh machine compiles the laws of
    contact once.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    pairs : pairs of grains near each other, (m,)
    bonds : bonds (b,)
    joints : contacts (j,) across joints
    law : law of contact, a named tuple that chooses what is done by its type
    box : walls xmin, xmax, ymin, ymax, (4,)
    step : number of the step that led here
    dt : its time step, by which shear forces grow with the velocities
    """
    run = Run(Fire(TIME_STEP, START_MIXING, 0), step=step, dt=dt)
    found: Sums = advance(
        grains, pairs, bonds, any_of(joints), law, Walls(box), STANDING, NEVER, run, TIME_STEP, 0.0,
        np.inf, 0.0, 0, 0, np.zeros((2, 4)), None,
    )[3]  # fmt: skip
    return found


@dataclass
class Assembly(ABC):
    """Grains that are brought to rest; what bounds them, walls or a cell, is up to the kind.

    Lists of pairs are as wide as pays, where no `skin` is given: a wide one lasts long, but holds
    pairs that do not touch, which every step pays for. At v mean radii a step a list of width s
    lasts s / 2v steps; a step costs least, list and width together, at s = √(2 v `LIST_COST`).
    Forces do not depend on it.
    """

    # of making a list, over what a step costs more per width: mean radii times steps
    LIST_COST: ClassVar[float] = 7.0
    grains: Grains
    box: Array  # (4,) xmin, xmax, ymin, ymax
    law: Law
    dt: float = TIME_STEP
    skin: float | None = None  # of every list of pairs; None: what pays
    width: float = field(init=False)  # skin of the list as it stands
    pairs: Pairs = field(init=False)
    run: Run = field(init=False)
    sums: Sums = field(init=False)
    swings: Array = field(init=False)  # (2, 4) memory of `servo.oscillates`
    steps: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self.run = Run(Fire(self.dt, START_MIXING, 0))
        self.width = SKIN if self.skin is None else self.skin
        self.swings = np.zeros((2, 4))
        self._watched: Servo | None = None

    def relax(self, servo: Servo, stop: Stop, *, damping: float, steps: int) -> int:
        """Follow the servo's path until at rest.

        Returns AT_REST, OUT_OF_STEPS, STRAINED, or OSCILLATES where the servo overshoots for ever.
        Raises ModelError where a position or force is no finite number any more.

        `damping` is the coefficient of local damping, or FIRE.

        Parameters
        ----------
        servo : what the walls are to do
        stop : when grains count as at rest
        damping : coefficient of local damping, or FIRE
        steps : most that are taken
        """
        start = 0.0 if servo.gain > 0.0 else 1.0
        self.run = self.run._replace(
            strain_x=0.0,
            strain_y=0.0,
            progress=start,
            lead_x=0.0,
            lead_y=0.0,
            ratio=np.inf,
            error=np.inf,
        )
        slack = self._slack()
        if self._watched is not None and servo is not self._watched:
            self.swings = np.zeros((2, 4))  # one that goes on is watched on
        self._watched = servo
        left = steps
        while True:
            lasts = left + 1  # longer than it is asked to
            if self._fits_skin:
                lasts = max(1, int(self.LIST_COST / self.width) - self.run.age)
            end, taken, self.run, self.sums = self._advance(
                servo, stop, damping, slack, lasts, left
            )
            self.steps += taken
            left -= taken
            if end == NOT_FINITE:
                raise ModelError(RAN_AWAY)
            if end != LIST_STALE:
                return int(end)
            slack = self._slack()
            if taken >= lasts or not slack >= 0.1 * self.width:
                if self._fits_skin:
                    speed = max(0.5 * self.width - slack, 0.0) / self.run.age
                    best = float(np.sqrt(2.0 * speed * self.LIST_COST))
                    self.width = min(max(best, NARROWEST), WIDEST)
                self._begin_list()
                slack = 0.5 * self.width

    def list_within(self, reach: float) -> None:
        """Have the list hold all pairs that are closer than a reach now, not only those that pay.

        A list of a width that is given, or that bonds and joints hold, is left as it is.

        Parameters
        ----------
        reach : gap between two grains, mean radii
        """
        if self._fits_skin and 2.0 * self._slack() < reach:
            self.width = max(self.width, reach)
            self._begin_list()

    def _begin_list(self) -> None:
        """Make the list of pairs anew, and count from there."""
        self._list_pairs()
        self.run = self.run._replace(since_x=1.0, since_y=1.0, age=0)

    def stand_still(self) -> None:
        """Take all motion away."""
        for velocity in (self.grains.vx, self.grains.vy, self.grains.spin):
            velocity[:] = 0.0

    @abstractmethod
    def _advance(
        self, servo: Servo, stop: Stop, damping: float, slack: float, lasts: int, steps: int
    ) -> tuple[int, int, Run, Sums]:
        """Take steps, as `advance` does."""

    @abstractmethod
    def _list_pairs(self) -> None:
        """Make the list of pairs anew; what contacts, bonds and joints remember stays."""

    @property
    def _fits_skin(self) -> bool:
        """Whether lists are as wide as pays."""
        return self.skin is None

    def _reach(self) -> float:
        """Over which a stretch draws two grains that are in no pair."""
        return float(self.grains.radius.max()) + self.width

    def _slack(self) -> float:
        """How far grains may still move before the list of pairs can miss a contact."""
        since_x, since_y = self.run.since_x, self.run.since_y
        affine = self._reach() * max(abs(since_x - 1.0), abs(since_y - 1.0))
        moved = largest_displacement(self.grains, self.pairs, since_x, since_y)
        return 0.5 * self.width - affine - float(moved)


@dataclass
class Specimen(Assembly):
    """Grains in a box of four walls, with all that a run remembers between calls.

    `known` lists contacts that already have a shear force or a bond; `traces` are joints that
    are made now. The origin must lie inside the box, for it is the fixed point of the servo's
    stretch.
    """

    bonds: BondState = field(default_factory=no_bonds)
    known: InitVar[Pairs | None] = None
    traces: InitVar[Sequence[Trace]] = ()
    lines: Joints = field(init=False)  # the joints' traces
    joints: JointState = field(init=False)
    first_box: Array = field(init=False)  # as the specimen was made
    rebuilds: int = field(init=False, default=0)
    watch: Callable[[Specimen], object] | None = field(init=False, default=None)  # at each list
    ledger: Array | None = field(init=False, default=None)
    opening: Array | None = field(init=False, default=None)  # what it stood at when it was opened

    def __post_init__(self, known: Pairs | None, traces: Sequence[Trace]) -> None:
        super().__post_init__()
        if known is None:
            known = no_pairs(len(self.grains.x))
        self.pairs = find_pairs(self.grains, self.width, known)
        self.lines = Joints(traces, self.grains)
        self.joints = self.lines.join(self.grains, self.pairs, self.law, no_joints())
        self.first_box = self.box.copy()

    @property
    def idle_traces(self) -> int:
        """Joint traces that cross no contact: shorter than a grain, or outside the specimen."""
        return int(np.count_nonzero(~self.lines.found))

    def relax(self, servo: Servo, stop: Stop, *, damping: float, steps: int) -> int:
        """As every assembly does; a path that is paced starts from rest, by FIRE.

        Parameters
        ----------
        servo : what the walls are to do
        stop : when grains count as at rest
        damping : coefficient of local damping, or FIRE
        steps : most that are taken
        """
        if self.ledger is not None and damping < 0.0:
            raise ValueError("an energy ledger needs local damping, FIRE takes energy in leaps")
        if servo.gain > 0.0 and servo.pace < np.inf:
            steps -= self._come_to_rest_at_the_start(servo, stop, damping, steps)
        return super().relax(servo, stop, damping=damping, steps=steps)

    def open_ledger(self) -> None:
        """Count energies from here on; see `energy`."""
        self.ledger = new_ledger()
        self.relax(STANDING, NEVER, damping=0.0, steps=0)
        self.opening = self.ledger.copy()

    def energies(self) -> Energies:
        """The balance since the ledger was opened."""
        if self.ledger is None or self.opening is None:
            raise ValueError("the ledger was not opened")
        return energies(self.ledger, self.opening)

    def _come_to_rest_at_the_start(
        self, servo: Servo, stop: Stop, damping: float, steps: int
    ) -> int:
        """Steps taken; what is left is led away by the path. A ledger rules out FIRE."""
        first = self.steps
        hold = servo._replace(target_xx=servo.start_xx, target_yy=servo.start_yy, pace=np.inf)
        how = FIRE if self.ledger is None else damping
        rest = Stop(min(max(stop.ratio, CALMEST), START), max(stop.stress, CALMEST))
        self.relax(hold, rest, damping=how, steps=min(START_STEPS, steps))
        if self.ledger is None:
            self.stand_still()
        return self.steps - first

    def inherit_joints(self, whole: Specimen, kept: Array) -> None:
        """Have the joints of the specimen of which these grains are the ones `kept` (n,) bool."""
        self.lines = whole.lines.among(kept)
        known = among(whole.joints, kept)
        self.joints = self.lines.join(self.grains, self.pairs, self.law, known)

    def _advance(
        self, servo: Servo, stop: Stop, damping: float, slack: float, lasts: int, steps: int
    ) -> tuple[int, int, Run, Sums]:
        ended: tuple[int, int, Run, Sums] = advance(
            self.grains, self.pairs, self.bonds, any_of(self.joints), self.law, Walls(self.box),
            servo, stop,
            self.run, self.dt, damping, slack, self._reach(), lasts, steps, self.swings,
            self.ledger,
        )  # fmt: skip
        return ended

    @property
    def _fits_skin(self) -> bool:
        """Whether lists are as wide as pays: not where bonds or joints say who is in them."""
        return super()._fits_skin and self.bonds.kind == NO_BONDS and not self.lines.traces

    def _list_pairs(self) -> None:
        """As every assembly does.

        Raises ModelError where an intact bond was stretched beyond the reach of the list.
        """
        old, state = self.pairs.bond, self.bonds.state
        self.pairs = find_pairs(self.grains, self.width, self.pairs)
        listed = np.zeros(len(state), dtype=bool)
        listed[self.pairs.bond[self.pairs.bond >= 0]] = True
        old = old[old >= 0]
        if np.any(state[old[~listed[old]]] == INTACT):
            raise ModelError(
                f"a bond was stretched by more than {self.width:g} mean radii and did not break; "
                "try a bond modulus that is higher against the strengths"
            )
        self.joints = self.lines.join(self.grains, self.pairs, self.law, self.joints)
        self.rebuilds += 1
        if self.watch is not None:
            self.watch(self)
