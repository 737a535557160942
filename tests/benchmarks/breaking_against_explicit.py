"""A fracturing run of 1,440 grains to its first break against explicit steps of grains and fluid.

The same loaded rock, hole, contacts, pipes, injection and strengths. Grains have their mass at
2,700 kg/m³ and are damped locally (0.7; Cundall 1987); each step moves them by the leap-frog rule,
lets the fluid flow, and takes the pressure of each pore from what it holds and from its new volume.
Steps are 0.8 of the longest stable ones, of the rock with its pores sealed and of the flow. No mass
is scaled: a step of time is one of the grains. Both have to find the same contact first, at the
same time; what is compared is CPU time from the loaded rock on, with all kernels compiled.

Explicit steps pay for the time that passes, the march for what happens in it, so that their ratio
goes as that time: filling the hole at 0.3 l/s for each metre, which is fast in a field, takes some
seconds to break it. Both run whole. The march's steps have an error of 0.3 %: at its default of 1 %
it finds the break of a test at 1 l/s 1.3 % later than explicit steps do.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import eigsh

from demflow.model.coupling import breaking
from demflow.model.coupling.balance import openings
from demflow.model.coupling.breaking import March, State, Wells
from demflow.model.coupling.setting import Setting, setting
from demflow.model.coupling.skeleton import borne
from demflow.model.mechanics.contact.bonds import INTACT
from demflow.model.products import Packing
from demflow.model.stages import STAGES, run_stages
from tests.benchmarks.breaking_keeps_its_books import bored
from tests.benchmarks.result import Result

DENSITY, DAMPING, SAFETY = 2700.0, 0.7, 0.8
FASTER, SAME = 50.0, 0.01
CHUNK = 20_000  # steps
MOST = 4_000_000  # of them
SHARE = 0.3  # of the rate of `breaking_keeps_its_books`
STEP_ERROR = 3e-3
END = 1.3  # s, after the first break
FRESH = 1.0001  # of the time of the first break, to which the timed march goes

Array = np.ndarray


class Loaded(NamedTuple):
    """A rock that is loaded, with its well at work."""

    packing: Packing
    given: Setting
    march: March
    state: State
    wells: Wells


def loaded(share: float = SHARE) -> Loaded:
    """The scene of `breaking_keeps_its_books` at a share of its rate, before it begins."""
    scene = bored(1)
    packing = run_stages(scene)["pack"]
    stage = next(s for s in STAGES if s.name == "fracture")
    told = stage.given(scene, 0)
    given = setting(packing, None, rock=told["rock"], wet=told["wet"], wells=told["wells"])
    march = March(given, given.u, len(told["wet"].sides), STEP_ERROR)
    state = march.drained(breaking.start(given, len(told["wet"].sides)))
    march.origin = state.u
    d = len(given.case.storage)
    inflow = np.zeros(d)
    inflow[given.well] = [-share * well.rate / given.case.unit**2 for well in scene.wells]
    nothing = np.zeros(d, bool), np.zeros(d), np.empty(0, np.int64)
    return Loaded(packing, given, march, state, Wells(inflow, *nothing))


class Grainwise(NamedTuple):
    """Contacts as the steps read them: grains, walls behind them; normal, arms, law, cement."""

    a: Array
    b: Array
    nx: Array
    ny: Array
    arm_a: Array
    arm_b: Array
    overlap: Array
    kn: Array
    ks: Array
    friction: Array
    beside: Array
    cn: Array
    cs: Array
    cm: Array
    cement_n: Array
    cement_s: Array
    cement_m: Array
    half: Array
    tension: Array
    cohesion: Array
    cement_friction: Array


def grainwise(given: Setting, state: State, n: int) -> Grainwise:
    """Of a specimen without joints, at a state; walls are bodies n (fixed), right and top."""
    s, hold = given.case.skeleton, state.hold
    assert not s.joint.any()
    part, slide = s.parting.tocoo(), s.sliding.tocoo()
    c = len(s.a)
    wall = s.b < 0
    body = np.where(s.b >= 0, s.b, np.where(s.b == -2, n + 1, np.where(s.b == -4, n + 2, n)))
    on_a = 3 * s.a

    def taken(matrix: csr_array, column: Array) -> Array:
        rows, columns, values = matrix.row, matrix.col, matrix.data
        here = columns == column[rows]
        return np.bincount(rows[here], weights=values[here], minlength=c)

    intact = (hold.mode == INTACT).astype(float)
    return Grainwise(
        a=s.a,
        b=body,
        nx=-taken(part, on_a),
        ny=-taken(part, on_a + 1),
        arm_a=-taken(slide, on_a + 2),
        arm_b=np.where(wall, 0.0, -taken(slide, 3 * np.maximum(s.b, 0) + 2)),
        overlap=hold.overlap,
        kn=s.kn,
        ks=s.ks,
        friction=s.friction,
        beside=s.beside | (hold.mode != INTACT),
        cn=s.cn * intact,
        cs=s.cs * intact,
        cm=s.cm * intact,
        cement_n=s.cement_n * intact,
        cement_s=s.cement_s * intact,
        cement_m=s.cement_m * intact,
        half=s.half_width,
        tension=np.where(intact > 0.0, s.tensile_strength, np.inf),
        cohesion=np.where(intact > 0.0, s.shear_strength, np.inf),
        cement_friction=s.cement_friction,
    )


@njit(nogil=True, error_model="numpy")
def contact_step(g, u, shear, slid, gap, force):  # type: ignore[no-untyped-def]
    """Add the forces of all contacts; the largest load factor of cement, and whose it is."""
    worst, where = 0.0, -1
    for k in range(len(g.a)):
        a, b = 3 * g.a[k], 3 * g.b[k]
        nx, ny = g.nx[k], g.ny[k]
        x, y = u[b] - u[a], u[b + 1] - u[a + 1]
        part = nx * x + ny * y
        slide = nx * y - ny * x - g.arm_a[k] * u[a + 2] - g.arm_b[k] * u[b + 2]
        bend = u[b + 2] - u[a + 2]
        normal, along = 0.0, 0.0
        overlap = g.overlap[k] - part
        gap[k] = -overlap
        if g.beside[k] and overlap > 0.0:
            normal = g.kn[k] * overlap
            along = shear[k] - g.ks[k] * (slide - slid[k])
            along = min(max(along, -g.friction[k] * normal), g.friction[k] * normal)
        shear[k], slid[k] = along, slide
        half = g.half[k]
        cement_n = g.cement_n[k] - g.cn[k] * part
        cement_s = g.cement_s[k] - g.cs[k] * slide
        moment = g.cement_m[k] - g.cm[k] * bend
        tension = (-cement_n / (2.0 * half) + 1.5 * abs(moment) / half**2) / g.tension[k]
        holds = g.cohesion[k] + g.cement_friction[k] * max(cement_n, 0.0) / (2.0 * half)
        load = max(tension, abs(cement_s) / (2.0 * half) / holds)
        if load > worst:
            worst, where = load, k
        n, t = normal + cement_n, along + cement_s
        fx, fy = n * nx - t * ny, n * ny + t * nx
        force[a] -= fx
        force[a + 1] -= fy
        force[a + 2] -= t * g.arm_a[k] + moment
        force[b] += fx
        force[b + 1] += fy
        force[b + 2] += moment - t * g.arm_b[k]
    return worst, where


@njit(nogil=True, error_model="numpy")
def conductance(k, conduits, gap):  # type: ignore[no-untyped-def]
    """Of a pipe at the gap of its contact, where that opens it."""
    contact, factor, wide, gain, widest = conduits
    opened = wide[k]
    if gain[k] > 0.0:
        opened += gain[k] * max(gap[contact[k]], 0.0)
    return factor[k] * min(opened, widest) ** 3


@njit(nogil=True, error_model="numpy")
def march(  # type: ignore[no-untyped-def]
    g, u, v, shear, slid, mass, p, inverse_mass, load, push, pull, storage, pipes, links, inflow,
    dt, damping, steps,
):  # fmt: skip
    """Steps until cement reaches its strength: (steps taken, contact or −1)."""
    i, j = pipes[0], pipes[1]
    force, gap = np.zeros(len(u)), np.zeros(len(g.a))
    for step in range(steps):
        force[:] = load
        for row in range(len(push[1]) - 1):
            total = 0.0
            for entry in range(push[1][row], push[1][row + 1]):
                total += push[2][entry] * p[push[0][entry]]
            force[row] += total
        worst, where = contact_step(g, u, shear, slid, gap, force)
        if worst > 1.0:
            return step, where
        for m in range(len(u)):
            damped = force[m] - damping * abs(force[m]) * np.sign(v[m])
            v[m] += dt * inverse_mass[m] * damped
            u[m] += dt * v[m]
        for k in range(len(i)):
            moved = dt * conductance(k, pipes[2:], gap) * (p[i[k]] - p[j[k]])
            mass[i[k]] -= moved
            mass[j[k]] += moved
        for k in range(len(links[0])):
            d = links[0][k]
            mass[d] -= dt * conductance(k, links[2:], gap) * (p[d] - links[1][k])
        for d in range(len(p)):
            mass[d] += dt * inflow[d]
            volume = 0.0
            for entry in range(pull[1][d], pull[1][d + 1]):
                volume += pull[2][entry] * u[pull[0][entry]]
            p[d] = (mass[d] - volume) / storage[d]
    return steps, -1


class Steps(NamedTuple):
    """What explicit steps came to."""

    time: float  # s: of the first break
    contact: int
    taken: int
    dt: float  # s
    seconds: float  # of CPU


def explicit(rock: Loaded) -> Steps:
    """March from the loaded rock to its first break."""
    given, state, packing = rock.given, rock.state, rock.packing
    case, s, n = given.case, given.case.skeleton, len(packing.x)
    g = grainwise(given, state, n)
    # bodies of three unknowns: grains, what is fixed, the right and the top wall
    spread = np.concatenate([np.arange(3 * n), [3 * n + 3, 3 * n + 7]])
    size = 3 * (n + 3)

    def filled(values: Array) -> Array:
        found = np.zeros(size)
        found[spread] = values
        return found

    grain = DENSITY * math.pi * packing.radius**2 / case.stiffness  # s²
    inertia = 0.5 * grain * (packing.radius / case.unit) ** 2
    own = np.column_stack([grain, grain, inertia]).ravel()
    row = math.sqrt(n) * grain.mean()
    bears = np.append(np.repeat(given.grains, 3), [True, True])
    inverse = np.where(bears, 1.0 / np.append(own, [row, row]), 0.0)
    found = borne(s, state.hold, state.u)
    wide, link_wide = (o.wide for o in openings(case, state.hold, found))
    c = case.conduits
    conducts, link_conducts = c.factor * wide**3, c.link_factor * link_wide**3
    dt = SAFETY * min(_of_rock(rock, inverse), _of_flow(rock, conducts, link_conducts))
    pipes = c.i, c.j, *_opening(rock, c.contact, c.factor, c.wide)
    links = c.link, c.link_pressure, *_opening(rock, c.link_contact, c.link_factor, c.link_wide)
    to = csr_array((np.ones(len(spread)), (spread, np.arange(len(spread)))), (size, len(spread)))
    push, pull = (to @ case.push).tocsr(), (case.pull @ to.T).tocsr()
    u, v = filled(state.u), np.zeros(size)
    shear, slid = state.hold.shear.copy(), state.hold.slid.copy()
    mass, p = state.mass.copy(), state.p.copy()
    fixed = (
        filled(inverse), filled(case.load), _rows(push), _rows(pull), case.storage, pipes, links,
        rock.wells.inflow, dt, DAMPING,
    )  # fmt: skip
    march(g, u, v, shear, slid, mass, p, *fixed, 0)
    begin, taken, contact = time.process_time(), 0, -1
    while contact < 0 and taken < MOST:
        now, contact = march(g, u, v, shear, slid, mass, p, *fixed, CHUNK)
        taken += now
    return Steps(taken * dt, int(contact), taken, dt, time.process_time() - begin)


def _opening(
    rock: Loaded, contact: Array, factor: Array, wide: Array
) -> tuple[Array, Array, Array, Array, float]:
    """What says how a gap opens conduits: forces do not count here, intact cement stays tight."""
    case = rock.given.case
    assert np.isinf(case.conduits.half_force).all()
    parts = (contact >= 0) & (rock.state.hold.mode[contact] != INTACT)
    return contact, factor, wide, np.where(parts, case.gap_factor * case.unit, 0.0), case.widest


def _rows(matrix: csr_array) -> tuple[Array, Array, Array]:
    return matrix.indices.astype(np.int64), matrix.indptr.astype(np.int64), matrix.data


def _of_rock(rock: Loaded, inverse: Array) -> float:
    """Longest stable step (s) of the rock with its pores sealed: 2 over the largest frequency."""
    case = rock.given.case
    s = case.skeleton
    found = borne(s, rock.state.hold, rock.state.u)
    root = diags_array(np.sqrt(inverse))
    strains = [
        diags_array(np.sqrt(k)) @ b @ root
        for k, b in ((found.kn, s.parting), (found.ks, s.sliding), (found.km, s.bending))
    ]
    strains.append(diags_array(1.0 / np.sqrt(case.storage)) @ case.pull @ root)
    return 2.0 / math.sqrt(_largest(sum((b.T @ b for b in strains[1:]), strains[0].T @ strains[0])))


def _of_flow(rock: Loaded, conducts: Array, link_conducts: Array) -> float:
    """The same of the flow between pores that keep their volumes."""
    case = rock.given.case
    c, d = case.conduits, len(case.storage)
    p = np.arange(len(c.i))
    falls = csr_array(
        (np.append(np.ones(len(p)), -np.ones(len(p))), (np.append(p, p), np.append(c.i, c.j))),
        (len(p), d),
    )
    root = diags_array(1.0 / np.sqrt(case.storage))
    kept = diags_array(np.bincount(c.link, weights=link_conducts, minlength=d))
    return 2.0 / _largest(root @ (falls.T @ diags_array(conducts) @ falls + kept) @ root)


def _largest(matrix: csr_array) -> float:
    """Largest eigenvalue of a symmetric matrix."""
    return float(eigsh(matrix, k=1, which="LA", return_eigenvectors=False, tol=1e-3)[0])


class Broke(NamedTuple):
    """What the march came to."""

    time: float  # s: of the first break
    contact: int
    seconds: float  # of CPU
    told: str


def implicit(share: float = SHARE) -> Broke:
    """March from the loaded rock to its first break; timed once that is known."""
    rock = loaded(share)
    rock.march.to(rock.state, END / share, rock.wells)
    first = next(e for e in rock.march.events if e.time > 0.0)
    rock = loaded(share)
    begin = time.process_time()
    rock.march.to(rock.state, FRESH * first.time, rock.wells)
    seconds = time.process_time() - begin
    told = (
        f"{seconds:.2f} s of CPU for {rock.march.solves} balances with "
        f"{rock.given.case.matrix.factored} factorisations"
    )
    return Broke(first.time, first.contact, seconds, told)


def run(share: float = SHARE) -> Result:
    """Both to the first break."""
    found, slow = implicit(share), explicit(loaded(share))
    off, faster = abs(found.time / slow.time - 1.0), slow.seconds / found.seconds
    return Result(
        f"{faster:.0f} times faster, first breaks {off:.2%} apart",
        f"≥ {FASTER:g}; ≤ {SAME:.0%}, the same contact",
        bool(faster >= FASTER and off <= SAME and found.contact == slow.contact),
        f"{share:g} l/s: first break at {found.time:.5f} s, contact {found.contact}; explicit at "
        f"{slow.time:.5f} s, contact {slow.contact}\n"
        f"march: {found.told}\nexplicit: {slow.seconds:.1f} s of CPU for {slow.taken} steps of "
        f"{slow.dt:.3g} s, {1e6 * slow.seconds / slow.taken:.0f} µs each",
    )
