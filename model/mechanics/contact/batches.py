"""Contacts in blocks: gathered, loaded and handed back in loops of one idea each.

A block holds what BLOCK pairs see, a row a quantity, and stays in the nearest cache. The laws
run along its rows without a branch, so that the compiler takes several pairs at a time; only
gathering and handing back go pair by pair. Signs are those of `contacts`.
"""

from __future__ import annotations

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.bonds import (
    CONTACT_BONDS,
    INTACT,
    PARALLEL_BONDS,
    BondState,
    bond_state,
    load_parallel_bond,
    note_crack,
)
from demflow.model.mechanics.contact.energy import BREAKAGE, ELASTIC, JERKS, SLIP
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.law import (
    Law,
    energy,
    press,
    rolling_limit,
    rolling_stiffness,
    rolls,
    shear_stiffness,
)
from demflow.model.mechanics.contact.laws import (
    normal_force,
    shear_force,
    slip,
    spent,
    tangential_step,
)
from demflow.model.mechanics.contact.neighbours import JOINED, Pairs

BLOCK = 64
ROWS = 19
# Where the rows begin. What a pair sees: branch vector, its step, rotations in the step, radii,
# shear force so far
DX, DY, UX, UY, TURN_A, TURN_B, RADIUS_A, RADIUS_B, SHEAR = range(0, 9 * BLOCK, BLOCK)
# distance, unit normal, tangential step, arms
D, NX, NY, US, ARM_A, ARM_B = range(9 * BLOCK, 15 * BLOCK, BLOCK)
# what it carries: normal and shear force, moment of the bond, 1 where there is a contact
FN, FS, MOMENT, ACTS = range(15 * BLOCK, 19 * BLOCK, BLOCK)
# what it gives: force on b, torques on a and b, size of the force
FX, FY, TORQUE_A, TORQUE_B, FORCE = DX, DY, TURN_A, TURN_B, D


@kernel
def push(
    own: Array,
    grains: Grains,
    pairs: Pairs,
    bonds: BondState,
    law: Law,
    box: Array,
    step: int,
    dt: float,
    stretch_x: float,
    stretch_y: float,
    special: bool,
    ledger: Array | None,
) -> tuple[int, float]:
    """Add the forces of all pairs to their grains; returns the number of contacts and Σ |F|.

    What a grain gets from pairs under itself is summed on the way and stored in `own`, to be
    added later: one store a pair, which waits for none before it. Gathering and handing back
    stand here, since handing so many arrays to a function costs as much as a dozen pairs.

    Parameters
    ----------
    own : what grains get from pairs under themselves, (3, n), zeros
    grains : the grains (n,), in units of mean radius and k_n
    pairs : pairs of grains near each other, (m,)
    bonds : bonds (b,)
    law : law of contact, a named tuple that chooses what is done by its type
    box : walls xmin, xmax, ymin, ymax, (4,)
    step : number of the time step
    dt : time step
    stretch_x : affine strain of the step along x, extension positive
    stretch_y : the same along y
    special : whether there are bonds, joints or a ledger
    ledger : energies (13,), see `energy`, or None
    """
    x, y, radius = grains.x, grains.y, grains.radius
    vx, vy, spin = grains.vx, grains.vy, grains.spin
    fx, fy, torque = grains.fx, grains.fy, grains.torque
    one, other, shear = pairs.one, pairs.other, pairs.shear
    w = np.zeros(ROWS * BLOCK)
    contacts, force = 0, 0.0
    for begin in range(0, other.size, BLOCK):
        count = min(BLOCK, other.size - begin)
        for q in range(count):
            k = np.uint64(begin + q)
            i, j = np.uint64(one[k]), np.uint64(other[k])
            dx, dy = x[j] - x[i], y[j] - y[i]
            w[DX + q], w[DY + q] = dx, dy
            w[UX + q] = dt * (vx[j] - vx[i]) + stretch_x * dx
            w[UY + q] = dt * (vy[j] - vy[i]) + stretch_y * dy
            w[TURN_A + q], w[TURN_B + q] = dt * spin[i], dt * spin[j]
            w[RADIUS_A + q], w[RADIUS_B + q] = radius[i], radius[j]
        touch(w, shear, begin, count, law)
        if special:
            cement(w, grains, pairs, bonds, begin, count, law, box, step, ledger)
        resist_rolling(w, pairs, begin, count, law, special, ledger)
        contacts += project(w, count)
        i = last = np.uint64(one[np.uint64(begin)])
        ax, ay, at = own[0, i], own[1, i], own[2, i]
        for q in range(count):
            k = np.uint64(begin + q)
            i, j = np.uint64(one[k]), np.uint64(other[k])
            if i != last:
                ax = ay = at = 0.0
            last = i
            ax -= w[FX + q]
            ay -= w[FY + q]
            at += w[TORQUE_A + q]
            own[0, i], own[1, i], own[2, i] = ax, ay, at
            fx[j] += w[FX + q]
            fy[j] += w[FY + q]
            torque[j] += w[TORQUE_B + q]
            force += w[FORCE + q]
        for q in range(count):
            shear[np.uint64(begin + q)] = w[SHEAR + q]
    return contacts, force


