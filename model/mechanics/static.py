"""Equilibrium of bonded, unbroken grains by one factorisation: the static solver.

The stage *unit_loads* factors the stiffness of the packed, bonded grains once and solves
for three unit loads: σ_xx, σ_yy and σ_xy. While no bond breaks, every stress state is their
sum, corrected with the same factor until the *true* contact forces (`contacts`, the law of the
explicit solver: with friction, opening contacts and large displacements) are in balance.

The walls stay straight. Under a shear stress they tilt by the shear strain, and each grain at a
wall carries its part of the shear traction, in proportion to its force on the wall.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array, diags_array

from model.mechanics.bonds import INTACT, BondState
from model.mechanics.contacts import Sums, contact_forces
from model.mechanics.equilibrium import SKIN, Specimen
from model.mechanics.grains import Array
from model.mechanics.measures import listed, overlaps
from model.mechanics.neighbours import Pairs
from model.mechanics.stiffness import Contacts, Factor, factorise, matrix, solve
from model.products import UnitLoads

TOUCHING = 1e-6  # gap below which a grain counts as touching a wall, in mean radii
MOST_CORRECTIONS = 40
BASE_TOLERANCE, BASE_CORRECTIONS = 1e-9, 100  # of the packed state, from which stresses count
MEMORY = 10  # corrections that the next one takes into account
FAR = np.array([-np.inf, np.inf, -np.inf, np.inf])
Walls = tuple[Array, ...]  # grains at left, right, bottom, top
INWARD = (1.0, -1.0, 1.0, -1.0)  # sense of the force of each wall


class Found(NamedTuple):
    """How the static solver ended."""

    reached: bool
    corrections: int
    why: str = ""


def response(specimen: Specimen, packed: Array) -> UnitLoads:
    """Factor the stiffness of a specimen and solve its unit loads.

    Parameters
    ----------
    specimen : grains as they were packed, bonded; it is displaced.
    packed : stresses xx, yy, xy of its walls over k_n.
    """
    grains, box, n = specimen.grains, specimen.box, len(specimen.grains.x)
    width, height = box[1] - box[0], box[3] - box[2]
    contacts = contacts_of(specimen)
    carries = carrying(n, contacts)
    # a grain on one contact, with or without a wall, would roll around its neighbour
    kept = carries[contacts.a] & carries[contacts.b]
    rolls = np.bincount(np.r_[contacts.a[kept], contacts.b[kept]], minlength=n) < 2
    turning = np.zeros(3 * n + 2)
    turning[2:-2:3][rolls] = specimen.law.kn
    stiffness = matrix(grains, contacts, specimen.bonds, specimen.law)
    stiffness = csc_array(stiffness + diags_array(turning))
    factor = factorise(stiffness)

    def displaced(load: Array) -> Array:
        found = solve(factor, load)
        return found + solve(factor, load - stiffness @ found)

    reach = at_walls(specimen, carries, SKIN)  # they may come to touch
    near = tuple(np.union1d(w, r) for w, r in zip(contacts.walls, reach, strict=True))
    share = wall_shares(specimen, near, carries)
    loads = np.zeros((3, 3 * n + 2))
    loads[0, -2] = -height  # a compression moves the right wall inwards
    loads[1, -1] = -width
    loads[2] = shear_load(specimen, near, share)
    displacement = np.array([displaced(load) for load in loads])
    # under shear the walls are free to tilt by γ: γ (k_γγ − kᵀ K⁻¹ k) = kᵀ u
    tilt = tilt_load(specimen, contacts.walls)
    tilted = displaced(tilt)
    along = np.concatenate(
        [(grains.y if side < 2 else grains.x)[held] for side, held in enumerate(contacts.walls)]
    )
    own = 0.25 * specimen.law.kn * float(np.sum(along**2))
    shear = float(tilt @ displacement[2]) / (own - float(tilt @ tilted))
    displacement[2] += shear * tilted
    # what nothing holds is carried along
    free = np.bincount(np.r_[contacts.a, contacts.b], minlength=n) == 0
    carried = displacement[:, :-2].reshape(3, n, 3)
    carried[:, free, 0] = np.outer(displacement[:, -2], (grains.x[free] - box[0]) / width)
    carried[:, free, 1] = np.outer(displacement[:, -1], (grains.y[free] - box[2]) / height)
    carried[2, free, 0] += 0.5 * shear * grains.y[free]
    carried[2, free, 1] += 0.5 * shear * grains.x[free]
    units = UnitLoads(
        base=np.zeros(3 * n + 2),
        packed=np.array(packed, dtype=float),
        displacement=displacement,
        shear_strain=np.array(shear),
        wall_grain=np.concatenate(near),
        wall_start=np.concatenate([[0], np.cumsum([len(held) for held in near])]),
        wall_share=np.concatenate(share),
        order=factor.order,
        start=factor.start,
        row=factor.row,
        lower=factor.lower,
        pivot=factor.pivot,
    )
    base = np.zeros(3 * n + 2)
    _correct(_Trial(specimen, units), units, base, units.packed, BASE_TOLERANCE, BASE_CORRECTIONS)
    return units._replace(base=base)


def contacts_of(specimen: Specimen) -> Contacts:
    """All that touches or is bonded in a specimen."""
    grains = specimen.grains
    a, b = listed(specimen.pairs)
    bond = specimen.pairs.bond
    held = (bond >= 0) | (overlaps(grains.x, grains.y, grains.radius, a, b) > 0.0)
    a, b, bond = a[held], b[held], bond[held].astype(np.int64)
    inner = np.bincount(np.r_[a, b], minlength=len(grains.x)) > 0
    return Contacts(a, b, bond, at_walls(specimen, inner, TOUCHING))


def at_walls(specimen: Specimen, kept: Array, reach: float) -> Walls:
    """Grains among those kept, bool (n,), whose gap to a wall is below a reach, by wall."""
    grains, box = specimen.grains, specimen.box
    return tuple(
        np.flatnonzero(kept & (gap < reach))
        for gap in (
            grains.x - grains.radius - box[0],
            box[1] - grains.x - grains.radius,
            grains.y - grains.radius - box[2],
            box[3] - grains.y - grains.radius,
        )
    )


def carrying(n: int, contacts: Contacts) -> Array:
    """Grains that can carry load, bool (n,): at least two contacts with others that can."""
    walls = np.bincount(np.concatenate(contacts.walls), minlength=n)
    carries = np.ones(n, bool)
    while True:
        kept = carries[contacts.a] & carries[contacts.b]
        ends = np.r_[contacts.a[kept], contacts.b[kept]]
        fewer = carries & (np.bincount(ends, minlength=n) + walls > 1)
        if np.array_equal(fewer, carries):
            return carries
        carries = fewer


def wall_shares(specimen: Specimen, walls: Walls, carries: Array) -> tuple[Array, ...]:
    """Part of each wall's shear traction that each of its grains carries.

    In proportion to its force on the wall; none where the grain `carries` no load.
    """
    grains, box = specimen.grains, specimen.box
    shares = []
    for side, held in enumerate(walls):
        centre = (grains.x if side < 2 else grains.y)[held]
        press = np.maximum(grains.radius[held] - np.abs(centre - box[side]), 0.0)
        if not np.any(press > TOUCHING):  # a lattice at rest
            press[:] = 1.0
        press[~carries[held]] = 0.0
        shares.append(press / max(press.sum(), 1e-300))
    return tuple(shares)


def shear_load(specimen: Specimen, walls: Walls, share: tuple[Array, ...]) -> Array:
    """Forces and torques (3 n + 2,) by a unit shear traction σ_xy on the walls."""
    grains, box = specimen.grains, specimen.box
    load = np.zeros(3 * len(grains.x) + 2)
    sides = (box[3] - box[2], box[3] - box[2], box[1] - box[0], box[1] - box[0])
    for side, held in enumerate(walls):
        force = INWARD[side] * sides[side] * share[side]
        np.add.at(load, 3 * held + (1 - side // 2), force)
        # the arm points to the wall: −r e_x at the left, −r e_y at the bottom
        arm = -INWARD[side] * grains.radius[held] * (1.0 if side < 2 else -1.0)
        np.add.at(load, 3 * held + 2, arm * force)
    return load


def tilt_load(specimen: Specimen, walls: Walls) -> Array:
    """Forces (3 n + 2,) on grains and walls by a unit shear strain of the walls."""
    n = len(specimen.grains.x)
    load = np.zeros(3 * n + 2)
    for side, held in enumerate(walls):
        along = specimen.grains.y if side < 2 else specimen.grains.x
        force = 0.5 * specimen.law.kn * along[held]
        np.add.at(load, 3 * held + side // 2, force)
        if side % 2 == 1:
            load[3 * n + side // 2] -= force.sum()
    return load


def equilibrium(specimen: Specimen, units: UnitLoads, wanted: Array, tolerance: float) -> Found:
    """Bring a specimen, as it was packed, to stresses by its unit loads.

    Parameters
    ----------
    specimen : packed and bonded; left in the state that was found, spoilt where none was.
    units : its unit loads.
    wanted : stresses xx, yy, xy over k_n.
    tolerance : mean unbalanced over mean contact force, torques over radii included, and the
        relative error of the walls' stresses.
    """
    trial = _Trial(specimen, units)
    u = units.base + (wanted - units.packed) @ units.displacement
    corrections, ratio = _correct(trial, units, u, wanted, tolerance, MOST_CORRECTIONS)
    if ratio > tolerance:
        return Found(False, corrections, f"its corrections end at an unbalance of {ratio:.1e}")
    broken = trial.broken_bonds()
    trial.put_inside()
    specimen.run = specimen.run._replace(ratio=ratio, progress=1.0)
    return Found(broken == 0, corrections, f"{broken} bonds would break" if broken else "")


def _correct(
    trial: _Trial, units: UnitLoads, u: Array, wanted: Array, tolerance: float, most: int
) -> tuple[int, float]:
    """Correct the displacement u in place until balance; returns corrections and the last ratio.

    Steps of the factored stiffness, each combined with those before so that the residual is
    least (Anderson 1965, J. ACM 12, 547): contacts that open, close or slip differ from the
    stiffness in few directions, which are learnt so.
    """
    factor = Factor(units.order, units.start, units.row, units.lower, units.pivot)
    shear = wanted[2] * float(units.shear_strain)
    steps, changes = np.empty((2, MEMORY, len(u)))
    learnt = 0
    before, best, correction = u, u.copy(), np.empty(0)
    least, share = np.inf, 1.0
    for corrections in range(most + 1):
        residual, ratio = trial.forces(u, shear, wanted)
        if ratio <= tolerance or corrections == most:
            break
        if not ratio <= 10.0 * least:  # led astray: back to the best, more carefully
            u[:] = best
            learnt, share, correction = 0, 0.3 * share, np.empty(0)
            residual, _ = trial.forces(u, shear, wanted)
        elif ratio < least:
            best, least = u.copy(), ratio
        last, correction = correction, share * solve(factor, residual)
        if last.size:
            row = learnt % MEMORY
            changes[row] = correction - last
            steps[row] = u - before + changes[row]
            learnt += 1
        before = u.copy()
        u += correction
        if learnt:
            kept = changes[:learnt]  # all of them, once there are more than MEMORY
            scale = 1.0 / np.maximum(np.sqrt(np.sum(kept * kept, axis=1)), 1e-300)
            gram = scale[:, None] * (kept @ kept.T) * scale
            mix = np.linalg.lstsq(gram, scale * (kept @ correction), rcond=1e-11)[0]
            u -= (scale * mix) @ steps[:learnt]
    return corrections, ratio


class _Trial:
    """A specimen that is displaced from its packed state, again and again."""

    def __init__(self, specimen: Specimen, units: UnitLoads):
        self.specimen = specimen
        self.n = len(specimen.grains.x)
        grains = specimen.grains
        specimen.pairs = load_carrying(specimen)
        self.x, self.y = grains.x.copy(), grains.y.copy()
        self.box = specimen.box.copy()
        self.shear = specimen.pairs.shear.copy()
        self.bonds = specimen.bonds
        self.memory = (self.bonds.shear.copy(), self.bonds.moment.copy())
        starts = units.wall_start
        self.walls = [units.wall_grain[a:b] for a, b in zip(starts[:-1], starts[1:], strict=True)]
        self.share = [units.wall_share[a:b] for a, b in zip(starts[:-1], starts[1:], strict=True)]

    def forces(self, u: Array, tilt: float, wanted: Array) -> tuple[Array, float]:
        """Unbalanced forces (3 n + 2,) after a displacement, by the true law, and their ratio.

        The wanted stresses act on the deformed box. The displacement is taken in one step.
        """
        specimen, n = self.specimen, self.n
        grains, box, bonds = specimen.grains, specimen.box, self.bonds
        step = u[:-2].reshape(n, 3)
        grains.vx[:], grains.vy[:], grains.spin[:] = step.T
        grains.x[:], grains.y[:] = self.x + step[:, 0], self.y + step[:, 1]
        box[:] = self.box
        box[1] += u[-2]
        box[3] += u[-1]
        specimen.pairs.shear[:] = self.shear
        bonds.shear[:], bonds.moment[:] = self.memory
        bonds.state[:] = INTACT
        sums = contact_forces(
            grains, specimen.pairs, unbreakable(bonds), specimen.joints, specimen.law, FAR,
            0, 1.0, 0.0, 0.0, None,
        )  # fmt: skip
        residual = np.empty(3 * n + 2)
        loads, specimen.sums = self._walls(sums, tilt, wanted)
        on_grains = residual[:-2].reshape(n, 3)
        on_grains[:, 0], on_grains[:, 1], on_grains[:, 2] = grains.fx, grains.fy, grains.torque
        width, height = box[1] - box[0], box[3] - box[2]
        residual[-2] = loads[1] - wanted[0] * height
        residual[-1] = loads[3] - wanted[1] * width
        mean = specimen.sums.force / max(specimen.sums.contacts, 1)
        unbalanced = np.sqrt(grains.fx**2 + grains.fy**2 + (grains.torque / grains.radius) ** 2)
        held = unbalanced > 0.0
        ratio = unbalanced[held].mean() / mean if held.any() else 0.0
        # the walls that stand are held to it as well: what all grains lack adds up on them
        sides = (wanted[0] * height, wanted[0] * height, wanted[1] * width, wanted[1] * width)
        wall = max(
            abs(load - side) / max(side, 1e-300) for load, side in zip(loads, sides, strict=True)
        )
        return residual, float(max(ratio, wall))

    def _walls(self, sums: Sums, tilt: float, wanted: Array) -> tuple[list[float], Sums]:
        """Add the forces of the walls to the grains and to what the contacts sum up."""
        specimen = self.specimen
        grains, box, kn = specimen.grains, specimen.box, specimen.law.kn
        loads, counts = [], []
        virial = np.array([sums.virial_xx, sums.virial_yy, sums.virial_xy])
        force = sums.force
        sides = (box[3] - box[2], box[3] - box[2], box[1] - box[0], box[1] - box[0])
        for side, (held, share) in enumerate(zip(self.walls, self.share, strict=True)):
            sense = INWARD[side]
            across, along = (grains.x, grains.y) if side < 2 else (grains.y, grains.x)
            reached = box[side] + 0.5 * tilt * along[held]
            depth = sense * (reached - across[held]) + grains.radius[held]
            press = kn * np.maximum(depth, 0.0)
            drag = sense * wanted[2] * sides[side] * share
            loads.append(float(press.sum()))
            counts.append(int(np.count_nonzero(press)))
            normal, tangential = (grains.fx, grains.fy) if side < 2 else (grains.fy, grains.fx)
            normal[held] += sense * press
            tangential[held] += drag
            arm = across[held] - box[side]
            grains.torque[held] -= (1.0 if side < 2 else -1.0) * sense * grains.radius[held] * drag
            virial[side // 2] += float(np.sum(sense * press * arm))
            virial[2] += 0.5 * float(np.sum(drag * arm))
            force += float(np.sum(np.hypot(press, drag)))
        left, right, bottom, top = loads
        return loads, sums._replace(
            contacts=sums.contacts + sum(counts),
            force=force,
            virial_xx=float(virial[0]),
            virial_yy=float(virial[1]),
            virial_xy=float(virial[2]),
            left=left,
            right=right,
            bottom=bottom,
            top=top,
        )

    def put_inside(self) -> None:
        """Move grains that touch no other off the walls."""
        grains, box = self.specimen.grains, self.specimen.box
        a, b = listed(self.specimen.pairs)
        free = np.bincount(np.r_[a, b], minlength=self.n) == 0
        r = grains.radius[free]
        grains.x[free] = np.clip(grains.x[free], box[0] + r, box[1] - r)
        grains.y[free] = np.clip(grains.y[free], box[2] + r, box[3] - r)

    def broken_bonds(self) -> int:
        """Bonds that are beyond their strength in the present state."""
        specimen, bonds = self.specimen, self.bonds
        grains = specimen.grains
        specimen.pairs.shear[:] = self.shear
        bonds.shear[:], bonds.moment[:] = self.memory
        kept = tuple(f.copy() for f in (grains.fx, grains.fy, grains.torque))
        contact_forces(
            grains, specimen.pairs, bonds, specimen.joints, specimen.law, FAR,
            0, 1.0, 0.0, 0.0, None,
        )  # fmt: skip
        for field, value in zip((grains.fx, grains.fy, grains.torque), kept, strict=True):
            field[:] = value
        return int(np.count_nonzero(bonds.state != INTACT))


def load_carrying(specimen: Specimen) -> Pairs:
    """The pairs that touch, are bonded, or may come to touch among grains that carry load."""
    pairs, grains = specimen.pairs, specimen.grains
    a, b = listed(pairs)
    carries = carrying(len(grains.x), contacts_of(specimen))
    stays = (pairs.bond >= 0) | (overlaps(grains.x, grains.y, grains.radius, a, b) > 0.0)
    stays |= carries[a] & carries[b]
    return pairs._replace(
        start=np.concatenate([[0], np.cumsum(stays)])[pairs.start],
        other=pairs.other[stays],
        shear=pairs.shear[stays],
        bond=pairs.bond[stays],
    )


def unbreakable(bonds: BondState) -> BondState:
    """The same bonds without a strength."""
    endless = np.full(len(bonds.state), np.inf)
    return bonds._replace(tensile_strength=endless, shear_strength=endless)
