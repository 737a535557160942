"""Faces of a plane straight-line graph: kernels on grains and the contacts between them.

A half-edge 2e runs from a to b of contact e, 2e + 1 back; its face lies to the left.
"""

from __future__ import annotations

import numpy as np

from demflow.model.compile import Array, kernel
from demflow.model.network.cells import Cells, cell_of, into_cells


@kernel
def prune(n: int, a: Array, b: Array) -> Array:
    """Contacts that can bound a face: both grains keep at least two of them.

    Grains with fewer than two contacts are removed until none is left.
    Returns a mask over the contacts.

    Parameters
    ----------
    n : number of grains
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    """
    degree = np.zeros(n, np.int64)
    for e in range(a.size):
        degree[a[e]] += 1
        degree[b[e]] += 1
    kept = np.ones(a.size, np.bool_)
    changed = True
    while changed:
        changed = False
        for e in range(a.size):
            if kept[e] and (degree[a[e]] < 2 or degree[b[e]] < 2):
                kept[e] = False
                degree[a[e]] -= 1
                degree[b[e]] -= 1
                changed = True
    return kept


def next_half_edges(n: int, origin: Array, angle: Array) -> Array:
    """The half-edge that follows each one around its face, counter-clockwise.

    Half-edges are sorted by their angle about each grain, which takes time in proportion to
    their number: a grain has few.

    Parameters
    ----------
    n : number of grains
    origin : grain that each half-edge leaves, (2 c,)
    angle : its direction there, (2 c,) rad
    """
    end = np.cumsum(np.bincount(origin, minlength=n))
    around, following = np.empty_like(origin), np.empty_like(origin)
    _turn(end, origin, angle, around, following)
    return following


@kernel
def _turn(end: Array, origin: Array, angle: Array, around: Array, following: Array) -> None:
    """Sort the half-edges `around` each grain, whose last one lies before `end`, and link them.

    Arrays of their number are made by NumPy, here and below: it asks for large pages.
    """
    first = end.copy()
    for h in range(origin.size - 1, -1, -1):
        v = origin[h]
        first[v] -= 1
        k = first[v]
        while k + 1 < end[v] and angle[around[k + 1]] < angle[h]:
            around[k] = around[k + 1]
            k += 1
        around[k] = h
    for v in range(end.size):
        for k in range(first[v], end[v]):
            # the face lies to the left: turn to the next half-edge clockwise
            following[around[k] ^ 1] = around[k - 1] if k > first[v] else around[end[v] - 1]


def walk_faces(following: Array, origin: Array) -> tuple[Array, Array, Array, Array]:
    """Collect the cycles of `following`.

    Returns the first corner of each face (faces + 1), the grain and the half-edge at
    each corner, and the face of each half-edge.
    """
    first = np.empty(following.size + 1, np.int64)
    corner_grain, corner_half_edge = np.empty_like(following), np.empty_like(following)
    face = np.full_like(following, -1)
    faces = _walk(following, origin, first, corner_grain, corner_half_edge, face)
    return first[: faces + 1].copy(), corner_grain, corner_half_edge, face


@kernel
def _walk(
    following: Array,
    origin: Array,
    first: Array,
    corner_grain: Array,
    corner_half_edge: Array,
    face: Array,
) -> int:
    """Number the faces from half-edge to half-edge; how many there are."""
    faces = 0
    corner = 0
    for h0 in range(following.size):
        if face[h0] >= 0:
            continue
        first[faces] = corner
        h = h0
        while face[h] < 0:
            face[h] = faces
            corner_grain[corner] = origin[h]
            corner_half_edge[corner] = h
            corner += 1
            h = following[h]
        faces += 1
    first[faces] = corner
    return faces


@kernel
def measure_faces(
    first: Array, corner_grain: Array, x: Array, y: Array, radius: Array
) -> tuple[Array, Array, Array, Array]:
    """Signed area, centroid and void area (polygon less grain sectors) of each face.

    Parameters
    ----------
    first : first corner of each face, (faces + 1,)
    corner_grain : grain at each corner
    x, y : centres of grains, (n,) m
    radius : radii of grains, (n,) m
    """
    n = first.size - 1
    area = np.empty(n)
    cx = np.empty(n)
    cy = np.empty(n)
    void = np.empty(n)
    for f in range(n):
        lo, hi = first[f], first[f + 1]
        x0, y0 = x[corner_grain[lo]], y[corner_grain[lo]]
        twice, sx, sy, sectors = 0.0, 0.0, 0.0, 0.0
        for k in range(lo, hi):
            g = corner_grain[k]
            after = corner_grain[k + 1] if k + 1 < hi else corner_grain[lo]
            before = corner_grain[k - 1] if k > lo else corner_grain[hi - 1]
            # relative to the first corner: no cancellation far from the origin
            px, py = x[g] - x0, y[g] - y0
            qx, qy = x[after] - x0, y[after] - y0
            cross = px * qy - qx * py
            twice += cross
            sx += (px + qx) * cross
            sy += (py + qy) * cross
            ux, uy = x[after] - x[g], y[after] - y[g]
            vx, vy = x[before] - x[g], y[before] - y[g]
            angle = np.arctan2(ux * vy - uy * vx, ux * vx + uy * vy)
            if angle <= 0.0:
                angle += 2.0 * np.pi
            sectors += 0.5 * angle * radius[g] ** 2
        area[f] = 0.5 * twice
        cx[f] = x0 + sx / (3.0 * twice) if twice != 0.0 else x0
        cy[f] = y0 + sy / (3.0 * twice) if twice != 0.0 else y0
        void[f] = area[f] - sectors
    return area, cx, cy, void