@kernel
def touch(w: Array, shear: Array, begin: int, count: int, law: Law) -> None:
    """Forces of contacts with friction.

    Parameters
    ----------
    w : the block, (ROWS * BLOCK,)
    shear : shear forces of all pairs before the step, (m,)
    begin : first pair
    count : pairs in the block
    law : law of contact, a named tuple that chooses what is done by its type
    """
    mu = law.friction
    for q in range(count):
        dx, dy = w[DX + q], w[DY + q]
        d = np.sqrt(dx * dx + dy * dy)
        ra, rb = w[RADIUS_A + q], w[RADIUS_B + q]
        un, r = ra + rb - d, ra * rb / (ra + rb)
        apart = d > 0.0  # where centres coincide any direction parts them
        inverse = 1.0 / d if apart else 0.0
        nx, ny = dx * inverse if apart else 1.0, dy * inverse
        arm_a, arm_b = ra - 0.5 * un, rb - 0.5 * un
        us = tangential_step(
            w[UX + q], w[UY + q], nx, ny, inverse, w[TURN_A + q], w[TURN_B + q], arm_a, arm_b
        )
        fn = press(law, un, r)
        before = shear[np.uint64(begin + q)]
        fs = slip(shear_force(before, shear_stiffness(law, un, r), us), mu * fn)
        w[D + q], w[NX + q], w[NY + q], w[US + q] = d, nx, ny, us
        w[ARM_A + q], w[ARM_B + q] = arm_a, arm_b
        w[FN + q], w[FS + q], w[SHEAR + q] = fn, fs, fs
        w[ACTS + q] = 1.0 if un > 0.0 else 0.0


@kernel
def cement(  # noqa: C901 (a kernel)
    w: Array,
    grains: Grains,
    pairs: Pairs,
    bonds: BondState,
    begin: int,
    count: int,
    law: Law,
    box: Array,
    step: int,
    ledger: Array | None,
) -> None:
    """Let bonds act beside their contacts, leave joints to `joints`, and count energies.

    Parameters
    ----------
    w : the block, (ROWS * BLOCK,)
    grains : the grains (n,), in units of mean radius and k_n
    pairs : pairs of grains near each other, (m,)
    bonds : bonds (b,)
    begin : first pair
    count : pairs in the block
    law : law of contact, a named tuple that chooses what is done by its type
    box : walls xmin, xmax, ymin, ymax, (4,)
    step : number of the time step
    ledger : energies (13,), see `energy`, or None
    """
    for q in range(count):
        k = begin + q
        b = pairs.bond[k]
        w[MOMENT + q] = 0.0
        if b == JOINED:
            w[FN + q] = w[FS + q] = w[SHEAR + q] = w[ACTS + q] = 0.0
            continue
        if b >= 0 and bonds.state[b] != INTACT:
            b = -1
        if b < 0 and ledger is None:
            continue
        d, us = w[D + q], w[US + q]
        ra, rb = w[RADIUS_A + q], w[RADIUS_B + q]
        un, r = ra + rb - d, ra * rb / (ra + rb)
        ks = shear_stiffness(law, un, r)
        state = INTACT
        if b >= 0:
            w[ACTS + q] = 1.0
            if bonds.kind == CONTACT_BONDS:
                fn = normal_force(law.kn, bonds.length[b] - d)
                fs = shear_force(pairs.shear[k], ks, us)
                state = bond_state(bonds, b, fn, fs, 0.0)
                if state == INTACT:
                    w[FN + q], w[FS + q], w[SHEAR + q] = fn, fs, fs
                else:
                    bonds.state[b] = state
                    _note_crack(w, q, grains, pairs.one[k], bonds, b, step, box)
        if ledger is not None:
            dn = d - np.sqrt((w[DX + q] - w[UX + q]) ** 2 + (w[DY + q] - w[UY + q]) ** 2)
            fn, fs = w[FN + q], w[FS + q]
            before = pairs.shear[k]
            lost = _stored(before, shear_stiffness(law, un + dn, r)) - _stored(fs, ks)
            lost -= 0.5 * (before + fs) * us
            glued = b >= 0 and bonds.kind == CONTACT_BONDS
            if state != INTACT:
                kn = law.kn
                ledger[BREAKAGE] += lost + spent(kn * (bonds.length[b] - d + dn), fn, kn, dn)
            else:
                ledger[SLIP] += lost
                if not glued:
                    ledger[JERKS] += energy(law, un + dn, r) - energy(law, un, r)
                    ledger[JERKS] -= 0.5 * (press(law, un + dn, r) + fn) * dn
            held = 0.5 * fn * fn / law.kn if glued and state == INTACT else energy(law, un, r)
            ledger[ELASTIC] += held + _stored(fs, ks)
        if b >= 0 and bonds.kind == PARALLEL_BONDS:
            shear, moment = bonds.shear[b], bonds.moment[b]
            turn = w[TURN_B + q] - w[TURN_A + q]
            bn, bs, bm = load_parallel_bond(bonds, b, d, us, turn)
            state = bonds.state[b]
            if state != INTACT:
                _note_crack(w, q, grains, pairs.one[k], bonds, b, step, box)
            if ledger is not None:
                bkn, bks, bkr = bonds.kn[b], bonds.ks[b], bonds.kr[b]
                if state != INTACT:
                    ledger[BREAKAGE] += (
                        spent(bkn * (bonds.length[b] - d + dn), 0.0, bkn, dn)
                        + spent(shear, 0.0, bks, us)
                        + spent(moment, 0.0, bkr, turn)
                    )
                ledger[ELASTIC] += 0.5 * (bn * bn / bkn + bs * bs / bks + bm * bm / bkr)
            w[FN + q] += bn
            w[FS + q] += bs
            w[MOMENT + q] = bm


