"""Cemented contacts that hold, stick and stay closed: the rock that answers loads in proportion.

Where no bond breaks, no contact slips or opens and no other closes, the forces follow from the
displacement alone, contact by contact, and a few solves of one factor balance them to
round-off. What the true law would change in such a state is counted, so that nothing is taken
for elastic that is not.
"""

from __future__ import annotations

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.bonds import CONTACT_BONDS, INTACT, BondState, bond_state
from demflow.model.mechanics.contact.contacts import Sums
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.contact.laws import normal_force, shear_force, slip, tangential_step
from demflow.model.mechanics.static.displaced import Trial
from demflow.model.products import UnitLoads

NO_LOADS_NO_WALLS = (0.0,) * 6 + (0,) * 4  # of `Sums`


class StickingTrial(Trial):
    """Displaced grains whose cemented contacts hold."""

    law: Linear

    def __init__(self, grains: Grains, box: Array, law: Linear, bonds: BondState, units: UnitLoads):
        super().__init__(grains, box, law, units)
        self.bonds, self.units = bonds, units
        self.normal, self.shear = np.empty((2, len(units.contact_a)))
        self.broken, self.spare = 0, 0.0

    def bear(self) -> Sums:
        """Set the forces of the cemented contacts; count what would not hold."""
        units = self.units
        virial, force, self.broken, self.spare = held_forces(
            self.grains, units.contact_a, units.contact_b, units.touching, units.contact_shear,
            self.bonds, self.law, self.normal, self.shear,
        )  # fmt: skip
        return Sums._make([len(units.contact_a), force, 0.0, *virial, *NO_LOADS_NO_WALLS])

    def astray(self) -> float:
        """Mean force on a grain that the true law would change, over the mean contact force."""
        units, grains = self.units, self.grains
        changed = self.spare + closing(grains, units.near_a, units.near_b, self.law.friction)
        return 2.0 * changed * self.sums.contacts / (self.n * max(self.sums.force, 1e-300))


@kernel
def held_forces(
    grains: Grains,
    a: Array,
    b: Array,
    touching: Array,
    before: Array,
    bonds: BondState,
    law: Linear,
    normal: Array,
    shear: Array,
) -> tuple[tuple[float, float, float], float, int, float]:
    """Set forces and torques of all grains by their cemented contacts (a, b), one bond each.

    The displacement is that of `contacts.contact_forces` in a step of 1; `before` are the
    shear forces it starts from. Under a parallel bond the grains themselves bear where they were
    `touching`. Returns the virial, Σ |F|, the bonds beyond their strength, and how much force the
    grains under parallel bonds would not bear, since they slip or open.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    touching : grains that touched before, (c,) bool
    before : shear forces that the displacement starts from, (c,)
    bonds : bonds (b,)
    law : law of contact, a named tuple that chooses what is done by its type
    normal : normal forces, (c,), which are set
    shear : shear forces, (c,), which are set
    """
    x, y, radius = grains.x, grains.y, grains.radius
    fx, fy, torque = grains.fx, grains.fy, grains.torque
    kn, ks, mu = law.kn, law.ks, law.friction
    fx[:] = 0.0
    fy[:] = 0.0
    torque[:] = 0.0
    xx = yy = xy = force = spare = 0.0
    broken = 0
    for k in range(a.size):
        i, j = a[k], b[k]
        dx, dy = x[j] - x[i], y[j] - y[i]
        d = np.sqrt(dx * dx + dy * dy)
        un = radius[i] + radius[j] - d
        nx, ny = dx / d, dy / d
        li, lj = radius[i] - 0.5 * un, radius[j] - 0.5 * un
        ux, uy = grains.vx[j] - grains.vx[i], grains.vy[j] - grains.vy[i]
        us = tangential_step(ux, uy, nx, ny, 1.0 / d, grains.spin[i], grains.spin[j], li, lj)
        moment = 0.0
        grip = bonds.length[k] - d
        if bonds.kind == CONTACT_BONDS:
            fn, fs = normal_force(kn, grip), shear_force(before[k], ks, us)
            if bond_state(bonds, k, fn, fs, 0.0) != INTACT:
                broken += 1
        else:
            fn, fs = normal_force(bonds.kn[k], grip), shear_force(0.0, bonds.ks[k], us)
            moment = -bonds.kr[k] * (grains.spin[j] - grains.spin[i])
            if bond_state(bonds, k, fn, fs, moment) != INTACT:
                broken += 1
            own, slid = normal_force(kn, un), shear_force(before[k], ks, us)
            borne = max(own, 0.0)
            if touching[k]:
                spare += borne - own + abs(slid - slip(slid, mu * borne))
                fn += own
                fs += slid
            else:
                spare += (1.0 + mu) * borne
        normal[k], shear[k] = fn, fs
        fcx, fcy = fn * nx - fs * ny, fn * ny + fs * nx
        fx[i] -= fcx
        fy[i] -= fcy
        torque[i] -= moment + li * fs
        fx[j] += fcx
        fy[j] += fcy
        torque[j] += moment - lj * fs
        xx += fcx * dx
        yy += fcy * dy
        xy += 0.5 * (fcx * dy + fcy * dx)
        force += np.sqrt(fn * fn + fs * fs)
    return (xx, yy, xy), force, broken, spare


@kernel
def closing(grains: Grains, a: Array, b: Array, friction: float) -> float:
    """Most force over k_n by which pairs (a, b) without cement would press on each other.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    friction : Coulomb coefficient of contacts
    """
    total = 0.0
    for k in range(a.size):
        i, j = a[k], b[k]
        dx, dy = grains.x[j] - grains.x[i], grains.y[j] - grains.y[i]
        reach = grains.radius[i] + grains.radius[j]
        d2 = dx * dx + dy * dy
        if d2 < reach * reach:
            total += (1.0 + friction) * (reach - np.sqrt(d2))
    return total
