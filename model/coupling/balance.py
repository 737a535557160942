"""One implicit step of rock and fluid together: forces balance, and every pore its volume.

Over a step Δt the displacement u of the grains and the pressures p, counted from those at the
start, satisfy

    f + A p + F(u) = 0
    C p + Aᵀ u = M₀ + Δt (q − G(u) p)

with F the forces of contacts (`skeleton`), A the push of the fluid (`duality`), and M the fluid
volume that each pore has gained, at the initial pressure. Δt = 0 keeps every pore's fluid where
it is, which is how a bond breaks. Newton's method takes the derivatives of friction and of
apertures along; equations are solved by `matrix`.

A pore may keep its pressure: that of a well, or the one at which its liquid turns to vapour, where
an option says so; then its fluid volume falls short of C p + Aᵀ u by that of the vapour.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array

from demflow.model.coupling.matrix import StepMatrix
from demflow.model.coupling.skeleton import (
    FIRM,
    Borne,
    Hold,
    Skeleton,
    borne,
    forces,
    remembered,
)
from demflow.model.mechanics.contact.bonds import INTACT
from demflow.model.mechanics.contact.grains import Array

MOST_ITERATIONS = 12
HALVINGS = 3  # of a step of it that does not come closer
TOLERANCE = 1e-8  # of forces over the mean contact force
STRICTER = 100.0  # volumes are held to it by so much more
ENOUGH = 1e-4  # where sliding contacts take turns, so that no iteration comes closer
EQUATION = 1e-5  # relative residual of the equations of Newton's method, at the strictest
LOOSEST = 1e-2  # and where what is not linear is larger (Eisenstat & Walker 1996, choice 2)
WAITS = 4  # iterations in which it has to come closer by half where a shorter step may do
OILS = (0.3, 0.1, 0.1, 0.03, 0.03, 0.01, 0.01, 0.01, 3e-3, 3e-3, 3e-3)  # grips, over k_n
THICKENED = 12  # times that it may be made thicker again
SETTLED = 1e-3  # force that they still bear, over the mean contact force
MOST_TURNS = 40  # of the limits of friction
MOST_DOWNHILL = 60  # steps of one turn
HALVED = 12  # times that one of them is shortened
FLAT = 0.1  # slope of the energy at its end, over that at its start
LONGEST = 0.1  # mean radii by which an iteration moves grains at most


class Conduits(NamedTuple):
    """What conducts: p pipes between pores, then q links to what keeps its pressure."""

    i: Array  # (p,) pore
    j: Array
    contact: Array  # (p,) between whose grains it runs, −1 a wall's
    wide: Array  # (p,) m: w0
    factor: Array  # (p,) conductance over w³, 1/(s m³) in units of the case
    half_force: Array  # (p,) in units of the case, infinite where forces do not count
    link: Array  # (q,) pore
    link_contact: Array
    link_wide: Array
    link_factor: Array
    link_half_force: Array
    link_pressure: Array  # (q,) kept at its other end


class Case(NamedTuple):
    """What stays in a march; in units of the mean radius and k_n, and of seconds."""

    unit: float  # m: the mean radius
    stiffness: float  # Pa: k_n
    skeleton: Skeleton
    load: Array  # (m,) by walls and by what lies outside the region
    push: csr_array  # A (m, d)
    pull: csr_array  # Aᵀ
    storage: Array  # (d,) C
    conduits: Conduits
    gap_factor: float
    widest: float  # m: an aperture beyond which it conducts no better
    matrix: StepMatrix
    least_pressure: float  # at which the liquid turns to vapour, −∞ without


class Fluid(NamedTuple):
    """What goes into the pores during a step, and which keep their pressure."""

    dt: float  # s
    inflow: Array  # (d,) from outside, a second
    held: Array  # (d,) bool


class Balanced(NamedTuple):
    """A state that was found, or the last one tried."""

    u: Array  # (m,)
    p: Array  # (d,)
    found: Borne
    net: Array  # (d,) volume that flowed into each pore
    vapour: Array  # (d,) bool: pores at the least pressure
    reached: bool
    off: float  # what is left, of forces over the mean contact force, and of volumes alike
    hold: Hold  # what contacts remembered before


class Openings(NamedTuple):
    """Apertures of pipes and links, and how they change by parting."""

    wide: Array
    by_parting: Array  # m per unit


def openings(case: Case, hold: Hold, found: Borne) -> tuple[Openings, Openings]:
    """Apertures of the pipes and of the links, m.

    Under compression w0 F0 / (F + F0), else w0 + m g with g the gap (Eqs 2, 3); w0 where cement
    still holds, which what little it stretches leaves as tight as it was. What a joint that dilates
    was lifted by as it slid parts its walls too, pressed together or not.

    Parameters
    ----------
    case : the specimen and its loads
    hold : what they remember
    found : what contacts bear there
    """
    c = case.conduits
    return (
        _apertures(case, hold, found, c.contact, c.wide, c.half_force),
        _apertures(case, hold, found, c.link_contact, c.link_wide, c.link_half_force),
    )


def _apertures(
    case: Case, hold: Hold, found: Borne, contact: Array, wide: Array, half: Array
) -> Openings:
    known = contact >= 0
    force = np.where(known, found.force[contact], 0.0)
    gap = np.where(known, (found.part - hold.overlap)[contact], 0.0)
    stiff = np.where(known, found.kn[contact], 0.0)
    finite = np.isfinite(half)
    f0 = np.where(finite, half, 1.0)
    share = np.where(finite & (force > 0.0), f0 / (f0 + np.maximum(force, 0.0)), 1.0)
    parts = (force <= 0.0) & (gap > 0.0) & ~(known & (hold.mode == INTACT)[contact])
    lifted = np.where(known, (case.skeleton.dilation * hold.slip)[contact], 0.0)
    opened = np.where(parts, wide + case.gap_factor * case.unit * gap, wide * share)
    opened += case.gap_factor * case.unit * lifted
    slope = np.where(parts, case.gap_factor * case.unit, 0.0)
    slope += np.where(finite & (force > 0.0), wide * share**2 / f0 * stiff, 0.0)
    free = opened < case.widest
    return Openings(np.where(free, opened, case.widest), np.where(free, slope, 0.0))


class Flow(NamedTuple):
    """Flows at a state, and how they change by parting."""

    pipe: Array  # (p,) from i to j, a second
    link: Array  # (q,) out of the pore
    conductance: Array  # (p + q,)
    by_parting: Array  # (p,) of the flow
    link_by_parting: Array


def flow(case: Case, hold: Hold, found: Borne, p: Array) -> Flow:
    """What flows at pressures p (d,), at the apertures of a state.

    Parameters
    ----------
    case : the specimen and its loads
    hold : what they remember
    found : what contacts bear there
    p : pressures, (n,) Pa
    """
    c = case.conduits
    pipes, links = openings(case, hold, found)
    g, h = c.factor * pipes.wide**3, c.link_factor * links.wide**3
    fall, link_fall = p[c.i] - p[c.j], p[c.link] - c.link_pressure
    steep = 3.0 * c.factor * pipes.wide**2 * pipes.by_parting
    link_steep = 3.0 * c.link_factor * links.wide**2 * links.by_parting
    return Flow(g * fall, h * link_fall, np.append(g, h), steep * fall, link_steep * link_fall)


def net_inflow(case: Case, pipe: Array, link: Array) -> Array:
    """Sum of flows into each pore, (d,).

    Parameters
    ----------
    case : the specimen and its loads
    pipe : flow along each pipe, m³/s
    link : flow along each link to a fixed pressure, m³/s
    """
    c, d = case.conduits, len(case.storage)
    net: Array = np.bincount(c.j, weights=pipe, minlength=d)
    net -= np.bincount(c.i, weights=pipe, minlength=d)
    net -= np.bincount(c.link, weights=link, minlength=d)
    return net


def balanced(
    case: Case, hold: Hold, u: Array, p: Array, mass: Array, fluid: Fluid, vapour: Array,
    *, patient: bool = True,
) -> Balanced:  # fmt: skip
    """Find the state after a step.

    Parameters
    ----------
    case : what stays.
    hold : what contacts remember of the start.
    u, p : a first guess, (m,) and (d,); pressures that are held are those of p.
    mass : (d,) fluid volume of each pore at the start.
    fluid : the step.
    vapour : (d,) bool, which pores are at the least pressure, as a first guess.
    patient : whether it goes on where it hardly comes closer.
    """
    s, m = case.skeleton, len(u)
    u, p, vapour = u.copy(), p.copy(), vapour.copy()
    scale = max(float(np.abs(case.load).max(initial=0.0)) * 1e-2, 1e-12)
    p[vapour] = case.least_pressure

    def state(u: Array, p: Array, vapour: Array) -> tuple[Borne, Flow, Array, Array, float]:
        found = borne(s, hold, u)
        moved = flow(case, hold, found, p)
        net = fluid.dt * (net_inflow(case, moved.pipe, moved.link) + fluid.inflow)
        force = case.load + forces(s, hold, found, u) + case.push @ p
        lack = mass + net - case.storage * p - case.pull @ u
        lack[fluid.held | vapour] = 0.0
        unit = max(float(np.mean(np.abs(found.force))), scale)
        # volumes have to be met; of forces ENOUGH may do
        off = max(
            float(np.abs(force).max(initial=0.0)) / unit,
            STRICTER * float(np.abs(lack).max(initial=0.0)) / unit,
        )
        return found, moved, net, np.concatenate([force, -lack]), off

    found, moved, net, residual, off = state(u, p, vapour)
    closest = Balanced(u, p, found, net, vapour, False, np.inf, hold)
    were, strict = [off], LOOSEST
    for iteration in range(MOST_ITERATIONS + 1):
        changed = _boils(case, fluid, u, p, mass, net, vapour)
        if changed is not None:
            vapour = changed
            p[vapour] = case.least_pressure
            found, moved, net, residual, off = state(u, p, vapour)
        elif off <= TOLERANCE:
            return Balanced(u, p, found, net, vapour, True, off, hold)
        elif off < closest.off:
            closest = Balanced(u, p, found, net, vapour, off <= ENOUGH, off, hold)
        if iteration == MOST_ITERATIONS or not np.isfinite(off):
            break
        if not patient and iteration > WAITS and off > 0.5 * were[-1 - WAITS]:
            break
        keeps = fluid.held | vapour
        stiffnesses = np.concatenate([found.kn, found.ks, found.km, hold.grip])
        upper = case.matrix.entries(stiffnesses, fluid.dt * moved.conductance, keeps)
        besides = _besides(case, found, moved, fluid.dt, keeps)
        step = case.matrix.solve(upper, besides, residual, strict)
        step[m:][keeps] = 0.0
        step *= min(1.0, LONGEST / max(float(np.abs(step[:m]).max()), 1e-300))
        for halving in range(HALVINGS + 1):
            share = 0.5**halving
            to = u + share * step[:m], p + share * step[m:]
            tried = state(*to, vapour)
            if tried[-1] < off:
                break
        (u, p), (found, moved, net, residual, off) = to, tried
        strict = float(np.clip(0.1 * (off / were[-1]) ** 2, EQUATION, LOOSEST))
        were.append(off)
    return closest


def by_turns(
    case: Case, hold: Hold, u: Array, p: Array, mass: Array, fluid: Fluid, vapour: Array
) -> Balanced:  # fmt: skip
    """The state after a step that Newton's method alone does not find, limits of friction by turns.

    With the limits of friction, what slip lifts and the conductances as they were in the turn
    before, forces are the slope of a convex energy: the way down is followed to where the energy
    turns, so that it always ends. Limits that depend on what they bring about settle in some turns
    (Panagiotopoulos 1975, Ing.-Arch. 44, 421). From there Newton's method goes on by itself.

    Parameters
    ----------
    case, hold, u, p, mass, fluid, vapour : as for `balanced`
    """
    s = case.skeleton
    now = borne(s, hold, u)
    limit, slid = s.friction * now.normal, now.slid
    for _ in range(MOST_TURNS):
        held = s._replace(
            friction=np.zeros_like(limit), dilation=np.zeros_like(limit), adhesion=limit
        )
        lifted = hold._replace(overlap=hold.overlap + s.dilation * slid)
        moved = flow(case, hold, borne(s, hold, u), p)
        u, p, found = _downhill(
            case._replace(skeleton=held), lifted, moved.conductance, u, p, mass, fluid, vapour
        )
        was, limit, slid = limit, s.friction * found.normal, found.slid
        unit = max(float(np.mean(np.abs(found.force))), 1e-300)
        if float(np.abs(limit - was).max(initial=0.0)) <= ENOUGH * unit:
            break
    return balanced(case, hold, u, p, mass, fluid, vapour)


def _downhill(
    case: Case, hold: Hold, conductance: Array, u: Array, p: Array, mass: Array, fluid: Fluid,
    vapour: Array,
) -> tuple[Array, Array, Borne]:  # fmt: skip
    """The lowest energy of a case without friction's coupling, pressures with it."""
    s, c, m, keeps = case.skeleton, case.conduits, len(u), fluid.held | vapour
    pipes = len(c.i)
    beside = csr_array((m + len(p), m + len(p)))

    def state(u: Array, p: Array) -> tuple[Borne, Array]:
        found = borne(s, hold, u)
        moved = conductance[:pipes] * (p[c.i] - p[c.j])
        link = conductance[pipes:] * (p[c.link] - c.link_pressure)
        net = fluid.dt * (net_inflow(case, moved, link) + fluid.inflow)
        lack = mass + net - case.storage * p - case.pull @ u
        lack[keeps] = 0.0
        return found, np.append(case.load + forces(s, hold, found, u) + case.push @ p, -lack)

    found, residual = state(u, p)
    for _ in range(MOST_DOWNHILL):
        unit = max(float(np.mean(np.abs(found.force))), 1e-300)
        if float(np.abs(residual).max(initial=0.0)) <= TOLERANCE * unit:
            break
        stiffnesses = np.concatenate([found.kn, found.ks, found.km, hold.grip])
        upper = case.matrix.entries(stiffnesses, fluid.dt * conductance, keeps)
        step = case.matrix.solve(upper, beside, residual, EQUATION)
        step[m:][keeps] = 0.0
        step[:m] = np.clip(step[:m], -LONGEST, LONGEST)  # what hangs free would go far
        fall, low, high, share = float(step[:m] @ residual[:m]), 0.0, 1.0, 1.0
        for _ in range(HALVED):  # to where the energy's slope has turned, nearly
            to = u + share * step[:m], p + share * step[m:]
            found, tried = state(*to)
            slope = float(step[:m] @ tried[:m])
            if abs(slope) <= FLAT * abs(fall) or (share == 1.0 and slope > 0.0):
                break
            low, high = (share, high) if slope > 0.0 else (low, share)
            share = 0.5 * (low + high)
        (u, p), residual = to, tried
    return u, p, found


