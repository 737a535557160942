"""The lines that a scene's fractures draw in its region."""

from __future__ import annotations

import functools
import math
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from demflow.model.region import Region, bounding_box, clip_segments, contains, outer_shape
from demflow.model.scene.distributions import apertures
from demflow.model.scene.flow import Well
from demflow.model.scene.fractures import Fracture, FractureSet, Joint, RandomSet, TraceMap
from demflow.model.scene.random_sets import segments, stream
from demflow.model.scene.rock import Refinement
from demflow.model.scene.trace_maps import pieces

__all__ = [
    "FlowLine",
    "JointLine",
    "Line",
    "Polylines",
    "RefinedPlace",
    "acting_lines",
    "flow_lines",
    "joint_lines",
    "lines_of",
    "polylines",
    "refined_places",
]

# An end of a trace nearer to the rim than this part of its length lies on it.
RIM_TOUCH = 1e-9

MOST_FOUND = 32  # networks of lines that are kept
MOST_CLIPPED = 8  # fractures of which the pieces inside a region are kept


class Line(NamedTuple):
    """A straight piece of a trace inside the region.

    Pieces of one trace follow each other in its order; consecutive ones share the coordinates
    of their common end, bit by bit, unless the trace leaves the region between them.
    """

    fracture: int  # index of the fracture in the scene
    start: tuple[float, float]  # m
    end: tuple[float, float]  # m
    start_at_rim: bool  # the fracture leaves the region there
    end_at_rim: bool
    trace: int = 0  # the polyline that it is a piece of, counted over all fractures of the scene
    aperture: float | None = None  # m, hydraulic, of this trace; None where it is given otherwise

    @property
    def length(self) -> float:
        """Length in m."""
        return math.dist(self.start, self.end)


class JointLine(NamedTuple):
    """A straight joint; it may go beyond the region, for the rock does."""

    start: tuple[float, float]  # m
    end: tuple[float, float]  # m
    joint: Joint


class Polylines(NamedTuple):
    """What a fracture draws in the plane: m polylines with bends, before clipping."""

    vertices: np.ndarray  # (v, 2) m, of one polyline after the other
    first: np.ndarray  # (m + 1,) the first vertex of each
    aperture: np.ndarray | None  # (m,) m, hydraulic; None where the fracture has none

    @property
    def pieces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Polyline (s,), start and end (s, 2) of each straight piece."""
        owner, start = pieces(self.first)
        return owner, self.vertices[start], self.vertices[start + 1]

    @property
    def length(self) -> np.ndarray:
        """Length of each polyline, (m,) m."""
        owner, start, end = self.pieces
        return np.bincount(owner, np.hypot(*(end - start).T), minlength=len(self.first) - 1)


class RefinedPlace(NamedTuple):
    """A segment, or a point, around which grains are finer."""

    start: tuple[float, float]  # m
    end: tuple[float, float]  # m
    within: float  # m, distance up to which they are finest
    size: float  # of them there, over that of the grains elsewhere


def joint_lines(fractures: tuple[Fracture, ...], region: Region) -> tuple[JointLine, ...]:
    """Every straight piece of the fractures that are joints, with nothing of what they conduct."""
    return tuple(
        JointLine(_point(start), _point(end), fracture.joint)
        for fracture in fractures
        if fracture.joint is not None
        for start, end in zip(*polylines(fracture, region).pieces[1:], strict=True)
        if not np.array_equal(start, end)
    )


def refined_places(
    refinements: tuple[Refinement, ...] | None,
    wells: tuple[Well, ...],
    fractures: tuple[Fracture, ...],
    region: Region,
) -> tuple[RefinedPlace, ...] | None:
    """Places around which grains are finer; None where there are none, or nothing to refine by.

    Parameters
    ----------
    refinements : where, how far and how much finer, or None
    wells : the wells of the scene
    fractures : the fractures of the scene
    region : where the case lies, m
    """
    found: list[RefinedPlace] = []
    for one in refinements or ():
        if one.around == "wells":
            ends = [(well.at, well.at, one.within + well.effective_radius) for well in wells]
        elif one.around == "traces":
            lines = lines_of(fractures, region)
            ends = [(line.start, line.end, one.within) for line in lines]
        else:
            assert not isinstance(one.around, str)
            ends = [(one.around, one.around, one.within)]
        found += [RefinedPlace(*end, 1.0 / one.factor) for end in ends]
    return tuple(found) or None


def lines_of(fractures: tuple[Fracture, ...], region: Region) -> list[Line]:
    """Every straight piece of the scene's fractures, clipped to the region."""
    return list(_lines_of(fractures, region))


@functools.lru_cache(maxsize=4)  # stages of one case, and cases of a study, ask for the same
def _lines_of(fractures: tuple[Fracture, ...], region: Region) -> tuple[Line, ...]:
    lines: list[Line] = []
    traces = 0
    for index, fracture in enumerate(fractures):
        drawn = _clipped(fracture, region)
        width = _apertures(fracture, drawn.length)
        for trace, start, end, at_start, at_end in drawn.pieces:
            aperture = None if width is None else float(width[trace])
            lines.append(Line(index, start, end, at_start, at_end, traces + trace, aperture))
        traces += len(drawn.length)
    return tuple(lines)


class _Clipped(NamedTuple):
    """What a fracture of whatever aperture draws in a region."""

    # polyline, start, end, and whether the fracture leaves the region there, of each piece
    pieces: tuple[tuple[int, tuple[float, float], tuple[float, float], bool, bool], ...]
    length: np.ndarray  # (m,) m, of each polyline, with all that lies outside


