"""Where lines in the plane meet: the nodes and branches of a network of traces.

Lines meet where they cross or where an end of one lies on the other; within a tolerance that
is stated, never because something coarser says so. The same routine joins the traces of a
map that is read, gives embedded traces their shared nodes, and counts what the network is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

Array = np.ndarray

# Lines that come nearer to each other than this part of their length touch.
TOUCH = 1e-9
MOST_PAIRS = 4_000_000  # candidates that are looked at in one go
MOST_CELLS = 4_000_000  # entries of the grid that finds them


class Meetings(NamedTuple):
    """Places where two lines meet, m of them; places on a line are distances from its start."""

    line_a: Array  # (m,)
    line_b: Array  # (m,) > line_a
    along_a: Array  # (m,) m
    along_b: Array  # (m,) m
    overlap: Array  # (m,) bool: one end of a stretch along which the two lie on each other


class Topology(NamedTuple):
    """Nodes of a network of n lines, and the places of each line at which they stand.

    Every end of a line is at a node, so that line l consists of the branches between its
    consecutive places. Places are sorted by line, then along it.
    """

    node_x: Array  # (k,) m
    node_y: Array  # (k,) m
    line: Array  # (p,) line of a place
    node: Array  # (p,) its node
    along: Array  # (p,) m from the start of the line; 0 at its start, its length at its end

    @property
    def branches(self) -> tuple[Array, Array, Array]:
        """Line (b,), places before and after (b,), of each branch that joins two nodes."""
        first = np.flatnonzero(self.line[1:] == self.line[:-1])
        first = first[self.node[first] != self.node[first + 1]]
        return self.line[first], first, first + 1

    @property
    def degree(self) -> Array:
        """Branches that end at each node, (k,): 1 at a free end, 2 at a bend, 3 Y, 4 X."""
        _, before, after = self.branches
        return np.bincount(
            np.concatenate([self.node[before], self.node[after]]), minlength=len(self.node_x)
        )


def topology(start: Array, end: Array, snap: float = 0.0) -> Topology:
    """Nodes of straight lines in the plane, one for each place where some of them meet.

    Two lines share a node where they cross, or where an end of one lies within the tolerance
    of the other: the larger of `snap` and `TOUCH` times the longer of their lengths. Nodes
    nearer to each other along a line than its own tolerance are one. Consecutive pieces of a
    polyline share a node since their ends coincide. The cost grows with the number of lines and
    of their meetings, not with its square.

    Parameters
    ----------
    start, end : ends of the lines, (n, 2) in m.
    snap : distance within which an end counts as lying on another line, m.
    """
    from scipy.sparse import coo_array  # late: a study without maps is checked without it
    from scipy.sparse.csgraph import connected_components

    start = np.asarray(start, dtype=float).reshape(-1, 2)
    end = np.asarray(end, dtype=float).reshape(-1, 2)
    n = len(start)
    length = np.hypot(*(end - start).T)
    met = meetings(start, end, snap)
    line = np.concatenate([np.arange(n), np.arange(n), met.line_a, met.line_b])
    along = np.concatenate([np.zeros(n), length, met.along_a, met.along_b])
    m, count = len(met.line_a), len(line)
    one, other = 2 * n + np.arange(m), 2 * n + m + np.arange(m)
    # places of one line within its tolerance are one, and so are those where two lines meet
    order = np.lexsort((along, line))
    tolerance = np.maximum(snap, TOUCH * length)
    same = (line[order][1:] == line[order][:-1]) & (
        np.diff(along[order]) <= tolerance[line[order][1:]]
    )
    i = np.concatenate([one, order[:-1][same]])
    j = np.concatenate([other, order[1:][same]])
    graph = coo_array((np.ones(len(i), dtype=np.int8), (i, j)), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    # one place for each node on a line, an end of the line before what is beside it
    order = np.lexsort((np.arange(count), label, line))
    keep = np.ones(count, dtype=bool)
    keep[1:] = (line[order][1:] != line[order][:-1]) | (label[order][1:] != label[order][:-1])
    places = order[keep]
    places = places[np.lexsort((along[places], line[places]))]
    line, along, label = line[places], along[places], label[places]
    fraction = np.divide(along, length[line], out=np.zeros(len(line)), where=length[line] > 0)
    at = start[line] + fraction[:, None] * (end[line] - start[line])
    at[fraction == 1.0] = end[line[fraction == 1.0]]
    # a node stands at an end of a line where there is one, so that joined ends stay in place
    inner = (fraction > 0.0) & (fraction < 1.0)
    preferred = np.lexsort((inner, label))
    _, first = np.unique(label[preferred], return_index=True)
    stands, node = np.unique(label, return_inverse=True)
    chosen = at[preferred[first]].reshape(len(stands), 2)
    return Topology(chosen[:, 0], chosen[:, 1], line, node.reshape(-1), along)


def meetings(start: Array, end: Array, snap: float = 0.0) -> Meetings:
    """Where lines meet two by two; see `topology`, which makes nodes of it.

    A pair meets at every end of one that lies within the tolerance of the other; without one,
    where the two cross. Two that lie on each other meet at both ends of the stretch.

    Parameters
    ----------
    start, end : of the lines, (l, 2) m
    snap : tolerance, m
    """
    start = np.asarray(start, dtype=float).reshape(-1, 2)
    end = np.asarray(end, dtype=float).reshape(-1, 2)
    if len(start):  # coordinates of a map are large against its extent
        origin = 0.5 * (start.min(axis=0) + start.max(axis=0))
        start, end = start - origin, end - origin
    found = [
        _meet(start, end, i, j, snap)
        for i, j in _candidates(start, end, max(snap, TOUCH * _longest(start, end)))
    ]
    if not found:
        none, places = np.empty(0, dtype=np.int64), np.empty(0)
        return Meetings(none, none, places, places, np.empty(0, dtype=bool))
    return _joined(found)


def _joined(found: list[Meetings]) -> Meetings:
    return Meetings(*(np.concatenate(columns) for columns in zip(*found, strict=True)))


def _longest(start: Array, end: Array) -> float:
    return float(np.hypot(*(end - start).T).max(initial=0.0))


def _candidates(start: Array, end: Array, margin: float) -> list[tuple[Array, Array]]:
    """Pairs of lines i < j that share a cell of a grid, in lots.

    The cells are about as wide as the mean distance of the lines, 1 / P21, so that few lines
    pass each; a line stands in the cells of the boxes around its parts of one cell's length.
    """
    n = len(start)
    if n < 2:
        return []
    low = np.minimum(start, end).min(axis=0) - margin
    extent = float((np.maximum(start, end).max(axis=0) + margin - low).max())
    length = np.hypot(*(end - start).T)
    if extent == 0.0:
        extent = 1.0
    total = float(length.sum())
    width = max(2.0 * extent**2 / max(total, extent), 4.0 * margin, extent / 4096)
    while total / width + n > MOST_CELLS / 4:
        width *= 2.0
    parts = np.ceil(length / width).astype(np.int64).clip(1)
    owner = np.repeat(np.arange(n), parts)
    k = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)
    step = (end - start)[owner] / parts[owner][:, None]
    a = start[owner] + k[:, None] * step
    b = a + step
    first = np.floor((np.minimum(a, b) - margin - low) / width).astype(np.int64).clip(0)
    last = np.floor((np.maximum(a, b) + margin - low) / width).astype(np.int64).clip(0)
    spans = last - first + 1  # 1 to 3 each way
    cells = spans[:, 0] * spans[:, 1]
    entry = np.repeat(np.arange(len(owner)), cells)
    k = np.arange(len(entry)) - np.repeat(np.cumsum(cells) - cells, cells)
    column = first[entry, 0] + k % spans[entry, 0]
    row = first[entry, 1] + k // spans[entry, 0]
    key = column * np.int64(1 << 20) + row
    # each line once in each cell
    line, key = _unique_pairs(owner[entry], key)
    order = np.lexsort((line, key))
    line, key = line[order], key[order]
    group = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    size = np.diff(np.concatenate([group, [len(key)]]))
    behind = np.repeat(group + size, size) - np.arange(len(key)) - 1  # later lines in the cell
    lots = []
    ends = np.searchsorted(
        np.cumsum(behind), np.arange(1, int(behind.sum()) // MOST_PAIRS + 2) * MOST_PAIRS
    )
    begin = 0
    for stop in [*ends[ends < len(key)], len(key)]:
        if stop <= begin:
            continue
        here = np.repeat(np.arange(begin, stop), behind[begin:stop])
        k = np.arange(len(here)) - np.repeat(
            np.cumsum(behind[begin:stop]) - behind[begin:stop], behind[begin:stop]
        )
        lots.append(_unique_pairs(line[here], line[here + k + 1]))
        begin = stop
    if not lots:
        return []
    # a pair that shares cells of two lots is looked at once
    pairs = _unique_pairs(*(np.concatenate(side) for side in zip(*lots, strict=True)))
    cuts = range(0, len(pairs[0]), MOST_PAIRS)
    return [(pairs[0][c : c + MOST_PAIRS], pairs[1][c : c + MOST_PAIRS]) for c in cuts]


def _unique_pairs(i: Array, j: Array) -> tuple[Array, Array]:
    if len(i) == 0:
        return i, j
    order = np.lexsort((j, i))
    i, j = i[order], j[order]
    keep = np.concatenate([[True], (i[1:] != i[:-1]) | (j[1:] != j[:-1])])
    return i[keep], j[keep]


def _meet(start: Array, end: Array, i: Array, j: Array, snap: float) -> Meetings:
    """The meetings of candidate pairs."""
    p, r = start[i], end[i] - start[i]
    q, s = start[j], end[j] - start[j]
    length_i, length_j = np.hypot(*r.T), np.hypot(*s.T)
    tolerance = np.maximum(snap, TOUCH * np.maximum(length_i, length_j))
    # each end on the other line: distance from it and place on it
    on_j = [_foot(point, q, s, length_j) for point in (p, p + r)]
    on_i = [_foot(point, p, r, length_i) for point in (q, q + s)]
    touches = [
        (on_j[0][0] <= tolerance, np.zeros(len(i)), on_j[0][1]),
        (on_j[1][0] <= tolerance, length_i, on_j[1][1]),
        (on_i[0][0] <= tolerance, on_i[0][1], np.zeros(len(i))),
        (on_i[1][0] <= tolerance, on_i[1][1], length_j),
    ]
    any_touch = np.logical_or.reduce([touch for touch, _, _ in touches])
    low_i = np.min([np.where(t, a, np.inf) for t, a, _ in touches], axis=0)
    high_i = np.max([np.where(t, a, -np.inf) for t, a, _ in touches], axis=0)
    overlap = any_touch & (high_i - low_i > 2.0 * tolerance)
    turn = r[:, 0] * s[:, 1] - r[:, 1] * s[:, 0]
    gap = q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (gap[:, 0] * s[:, 1] - gap[:, 1] * s[:, 0]) / turn
        u = (gap[:, 0] * r[:, 1] - gap[:, 1] * r[:, 0]) / turn
        crosses = ~any_touch & (t > 0) & (t < 1) & (u > 0) & (u < 1)
        at = t * length_i, u * length_j
    return _joined(
        [
            Meetings(i[mask], j[mask], a[mask], b[mask], overlap[mask])
            for mask, a, b in (*touches, (crosses, *at))
        ]
    )


def _foot(point: Array, origin: Array, step: Array, length: Array) -> tuple[Array, Array]:
    """Distance of points from lines, and the place on them that is nearest, m."""
    squared = length**2
    along = np.einsum("ij,ij->i", point - origin, step)
    fraction = np.divide(along, squared, out=np.zeros(len(length)), where=squared > 0)
    fraction = np.clip(fraction, 0.0, 1.0)
    apart = point - origin - fraction[:, None] * step
    return np.hypot(apart[:, 0], apart[:, 1]), fraction * length


def polyline_problems(vertices: Sequence[tuple[float, float]] | Array) -> list[str]:
    """What keeps a polyline from being one trace: too few vertices, no length, meeting itself."""
    points = np.asarray(vertices, dtype=float).reshape(-1, 2)
    if len(points) < 2:
        return ["a trace needs at least two vertices"]
    if not np.isfinite(points).all():
        return [f"vertex {np.flatnonzero(~np.isfinite(points).all(axis=1))[0] + 1} is no number"]
    still = np.flatnonzero((points[1:] == points[:-1]).all(axis=1))
    if len(still):
        return [f"vertices {still[0] + 1} and {still[0] + 2} are the same point; leave one out"]
    met = meetings(points[:-1], points[1:])
    wrong = np.flatnonzero((met.line_b - met.line_a > 1) | met.overlap)
    if len(wrong) == 0:
        return []
    a, b = met.line_a[wrong[0]] + 1, met.line_b[wrong[0]] + 1
    if (points[0] == points[-1]).all() and (a, b) == (1, len(points) - 1):
        return ["the trace is a closed ring; leave its last vertex out, or give two traces"]
    how = "folds back on itself" if b == a + 1 else "meets itself"
    return [f"the trace {how} in its pieces {a} and {b}; give two traces instead"]