def through_oil(
    case: Case,
    first: Hold,
    u: Array,
    p: Array,
    mass: Array,
    fluid: Fluid,
    vapour: Array,
    last: Balanced,
    *,
    patience: int = THICKENED,
) -> Balanced:
    """The state after a step that is not found at once, by way of thicker oil.

    Grains that hang on contacts which slide and open in turns are held more at first, and let go
    in several parts, as they would settle in a viscous fluid.

    Parameters
    ----------
    case, mass, fluid : as for `balanced`
    first : what contacts remember of the start
    u, p, vapour : the state at the start
    last : what was found without it
    patience : how often it is made thicker again, where a part is not found
    """
    memory, stages, thickened = first, list(reversed(OILS)), 0
    while stages:
        grip = stages.pop()
        thick = np.maximum(first.grip, grip)
        thick[-2:] = first.grip[-2:]
        place = np.where(first.grip < FIRM, u, first.place)
        memory = memory._replace(grip=thick, place=place)
        now = balanced(case, memory, u, p, mass, fluid, vapour)
        if not now.reached:
            thickened += 1
            if thickened > patience:
                return last
            stages += [grip, 2.0 * grip]
            continue
        held = float(np.abs((thick * (now.u - place))[first.grip < FIRM]).max())
        off = max(now.off, held / max(float(np.mean(np.abs(now.found.force))), 1e-300))
        own = memory._replace(grip=first.grip)
        last = now._replace(reached=off <= SETTLED, off=off, hold=own)
        memory = remembered(case.skeleton, memory, now.found, now.u)
        u, p, vapour = now.u, now.p, now.vapour
        if not stages and off > SETTLED and thickened < patience:
            thickened += 1
            stages = [grip]
    final = balanced(case, memory._replace(grip=first.grip), u, p, mass, fluid, vapour)
    return final if final.reached else last