def _clipped(fracture: Fracture, region: Region) -> _Clipped:
    """Found once, of cases that differ in what the fracture conducts."""
    key = fracture.course, region
    known = _kept.pop(key, None) or _clip(_outlines(fracture, region), region)
    _kept[key] = known
    if len(_kept) > MOST_CLIPPED:
        del _kept[next(iter(_kept))]
    return known


_kept: dict[Any, _Clipped] = {}  # the last one used at the end


def _clip(drawn: Polylines, region: Region) -> _Clipped:
    owner, start, end = drawn.pieces
    piece, s0, s1 = clip_segments(region, start, end)
    step = end[piece] - start[piece]
    a = np.where(s0[:, None] == 0.0, start[piece], start[piece] + s0[:, None] * step)
    b = np.where(s1[:, None] == 1.0, end[piece], start[piece] + s1[:, None] * step)
    # an end on the rim, but for round-off, is an end at the rim
    leaves = ~contains(region, np.concatenate([a, b]) + RIM_TOUCH * np.vstack([a - b, b - a]))
    at_rim = leaves.reshape(2, len(piece)).tolist()
    columns = (owner[piece].tolist(), map(_point, a), map(_point, b), *at_rim)
    return _Clipped(tuple(zip(*columns, strict=True)), drawn.length)


class FlowLine(NamedTuple):
    """A line that acts on flow, with nothing of how much: what decides where it runs."""

    part: str  # trace (nodes of its own), chain (pipes along it), barrier or multiplier (across)
    start: tuple[float, float]  # m
    end: tuple[float, float]  # m
    start_at_rim: bool
    end_at_rim: bool


def acting_lines(fractures: tuple[Fracture, ...], region: Region) -> list[Line]:
    """The lines that act on flow, in order; of no length is none."""
    return [
        line
        for line in lines_of(fractures, region)
        if line.length > 0.0 and fractures[line.fracture].acts_on_flow
    ]


def flow_lines(fractures: tuple[Fracture, ...], region: Region) -> tuple[FlowLine, ...]:
    """Where `acting_lines` run, and the part that each has in flow.

    Of cases that differ in how wide fractures are, the same lines: found once.
    """
    drawn = tuple(
        (type(one), one.part, *(getattr(one, f.name) for f in fields(one) if f.name != "aperture"))
        for one in fractures
    )
    try:
        known = _found.get((drawn, region))
    except TypeError:  # a part that has no hash
        return _flow_lines(fractures, region)
    if known is None:
        if len(_found) >= MOST_FOUND:
            _found.clear()
        known = _found[drawn, region] = _flow_lines(fractures, region)
    return known


_found: dict[tuple[Any, Region], tuple[FlowLine, ...]] = {}


def _flow_lines(fractures: tuple[Fracture, ...], region: Region) -> tuple[FlowLine, ...]:
    return tuple(
        FlowLine(
            fractures[line.fracture].part,
            line.start,
            line.end,
            line.start_at_rim,
            line.end_at_rim,
        )
        for line in acting_lines(fractures, region)
    )


def polylines(fracture: Fracture, region: Region) -> Polylines:
    """The polylines of a fracture, before clipping, and the aperture of each.

    An aperture that goes with the length of a trace goes with all of it, also what lies outside.
    Holes cut what is drawn, and change nothing of it.
    """
    drawn = _outlines(fracture, region)
    return drawn._replace(aperture=_apertures(fracture, drawn.length))


def _outlines(fracture: Fracture, region: Region) -> Polylines:
    """The polylines of a fracture, of whatever aperture."""
    region = outer_shape(region)
    if isinstance(fracture, TraceMap):
        return Polylines(fracture.laid.vertices, fracture.laid.first, None)
    if isinstance(fracture, FractureSet):
        points = _set_ends(fracture, region)
    elif isinstance(fracture, RandomSet):
        points = np.stack(segments(fracture.drawing, region), axis=1).reshape(-1, 2)
    else:
        points = np.array(fracture.points, dtype=float).reshape(-1, 2)
        return Polylines(points, np.array([0, len(points)]), None)
    return Polylines(points, np.arange(0, len(points) + 1, 2), None)


def _apertures(fracture: Fracture, length: np.ndarray) -> np.ndarray | None:
    """Apertures (m,) m of the polylines of a fracture, (m,) m long; None where it has none."""
    if fracture.aperture is None:
        return None
    seed = getattr(fracture, "seed", None)
    rng = stream(1 if seed is None else seed, "aperture")
    return apertures(fracture.aperture, rng, length)


def _point(at: np.ndarray) -> tuple[float, float]:
    return (float(at[0]), float(at[1]))


def _set_ends(fracture: FractureSet, region: Region) -> np.ndarray:
    """Ends of the fractures of a regular set over the region, (2 n, 2)."""
    along = np.array([math.cos(fracture.angle), math.sin(fracture.angle)])
    across = np.array([-along[1], along[0]])
    xmin, xmax, ymin, ymax = bounding_box(region)
    corners = np.array([(xmin, ymin), (xmax, ymin), (xmin, ymax), (xmax, ymax)])
    period = fracture.length + (fracture.spacing if fracture.gap is None else fracture.gap)
    rows = np.arange(
        math.ceil((corners @ across).min() / fracture.spacing),
        math.floor((corners @ across).max() / fracture.spacing) + 1,
    )
    low, high = (corners @ along).min(), (corners @ along).max()
    ends = []
    for row in rows:
        shift = 0.5 * period * (row % 2)
        first = math.floor((low - shift - 0.5 * fracture.length) / period)
        last = math.ceil((high - shift + 0.5 * fracture.length) / period)
        for k in range(first, last + 1):
            middle = row * fracture.spacing * across + (k * period + shift) * along
            a, b = middle - 0.5 * fracture.length * along, middle + 0.5 * fracture.length * along
            ends += [a, b]
    return np.array(ends).reshape(-1, 2)
