"""Faces of a plane straight-line graph: kernels on grains and the contacts between them.

A half-edge 2e runs from a to b of contact e, 2e + 1 back; its face lies to the left.
"""

from __future__ import annotations

import numpy as np

from model.compile import kernel


@kernel
def prune(n, a, b):
    """Contacts that can bound a face: both grains keep at least two of them.

    Grains with fewer than two contacts are removed until none is left.
    Returns a mask over the contacts.
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
def next_half_edges(start, half_edges, a, b):
    """The half-edge that follows each one around its face, counter-clockwise.

    `half_edges[start[v]:start[v + 1]]` leave grain v in counter-clockwise order.
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
def walk_faces(following, origin):
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
def measure_faces(first, corner_grain, x, y, radius):
    """Signed area, centroid and void area (polygon less grain sectors) of each face."""
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
def locate(px, py, first, corner_grain, x, y):
    """The face whose polygon contains each point, −1 where none does."""
    n = first.size - 1
    box = np.empty((n, 4))
    for f in range(n):
        box[f, 0], box[f, 1], box[f, 2], box[f, 3] = np.inf, -np.inf, np.inf, -np.inf
        for k in range(first[f], first[f + 1]):
            gx, gy = x[corner_grain[k]], y[corner_grain[k]]
            box[f, 0], box[f, 1] = min(box[f, 0], gx), max(box[f, 1], gx)
            box[f, 2], box[f, 3] = min(box[f, 2], gy), max(box[f, 3], gy)
    found = np.full(px.size, -1, np.int64)
    for p in range(px.size):
        for f in range(n):
            if px[p] < box[f, 0] or px[p] > box[f, 1] or py[p] < box[f, 2] or py[p] > box[f, 3]:
                continue
            inside = False
            lo, hi = first[f], first[f + 1]
            for k in range(lo, hi):
                g = corner_grain[k]
                q = corner_grain[k + 1] if k + 1 < hi else corner_grain[lo]
                if (y[g] > py[p]) != (y[q] > py[p]) and px[p] < x[g] + (py[p] - y[g]) * (
                    x[q] - x[g]
                ) / (y[q] - y[g]):
                    inside = not inside
            if inside:
                found[p] = f
                break
    return found


@kernel
def crossing_pairs(pairs, a, b, x, y):
    """Which of the candidate pairs of contacts properly cross each other."""
    crosses = np.zeros(len(pairs), np.bool_)
    for k in range(len(pairs)):
        e, f = pairs[k, 0], pairs[k, 1]
        p, q, r, s = a[e], b[e], a[f], b[f]
        if p in (r, s) or q in (r, s):
            continue
        d1 = (x[q] - x[p]) * (y[r] - y[p]) - (y[q] - y[p]) * (x[r] - x[p])
        d2 = (x[q] - x[p]) * (y[s] - y[p]) - (y[q] - y[p]) * (x[s] - x[p])
        d3 = (x[s] - x[r]) * (y[p] - y[r]) - (y[s] - y[r]) * (x[p] - x[r])
        d4 = (x[s] - x[r]) * (y[q] - y[r]) - (y[s] - y[r]) * (x[q] - x[r])
        crosses[k] = d1 * d2 < 0.0 and d3 * d4 < 0.0
    return crosses
