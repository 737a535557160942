"""A map of traces as a file holds it, and how it is laid into a scene: judged, joined, cut.

Reading files is the study's; here a map is arrays with the hash of the file they came from, so
that a scene stays a value and a case's identity follows the content.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from demflow.model.parameters import SceneError
from demflow.model.region import Rectangle, clip_segments
from demflow.model.scene.topology import Topology, meetings, topology

__all__ = ["LaidMap", "MapFile", "lay", "ring_area_and_centroid"]

Array = np.ndarray

MOST_TOLD = 8  # faults of a map that are told one by one


@dataclass(frozen=True, slots=True, eq=False)
class MapFile:
    """The polylines of a file, m of them with v vertices, in the file's own coordinates."""

    vertices: Array  # (v, 2) of one polyline after the other
    first: Array  # (m + 1,) the first vertex of each
    feature: Array  # (m,) number of the feature (record, line) in the file, from 1
    sha256: str  # of the file's content
    unit: float | None = 1.0  # m per unit of the coordinates; None: perhaps degrees

    def __post_init__(self) -> None:
        for array in (self.vertices, self.first, self.feature):
            array.flags.writeable = False

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MapFile) and self._content() == other._content()

    def __hash__(self) -> int:
        return hash(self._content())

    def _content(self) -> tuple[str, bytes, bytes]:
        return self.sha256, self.vertices.tobytes(), self.first.tobytes()


class LaidMap(NamedTuple):
    """A map in the coordinates of the scene."""

    vertices: Array  # (v, 2) m
    first: Array  # (m + 1,)
    feature: Array  # (m,) number in the file
    extent: tuple[float, float]  # m, of the whole map
    origin: tuple[float, float]  # m, the place of the map that is the scene's origin
    length: float  # m, of all traces of the map
    area: float | None  # m2, of the mapped area where one is given
    traces: int  # of the map, before it is cut
    repeated: int  # vertices that stood twice and count once
    vanished: int  # traces that the snap closes to a point


@functools.lru_cache(maxsize=16)
def lay(
    file: MapFile,
    area: MapFile | None,
    unit: float,
    origin: str | tuple[float, float],
    crop: float | None,
    simplify: float | None,
    snap: float | None,
) -> LaidMap:
    """A map in the scene's coordinates, and what it was.

    Every trace is judged first. Then ends within `snap` of another trace are joined to it, and
    every meeting becomes a vertex of both traces; `simplify` takes out vertices between such
    joints (Douglas and Peucker 1973) where that neither makes nor loses a meeting; the origin
    is moved, and `crop` cuts all to a square around it.

    Parameters
    ----------
    simplify, snap : distance, m
    file, area : the traces; the rings of the mapped area.
    unit : metres per unit of the file's coordinates.
    origin : `file` (as it is), `centroid` (of the area, or of the traces by their length), or
        a point in metres of the map that becomes the scene's origin.
    crop : side of the square, m. simplify, snap : distances, m.

    Raises
    ------
    SceneError : with the number of each feature that is no trace, and what to do.
    """
    vertices, first, repeated = _without_repeats(file.vertices * unit, file.first)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if area is not None:
        mapped, centre = ring_area_and_centroid(area, unit)
    else:
        mapped, centre = None, _centroid(vertices, first)
    if origin == "centroid":
        at = centre
    else:
        at = np.zeros(2) if isinstance(origin, str) else np.array(origin)
    if problems := list(_faults(vertices, first, file.feature)):
        shown = problems[:MOST_TOLD]
        if len(problems) > MOST_TOLD:
            shown.append(f"and {len(problems) - MOST_TOLD} faults more")
        raise SceneError([("file", what) for what in shown])
    vertices = vertices - at
    length, count = float(_lengths(vertices, first).sum()), len(first) - 1
    if snap is not None and snap * count > length:  # ends would be joined to their own other ends
        what = f"{snap:.3g} m is longer than a trace is in the mean, {length / count:.3g} m"
        raise SceneError([("snap", what)])
    feature = file.feature
    if snap is not None or simplify is not None:
        vertices, first, feature = _joined(vertices, first, feature, snap or 0.0)
    vanished = count - (len(first) - 1)
    if simplify is not None:
        vertices, first = _simplified(vertices, first, simplify)
    if crop is not None:
        vertices, first, feature = _cropped(vertices, first, feature, Rectangle(crop, crop))
    return LaidMap(
        vertices,
        first,
        feature,
        (float(high[0] - low[0]), float(high[1] - low[1])),
        (float(at[0]), float(at[1])),
        length,
        mapped,
        count,
        repeated,
        vanished,
    )


def pieces(first: Array) -> tuple[Array, Array]:
    """Polyline and first vertex of each straight piece, (s,) each."""
    count = np.diff(first)
    owner = np.repeat(np.arange(len(count)), count)
    inner = np.flatnonzero(owner[1:] == owner[:-1])
    return owner[inner], inner


