"""The region of rock that is modelled: its shape, its sides and what lies inside.

Rectangles and circles are centred on the origin; a polygon stands where its
vertices say; a region with holes is one of them less others. Lengths in metres, angles in
radians, arrays of points as (n, 2).
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from demflow.model.parameters import SceneError, check_fields, parameter

if TYPE_CHECKING:
    import numpy.typing as npt

# A point of the rim nearer to a second side than this part of the extent is a corner.
CORNER = 1e-9


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle centred on the origin, with sides left, right, bottom, top."""

    width: float = parameter("m", above=0, help="extent along x")
    height: float = parameter("m", above=0, help="extent along y")

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of the sides, in the order of the edges of `vertices`."""
        return ("bottom", "right", "top", "left")

    @property
    def area(self) -> float:
        """Area in m²."""
        return self.width * self.height

    @property
    def vertices(self) -> np.ndarray:
        """Corners, counter-clockwise from the lower left, shape (4, 2)."""
        a, b = 0.5 * self.width, 0.5 * self.height
        return np.array([(-a, -b), (a, -b), (a, b), (-a, b)])


@dataclass(frozen=True, slots=True)
class Circle:
    """A disc centred on the origin; its only side is `outer`."""

    radius: float = parameter("m", above=0, help="outer radius")

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of the sides."""
        return ("outer",)

    @property
    def area(self) -> float:
        """Area in m²."""
        return float(np.pi * self.radius**2)


@dataclass(frozen=True, slots=True)
class Polygon:
    """A simple polygon; sides are `side[0]`, `side[1]`, … in the order of its vertices.

    `side[k]` runs from vertex k to vertex k + 1, whichever way round they are given.
    `outer` names every side at once.
    """

    vertices: tuple[tuple[float, float], ...] = parameter("m", help="corners, in order")

    def __post_init__(self) -> None:
        check_fields(self)
        if len(self.vertices) < 3:
            raise SceneError([("vertices", "a polygon needs at least three corners")])
        corners = np.asarray(self.vertices, dtype=float)
        if _signed_area(corners) == 0:
            raise SceneError([("vertices", "the polygon has no area")])
        if _edges_cross(corners):
            raise SceneError([("vertices", "the sides of the polygon cross each other")])

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of the sides."""
        return tuple(f"side[{k}]" for k in range(len(self.vertices)))

    @property
    def area(self) -> float:
        """Area in m²."""
        return abs(_signed_area(np.asarray(self.vertices)))


Shape = Rectangle | Circle | Polygon


@dataclass(frozen=True, slots=True)
class Hole:
    """A hole in a region; all of its rim is one side."""

    name: str  # of the side
    at: tuple[float, float]  # m, where the origin of the shape lies
    shape: Shape

    @property
    def rim(self) -> np.ndarray:
        """Points along the rim that tell where it lies, (n, 2) m."""
        if isinstance(self.shape, Circle):
            turn = np.arange(_RIM_POINTS) * (2.0 * np.pi / _RIM_POINTS)
            points = self.shape.radius * np.column_stack([np.cos(turn), np.sin(turn)])
        else:
            corners = np.asarray(self.shape.vertices, dtype=float)
            part = (np.arange(_RIM_POINTS // 4) / (_RIM_POINTS // 4))[:, None, None]
            points = (corners + part * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
        found: np.ndarray = points + np.array(self.at)
        return found


@dataclass(frozen=True, slots=True)
class Pierced:
    """A region with holes; its sides are those of the outer shape, then the holes'."""

    outer: Shape
    holes: tuple[Hole, ...]

    @property
    def sides(self) -> tuple[str, ...]:
        """Names of the sides."""
        return (*self.outer.sides, *(hole.name for hole in self.holes))

    @property
    def area(self) -> float:
        """Area in m²."""
        return self.outer.area - sum(hole.shape.area for hole in self.holes)


Region = Shape | Pierced

_RIM_POINTS = 64  # of a circular hole at which its distance to other rims is looked at
_LOT = 256  # boxes that are compared with others at once


