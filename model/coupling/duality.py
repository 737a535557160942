"""One matrix A = dV/dx for both ways of coupling: fluid pushes grains, grains squeeze pores.

The volume V_d of a pore is the area of its polygon less the sectors ½ θ r² of the grains at its
corners and less the floaters inside. Moving the ends of an edge i j, which bounds the pore to its
left, changes it by n · (l_i dx_i + l_j dx_j), n the outward normal and
l_i = (d² + r_i² − r_j²) / (2 d), l_i + l_j = d, the wetted lengths: what the polygon gains,
½ d n · (dx_i + dx_j), and what turning the edge takes from one sector and gives to the other.
Work of the pressures, p · dV = (A p) · dx, makes A p the forces of the fluid on grains and walls;
they have no torque.

Other forms of the push are known, and given here to be compared. On the arc of a grain in the
pore acts 2 p r sin(θ/2), in edges r n at both its ends: l_i = r_i (`arc`), the same where discs
just touch. Eq. 6 of the paper has p r θ in its place (`paper`), which leaves a net force under
uniform pressure. Neither is the gradient of a volume where grains overlap or stand apart, so
that energy is not kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array

from demflow.model.network.enclosure import CORNERS, feet
from demflow.model.network.faces import locate, measure_faces
from demflow.model.products import Network, Packing

Array = np.ndarray

LENGTHS = ("chord", "arc", "paper")  # forms of the wetted lengths


class Pores(NamedTuple):
    """The d pores of a packing between walls, bound to what moves.

    The place of n grains and the walls is a vector (3 n + 4,): x, y and rotation of each grain,
    which says nothing here, then the walls left, right, bottom, top. v vertices: grains, their
    feet on walls, corners of the box.
    """

    row_x: Array  # (v,) entry of that vector that is the vertex's x
    row_y: Array  # (v,)
    radius: Array  # (v,) m, zero at feet and corners
    start: Array  # (d + 1,) first corner of each pore
    corner: Array  # (corners,) vertex at each, counter-clockwise
    floating: Array  # (d,) m² of floaters inside
    walls: Array  # (d, 4) bool: the walls left, right, bottom, top that it reaches


def pores_of(packing: Packing, network: Network) -> Pores:
    """Bind the pores of a network that was made of the packing `enclosed` to what moves."""
    n, stands = len(packing.x), feet(packing)
    grain, wall = stands
    if len(network.grain_x) != n + len(grain) + len(CORNERS):
        raise ValueError("the network is not that of the packing between its walls")
    corner_x, corner_y = np.array(CORNERS).T
    own = 3 * np.arange(n)
    row_x = np.concatenate([own, np.where(wall < 2, 3 * n + wall, 3 * grain), 3 * n + corner_x])
    row_y = np.concatenate(
        [own + 1, np.where(wall < 2, 3 * grain + 1, 3 * n + wall), 3 * n + corner_y]
    )
    carried = np.zeros(n + len(grain) + len(CORNERS), dtype=bool)
    carried[network.corner_grain] = True
    (floats,) = np.nonzero(~carried[:n])
    host = locate(
        packing.x[floats],
        packing.y[floats],
        network.corner_start,
        network.corner_grain,
        network.grain_x,
        network.grain_y,
    )
    lies = host >= 0
    floating = np.bincount(
        host[lies],
        weights=np.pi * network.grain_radius[floats[lies]] ** 2,
        minlength=len(network.x),
    )
    on_wall = np.zeros((len(carried), 4), dtype=bool)
    on_wall[n + np.arange(len(grain)), wall] = True
    for k, both in enumerate(CORNERS):
        on_wall[n + len(grain) + k, list(both)] = True
    pore, i, j = _edges(network.corner_start, network.corner_grain)
    walls = np.zeros((len(network.x), 4), dtype=bool)
    np.logical_or.at(walls, pore, on_wall[i] & on_wall[j])
    return Pores(
        row_x,
        row_y,
        network.grain_radius,
        network.corner_start,
        network.corner_grain,
        floating,
        walls,
    )


def _edges(start: Array, corner: Array) -> tuple[Array, Array, Array]:
    """The pore that each edge bounds, and the vertices that it runs from and to, (corners,)."""
    count = np.diff(start)
    after = np.arange(1, len(corner) + 1)
    after[start[1:][count > 0] - 1] = start[:-1][count > 0]
    return np.repeat(np.arange(len(count)), count), corner, corner[after]


def place_of(x: Array, y: Array, box: Array) -> Array:
    """The vector (3 n + 4,) of places from centres (n,) and walls (4,), m.

    Parameters
    ----------
    x, y : centres, (n,) m
    box : walls, (4,) m
    """
    place = np.zeros(3 * len(x) + 4)
    place[:-4:3], place[1:-4:3], place[-4:] = x, y, box
    return place


def pore_volumes(pores: Pores, place: Array) -> Array:
    """Volumes (d,) of the pores, m³ per metre of depth, with grains and walls at a place."""
    x, y = place[pores.row_x], place[pores.row_y]
    ring = np.flatnonzero(np.diff(pores.start))  # where a pipe ends on a rim there is no pore
    void = np.zeros(len(pores.floating))
    first = np.append(pores.start[ring], pores.start[-1])
    void[ring] = measure_faces(first, pores.corner, x, y, pores.radius)[3]
    found: Array = void - pores.floating
    return found


def volume_gradient(pores: Pores, place: Array, lengths: str = "chord") -> csr_array:
    """A (3 n + 4, d) in metres: A p are the forces of pressures p, Aᵀ dx the changes of volume.

    Parameters
    ----------
    pores : what moves them.
    place : (3 n + 4,) m, see `place_of`.
    lengths : a form of the wetted lengths, see the head of this file.
    """
    if lengths not in LENGTHS:
        raise ValueError(f"wetted lengths are {', '.join(LENGTHS)}, not {lengths!r}")
    pore, i, j = _edges(pores.start, pores.corner)
    x, y = place[pores.row_x], place[pores.row_y]
    dx, dy = x[j] - x[i], y[j] - y[i]
    d = np.hypot(dx, dy)
    ri, rj = pores.radius[i], pores.radius[j]
    # feet that fall together leave an edge of no length, and no push
    unit = np.divide(1.0, d, out=np.zeros_like(d), where=d > 0.0)
    if lengths == "chord":
        li = 0.5 * (d + (ri - rj) * (ri + rj) * unit)
        lj = d - li
    else:
        on_wall = (ri == 0.0) & (rj == 0.0)
        li, lj = np.where(on_wall, 0.5 * d, ri), np.where(on_wall, 0.5 * d, rj)
    if lengths == "paper":
        first, last = pores.start[pore], pores.start[pore + 1] - 1
        here = np.arange(len(i))
        turn = np.arctan2(dy, dx)
        before = turn[np.where(here > first, here - 1, last)]
        half = 0.5 * np.mod(before + np.pi - turn, 2.0 * np.pi)
        more = half / np.sin(half)
        li, lj = li * more, lj * more[np.where(here < last, here + 1, first)]
    nx, ny = dy * unit, -dx * unit
    row = [pores.row_x[i], pores.row_y[i], pores.row_x[j], pores.row_y[j]]
    value = [li * nx, li * ny, lj * nx, lj * ny]
    return coo_array(
        (np.concatenate(value), (np.concatenate(row), np.tile(pore, 4))),
        shape=(len(place), len(pores.start) - 1),
    ).tocsr()
