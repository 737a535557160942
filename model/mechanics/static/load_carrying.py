"""What carries load in a packed, bonded specimen: its contacts, those with walls, their pairs."""

from __future__ import annotations

import numpy as np

from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.neighbours import JOINED, Pairs, some_pairs
from demflow.model.mechanics.motion.equilibrium import SKIN, Specimen
from demflow.model.mechanics.specimen.measures import listed, overlaps
from demflow.model.mechanics.static.stiffness import TOUCHING, Contacts
from demflow.model.mechanics.static.walls import Walls

BRAKE = 5e-3


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
    """Grains among those kept, bool (n,), whose gap to a wall is below a reach, by wall.

    Parameters
    ----------
    specimen : grains with bonds, joints and walls, in units of mean radius and k_n
    kept : grains that count, (n,) bool
    reach : largest gap
    """
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


def carrying_beside_joints(specimen: Specimen) -> Array:
    """Grains that can carry load, (n,) bool: those that touch others across joints alone cannot.

    Nothing but friction would hold them along the joint, by themselves or against a wall.
    """
    n, contacts = len(specimen.grains.x), contacts_of(specimen)
    while True:
        carries = carrying(n, contacts)
        if not len(specimen.joints.a):
            return carries
        plain = (contacts.bond != JOINED) & carries[contacts.a] & carries[contacts.b]
        held = np.bincount(np.append(contacts.a[plain], contacts.b[plain]), minlength=n) > 0
        if np.all(held[carries]):
            return carries
        stays = held[contacts.a] & held[contacts.b]
        walls = tuple(wall[held[wall]] for wall in contacts.walls)
        contacts = Contacts(contacts.a[stays], contacts.b[stays], contacts.bond[stays], walls)


def brakes(grains: Grains, contacts: Contacts, carries: Array) -> Array:
    """Turning stiffness over k_n (n,) that a grain on one contact lacks: it rolls on its neighbour.

    A wall that it leans on beside holds it by (t·e)² k_n, t the tangent of the contact and e the
    normal of the wall, unless that is as small as what the forces themselves add.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    contacts : contacts (c,) of the specimen, with their bonds
    carries : (n,) bool, which grains carry load
    """
    n = len(grains.x)
    kept = carries[contacts.a] & carries[contacts.b]
    a, b = contacts.a[kept], contacts.b[kept]
    dx, dy = grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]
    nx2, ny2 = dx * dx / (dx * dx + dy * dy), dy * dy / (dx * dx + dy * dy)
    ends = np.r_[a, b]
    left, right, bottom, top = (np.bincount(wall, minlength=n)[ends] for wall in contacts.walls)
    leans = (left + right) * np.r_[ny2, ny2] + (bottom + top) * np.r_[nx2, nx2]
    rolls = (np.bincount(ends, minlength=n) < 2) & (np.bincount(ends, leans, n) < BRAKE)
    return np.where(carries, BRAKE * rolls, 1.0)


def load_carrying(specimen: Specimen) -> Pairs:
    """The pairs that touch, are bonded, or may come to touch among grains that carry load."""
    specimen.list_within(SKIN)
    pairs, grains = specimen.pairs, specimen.grains
    a, b = listed(pairs)
    carries = carrying(len(grains.x), contacts_of(specimen))
    stays = (pairs.bond >= 0) | (overlaps(grains.x, grains.y, grains.radius, a, b) > 0.0)
    stays |= carries[a] & carries[b]
    start = np.concatenate([[0], np.cumsum(stays)])[pairs.start]
    return some_pairs(pairs, stays)._replace(start=start)