def outer_shape(region: Region) -> Shape:
    """The region without its holes."""
    return region.outer if isinstance(region, Pierced) else region


def parts_of(region: Region) -> list[tuple[Shape, np.ndarray, list[int]]]:
    """The outer shape and the holes: each with its place (2,) m and its sides by number."""
    outer = outer_shape(region)
    found = [(outer, np.zeros(2), list(range(len(outer.sides))))]
    if isinstance(region, Pierced):
        for number, hole in enumerate(region.holes, len(outer.sides)):
            edges = 1 if isinstance(hole.shape, Circle) else len(hole.shape.vertices)
            found.append((hole.shape, np.array(hole.at), [number] * edges))
    return found


def named_sides(region: Region, name: str) -> list[int]:
    """Numbers of the sides that a name stands for: `outer` for all but the holes'."""
    outer = outer_shape(region)
    if name == "outer":
        return list(range(len(outer.sides)))
    return [region.sides.index(name)]


def side_length(region: Region, name: str) -> float:
    """Length of the side that a name stands for, m; of all that `outer` does.

    Parameters
    ----------
    region : the region
    name : of a side
    """
    wanted, total = named_sides(region, name), 0.0
    for shape, _, numbers in parts_of(region):
        if isinstance(shape, Circle):
            lengths = np.array([2.0 * np.pi * shape.radius])
        else:
            corners = np.asarray(shape.vertices, dtype=float)
            lengths = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
        total += float(lengths[np.isin(numbers, wanted)].sum())
    return total


def bounding_box(region: Region) -> tuple[float, float, float, float]:
    """Smallest upright box (xmin, xmax, ymin, ymax) around the region, m."""
    region = outer_shape(region)
    if isinstance(region, Circle):
        return (-region.radius, region.radius, -region.radius, region.radius)
    corners = np.asarray(region.vertices)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return (float(low[0]), float(high[0]), float(low[1]), float(high[1]))


def contains(region: Region, points: np.ndarray) -> np.ndarray:
    """Which of the points (n, 2) lie inside the region, as a boolean array (n,)."""
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    if isinstance(region, Pierced):
        inside = contains(region.outer, points)
        for hole in region.holes:
            inside &= ~contains(hole.shape, points - np.array(hole.at))
        return inside
    if isinstance(region, Circle):
        found: np.ndarray = np.hypot(points[:, 0], points[:, 1]) < region.radius
        return found
    if isinstance(region, Rectangle):
        found = (np.abs(points[:, 0]) < 0.5 * region.width) & (
            np.abs(points[:, 1]) < 0.5 * region.height
        )
        return found
    corners = np.asarray(region.vertices)
    (x1, y1), (x2, y2) = corners.T, np.roll(corners, -1, axis=0).T
    slanted = y1 != y2
    x1, y1, x2, y2 = x1[slanted], y1[slanted], x2[slanted], y2[slanted]
    inside = np.zeros(len(points), dtype=bool)
    for lot in _lots(len(points), len(x1)):
        x, y = points[lot, 0, None], points[lot, 1, None]
        spans = (y1 > y) != (y2 > y)
        crossed = spans & (x < x1 + (y - y1) * (x2 - x1) / (y2 - y1))
        inside[lot] = np.count_nonzero(crossed, axis=1) % 2 == 1
    return inside


