"""Parts of a specimen: what is cut out keeps its forces, what is excavated leaves a hole.

A *cut* keeps the grains inside a region; the forces and torques of the contacts (and walls) that
are lost act on as loads from outside, so that every grain is as balanced as it was. An
*excavation* takes the grains inside a region away, and their forces with them; what then moves
is found by `Specimen.relax`. Bonds and joints between grains that stay are kept by both.
"""

from __future__ import annotations

import copy

import numpy as np
from scipy.spatial import Delaunay

from demflow.model.mechanics.contact.grains import Array, at_rest
from demflow.model.mechanics.contact.neighbours import Pairs
from demflow.model.mechanics.motion.equilibrium import Specimen, forces
from demflow.model.mechanics.specimen.measures import listed, overlaps
from demflow.model.region import Region, contains

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
    return without(specimen, _inside(specimen, region))


def without(specimen: Specimen, gone: Array) -> Specimen:
    """The specimen without some of its grains (n,) bool, and without the forces on them."""
    if gone.all():
        raise ValueError("the excavation leaves no grain")
    part = _part(specimen, ~gone, specimen.box.copy())
    part.first_box = specimen.first_box.copy()  # from which strains of cracks are counted
    part.steps = specimen.steps
    return part


def press_on(specimen: Specimen, gone: Array, pressure: float) -> Array:
    """Loads (n, 2) of a pressure in a hole on the grains around it, in the way of a membrane.

    The rim is the outline of all triangles, of Delaunay's between the centres of grains that
    touch others, that have a corner among the grains to be taken, `gone` (n,) bool. Each of its
    edges shares the force of the pressure on it between its two ends, so that loads on a closed
    rim, whatever its shape, add up to neither a force nor a moment. Pressures are over k_n.

    Parameters
    ----------
    specimen : grains with bonds, joints and walls, in units of mean radius and k_n
    gone : grains that are taken, (n,) bool
    pressure : in the hole, over k_n
    """
    grains = specimen.grains
    a, b = listed(specimen.pairs)
    touch = (overlaps(grains.x, grains.y, grains.radius, a, b) > 0.0) | (specimen.pairs.bond >= 0)
    held = np.flatnonzero(gone | (np.bincount(np.r_[a[touch], b[touch]], minlength=len(gone)) > 1))
    loads = np.zeros((len(gone), 2))
    if pressure == 0.0:
        return loads
    corner = held[Delaunay(np.column_stack([grains.x[held], grains.y[held]])).simplices]
    for k in range(3):  # corners run counter-clockwise
        one, other, taken = corner[:, k], corner[:, (k + 1) % 3], corner[:, (k + 2) % 3]
        rim = gone[taken] & ~gone[one] & ~gone[other]
        one, other = one[rim], other[rim]
        dx, dy = grains.x[other] - grains.x[one], grains.y[other] - grains.y[one]
        outwards = 0.5 * pressure * np.column_stack([dy, -dx])
        np.add.at(loads, one, outwards)
        np.add.at(loads, other, outwards)
    return loads


def _inside(specimen: Specimen, region: Region) -> Array:
    grains = specimen.grains
    inside = contains(region, np.column_stack([grains.x, grains.y]))
    if not inside.any():
        raise ValueError("no grain lies inside the region")
    return inside


def _forces(specimen: Specimen) -> Array:
    """Forces and torques (n, 3) in the present state; nothing moves."""
    specimen.sums = forces(
        specimen.grains, specimen.pairs, specimen.bonds, specimen.joints, specimen.law,
        specimen.box, step=specimen.run.step,
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