def _besides(case: Case, found: Borne, moved: Flow, dt: float, keeps: Array) -> csr_array:
    """What friction and apertures add to the matrix, which is not symmetric, (m + d, m + d)."""
    s, c = case.skeleton, case.conduits
    m, d = case.push.shape
    (slips,) = np.nonzero(found.slips & (found.cross != 0.0))
    friction = _scaled(s.sliding, slips, found.cross).T @ s.parting[slips]
    (lifts,) = np.nonzero(found.lifts)
    if len(lifts):
        friction += _scaled(s.parting, lifts, found.lifts).T @ s.sliding[lifts]
    contact = np.append(c.contact, c.link_contact)
    slope = dt * np.append(moved.by_parting, moved.link_by_parting)
    (opens,) = np.nonzero((contact >= 0) & (slope != 0.0))
    ends = np.append(np.append(c.i, c.link)[opens], np.append(c.j, np.full(len(c.link), d))[opens])
    into = np.append(~keeps, False)[ends]  # a side stands behind the last pore
    values, place = np.append(-slope[opens], slope[opens]), np.tile(np.arange(len(opens)), 2)
    gains = coo_array((values[into], (ends[into], place[into])), shape=(d, len(opens)))
    gains = gains.tocsr() @ s.parting[contact[opens]]
    friction = csr_array(friction)
    rows = np.append(friction.indptr, friction.nnz + gains.indptr[1:])
    columns = np.append(friction.indices, gains.indices)
    added = csr_array((np.append(-friction.data, gains.data), columns, rows), shape=(m + d, m + d))
    added.sort_indices()
    return added


def _scaled(matrix: csr_array, which: Array, size: Array) -> csr_array:
    """Some rows of a matrix, each times its size."""
    rows = matrix[which]
    rows.data *= np.repeat(size[which], np.diff(rows.indptr))
    return rows


def _boils(
    case: Case, fluid: Fluid, u: Array, p: Array, mass: Array, net: Array, vapour: Array
) -> Array | None:
    """Which pores are at the least pressure, where that changes; None where it does not."""
    if not np.isfinite(case.least_pressure):
        return None
    spare = case.storage * p + case.pull @ u - (mass + net)  # volume of the vapour
    little = 1e-12 * float(np.abs(case.storage).max(initial=0.0))
    now = np.where(vapour, spare > -little, p < case.least_pressure) & ~fluid.held
    return None if np.array_equal(now, vapour) else now
