"""Forces at the contacts between grains and between grains and walls.

Signs: n points from grain a to grain b (a < b), t is n turned by +90°. The force on b
is F_n n + F_s t, compression positive; the force on a is its opposite. The torque of the
contact is −l_a F_s on a and −l_b F_s on b, where the arms l = r − U_n / 2 end in the middle
of the overlap, so that l_a + l_b is the distance and angular momentum is kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.batches import BLOCK, push
from demflow.model.mechanics.contact.bonds import NO_BONDS, BondState
from demflow.model.mechanics.contact.energy import ELASTIC
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.joints import JointState, joint_forces
from demflow.model.mechanics.contact.law import Law, energy, press
from demflow.model.mechanics.contact.neighbours import Pairs

NO_WALLS = np.array([-np.inf, np.inf, -np.inf, np.inf])  # a box that nothing touches


class Sums(NamedTuple):
    """What one pass over the contacts adds up."""

    contacts: int  # grains that touch, are bonded or joined, and contacts with walls
    force: float  # Σ |F| over them
    unbalanced: float  # mean |F| over the grains on which anything acts
    virial_xx: float  # Σ F_x l_x with the actual branch vectors, compression positive
    virial_yy: float
    virial_xy: float
    load_xx: float  # Σ x L_x of the loads from outside, which the walls bear with the virial
    load_yy: float
    left: float  # force on each wall, outwards
    right: float
    bottom: float
    top: float
    left_contacts: int
    right_contacts: int
    bottom_contacts: int
    top_contacts: int


@kernel
def contact_forces(
    grains: Grains,
    pairs: Pairs,
    bonds: BondState,
    joints: JointState | None,
    law: Law,
    box: Array,
    step: int,
    dt: float,
    stretch_x: float,
    stretch_y: float,
    ledger: Array | None,
) -> Sums:
    """Set the forces and torques of all grains, and advance what contacts and bonds remember.

    The step that led to the present positions, the one numbered `step`, was `dt` times the
    velocities plus an affine stretch (strains in x and y, extension positive); shear forces grow
    by it. Walls xmin, xmax, ymin, ymax, `box` (4,), are frictionless and as stiff as the grains.
    A pair stands under its grain with the smaller index, so that the forces on a grain are
    complete when its row is done: the virial is Σ x F over the grains, less what the walls push.
    `ledger` counts energies where it is given.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    pairs : pairs of grains near each other, (m,)
    bonds : bonds (b,)
    joints : contacts (j,) across joints, or None
    law : law of contact, a named tuple that chooses what is done by its type
    box : walls xmin, xmax, ymin, ymax, (4,)
    step : number of the time step
    dt : time step
    stretch_x : affine strain of the step along x, extension positive
    stretch_y : the same along y
    ledger : energies (13,), see `energy`, or None
    """
    x, y, radius = grains.x, grains.y, grains.radius
    fx, fy, torque = grains.fx, grains.fy, grains.torque
    xmin, xmax, ymin, ymax = box[0], box[1], box[2], box[3]
    for i in range(x.size):
        fx[i] = grains.load_x[i]
        fy[i] = grains.load_y[i]
        torque[i] = grains.load_torque[i]
    if ledger is not None:
        ledger[ELASTIC] = 0.0
    contacts, force = 0, 0.0
    special = bonds.kind != NO_BONDS or ledger is not None
    if joints is not None:
        contacts, force = joint_forces(grains, joints, box, step, dt, stretch_x, stretch_y, ledger)
        special = special or joints.a.size > 0
    own = np.zeros((3, x.size))
    touching, pushed = push(
        own, grains, pairs, bonds, law, box, step, dt, stretch_x, stretch_y, special, ledger
    )
    contacts += touching
    force += pushed
    virial_xx = virial_yy = virial_xy = load_xx = load_yy = 0.0
    left = right = bottom = top = 0.0
    n_left = n_right = n_bottom = n_top = 0
    for i in range(x.size):
        xi, yi, ri = x[i], y[i], radius[i]
        fxi, fyi, ti = fx[i] + own[0, i], fy[i] + own[1, i], torque[i] + own[2, i]
        if xi - ri < xmin:
            fn = press(law, xmin - (xi - ri), ri)
            fxi += fn
            left += fn
            n_left += 1
            virial_xy -= 0.5 * fn * yi
        if xi + ri > xmax:
            fn = press(law, xi + ri - xmax, ri)
            fxi -= fn
            right += fn
            n_right += 1
            virial_xy += 0.5 * fn * yi
        if yi - ri < ymin:
            fn = press(law, ymin - (yi - ri), ri)
            fyi += fn
            bottom += fn
            n_bottom += 1
            virial_xy -= 0.5 * fn * xi
        if yi + ri > ymax:
            fn = press(law, yi + ri - ymax, ri)
            fyi -= fn
            top += fn
            n_top += 1
            virial_xy += 0.5 * fn * xi
        fx[i], fy[i], torque[i] = fxi, fyi, ti
        load_x, load_y = grains.load_x[i], grains.load_y[i]
        load_xx += xi * load_x
        load_yy += yi * load_y
        fxi -= load_x
        fyi -= load_y
        virial_xx += xi * fxi
        virial_yy += yi * fyi
        virial_xy += 0.5 * (xi * fyi + yi * fxi)
    if ledger is not None:
        ledger[ELASTIC] += wall_energy(grains, law, box)
    contacts += n_left + n_right + n_bottom + n_top
    force += left + right + bottom + top
    if n_left + n_right > 0:
        virial_xx += right * xmax - left * xmin
    if n_bottom + n_top > 0:
        virial_yy += top * ymax - bottom * ymin
    return Sums(
        contacts, force, mean_size(fx, fy, x.size), virial_xx, virial_yy, virial_xy,
        load_xx, load_yy, left, right, bottom, top, n_left, n_right, n_bottom, n_top,
    )  # fmt: skip


@kernel
def mean_size(fx: Array, fy: Array, count: int) -> float:
    """Mean |F| over those of the first grains on which anything acts.

    A loop of its own over blocks, so that the compiler takes several roots at a time.

    Parameters
    ----------
    fx, fy : forces, (n,)
    count : how many grains are looked at
    """
    size = np.empty(BLOCK)
    total, loaded = 0.0, 0
    for begin in range(0, count, BLOCK):
        some = min(BLOCK, count - begin)
        for q in range(some):
            i = np.uint64(begin + q)
            size[q] = np.sqrt(fx[i] * fx[i] + fy[i] * fy[i])
        for q in range(some):
            total += size[q]
            loaded += int(size[q] > 0.0)
    return total / max(loaded, 1)


@kernel
def wall_energy(grains: Grains, law: Law, box: Array) -> float:
    """Elastic energy of the contacts with walls.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    law : law of contact, a named tuple that chooses what is done by its type
    box : walls xmin, xmax, ymin, ymax, (4,)
    """
    total = 0.0
    for i in range(grains.x.size):
        x, y, r = grains.x[i], grains.y[i], grains.radius[i]
        for un in (box[0] - x + r, x + r - box[1], box[2] - y + r, y + r - box[3]):
            total += energy(law, un, r)
    return total