def exit_point(
    region: Region, inside: np.ndarray, outside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where segments that leave the region cross its rim.

    Parameters: start points inside (n, 2) and end points outside (n, 2). Returns
    the fraction of each segment that lies before the first crossing, (n,) in
    [0, 1], and the index of the side that is crossed, (n,) into `region.sides`.

    Parameters
    ----------
    region : where the case lies, m
    inside : start points, (n, 2) m
    outside : end points, (n, 2) m
    """
    inside = np.asarray(inside, dtype=float).reshape(-1, 2)
    step = np.asarray(outside, dtype=float).reshape(-1, 2) - inside
    if isinstance(region, Pierced):
        fraction, side = exit_point(region.outer, inside, outside)
        for number, hole in enumerate(region.holes, len(region.outer.sides)):
            entry = _entry(hole.shape, inside - np.array(hole.at), step)
            fraction = np.where(entry <= fraction, entry, fraction)
            side = np.where(entry == fraction, number, side)
        return fraction, side
    if isinstance(region, Circle):
        a = np.einsum("ij,ij->i", step, step)
        b = np.einsum("ij,ij->i", inside, step)
        c = np.einsum("ij,ij->i", inside, inside) - region.radius**2
        # c < 0 inside, hence one positive root, written without cancellation
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            fraction = np.where(b > 0, -c / (b + root), (root - b) / a)
        return np.clip(np.nan_to_num(fraction, nan=1.0), 0.0, 1.0), np.zeros(len(step), dtype=int)
    corners = np.asarray(region.vertices, dtype=float)
    fraction, side = _first_crossing(corners, np.sign(_signed_area(corners)), inside, step)
    return np.clip(fraction, 0.0, 1.0), side


def _entry(shape: Shape, start: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Part of segments that start outside a shape before they enter it, (n,), infinite if never."""
    if not isinstance(shape, Circle):
        corners = np.asarray(shape.vertices, dtype=float)
        entry = _first_crossing(corners, -np.sign(_signed_area(corners)), start, step)[0]
        return np.where(entry <= 1.0, entry, np.inf)
    a = np.einsum("ij,ij->i", step, step)
    b = np.einsum("ij,ij->i", start, step)
    c = np.maximum(np.einsum("ij,ij->i", start, start) - shape.radius**2, 0.0)
    within = b * b - a * c
    meets = (b < 0.0) & (within > 0.0)
    entry = np.full(len(step), np.inf)
    # the nearer root, written without cancellation
    np.divide(c, -b + np.sqrt(np.maximum(within, 0.0)), out=entry, where=meets)
    return np.where(entry <= 1.0, entry, np.inf)


def _first_crossing(
    corners: np.ndarray, sense: float, inside: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fraction of each segment before it crosses an edge outwards, infinite if never; the edge."""
    fraction = np.full(len(step), np.inf)
    side = np.zeros(len(step), dtype=int)
    for k, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        edge = end - start
        normal = sense * np.array([edge[1], -edge[0]])  # outward
        approach = step @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            s = ((start - inside) @ normal) / approach
            along = ((inside + s[:, None] * step - start) @ edge) / (edge @ edge)
        hit = (approach > 0) & (s >= 0) & (along >= -1e-9) & (along <= 1 + 1e-9) & (s < fraction)
        fraction[hit], side[hit] = s[hit], k
    return fraction, side


def distance_to_rim(region: Region, points: np.ndarray) -> np.ndarray:
    """Distance of points (n, 2) to the nearest point of the rim, (n,) m."""
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    if isinstance(region, Pierced):
        rims = [distance_to_rim(shape, points - at) for shape, at, _ in parts_of(region)]
        found: np.ndarray = np.min(rims, axis=0)
        return found
    if isinstance(region, Circle):
        found = np.abs(np.hypot(points[:, 0], points[:, 1]) - region.radius)
        return found
    corners = np.asarray(region.vertices, dtype=float)
    edge = np.roll(corners, -1, axis=0) - corners
    squared = np.sum(edge**2, axis=1)
    squared[squared == 0.0] = 1.0  # corners given twice are points
    distance = np.empty(len(points))
    for lot in _lots(len(points), len(corners)):
        offset = points[lot, None, :] - corners
        along = np.sum(offset * edge, axis=2) / squared
        apart = offset - np.clip(along, 0.0, 1.0)[:, :, None] * edge
        distance[lot] = np.linalg.norm(apart, axis=2).min(axis=1)
    return distance


def _lots(count: int, each: int) -> Iterator[slice]:
    """Slices of so many things that meet `each` others, so that few pairs are held at once."""
    size = max(1, 1_000_000 // max(each, 1))
    yield from (slice(k, k + size) for k in range(0, count, size))


def narrowest(region: Polygon) -> tuple[float, int, int]:
    """Least distance (m) between two sides that face each other across the region, and the two.

    Infinity where no two sides run against each other (within some 25°) side by side.
    """
    corners = np.asarray(region.vertices, dtype=float)
    edge = np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(edge, axis=1)
    sense = np.sign(_signed_area(corners))
    found = (np.inf, 0, 0)
    for k in range(len(corners)):
        along = edge[k] / max(length[k], 1e-300)
        inward = sense * np.array([-along[1], along[0]])
        start, end = corners - corners[k], corners + edge - corners[k]
        facing = edge @ along < -0.9 * length
        # how far the other lies over this one, along it
        low = np.maximum(np.minimum(start @ along, end @ along), 0.0)
        high = np.minimum(np.maximum(start @ along, end @ along), length[k])
        across = 0.5 * (start + end) @ inward
        for m in np.flatnonzero(facing & (high > low) & (across > 0.0)):
            middle = corners[k] + 0.5 * (low[m] + high[m]) * along + 0.5 * across[m] * inward
            if across[m] < found[0] and contains(region, middle[None])[0]:
                found = (float(across[m]), k, int(m))
    return found


@functools.lru_cache(maxsize=64)
def tightest(region: Pierced) -> tuple[float, str, str]:
    """Least distance (m) between the rim of a hole and another, the hole, and whose rim that is.

    Negative where they overlap (of many such pairs, one); the other is `outer` where the hole is
    near the region's own rim.
    """
    found = (np.inf, "", "")
    rims = [hole.rim for hole in region.holes]
    low, high = (np.array([end(rim, axis=0) for rim in rims]) for end in (np.min, np.max))
    for number, (hole, rim) in enumerate(zip(region.holes, rims, strict=True)):
        room = np.where(contains(region.outer, rim), 1.0, -1.0) * distance_to_rim(region.outer, rim)
        found = min(found, (float(room.min()), hole.name, "outer"))
        gap = np.maximum(low[:number] - high[number], low[number] - high[:number])
        least = np.linalg.norm(np.maximum(gap, 0.0), axis=1)  # they are no nearer than their boxes
        for k in range(number):
            if least[k] >= found[0]:
                continue
            other = region.holes[k]
            for points, two in ((rim, other), (rims[k], hole)):
                points = points - np.array(two.at)
                apart = np.where(contains(two.shape, points), -1.0, 1.0)
                room = apart * distance_to_rim(two.shape, points)
                found = min(found, (float(room.min()), hole.name, other.name))
    return found


def sides_at(region: Region, points: np.ndarray) -> np.ndarray:
    """Sides of the region on which points (n, 2) of its rim lie, (n, 2) into `region.sides`.

    The nearest side, and the next one where the point is their corner, else −1.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    found = np.full((len(points), 2), -1)
    if len(points) == 0:
        return found
    if isinstance(region, Pierced):
        rims = [distance_to_rim(shape, points - at) for shape, at, _ in parts_of(region)]
        nearest = np.argmin(rims, axis=0)
        found = sides_at(region.outer, points)
        found[nearest > 0, 0] = len(region.outer.sides) + nearest[nearest > 0] - 1
        found[nearest > 0, 1] = -1
        return found
    if isinstance(region, Circle):
        found[:, 0] = 0
        return found
    corners = np.asarray(region.vertices, dtype=float)
    start, edge = corners[None, :, :], (np.roll(corners, -1, axis=0) - corners)[None, :, :]
    along = np.sum((points[:, None, :] - start) * edge, axis=2) / np.sum(edge**2, axis=2)
    nearest = start + np.clip(along, 0.0, 1.0)[:, :, None] * edge
    away = np.linalg.norm(points[:, None, :] - nearest, axis=2)
    order = np.argsort(away, axis=1, kind="stable")[:, :2]
    found[:, 0] = order[:, 0]
    corner = np.take_along_axis(away, order[:, 1:], axis=1)[:, 0] <= CORNER * np.ptp(corners)
    found[corner, 1] = order[corner, 1]
    return found


def clip_segment(
    region: Region,
    start: tuple[float, float] | np.ndarray,
    end: tuple[float, float] | np.ndarray,
) -> list[tuple[float, float]]:
    """Parts of the segment start–end inside the region, as fractions (s0, s1) of it, in order.

    Parameters
    ----------
    region : where the case lies, m
    start, end : x, y in m
    """
    _, low, high = clip_segments(region, np.array([start]), np.array([end]))
    return list(zip(low.tolist(), high.tolist(), strict=True))


def clip_segments(
    region: Region, start: npt.ArrayLike, end: npt.ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts of segments, ends (n, 2) each, that lie inside the region.

    Returns the segment of each part (m,), in order, and the fractions of it, (m,) each, between
    which the part lies; a segment that leaves and comes back has several.

    Parameters
    ----------
    region : where the case lies, m
    start, end : (n, 2) m
    """
    start, end = (np.asarray(ends, dtype=float).reshape(-1, 2) for ends in (start, end))
    xmin, xmax, ymin, ymax = bounding_box(region)
    low, high = np.minimum(start, end), np.maximum(start, end)
    near = (low[:, 0] <= xmax) & (high[:, 0] >= xmin) & (low[:, 1] <= ymax) & (high[:, 1] >= ymin)
    whole = contains(region, start) & contains(region, end)
    for shape, at, _ in parts_of(region):
        if isinstance(shape, Polygon):
            whole &= ~_meets_an_edge(np.asarray(shape.vertices), start - at, end - at)
        elif shape is not outer_shape(region):  # a convex hole between two ends outside it
            whole &= _entry(shape, start - at, end - start) > 1.0
    inside, rest = np.flatnonzero(whole), np.flatnonzero(near & ~whole)
    found = [(inside, np.zeros(len(inside)), np.ones(len(inside)))]
    sides = sum(len(shape.sides) + 2 for shape, _, _ in parts_of(region))
    for lot in _lots(len(rest), sides):
        row, s0, s1 = _inner_parts(region, start[rest[lot]], (end - start)[rest[lot]])
        found.append((rest[lot][row], s0, s1))
    segment, s0, s1 = (np.concatenate(one) for one in zip(*found, strict=True))
    order = np.lexsort((s0, segment))
    return segment[order].astype(np.int64), s0[order], s1[order]


def _inner_parts(
    region: Region, start: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `clip_segments`, of segments that may cross the rim."""
    ends = np.array([[0.0, 1.0]]).repeat(len(start), axis=0)
    cuts = [_cuts(shape, start - at, step) for shape, at, _ in parts_of(region)]
    at = np.sort(np.clip(np.hstack([ends, *cuts]), 0.0, 1.0), axis=1)  # what is NaN comes last
    row, column = np.nonzero(at[:, 1:] > at[:, :-1])
    s0, s1 = at[row, column], at[row, column + 1]
    middle = start[row] + (0.5 * (s0 + s1))[:, None] * step[row]
    within = contains(region, middle)
    if isinstance(region, Polygon | Pierced):  # what lies on an edge is outside, whichever it is
        xmin, xmax, ymin, ymax = bounding_box(region)
        within &= distance_to_rim(region, middle) > 1e-12 * max(xmax - xmin, ymax - ymin)
    row, s0, s1 = row[within], s0[within], s1[within]
    goes_on = (row[1:] == row[:-1]) & (s0[1:] == s1[:-1])
    first, last = np.append(True, ~goes_on)[: len(row)], np.append(~goes_on, True)[: len(row)]
    return row[first], s0[first], s1[last]


def _cuts(shape: Shape, start: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Fractions at which lines cross the rim of a shape, (n, cuts); NaN where they do not.

    Parameters
    ----------
    shape : about the origin
    start, step : a point of each line and its direction, (n, 2) m
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(shape, Circle):
            qa, qb = np.sum(step * step, axis=1), np.sum(start * step, axis=1)
            disc = qb * qb - qa * (np.sum(start * start, axis=1) - shape.radius**2)
            root = np.sqrt(np.where((disc > 0) & (qa > 0), disc, np.nan))
            return np.stack([(-qb - root) / qa, (-qb + root) / qa], axis=1)
        corners = np.asarray(shape.vertices, dtype=float)
        edge_x, edge_y = (np.roll(corners, -1, axis=0) - corners).T
        step_x, step_y = step.T[:, :, None]
        x, y = (corners[None] - start[:, None]).transpose(2, 0, 1)
        denominator = step_x * edge_y - step_y * edge_x
        along_edge = (x * step_y - y * step_x) / denominator
        crosses = (denominator != 0.0) & (along_edge >= -1e-12) & (along_edge <= 1 + 1e-12)
        return np.where(crosses, (x * edge_y - y * edge_x) / denominator, np.nan)


def _meets_an_edge(corners: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Which segments may cross or touch an edge of a polygon, (n,) bool."""
    step = end - start
    meets = np.zeros(len(start), dtype=bool)
    for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = q - p

        def side(point: np.ndarray, p: np.ndarray = p, edge: np.ndarray = edge) -> np.ndarray:
            found: np.ndarray = edge[0] * (point[:, 1] - p[1]) - edge[1] * (point[:, 0] - p[0])
            return found

        def turn(corner: np.ndarray) -> np.ndarray:
            apart = corner - start
            found: np.ndarray = step[:, 0] * apart[:, 1] - step[:, 1] * apart[:, 0]
            return found

        meets |= (side(start) * side(end) <= 0) & (turn(p) * turn(q) <= 0)
    return meets


def _signed_area(corners: np.ndarray) -> float:
    x, y = corners[:, 0], corners[:, 1]
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def box_pairs(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs i < j of upright boxes (n, 2) that overlap or touch, each pair once.

    Boxes are met in the order of their lower x, so that few are compared where few overlap.
    """
    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    found_i, found_j = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for begin in range(0, len(order), _LOT):
        block = slice(begin, begin + _LOT)
        end = np.searchsorted(low[:, 0], high[block, 0].max(), side="right")
        later = slice(begin + 1, end)
        touch = (low[later, 0] <= high[block, 0, None]) & (low[later, 1] <= high[block, 1, None])
        touch &= low[block, 1, None] <= high[later, 1]
        i, j = np.nonzero(np.triu(touch))
        found_i.append(order[begin + i])
        found_j.append(order[begin + 1 + j])
    i, j = np.concatenate(found_i), np.concatenate(found_j)
    return np.minimum(i, j), np.maximum(i, j)


def _edges_cross(corners: np.ndarray) -> bool:
    """Whether two sides that share no corner meet."""
    n, ends = len(corners), np.roll(corners, -1, axis=0)
    i, j = box_pairs(np.minimum(corners, ends), np.maximum(corners, ends))
    apart = (j > i + 1) & (j < i + n - 1)
    i, j = i[apart], j[apart]
    p, q, r, s = corners[i], ends[i], corners[j], ends[j]

    def turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
        (ux, uy), (vx, vy) = (b - a).T, (c - a).T
        found: np.ndarray = np.sign(ux * vy - uy * vx)
        return found

    def within(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Whether c, on the line a–b, lies between a and b."""
        found: np.ndarray = np.all((np.minimum(a, b) <= c) & (c <= np.maximum(a, b)), axis=1)
        return found

    pqr, pqs, rsp, rsq = turn(p, q, r), turn(p, q, s), turn(r, s, p), turn(r, s, q)
    crosses = (pqr * pqs < 0) & (rsp * rsq < 0)
    for side, (a, b, c) in ((pqr, (p, q, r)), (pqs, (p, q, s)), (rsp, (r, s, p)), (rsq, (r, s, q))):
        crosses |= (side == 0) & within(a, b, c)
    return bool(crosses.any())
