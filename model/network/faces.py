"""Faces of a plane straight-line graph: kernels on grains and the contacts between them.

A half-edge 2e runs from a to b of contact e, 2e + 1 back; its face lies to the left.
"""

from __future__ import annotations

import numpy as np

from demflow.model.compile import Array, kernel


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


@kernel
def next_half_edges(start: Array, half_edges: Array, a: Array, b: Array) -> Array:
    """The half-edge that follows each one around its face, counter-clockwise.

    `half_edges[start[v]:start[v + 1]]` leave grain v in counter-clockwise order.

    Parameters
    ----------
    start : where the half-edges of each grain begin, (n + 1,)
    half_edges : (2 c,), counter-clockwise about each grain
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    """
    m = half_edges.size
    place = np.empty(m, np.int64)
    for k in range(m):
        place[half_edges[k]] = k
    following = np.empty(m, np.int64)
    for h in range(m):
        e = h >> 1
        v = b[e] if h & 1 == 0 else a[e]
        k = place[h ^ 1]
        # the face lies to the left: turn to the next half-edge clockwise
        following[h] = half_edges[k - 1] if k > start[v] else half_edges[start[v + 1] - 1]
    return following


@kernel
def walk_faces(following: Array, origin: Array) -> tuple[Array, Array, Array, Array]:
    """Collect the cycles of `following`.

    Returns the first corner of each face (faces + 1), the grain and the half-edge at
    each corner, and the face of each half-edge.
    """
    m = following.size
    face = np.full(m, -1, np.int64)
    first = np.empty(m + 1, np.int64)
    corner_grain = np.empty(m, np.int64)
    corner_half_edge = np.empty(m, np.int64)
    faces = 0
    corner = 0
    for h0 in range(m):
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
    return first[: faces + 1].copy(), corner_grain, corner_half_edge, face


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


@kernel
def _cell(value: float, low: float, size: float, count: int) -> int:
    """Cell of a row of `count` that a coordinate lies in; what lies outside is in the last."""
    return min(max(int((value - low) / size), 0), count - 1)


@kernel
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
    if px.size == 0:
        return found
    west, south = px.min(), py.min()
    cells = int(np.ceil(np.sqrt(px.size)))
    size = max(px.max() - west, py.max() - south) / cells
    if size == 0.0:
        cells, size = 1, 1.0
    start = np.zeros(cells * cells + 1, np.int64)
    cell = np.empty(px.size, np.int64)
    for p in range(px.size):
        column, row = _cell(px[p], west, size, cells), _cell(py[p], south, size, cells)
        cell[p] = row * cells + column
        start[cell[p] + 1] += 1
    start = np.cumsum(start)
    fill = start.copy()
    points = np.empty(px.size, np.int64)
    for p in range(px.size):
        points[fill[cell[p]]] = p
        fill[cell[p]] += 1
    for f in range(first.size - 1):
        if first[f] == first[f + 1]:
            continue
        x0, x1, y0, y1 = np.inf, -np.inf, np.inf, -np.inf
        for k in range(first[f], first[f + 1]):
            gx, gy = x[corner_grain[k]], y[corner_grain[k]]
            x0, x1, y0, y1 = min(x0, gx), max(x1, gx), min(y0, gy), max(y1, gy)
        for row in range(_cell(y0, south, size, cells), _cell(y1, south, size, cells) + 1):
            for column in range(_cell(x0, west, size, cells), _cell(x1, west, size, cells) + 1):
                for s in range(start[row * cells + column], start[row * cells + column + 1]):
                    p = points[s]
                    if (
                        found[p] < 0
                        and x0 <= px[p] <= x1
                        and y0 <= py[p] <= y1
                        and _contains(px[p], py[p], first[f], first[f + 1], corner_grain, x, y)
                    ):
                        found[p] = f
    return found


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


@kernel
def crossing_pairs(  # noqa: C901 (a kernel)
    a: Array, b: Array, x: Array, y: Array, size: float
) -> Array:
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
    west, south = x.min(), y.min()
    columns = int((x.max() - west) / size) + 1
    rows = int((y.max() - south) / size) + 1
    start = np.zeros(columns * rows + 1, np.int64)
    member = np.empty(0, np.int64)
    for filling in (False, True):
        for e in range(a.size):
            x0, x1 = min(x[a[e]], x[b[e]]), max(x[a[e]], x[b[e]])
            y0, y1 = min(y[a[e]], y[b[e]]), max(y[a[e]], y[b[e]])
            for row in range(_cell(y0, south, size, rows), _cell(y1, south, size, rows) + 1):
                for column in range(
                    _cell(x0, west, size, columns), _cell(x1, west, size, columns) + 1
                ):
                    cell = row * columns + column
                    if filling:
                        start[cell] -= 1
                        member[start[cell]] = e
                    else:
                        start[cell] += 1
        if not filling:
            start = np.cumsum(start)
            member = np.empty(start[-1], np.int64)
    found = 0
    pairs = np.empty((0, 2), np.int64)
    for filling in (False, True):
        if filling:
            pairs = np.empty((found, 2), np.int64)
            found = 0
        for cell in range(columns * rows):
            for s in range(start[cell], start[cell + 1]):
                for t in range(s + 1, start[cell + 1]):
                    e, f = min(member[s], member[t]), max(member[s], member[t])
                    x0 = max(min(x[a[e]], x[b[e]]), min(x[a[f]], x[b[f]]))
                    y0 = max(min(y[a[e]], y[b[e]]), min(y[a[f]], y[b[f]]))
                    home = _cell(y0, south, size, rows) * columns + _cell(x0, west, size, columns)
                    if home == cell and _cross(a[e], b[e], a[f], b[f], x, y):
                        if filling:
                            pairs[found, 0], pairs[found, 1] = e, f
                        found += 1
        if found == 0:
            break
    return pairs


@kernel
def _cross(p: int, q: int, r: int, s: int, x: Array, y: Array) -> bool:
    """Whether the segments p–q and r–s cross between their ends."""
    if p in (r, s) or q in (r, s):
        return False
    d1 = (x[q] - x[p]) * (y[r] - y[p]) - (y[q] - y[p]) * (x[r] - x[p])
    d2 = (x[q] - x[p]) * (y[s] - y[p]) - (y[q] - y[p]) * (x[s] - x[p])
    d3 = (x[s] - x[r]) * (y[p] - y[r]) - (y[s] - y[r]) * (x[p] - x[r])
    d4 = (x[s] - x[r]) * (y[q] - y[r]) - (y[s] - y[r]) * (x[q] - x[r])
    found: bool = d1 * d2 < 0.0 and d3 * d4 < 0.0
    return found
