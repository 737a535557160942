"""What the contacts of a specimen carry, and what broke in it, as arrays in its own units."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.bonds import INTACT, PARALLEL_BONDS, BondState, Cracks
from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.contact.joints import APART
from demflow.model.mechanics.contact.law import presses, relative_radius
from demflow.model.mechanics.contact.neighbours import JOINED, some_pairs
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.specimen import measures


class Carried(NamedTuple):
    """Contacts that touch, are bonded or lie across a joint; sorted by (a, b)."""

    a: Array  # (c,) a < b
    b: Array
    normal: Array  # (c,) force along the line of centres, compression positive
    shear: Array  # (c,) force across it, see `contacts`
    bonded: Array  # (c,) bool
    joint_gap: Array  # (c,) opening of the joint there, NaN where there is none
    joint_slip: Array  # (c,) length of its slip so far, 0 where there is none


class Broken(NamedTuple):
    """Bonds and joint contacts that broke, in the order of breaking."""

    x: Array  # (k,)
    y: Array
    mode: Array  # (k,) BROKEN_IN_TENSION or BROKEN_IN_SHEAR
    step: Array  # (k,) int64
    strain_xx: Array  # (k,) of the box by then, extension positive
    strain_yy: Array


def carried(specimen: Specimen) -> Carried:
    """All contacts of a specimen and the forces on them."""
    grains, bonds, joints = specimen.grains, specimen.bonds, specimen.joints
    a, b = measures.listed(specimen.pairs)
    overlap = measures.overlaps(grains.x, grains.y, grains.radius, a, b)
    radius = relative_radius(grains.radius[a], grains.radius[b])
    normal = presses(specimen.law, overlap, radius)
    shear = specimen.pairs.shear.copy()
    intact = bond_of_pair(specimen.pairs.bond, bonds)
    glued = intact >= 0
    of, distance = intact[glued], (grains.radius[a] + grains.radius[b] - overlap)[glued]
    if bonds.kind == PARALLEL_BONDS:
        normal[glued] += bonds.kn[of] * (bonds.length[of] - distance)
        shear[glued] += bonds.shear[of]
    else:
        normal[glued] = specimen.law.kn * (bonds.length[of] - distance)
    kept = (glued | (overlap > 0.0)) & (specimen.pairs.bond != JOINED)
    acts = joints.state != APART
    one, two = joints.a[acts], joints.b[acts]
    nx, ny = joints.nx[acts], joints.ny[acts]
    fn, fs = joints.normal[acts], joints.shear[acts]
    fx, fy = fn * nx - fs * ny, fn * ny + fs * nx
    dx, dy = grains.x[two] - grains.x[one], grains.y[two] - grains.y[one]
    distance = np.hypot(dx, dy)
    joined = Carried(
        one,
        two,
        (fx * dx + fy * dy) / distance,
        (fy * dx - fx * dy) / distance,
        joints.state[acts] == INTACT,
        joints.gap[acts],
        joints.slipped[acts],
    )
    plain = Carried(
        a[kept],
        b[kept],
        normal[kept],
        shear[kept],
        glued[kept],
        np.full(kept.sum(), np.nan),
        np.zeros(kept.sum()),
    )
    both = Carried(*map(np.concatenate, zip(plain, joined, strict=True)))
    order = np.lexsort((both.b, both.a))
    return Carried(*(field[order] for field in both))


def overlap_of(specimen: Specimen) -> float:
    """Largest overlap of two grains, over the mean radius; raises `ModelError` beyond a bound.

    Along a smooth joint grains slide past each other, so that those pairs do not count.
    """
    grains, pairs = specimen.grains, specimen.pairs
    a, b = measures.listed(some_pairs(pairs, pairs.bond != JOINED))
    return measures.largest_overlap(grains.x, grains.y, grains.radius, a, b)


def broken(specimen: Specimen) -> Broken:
    """Every breakage since the specimen was made."""
    joints = specimen.joints
    cracks = Cracks(*map(np.concatenate, zip(specimen.bonds.cracks, joints.cracks, strict=True)))
    which = np.flatnonzero(cracks.step >= 0)
    which = which[np.argsort(cracks.step[which], kind="stable")]
    first = specimen.first_box
    return Broken(
        cracks.x[which],
        cracks.y[which],
        cracks.mode[which].astype(np.int64),
        cracks.step[which],
        cracks.width[which] / (first[1] - first[0]) - 1.0,
        cracks.height[which] / (first[3] - first[2]) - 1.0,
    )


def crack_count(specimen: Specimen) -> int:
    """Number of bonds and joint contacts that broke since the specimen was made."""
    cracks = specimen.bonds.cracks, specimen.joints.cracks
    return sum(int(np.count_nonzero(some.step >= 0)) for some in cracks)


def bond_of_pair(bond: Array, bonds: BondState) -> Array:
    """Index of the intact bond of each pair, −1 where there is none."""
    intact = bond.astype(np.int64)
    intact[intact >= 0] = np.where(
        bonds.state[intact[intact >= 0]] == INTACT, intact[intact >= 0], -1
    )
    return intact
