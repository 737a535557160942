"""The straight lines that a scene's fractures draw in its region."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from demflow.model.region import Region, bounding_box, clip_segment, contains
from demflow.model.scene.fractures import Fracture, FractureSet, Joint

__all__ = ["JointLine", "Line", "joint_lines", "lines_of"]

# An end of a trace nearer to the rim than this part of its length lies on it.
RIM_TOUCH = 1e-9


class Line(NamedTuple):
    """A straight trace inside the region."""

    fracture: int  # index of the fracture in the scene
    start: tuple[float, float]  # m
    end: tuple[float, float]  # m
    start_at_rim: bool  # the fracture leaves the region there
    end_at_rim: bool

    @property
    def length(self) -> float:
        """Length in m."""
        return math.dist(self.start, self.end)


class JointLine(NamedTuple):
    """A straight joint; it may go beyond the region, for the rock does."""

    start: tuple[float, float]  # m
    end: tuple[float, float]  # m
    joint: Joint


def joint_lines(fractures: tuple[Fracture, ...], region: Region) -> tuple[JointLine, ...]:
    """Every straight trace of the fractures that are joints, with nothing of what they conduct."""
    return tuple(
        JointLine(start, end, fracture.joint)
        for fracture in fractures
        if fracture.joint is not None
        for start, end in _segments(fracture, region)
        if start != end
    )


def lines_of(fractures: tuple[Fracture, ...], region: Region) -> list[Line]:
    """Every straight trace of the scene's fractures, clipped to the region."""
    lines = []
    for index, fracture in enumerate(fractures):
        for start, end in _segments(fracture, region):
            for s0, s1 in clip_segment(region, start, end):
                a = np.asarray(start) + s0 * (np.asarray(end) - start)
                b = np.asarray(start) + s1 * (np.asarray(end) - start)
                # an end on the rim, but for round-off, is an end at the rim
                beyond = np.array([a - RIM_TOUCH * (b - a), b + RIM_TOUCH * (b - a)])
                leaves = ~contains(region, beyond)
                lines.append(
                    Line(
                        index,
                        (float(a[0]), float(a[1])),
                        (float(b[0]), float(b[1])),
                        bool(leaves[0]),
                        bool(leaves[1]),
                    )
                )
    return lines


def _segments(
    fracture: Fracture, region: Region
) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Ends of every straight piece of a fracture, before clipping."""
    if not isinstance(fracture, FractureSet):
        return [fracture.ends]
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
    segments = []
    for row in rows:
        shift = 0.5 * period * (row % 2)
        first = math.floor((low - shift - 0.5 * fracture.length) / period)
        last = math.ceil((high - shift + 0.5 * fracture.length) / period)
        for k in range(first, last + 1):
            middle = row * fracture.spacing * across + (k * period + shift) * along
            a, b = middle - 0.5 * fracture.length * along, middle + 0.5 * fracture.length * along
            segments.append(((float(a[0]), float(a[1])), (float(b[0]), float(b[1]))))
    return segments
