"""The walls of a specimen as part of the graph of contacts, so that pores at walls are faces too.

A grain that touches a wall has a foot on it, a vertex of radius zero at the nearest point of the
wall, and the box has its four corners; edges along the walls join them. The pores of the graph
then fill the box but for the grains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.products import Packing

TOUCHING = 1e-6  # gap, in mean radii, below which a grain counts as touching a wall

# walls left, right, bottom, top, as in `Packing.box`; the corners are each on one of either kind
CORNERS = ((0, 2), (1, 2), (0, 3), (1, 3))


class Feet(NamedTuple):
    """Where f grains stand on walls, wall by wall, along each in the order of its coordinate."""

    grain: np.ndarray  # (f,)
    wall: np.ndarray  # (f,) 0 left, 1 right, 2 bottom, 3 top


def feet(packing: Packing) -> Feet:
    """The feet of the grains that touch a wall."""
    x, y, radius, box = packing.x, packing.y, packing.radius, packing.box
    reach = radius + TOUCHING * radius.mean()
    grain, wall = [], []
    for side, gap in enumerate((x - box[0], box[1] - x, y - box[2], box[3] - y)):
        (touch,) = np.nonzero(gap < reach)
        along = y if side < 2 else x
        grain.append(touch[np.argsort(along[touch], kind="stable")])
        wall.append(np.full(len(touch), side))
    return Feet(np.concatenate(grain), np.concatenate(wall))


def enclosed(packing: Packing) -> Packing:
    """The packing with feet and corners as further grains of radius zero, behind its own.

    Contacts join each foot to its grain, and what stands on a wall to its neighbours along it.
    """
    n, stands = len(packing.x), feet(packing)
    first = n + len(stands.grain)
    at_side = packing.box[stands.wall]
    corner_x, corner_y = (packing.box[list(walls)] for walls in zip(*CORNERS, strict=True))
    upright = stands.wall < 2
    a, b = [packing.contact_a, stands.grain], [packing.contact_b, n + np.arange(len(stands.grain))]
    for wall in range(4):
        start, end = (first + k for k, walls in enumerate(CORNERS) if wall in walls)
        chain = np.concatenate([[start], n + np.flatnonzero(stands.wall == wall), [end]])
        a.append(np.minimum(chain[:-1], chain[1:]))
        b.append(np.maximum(chain[:-1], chain[1:]))
    one, other = np.concatenate(a), np.concatenate(b)
    order = np.lexsort((other, one))
    none = np.zeros(len(one) - len(packing.contact_a))
    scale = packing.scale
    if len(scale):
        scale = np.concatenate([scale, scale[stands.grain], np.ones(4)])
    return packing._replace(
        x=np.concatenate(
            [packing.x, np.where(upright, at_side, packing.x[stands.grain]), corner_x]
        ),
        y=np.concatenate(
            [packing.y, np.where(upright, packing.y[stands.grain], at_side), corner_y]
        ),
        radius=np.concatenate([packing.radius, np.zeros(first - n + 4)]),
        contact_a=one[order],
        contact_b=other[order],
        normal_force=np.append(packing.normal_force, none)[order],
        shear_force=np.append(packing.shear_force, none)[order],
        scale=scale,
    )


def hollowed(packing: Packing, gone: np.ndarray) -> Packing:
    """The packing without some of its grains: they keep their numbers, but no size and no contact.

    Parameters
    ----------
    packing : grains, feet and corners
    gone : (n,) bool
    """
    stays = ~(gone[packing.contact_a] | gone[packing.contact_b])
    return packing._replace(
        radius=np.where(gone, 0.0, packing.radius),
        contact_a=packing.contact_a[stays],
        contact_b=packing.contact_b[stays],
        normal_force=packing.normal_force[stays],
        shear_force=packing.shear_force[stays],
    )
