"""Steady flow through rock with open fractures on triangles that follow them: slow and obvious.

Pressures are quadratic on triangles of which each trace is a chain of edges, the finer the nearer
to its ends and to where traces meet. The flow is the least dissipation of such pressures, so that
it falls towards the true one as the triangles grow smaller, and is never below it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay, cKDTree

Size = Callable[[np.ndarray], np.ndarray]

MIDDLES = ((0.5, 0.0), (0.5, 0.5), (0.0, 0.5))  # of the sides, where products of slopes are summed
ALONG = np.array([[7, 1, -8], [1, 7, -8], [-8, -8, 16]]) / 3.0  # of a piece: its ends and middle


def flow(
    width: float,
    height: float,
    traces: np.ndarray,
    transmissivity: float,
    finest: float,
    growth: float,
    coarsest: float,
) -> float:
    """Flow from left to right for a drop of one, over the mobility of the rock.

    Parameters
    ----------
    width, height : of the rectangle, its corner at the origin
    traces : (k, 4) as x0, y0, x1, y1, inside
    transmissivity : of the traces, over the permeability of the rock, a length
    finest : size of the triangles at ends of traces and where they meet
    growth : of the size per distance from there
    coarsest : size of the triangles far away
    """
    points, triangles, pieces = _mesh(width, height, traces, finest, growth, coarsest)
    nodes, six, three = _with_middles(points, triangles, pieces)
    corner = nodes[six[:, :3]]
    edges = np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], axis=2)
    inverse, area = np.linalg.inv(edges), 0.5 * np.abs(np.linalg.det(edges))
    within = np.zeros((len(six), 6, 6))
    for r, s in MIDDLES:
        slope = np.einsum("ka,eab->ekb", _slopes(r, s), inverse)
        within += (area / 3.0)[:, None, None] * np.einsum("eka,ela->ekl", slope, slope)
    length = np.hypot(*(points[pieces[:, 1]] - points[pieces[:, 0]]).T)
    along = (transmissivity / length)[:, None, None] * ALONG
    rows = [np.repeat(six, 6, axis=1), np.repeat(three, 3, axis=1)]
    columns = [np.tile(six, (1, 6)), np.tile(three, (1, 3))]
    where = tuple(np.concatenate([part.ravel() for part in parts]) for parts in (rows, columns))
    values = np.concatenate([within.ravel(), along.ravel()])
    matrix = coo_array((values, where), (len(nodes),) * 2).tocsr()
    left, right = nodes[:, 0] < 1e-9 * width, nodes[:, 0] > (1.0 - 1e-9) * width
    p, free = left.astype(float), ~(left | right)
    p[free] = spsolve(matrix[free][:, free].tocsc(), -(matrix @ p)[free])
    return float(p @ (matrix @ p))


def _slopes(r: float, s: float) -> np.ndarray:
    """Of the six shapes at a place: corners, then the middles of sides 01, 12 and 20."""
    t = 1.0 - r - s
    return np.array(
        [
            [1.0 - 4.0 * t, 1.0 - 4.0 * t],
            [4.0 * r - 1.0, 0.0],
            [0.0, 4.0 * s - 1.0],
            [4.0 * (t - r), -4.0 * r],
            [4.0 * s, 4.0 * r],
            [-4.0 * s, 4.0 * (t - s)],
        ]
    )


def _with_middles(
    points: np.ndarray, triangles: np.ndarray, pieces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners and middles of sides, the six of each triangle, and the three of each piece."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    every, which = np.unique(sides, axis=0, return_inverse=True)
    key = every @ [len(points), 1]
    of_pieces = np.searchsorted(key, np.sort(pieces, axis=1) @ [len(points), 1])
    nodes = np.concatenate([points, points[every].mean(axis=1)])
    six = np.column_stack([triangles, len(points) + which.reshape(-1, 3)])
    return nodes, six, np.column_stack([pieces, len(points) + of_pieces])


def _mesh(
    width: float,
    height: float,
    traces: np.ndarray,
    finest: float,
    growth: float,
    coarsest: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 2), triangles (t, 3), and pieces (m, 2) of traces, which are their sides."""
    w, h = width, height
    rim = np.array([[0, 0, w, 0], [w, 0, w, h], [w, h, 0, h], [0, h, 0, 0]], dtype=float)
    lines = np.concatenate([traces, rim])
    stops = [_stops(lines, k) for k in range(len(lines))]
    special = [
        line[:2] + t[:, None] * (line[2:] - line[:2]) for line, t in zip(lines, stops, strict=True)
    ]
    near = cKDTree(np.concatenate(special))

    def size(points: np.ndarray) -> np.ndarray:
        return np.minimum(finest + growth * near.query(points)[0], coarsest)

    ends, trace = [], []
    for k, places in enumerate(special):
        for a, b in itertools.pairwise(places):
            chain = _spaced(a, b, size)
            ends.append(np.stack([chain[:-1], chain[1:]], axis=1))
            trace.append(np.full(len(chain) - 1, k < len(traces)))
    pieces, is_trace = np.concatenate(ends), np.concatenate(trace)
    bulk = _between(width, height, coarsest, size)
    while True:
        middle = pieces.mean(axis=1)
        half = 0.5 * np.hypot(*(pieces[:, 1] - pieces[:, 0]).T)
        # the points between keep out of the circles over the pieces, and some way off
        off, nearest = cKDTree(middle).query(bulk)
        bulk = bulk[off > 1.3 * half[nearest]]
        corners = pieces.reshape(-1, 2)
        known = np.round(corners / (1e-7 * finest)).astype(np.int64)
        _, first, which = np.unique(known, axis=0, return_index=True, return_inverse=True)
        points = np.concatenate([corners[first], bulk])
        numbers = which.reshape(-1, 2)
        triangles = Delaunay(points).simplices
        a, b, c = points[triangles.T]
        twice = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        triangles = triangles[twice > 1e-12 * finest**2]
        sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        there = np.isin(np.sort(numbers, axis=1) @ [len(points), 1], sides @ [len(points), 1])
        if there.all():
            return points, triangles, numbers[is_trace]
        parts = np.stack(
            [
                np.stack([pieces[~there, 0], middle[~there]], axis=1),
                np.stack([middle[~there], pieces[~there, 1]], axis=1),
            ],
            axis=1,
        ).reshape(-1, 2, 2)
        pieces = np.concatenate([pieces[there], parts])
        is_trace = np.concatenate([is_trace[there], np.repeat(is_trace[~there], 2)])


