"""Parts of a specimen: what is cut out keeps its forces, what is excavated leaves a hole.

A *cut* keeps the grains inside a region; the forces and torques of the contacts (and walls) that
are lost act on as loads from outside, so that every grain is as balanced as it was. An
*excavation* takes the grains inside a region away, and their forces with them; what then moves
is found by `Specimen.relax`. Bonds and joints between grains that stay are kept by both.
"""

from __future__ import annotations

import copy

import numpy as np

from demflow.model.mechanics.contact.contacts import contact_forces
from demflow.model.mechanics.contact.grains import Array, at_rest
from demflow.model.mechanics.contact.neighbours import Pairs
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.specimen.measures import listed
from demflow.model.region import Region, bounding_box, contains

FAR = 1e3  # widths of the specimen at which a cut has its walls: none


def cut(specimen: Specimen, region: Region) -> Specimen:
    """The grains whose centres lie in the region, loaded by what was cut away.

    Parameters
    ----------
    specimen : at rest; it is not changed.
    region : in the units of the specimen (mean radii, its centre at the origin).

    Raises ValueError where no grain lies inside.
    """
    inside = _inside(specimen, region)
    before = _forces(specimen)[inside]
    part = _part(specimen, inside, FAR * specimen.box)
    loads = before - (_forces(part) - _loads(part))
    part.grains.load_x[:], part.grains.load_y[:], part.grains.load_torque[:] = loads.T
    _forces(part)
    return part


def excavate(specimen: Specimen, region: Region) -> Specimen:
    """The specimen without the grains whose centres lie in the region; see `cut`."""
    inside = _inside(specimen, region)
    if inside.all():
        raise ValueError("the excavation leaves no grain")
    part = _part(specimen, ~inside, specimen.box.copy())
    part.first_box = specimen.first_box.copy()  # from which strains of cracks are counted
    return part


def press_on(specimen: Specimen, region: Region, pressure: float) -> int:
    """Load the grains at the rim of a hole by a pressure in it, in the way of a membrane.

    A grain belongs to the rim if its disc reaches into the region, a circle or polygon around
    the hole; each carries the pressure over the arc or the part of the perimeter that falls to
    it, half of the way to its neighbours along the rim. Pressures are over k_n.

    Returns the number of grains on the rim.
    """
    grains = specimen.grains
    centre = np.array(_middle(region))
    away = np.column_stack([grains.x, grains.y]) - centre
    distance = np.hypot(*away.T)
    unit = away / np.maximum(distance, 1e-300)[:, None]
    nearest = np.column_stack([grains.x, grains.y]) - grains.radius[:, None] * unit
    rim = np.flatnonzero(contains(region, nearest))
    if len(rim) < 3:
        raise ValueError("fewer than three grains stand around the hole")
    angle = np.arctan2(away[rim, 1], away[rim, 0])
    order = rim[np.argsort(angle)]
    # the polygon through the rim's grains: its edges share their pressure between their ends
    x, y = grains.x[order], grains.y[order]
    dx, dy = np.roll(x, -1) - x, np.roll(y, -1) - y
    outward_x, outward_y = 0.5 * pressure * dy, -0.5 * pressure * dx
    np.add.at(grains.load_x, order, outward_x)
    np.add.at(grains.load_y, order, outward_y)
    np.add.at(grains.load_x, np.roll(order, -1), outward_x)
    np.add.at(grains.load_y, np.roll(order, -1), outward_y)
    return len(rim)


def gravity(specimen: Specimen, weight: Array, angle: float = -0.5 * np.pi) -> None:
    """Load every grain by its weight (n,) over k_n and mean radius, in a direction (radians)."""
    specimen.grains.load_x[:] += weight * np.cos(angle)
    specimen.grains.load_y[:] += weight * np.sin(angle)


def _middle(region: Region) -> tuple[float, float]:
    box = bounding_box(region)
    return 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])


def _inside(specimen: Specimen, region: Region) -> Array:
    grains = specimen.grains
    inside = contains(region, np.column_stack([grains.x, grains.y]))
    if not inside.any():
        raise ValueError("no grain lies inside the region")
    return inside


def _forces(specimen: Specimen) -> Array:
    """Forces and torques (n, 3) in the present state; nothing moves."""
    specimen.sums = contact_forces(
        specimen.grains, specimen.pairs, specimen.bonds, specimen.joints, specimen.law,
        specimen.box, specimen.run.step, 0.0, 0.0, 0.0, None,
    )  # fmt: skip
    grains = specimen.grains
    return np.column_stack([grains.fx, grains.fy, grains.torque])


def _loads(specimen: Specimen) -> Array:
    grains = specimen.grains
    return np.column_stack([grains.load_x, grains.load_y, grains.load_torque])


def _part(specimen: Specimen, kept: Array, box: Array) -> Specimen:
    """Some grains of a specimen, at rest, with what their contacts, bonds and joints remember."""
    grains, pairs = specimen.grains, specimen.pairs
    a, b = listed(pairs)
    stays = kept[a] & kept[b]
    number = np.cumsum(kept) - 1
    known = Pairs(
        start=np.searchsorted(number[a[stays]], np.arange(int(kept.sum()) + 1)),
        one=number[a[stays]].astype(np.int32),
        other=number[b[stays]].astype(np.int32),
        shear=pairs.shear[stays],
        moment=pairs.moment[stays],
        bond=pairs.bond[stays],
        x=grains.x[kept],
        y=grains.y[kept],
    )
    fresh = at_rest(
        grains.x[kept], grains.y[kept], grains.radius[kept], 1.0 / grains.inverse_mass[kept]
    )
    fresh.load_x[:], fresh.load_y[:] = grains.load_x[kept], grains.load_y[kept]
    fresh.load_torque[:] = grains.load_torque[kept]
    part = Specimen(
        fresh,
        box,
        specimen.law,
        bonds=copy.deepcopy(specimen.bonds),
        dt=specimen.dt,
        skin=specimen.skin,
        known=known,
    )
    part.inherit_joints(specimen, kept)
    part.run = part.run._replace(step=specimen.run.step)  # later cracks are numbered on
    return part
