"""Grains that are finer around chosen places: the size of grains by where they lie."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.grains import Array
from demflow.model.region import Region, bounding_box, contains
from demflow.model.scene.lines import RefinedPlace

# Radii grow by this per distance from a refined place: slowly enough that grains beside one another
# are nearly alike, so that they pack as grains of one size do.
SLOPE = 0.05

CELLS = 256  # along either side of a box, in which the density of grains is even


class Grading(NamedTuple):
    """Mean radius, over that of the coarse grains, around q segments or points."""

    start: Array  # (q, 2)
    end: Array  # (q, 2)
    within: Array  # (q,) distance up to which grains are finest
    least: Array  # (q,) their size

    def moved(self, centre: Array, unit: float) -> Grading:
        """The same in lengths of `unit`, from `centre` on."""
        start, end = (self.start - centre) / unit, (self.end - centre) / unit
        return Grading(start, end, self.within / unit, self.least)

    def size(self, points: Array, unit: float = 1.0) -> Array:
        """Sizes (n,) in (0, 1] at points (n, 2); `unit` is the radius of the coarse grains."""
        size = np.ones(len(points))
        for start, end, within, least in zip(*self, strict=True):
            along = end - start
            squared = float(along @ along)
            part = (points - start) @ along / squared if squared > 0.0 else np.zeros(len(points))
            foot = start + np.clip(part, 0.0, 1.0)[:, None] * along
            beyond = np.maximum(np.linalg.norm(points - foot, axis=1) - within, 0.0)
            size = np.minimum(size, least + SLOPE * beyond / unit)
        return size


def graded(places: tuple[RefinedPlace, ...] | None) -> Grading | None:
    """The grading of a scene's refined places (m), None without any."""
    if places is None:
        return None
    start, end, within, size = (
        np.array(column, dtype=float) for column in zip(*places, strict=True)
    )
    return Grading(start, end, within, size)


def coarse_radius(grading: Grading, region: Region, count: int, share: float) -> float:
    """Mean radius (m) of the coarse grains with which `count` grains lie in the region.

    `share` is the area that a grain takes, its pores included, over the square of its mean radius.

    Parameters
    ----------
    grading : size of grains by place, over the coarse ones
    region : where the case lies, m
    count : grains that are to lie in the region
    share : area that a grain takes with its pores, over the square of its mean radius
    """
    x0, x1, y0, y1 = bounding_box(region)
    steps = (np.arange(CELLS) + 0.5) / CELLS
    x, y = np.meshgrid(x0 + (x1 - x0) * steps, y0 + (y1 - y0) * steps)
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[contains(region, points)]
    low = high = float(np.sqrt(region.area / (count * share)))

    def made(radius: float) -> float:
        return (
            region.area * float(np.mean(grading.size(points, radius) ** -2.0)) / (share * radius**2)
        )

    while made(high) > count:
        high *= 2.0
    for _ in range(40):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if made(middle) > count else (low, middle)
    return high


def strew(grading: Grading, size: Array, share: float, rng: np.random.Generator) -> Array:
    """Points (n, 2) in a box of `size` about the origin, as dense as grains of those sizes are.

    In units of the coarse mean radius. Cells are gone through along a curve that stays near to
    where it was, and every so much of the density gets a point, so that it is even everywhere.

    Parameters
    ----------
    grading : size of grains by place, over the coarse ones
    size : of the box, (2,) in coarse mean radii
    share : area that a grain takes with its pores, over the square of its mean radius
    rng : source of randomness
    """
    number = np.arange(CELLS * CELLS)
    column, row = _spread(number), _spread(number >> 1)
    corner = np.column_stack([column, row]) / CELLS
    density = grading.size((corner + 0.5 / CELLS - 0.5) * size) ** -2.0
    reached = np.cumsum(density) * size.prod() / (CELLS * CELLS * share)
    n = max(4, round(float(reached[-1])))
    cell = np.searchsorted(reached, (np.arange(n) + rng.random(n)) * reached[-1] / n)
    found: Array = (
        corner[np.minimum(cell, len(number) - 1)] + rng.random((n, 2)) / CELLS - 0.5
    ) * size
    return found


def _spread(number: Array) -> Array:
    """Every second bit of a number, from the lowest on: one coordinate of Morton's curve."""
    found = np.zeros_like(number)
    for bit in range(CELLS.bit_length() - 1):
        found |= ((number >> (2 * bit)) & 1) << bit
    return found
