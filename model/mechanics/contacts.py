"""Forces at the contacts between grains and between grains and walls.

Signs: n points from grain a to grain b (a < b), t is n turned by +90°. The force on b
is F_n n + F_s t, compression positive; the force on a is its opposite. The torque of the
contact is −l_a F_s on a and −l_b F_s on b, where the arms l = r − U_n / 2 end in the middle
of the overlap, so that l_a + l_b is the distance and angular momentum is kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.compile import kernel
from model.mechanics.bonds import (
    CONTACT_BONDS,
    INTACT,
    NO_BONDS,
    PARALLEL_BONDS,
    BondState,
    bond_state,
    load_parallel_bond,
    note_crack,
)
from model.mechanics.energy import BREAKAGE, ELASTIC, JERKS, SLIP
from model.mechanics.grains import Array, Grains
from model.mechanics.joints import JointState, joint_forces
from model.mechanics.laws import normal_force, shear_force, slip, spent, tangential_step
from model.mechanics.neighbours import JOINED, Pairs


class ContactLaw(NamedTuple):
    """Linear contact with Coulomb friction; stiffnesses in force per length."""

    kn: float
    ks: float
    friction: float


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
    joints: JointState,
    law: ContactLaw,
    box: Array,
    step: int,
    dt: float,
    stretch_x: float,
    stretch_y: float,
    ledger: Array | None,
) -> Sums:
    """Set the forces and torques of all grains, and advance what contacts and bonds remember.

    The step that led to the present positions, the one numbered `step`, was `dt` times the
    velocities plus an affine stretch; shear forces grow by it. Walls are frictionless and as
    stiff as the grains. A pair stands under its grain with the smaller index, so that the
    forces on a grain are complete when its row is done: the virial is Σ x F over the grains,
    less what the walls push. `ledger` counts energies where it is given.
    """
    x, y, radius = grains.x, grains.y, grains.radius
    vx, vy, spin = grains.vx, grains.vy, grains.spin
    fx, fy, torque = grains.fx, grains.fy, grains.torque
    kn, ks, mu = law.kn, law.ks, law.friction
    xmin, xmax, ymin, ymax = box[0], box[1], box[2], box[3]
    for i in range(x.size):
        fx[i] = grains.load_x[i]
        fy[i] = grains.load_y[i]
        torque[i] = grains.load_torque[i]
    if ledger is not None:
        ledger[ELASTIC] = 0.0
    contacts, force = 0, 0.0
    if joints.a.size > 0:
        contacts, force = joint_forces(grains, joints, box, step, dt, stretch_x, stretch_y, ledger)
    special = bonds.kind != NO_BONDS or joints.a.size > 0
    virial_xx = virial_yy = virial_xy = load_xx = load_yy = 0.0
    unbalanced, loaded = 0.0, 0
    left = right = bottom = top = 0.0
    n_left = n_right = n_bottom = n_top = 0
    for i in range(x.size):
        xi, yi, ri = x[i], y[i], radius[i]
        vxi, vyi, wi = vx[i], vy[i], spin[i]
        fxi, fyi, ti = fx[i], fy[i], torque[i]
        for k in range(pairs.start[i], pairs.start[i + 1]):
            j = np.uint64(pairs.other[k])  # a signed index would be checked against zero
            dx, dy = x[j] - xi, y[j] - yi
            reach = ri + radius[j]
            d2 = dx * dx + dy * dy
            b = -1
            if special:
                b = pairs.bond[k]
                if b == JOINED:
                    continue
                if b >= 0 and bonds.state[b] != INTACT:
                    b = -1
            if d2 >= reach * reach and b < 0 and ledger is None:
                pairs.shear[k] = 0.0
                continue
            d = np.sqrt(d2)
            un = reach - d
            if d > 0.0:
                inverse = 1.0 / d
                nx, ny = dx * inverse, dy * inverse
            else:  # centres coincide: any direction parts them
                inverse, nx, ny = 0.0, 1.0, 0.0
            li, lj = ri - 0.5 * un, radius[j] - 0.5 * un
            ux = dt * (vx[j] - vxi) + stretch_x * dx
            uy = dt * (vy[j] - vyi) + stretch_y * dy
            us = tangential_step(ux, uy, nx, ny, inverse, dt * wi, dt * spin[j], li, lj)
            fn = normal_force(kn, un)
            fs = shear_force(pairs.shear[k], ks, us)
            glued = False
            if b >= 0 and bonds.kind == CONTACT_BONDS:
                fn = normal_force(kn, bonds.length[b] - d)
                state = bond_state(bonds, b, fn, fs, 0.0)
                glued = state == INTACT
                if not glued:
                    fn = normal_force(kn, un)
                    bonds.state[b] = state
                    note_crack(bonds.cracks, b, state, step, xi + li * nx, yi + li * ny, box)
            if not glued:
                fn = max(fn, 0.0)
                fs = slip(fs, mu * fn)
            if ledger is not None:
                lost = spent(pairs.shear[k], fs, ks, us)
                if b >= 0 and bonds.kind == CONTACT_BONDS and not glued:
                    dn = d - np.sqrt((dx - ux) * (dx - ux) + (dy - uy) * (dy - uy))
                    lost += spent(kn * (bonds.length[b] - d + dn), fn, kn, dn)
                    ledger[BREAKAGE] += lost
                else:
                    ledger[SLIP] += lost
                    if not glued:
                        dn = d - np.sqrt((dx - ux) * (dx - ux) + (dy - uy) * (dy - uy))
                        ledger[JERKS] += spent(max(kn * (un + dn), 0.0), fn, kn, dn)
                ledger[ELASTIC] += 0.5 * fn * fn / kn + 0.5 * fs * fs / max(ks, 1e-300)
            pairs.shear[k] = fs
            if d2 >= reach * reach and b < 0:
                continue
            if b >= 0 and bonds.kind == PARALLEL_BONDS:
                shear, moment = bonds.shear[b], bonds.moment[b]
                turn = dt * (spin[j] - wi)
                bn, bs, bm = load_parallel_bond(bonds, b, d, us, turn)
                state = bonds.state[b]
                if state != INTACT:
                    note_crack(bonds.cracks, b, state, step, xi + li * nx, yi + li * ny, box)
                if ledger is not None:
                    bkn, bks, bkr = bonds.kn[b], bonds.ks[b], bonds.kr[b]
                    if state != INTACT:
                        dn = d - np.sqrt((dx - ux) * (dx - ux) + (dy - uy) * (dy - uy))
                        ledger[BREAKAGE] += (
                            spent(bkn * (bonds.length[b] - d + dn), 0.0, bkn, dn)
                            + spent(shear, 0.0, bks, us)
                            + spent(moment, 0.0, bkr, turn)
                        )
                    ledger[ELASTIC] += 0.5 * (bn * bn / bkn + bs * bs / bks + bm * bm / bkr)
                fn += bn
                fs += bs
                ti -= bm
                torque[j] += bm
            fcx, fcy = fn * nx - fs * ny, fn * ny + fs * nx
            fxi -= fcx
            fyi -= fcy
            ti -= li * fs
            fx[j] += fcx
            fy[j] += fcy
            torque[j] -= lj * fs
            contacts += 1
            force += np.sqrt(fn * fn + fs * fs)
        if xi - ri < xmin:
            fn = normal_force(kn, xmin - (xi - ri))
            fxi += fn
            left += fn
            n_left += 1
            virial_xy -= 0.5 * fn * yi
        if xi + ri > xmax:
            fn = normal_force(kn, xi + ri - xmax)
            fxi -= fn
            right += fn
            n_right += 1
            virial_xy += 0.5 * fn * yi
        if yi - ri < ymin:
            fn = normal_force(kn, ymin - (yi - ri))
            fyi += fn
            bottom += fn
            n_bottom += 1
            virial_xy -= 0.5 * fn * xi
        if yi + ri > ymax:
            fn = normal_force(kn, yi + ri - ymax)
            fyi -= fn
            top += fn
            n_top += 1
            virial_xy += 0.5 * fn * xi
        fx[i], fy[i], torque[i] = fxi, fyi, ti
        f2 = fxi * fxi + fyi * fyi
        if f2 > 0.0:
            unbalanced += np.sqrt(f2)
            loaded += 1
        load_x, load_y = grains.load_x[i], grains.load_y[i]
        load_xx += xi * load_x
        load_yy += yi * load_y
        fxi -= load_x
        fyi -= load_y
        virial_xx += xi * fxi
        virial_yy += yi * fyi
        virial_xy += 0.5 * (xi * fyi + yi * fxi)
    if ledger is not None:
        ledger[ELASTIC] += wall_energy(grains, kn, box)
    contacts += n_left + n_right + n_bottom + n_top
    force += left + right + bottom + top
    if n_left + n_right > 0:
        virial_xx += right * xmax - left * xmin
    if n_bottom + n_top > 0:
        virial_yy += top * ymax - bottom * ymin
    return Sums(
        contacts, force, unbalanced / max(loaded, 1), virial_xx, virial_yy, virial_xy,
        load_xx, load_yy, left, right, bottom, top, n_left, n_right, n_bottom, n_top,
    )  # fmt: skip


@kernel
def wall_energy(grains: Grains, kn: float, box: Array) -> float:
    """Elastic energy of the contacts with walls."""
    total = 0.0
    for i in range(grains.x.size):
        x, y, r = grains.x[i], grains.y[i], grains.radius[i]
        for un in (box[0] - x + r, x + r - box[1], box[2] - y + r, y + r - box[3]):
            if un > 0.0:
                total += 0.5 * kn * un * un
    return total
