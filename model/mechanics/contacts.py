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
    contact_bond_state,
    load_parallel_bond,
)
from model.mechanics.grains import Array, Grains
from model.mechanics.laws import normal_force, shear_force, slip, tangential_step
from model.mechanics.neighbours import Pairs


class ContactLaw(NamedTuple):
    """Linear contact with Coulomb friction; stiffnesses in force per length."""

    kn: float
    ks: float
    friction: float


class Sums(NamedTuple):
    """What one pass over the contacts adds up."""

    contacts: int  # grains that touch or are bonded, and contacts with walls
    force: float  # Σ |F| over them
    virial_xx: float  # Σ F_x l_x with the actual branch vectors, compression positive
    virial_yy: float
    virial_xy: float
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
    law: ContactLaw,
    box: Array,
    dt: float,
    stretch_x: float,
    stretch_y: float,
) -> Sums:
    """Set the forces and torques of all grains, and advance what contacts and bonds remember.

    The step that led to the present positions was `dt` times the velocities plus an affine
    stretch; shear forces grow by it. Walls are frictionless and as stiff as the grains.
    """
    x, y, radius = grains.x, grains.y, grains.radius
    vx, vy, spin = grains.vx, grains.vy, grains.spin
    fx, fy, torque = grains.fx, grains.fy, grains.torque
    kn, ks, mu = law.kn, law.ks, law.friction
    xmin, xmax, ymin, ymax = box[0], box[1], box[2], box[3]
    for i in range(x.size):
        fx[i] = 0.0
        fy[i] = 0.0
        torque[i] = 0.0
    contacts = 0
    force = virial_xx = virial_yy = virial_xy = 0.0
    left = right = bottom = top = 0.0
    n_left = n_right = n_bottom = n_top = 0
    for i in range(x.size):
        xi, yi, ri = x[i], y[i], radius[i]
        vxi, vyi, wi = vx[i], vy[i], spin[i]
        fxi = fyi = ti = 0.0
        for k in range(pairs.start[i], pairs.start[i + 1]):
            j = pairs.other[k]
            dx, dy = x[j] - xi, y[j] - yi
            reach = ri + radius[j]
            d2 = dx * dx + dy * dy
            b = -1
            if bonds.kind != NO_BONDS:
                b = pairs.bond[k]
                if b >= 0 and bonds.state[b] != INTACT:
                    b = -1
            if d2 >= reach * reach and b < 0:
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
                bonds.state[b] = contact_bond_state(bonds, b, fn, fs)
                glued = bonds.state[b] == INTACT
            if not glued:
                fn = max(fn, 0.0)
                fs = slip(fs, mu * fn)
            pairs.shear[k] = fs
            if b >= 0 and bonds.kind == PARALLEL_BONDS:
                bn, bs, moment = load_parallel_bond(bonds, b, d, us, dt * (spin[j] - wi))
                fn += bn
                fs += bs
                ti -= moment
                torque[j] += moment
            fcx, fcy = fn * nx - fs * ny, fn * ny + fs * nx
            fxi -= fcx
            fyi -= fcy
            ti -= li * fs
            fx[j] += fcx
            fy[j] += fcy
            torque[j] -= lj * fs
            contacts += 1
            force += np.sqrt(fn * fn + fs * fs)
            virial_xx += fcx * dx
            virial_yy += fcy * dy
            virial_xy += 0.5 * (fcx * dy + fcy * dx)
        if xi - ri < xmin:
            fn = normal_force(kn, xmin - (xi - ri))
            fxi += fn
            left += fn
            n_left += 1
            virial_xx += fn * (xi - xmin)
        if xi + ri > xmax:
            fn = normal_force(kn, xi + ri - xmax)
            fxi -= fn
            right += fn
            n_right += 1
            virial_xx += fn * (xmax - xi)
        if yi - ri < ymin:
            fn = normal_force(kn, ymin - (yi - ri))
            fyi += fn
            bottom += fn
            n_bottom += 1
            virial_yy += fn * (yi - ymin)
        if yi + ri > ymax:
            fn = normal_force(kn, yi + ri - ymax)
            fyi -= fn
            top += fn
            n_top += 1
            virial_yy += fn * (ymax - yi)
        fx[i] += fxi
        fy[i] += fyi
        torque[i] += ti
    contacts += n_left + n_right + n_bottom + n_top
    force += left + right + bottom + top
    return Sums(
        contacts, force, virial_xx, virial_yy, virial_xy,
        left, right, bottom, top, n_left, n_right, n_bottom, n_top,
    )  # fmt: skip