@kernel
def _stored(force: float, stiffness: float) -> float:
    """Elastic energy of a spring; one without stiffness carries nothing, but for round-off."""
    return 0.5 * force * force / stiffness if stiffness > 0.0 else 0.0


@kernel
def resist_rolling(
    w: Array, pairs: Pairs, begin: int, count: int, law: Law, special: bool, ledger: Array | None
) -> None:
    """Add the moments of contacts that resist rolling to those of bonds, where there are any.

    Parameters
    ----------
    w : the block, (ROWS * BLOCK,)
    pairs : pairs of grains near each other, (m,)
    begin : first pair
    count : pairs in the block
    law : law of contact, a named tuple that chooses what is done by its type
    special : whether bonds have moments there already
    ledger : energies (13,), see `energy`, or None
    """
    if not rolls(law):
        return
    for q in range(count):
        k = begin + q
        ra, rb = w[RADIUS_A + q], w[RADIUS_B + q]
        un, r = ra + rb - w[D + q], ra * rb / (ra + rb)
        fn = press(law, un, r) if pairs.bond[k] != JOINED else 0.0
        kr = rolling_stiffness(law, un, r)
        turn = w[TURN_B + q] - w[TURN_A + q]
        before = pairs.moment[k]
        moment = slip(before - kr * turn, rolling_limit(law, fn, r))
        pairs.moment[k] = moment
        w[MOMENT + q] = moment + (w[MOMENT + q] if special else 0.0)
        if ledger is not None:
            ledger[SLIP] += spent(before, moment, kr, turn)
            ledger[ELASTIC] += _stored(moment, kr)


@kernel
def _note_crack(
    w: Array, q: int, grains: Grains, a: int, bonds: BondState, b: int, step: int, box: Array
) -> None:
    x, y = grains.x[a] + w[ARM_A + q] * w[NX + q], grains.y[a] + w[ARM_A + q] * w[NY + q]
    note_crack(bonds.cracks, b, bonds.state[b], step, x, y, box)


@kernel
def project(w: Array, count: int) -> int:
    """Forces and torques on the grains of each pair; returns the number of contacts."""
    contacts = 0
    for q in range(count):
        fn, fs, nx, ny = w[FN + q], w[FS + q], w[NX + q], w[NY + q]
        w[FX + q], w[FY + q] = fn * nx - fs * ny, fn * ny + fs * nx
        w[TORQUE_A + q] = -w[ARM_A + q] * fs - w[MOMENT + q]
        w[TORQUE_B + q] = w[MOMENT + q] - w[ARM_B + q] * fs
        w[FORCE + q] = np.sqrt(fn * fn + fs * fs)
        contacts += int(w[ACTS + q])
    return contacts