def _stops(lines: np.ndarray, k: int) -> np.ndarray:
    """Ends of a line and where others meet it, as parts of its length, in order."""
    start, step = lines[k, :2], lines[k, 2:] - lines[k, :2]
    found = [0.0, 1.0]
    for other, line in enumerate(lines):
        q, s = line[:2] - start, line[2:] - line[:2]
        turn = step[0] * s[1] - step[1] * s[0]
        if other == k or turn == 0.0:
            continue
        t, u = (q[0] * s[1] - q[1] * s[0]) / turn, (q[0] * step[1] - q[1] * step[0]) / turn
        if -1e-9 <= t <= 1.0 + 1e-9 and -1e-9 <= u <= 1.0 + 1e-9:
            found.append(min(max(t, 0.0), 1.0))
    parts = np.unique(found)
    kept: np.ndarray = parts[np.append(True, np.diff(parts) > 1e-9)]
    return kept


def _spaced(start: np.ndarray, end: np.ndarray, size: Size) -> np.ndarray:
    """Points from one to the other, as far apart as the triangles are large."""
    t = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 400))
    place = start + t[:, None] * (end - start)
    step = np.diff(t) * np.hypot(*(end - start))
    reached = np.append(0.0, np.cumsum(step / size(0.5 * (place[1:] + place[:-1]))))
    count = max(1, round(float(reached[-1])))
    t = np.interp(np.linspace(0.0, reached[-1], count + 1), reached, t)
    return start + t[:, None] * (end - start)


def _between(width: float, height: float, coarsest: float, size: Size) -> np.ndarray:
    """Centres of squares as large as triangles, a little off, for no four to lie on a circle."""
    counts = np.ceil(np.array([width, height]) / coarsest).astype(int)
    side = np.array([width, height]) / counts
    place = (np.stack(np.meshgrid(*map(np.arange, counts)), axis=-1).reshape(-1, 2) + 0.5) * side
    found = []
    while len(place):
        large = side.max() > size(place)
        found.append(place[~large])
        side = 0.5 * side
        quarters = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]]) * side
        place = (place[large][:, None] + quarters).reshape(-1, 2)
    points = np.concatenate(found)
    shaken = 0.2 * size(points)[:, None] * np.random.default_rng(1).uniform(-1.0, 1.0, points.shape)
    return np.clip(points + shaken, 0.0, [width, height])