def ring_area_and_centroid(area: MapFile, unit: float) -> tuple[float, Array]:
    """Area (m²) and centroid (m) of rings: outer ones count, rings within another are holes."""
    rings = [area.vertices[a:b] * unit for a, b in itertools.pairwise(area.first) if b - a > 2]
    total, moment = 0.0, np.zeros(2)
    origin = rings[0][0] if rings else np.zeros(2)
    for ring in rings:
        x, y = (ring - origin).T
        cross = x * np.roll(y, -1) - np.roll(x, -1) * y
        signed = 0.5 * float(cross.sum())
        inner = sum(_within(ring[0], other) for other in rings if other is not ring) % 2
        sign = (-1.0 if inner else 1.0) * (1.0 if signed > 0 else -1.0)
        total += sign * signed
        moment += sign * np.array(
            [((x + np.roll(x, -1)) * cross).sum(), ((y + np.roll(y, -1)) * cross).sum()]
        )
    if total <= 0.0:
        raise SceneError([("area", "the area of the map is no polygon with an area")])
    return total, origin + moment / (6.0 * total)


def _within(point: Array, ring: Array) -> bool:
    a, b = ring, np.roll(ring, -1, axis=0)
    spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (point[1] - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool(np.count_nonzero(spans & (point[0] < x)) % 2)


def _without_repeats(vertices: Array, first: Array) -> tuple[Array, Array, int]:
    """The polylines without vertices that follow themselves."""
    owner = np.repeat(np.arange(len(first) - 1), np.diff(first))
    keep = np.ones(len(vertices), dtype=bool)
    keep[1:] = (owner[1:] != owner[:-1]) | (vertices[1:] != vertices[:-1]).any(axis=1)
    counts = np.bincount(owner[keep], minlength=len(first) - 1)
    kept = np.concatenate([[0], np.cumsum(counts)])
    return vertices[keep], kept, int(np.count_nonzero(~keep))


def _lengths(vertices: Array, first: Array) -> Array:
    """Length of each polyline, (m,)."""
    owner, a = pieces(first)
    return np.bincount(
        owner, weights=np.hypot(*(vertices[a + 1] - vertices[a]).T), minlength=len(first) - 1
    )


def _centroid(vertices: Array, first: Array) -> Array:
    """Centre of the traces, by their length."""
    _, a = pieces(first)
    length = np.hypot(*(vertices[a + 1] - vertices[a]).T)
    if length.sum() == 0.0:
        found: Array = vertices.mean(axis=0)
        return found
    origin = vertices[0]
    middle = 0.5 * (vertices[a] + vertices[a + 1]) - origin
    found = origin + np.average(middle, axis=0, weights=length)
    return found


def _faults(vertices: Array, first: Array, feature: Array) -> Iterator[str]:
    """What keeps polylines from being traces, with the numbers of their features."""
    count = np.diff(first)
    for k in np.flatnonzero(count < 2).tolist():
        yield f"feature {feature[k]} has no length; remove it"
    ring = (count > 2) & (vertices[first[:-1]] == vertices[first[1:] - 1]).all(axis=1)
    for k in np.flatnonzero(ring).tolist():
        yield f"feature {feature[k]} is a ring, its ends coincide; cut it in two"
    owner, a = pieces(first)
    met = meetings(vertices[a], vertices[a + 1])
    one, other = owner[met.line_a], owner[met.line_b]
    same = one == other
    wrong = same & ((met.line_b - met.line_a > 1) | met.overlap) & ~ring[one]
    for k in _each_once(one[wrong], one[wrong]):
        x, y = vertices[a[met.line_a[wrong]]][k]
        how = f"feature {feature[one[wrong][k]]} crosses or touches itself"
        yield f"{how} near ({x:.7g}, {y:.7g}) m; split it there"
    doubled = ~same & met.overlap
    for k in _each_once(one[doubled], other[doubled]):
        i, j = feature[one[doubled][k]], feature[other[doubled][k]]
        x, y = vertices[a[met.line_a[doubled]]][k]
        where = f"near ({x:.7g}, {y:.7g}) m"
        if i == j:
            yield f"feature {i} has parts that lie on each other {where}; remove one"
        else:
            yield f"features {i} and {j} lie on each other {where}; remove what is double"


def _each_once(one: Array, other: Array) -> Iterable[int]:
    """Index of the first of each pair."""
    if len(one) == 0:
        return ()
    return sorted(np.unique(np.stack([one, other]), axis=1, return_index=True)[1].tolist())


def _topology_of(vertices: Array, first: Array, snap: float) -> tuple[Array, Topology]:
    """The polyline of each piece, and the nodes of the pieces."""
    owner, a = pieces(first)
    return owner, topology(vertices[a], vertices[a + 1], snap)


def _joined(
    vertices: Array, first: Array, feature: Array, snap: float
) -> tuple[Array, Array, Array]:
    """The polylines through the nodes at which they meet, which all of them then share."""
    owner, found = _topology_of(vertices, first, snap)
    trace = owner[found.line]
    # places of one trace in its order; a bend is the end of one piece and the start of the next
    node, trace = found.node, trace
    keep = np.ones(len(node), dtype=bool)
    keep[1:] = (trace[1:] != trace[:-1]) | (node[1:] != node[:-1])
    node, trace = node[keep], trace[keep]
    counts = np.bincount(trace, minlength=len(first) - 1)
    stays = counts >= 2
    node = node[stays[trace]]
    first = np.concatenate([[0], np.cumsum(counts[stays])])
    at = np.column_stack([found.node_x, found.node_y])[node]
    return at, first, feature[stays]


def _links(vertices: Array, first: Array) -> set[tuple[int, int]]:
    """Pairs of polylines that meet."""
    owner, a = pieces(first)
    met = meetings(vertices[a], vertices[a + 1])
    one, other = owner[met.line_a], owner[met.line_b]
    return {(i, j) for i, j in zip(one.tolist(), other.tolist(), strict=True) if i != j}


def _simplified(vertices: Array, first: Array, tolerance: float) -> tuple[Array, Array]:
    """Polylines with fewer vertices, no farther than the tolerance from what they were.

    Vertices where traces meet stay. Traces that would meet others than before stay whole.
    """
    _, found = _topology_of(vertices, first, 0.0)
    shared = found.degree > 2
    _owner, a = pieces(first)
    fixed = np.zeros(len(vertices), dtype=bool)
    fixed[first[:-1]] = fixed[first[1:] - 1] = True
    at_start = np.flatnonzero(found.along == 0.0)
    fixed[a[found.line[at_start]]] |= shared[found.node[at_start]]
    wanted = _links(vertices, first)
    thin = _thinned(vertices, first, fixed, tolerance)
    while True:
        keep = thin | fixed
        kept = np.concatenate([[0], np.cumsum(np.add.reduceat(keep, first[:-1]))])
        result = vertices[keep], kept
        changed = {k for pair in wanted ^ _links(*result) for k in pair}
        whole = [k for k in changed if not keep[first[k] : first[k + 1]].all()]
        if not whole:
            return result
        for k in whole:
            thin[first[k] : first[k + 1]] = True


def _thinned(vertices: Array, first: Array, fixed: Array, tolerance: float) -> Array:
    """Which vertices stay, (v,) bool: Douglas and Peucker between the fixed ones."""
    keep = fixed.copy()
    for a, b in itertools.pairwise(first):
        stops = a + np.flatnonzero(fixed[a:b])
        stack = list(itertools.pairwise(stops.tolist()))
        while stack:
            i, j = stack.pop()
            if j - i < 2:
                continue
            inner = vertices[i + 1 : j] - vertices[i]
            step = vertices[j] - vertices[i]
            along = np.clip(inner @ step / max(step @ step, 1e-300), 0.0, 1.0)
            apart = np.hypot(*(inner - along[:, None] * step).T)
            far = int(np.argmax(apart))
            if apart[far] > tolerance:
                keep[i + 1 + far] = True
                stack += [(i, i + 1 + far), (i + 1 + far, j)]
    return keep


def _cropped(
    vertices: Array, first: Array, feature: Array, box: Rectangle
) -> tuple[Array, Array, Array]:
    """The parts of polylines inside a box; one that comes back in is several."""
    owner, a = pieces(first)
    piece, s0, s1 = clip_segments(box, vertices[a], vertices[a + 1])
    start, step = vertices[a[piece]], vertices[a[piece] + 1] - vertices[a[piece]]
    begin = np.where(s0[:, None] == 0.0, start, start + s0[:, None] * step)
    end = np.where(s1[:, None] == 1.0, vertices[a[piece] + 1], start + s1[:, None] * step)
    # a part goes on where the next piece of the trace starts at its end
    new = np.ones(len(piece), dtype=bool)
    new[1:] = (
        (owner[piece[1:]] != owner[piece[:-1]])
        | (piece[1:] != piece[:-1] + 1)
        | (s1[:-1] != 1.0)
        | (s0[1:] != 0.0)
    )
    parts: list[Array] = []
    for i, j in itertools.pairwise([*np.flatnonzero(new), len(piece)]):
        parts.append(np.vstack([begin[i : i + 1], end[i:j]]))
    sizes = [len(part) for part in parts]
    joined = np.concatenate(parts) if parts else np.empty((0, 2))
    return joined, np.concatenate([[0], np.cumsum(sizes)]).astype(int), feature[owner[piece[new]]]