def locate(px: Array, py: Array, first: Array, corner_grain: Array, x: Array, y: Array) -> Array:
    """The first face whose polygon contains each point, −1 where none does.

    The points are sorted into cells, about one in each; a face looks at the cells that its
    box meets.

    Parameters
    ----------
    px, py : points, (k,) m
    first : first corner of each face, (faces + 1,)
    corner_grain : grain at each corner
    x, y : centres of grains, (n,) m
    """
    found = np.full(px.size, -1, np.int64)
    if px.size > 0:
        size = max(np.ptp(px), np.ptp(py)) / np.ceil(np.sqrt(px.size))
        cells = into_cells(px, py, px, py, float(size) if size > 0.0 else 1.0)
        _locate(found, cells, px, py, first, corner_grain, x, y)
    return found


@kernel
def _locate(
    found: Array,
    cells: Cells,
    px: Array,
    py: Array,
    first: Array,
    corner_grain: Array,
    x: Array,
    y: Array,
) -> None:
    """Look for the face of each point among the cells of all."""
    west, south, size, columns = cells.west, cells.south, cells.size, cells.columns
    for f in range(first.size - 1):
        if first[f] == first[f + 1]:
            continue
        x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
        for k in range(first[f], first[f + 1]):
            gx, gy = x[corner_grain[k]], y[corner_grain[k]]
            x0, x1, y0, y1 = min(x0, gx), max(x1, gx), min(y0, gy), max(y1, gy)
        c0, c1 = cell_of(x0, west, size, columns), cell_of(x1, west, size, columns)
        r0, r1 = cell_of(y0, south, size, cells.rows), cell_of(y1, south, size, cells.rows)
        for row in range(r0, r1 + 1):
            begin, end = row * columns + c0, row * columns + c1 + 1
            for s in range(cells.first[begin], cells.first[end]):
                p = cells.member[s]
                if (
                    found[p] < 0
                    and x0 <= px[p] <= x1
                    and y0 <= py[p] <= y1
                    and _contains(px[p], py[p], first[f], first[f + 1], corner_grain, x, y)
                ):
                    found[p] = f


@kernel
def _contains(
    px: float, py: float, lo: int, hi: int, corner_grain: Array, x: Array, y: Array
) -> bool:
    """Whether the polygon of corners lo … hi − 1 contains a point (even–odd rule)."""
    inside = False
    for k in range(lo, hi):
        g = corner_grain[k]
        q = corner_grain[k + 1] if k + 1 < hi else corner_grain[lo]
        if (y[g] > py) != (y[q] > py) and px < x[g] + (py - y[g]) * (x[q] - x[g]) / (y[q] - y[g]):
            inside = not inside
    return inside


def crossing_pairs(a: Array, b: Array, x: Array, y: Array, size: float) -> Array:
    """Pairs of contacts (pairs, 2) that properly cross each other.

    Contacts are sorted into square cells of the given size that their boxes meet; a pair is
    looked at in the cell where the boxes' common part begins.

    Parameters
    ----------
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    x, y : centres of grains, (n,) m
    size : side of a cell, m
    """
    ends = (x[a], y[a], x[b], y[b])
    cells = into_cells(*ends, size)
    pairs = np.empty((0, 2), np.int64)
    found = _cross_in(cells, a, b, *ends, pairs)
    if found > 0:
        pairs = np.empty((found, 2), np.int64)
        _cross_in(cells, a, b, *ends, pairs)
    return pairs


@kernel
def _cross_in(
    cells: Cells, a: Array, b: Array, px: Array, py: Array, qx: Array, qy: Array, pairs: Array
) -> int:
    """How many pairs of contacts in the same cell cross; they are written where there is room."""
    found = 0
    for cell in range(cells.columns * cells.rows):
        for s in range(cells.first[cell], cells.first[cell + 1]):
            for t in range(s + 1, cells.first[cell + 1]):
                e, f = cells.member[t], cells.member[s]  # the later one stands first in a cell
                x0 = max(min(px[e], qx[e]), min(px[f], qx[f]))
                y0 = max(min(py[e], qy[e]), min(py[f], qy[f]))
                row = cell_of(y0, cells.south, cells.size, cells.rows)
                column = cell_of(x0, cells.west, cells.size, cells.columns)
                if row * cells.columns + column != cell:
                    continue
                meet = a[e] == a[f] or a[e] == b[f] or b[e] == a[f] or b[e] == b[f]
                if meet or not _cross(e, f, px, py, qx, qy) or not _cross(f, e, px, py, qx, qy):
                    continue
                if found < len(pairs):
                    pairs[found, 0], pairs[found, 1] = e, f
                found += 1
    return found


@kernel
def _cross(e: int, f: int, px: Array, py: Array, qx: Array, qy: Array) -> bool:
    """Whether the ends of a segment f lie on two sides of another one e."""
    dx, dy = qx[e] - px[e], qy[e] - py[e]
    p = dx * (py[f] - py[e]) - dy * (px[f] - px[e])
    q = dx * (qy[f] - py[e]) - dy * (qx[f] - px[e])
    parted: bool = p * q < 0.0
    return parted
