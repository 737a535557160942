"""Fractures drawn at random: where, how long, at which angle (a Boolean model of segments)."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from demflow.model.parameters import Problems, SceneError
from demflow.model.region import Circle, Region, bounding_box, contains
from demflow.model.scene.distributions import Angle, Length, draw

Array = np.ndarray

MOST_TRIES = 200  # places tried for one fracture before its least spacing counts as impossible
STREAMS = ("count", "length", "angle", "place", "aperture")


@dataclass(frozen=True, slots=True)
class Drawing:
    """What of a random set decides where its fractures lie; see `RandomSet` for the fields."""

    seed: int
    intensity: float | None  # 1/m; one of these three
    density: float | None  # 1/m2
    count: int | None
    length: Length  # m
    angle: Angle  # rad
    least_spacing: float | None  # m
    within: float | None  # m


def stream(seed: int, name: str) -> np.random.Generator:
    """The generator of one property of a set: another law of one leaves the others as drawn.

    NumPy's PCG64, seeded by (seed, number of the property in `STREAMS`).
    """
    return np.random.Generator(
        np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(STREAMS.index(name),)))
    )


def mean_length(law: Length) -> float:
    """Mean of a law of lengths, m."""
    return float(law) if isinstance(law, float | int) else law.mean


def expected(drawing: Drawing, region: Region) -> float:
    """Number of fractures that are drawn in the mean."""
    if drawing.count is not None:
        return float(drawing.count)
    mean = mean_length(drawing.length)
    per_area = drawing.density or (drawing.intensity or 0.0) / mean
    _, radius = window(drawing.within, region)
    return per_area * (math.pi * radius**2 + 2.0 * radius * mean)


def window(within: float | None, region: Region) -> tuple[Array, float]:
    """Centre and radius (m) of the disc in which a set is drawn: `within`, or around the region."""
    if within is not None:
        return np.zeros(2), within
    if isinstance(region, Circle):
        return np.zeros(2), region.radius
    xmin, xmax, ymin, ymax = bounding_box(region)
    centre = np.array([0.5 * (xmin + xmax), 0.5 * (ymin + ymax)])
    return centre, 0.5 * math.hypot(xmax - xmin, ymax - ymin)


def window_problems(drawing: Drawing, region: Region) -> Problems:
    """What is wrong with where a set is drawn."""
    if drawing.within is None:
        return
    centre, radius = window(None, region)
    if drawing.within < (reach := radius + float(np.hypot(*centre))):
        yield "within", f"the region reaches {reach:.4g} m from the origin; draw at least there"


@functools.lru_cache(maxsize=64)
def segments(drawing: Drawing, region: Region) -> tuple[Array, Array]:
    """Start and end, (n, 2) each in m, of the fractures of a set that may reach the region.

    By density or intensity their centres are a Poisson process of the whole plane, and exactly
    the fractures that meet a disc around the region are drawn: one of length ℓ does so where
    its centre lies in the disc dilated by it, of area π R² + 2 R ℓ. Their number is therefore
    Poisson, long ones are taken accordingly more often (the length-biased law in the part 2 R ℓ),
    and nothing thins out towards the rim. With `count`, so many centres lie in the region
    itself and none outside. With `least_spacing` a centre nearer than that to an earlier one is
    drawn again (simple sequential inhibition).

    Raises SceneError where the spacing leaves no room.
    """
    place = stream(drawing.seed, "place")
    lengths, angles = stream(drawing.seed, "length"), stream(drawing.seed, "angle")
    if drawing.count is not None:
        n = drawing.count
        length = draw(drawing.length, lengths, n)

        def centres(k: Array, along: Array) -> Array:  # noqa: ARG001 (as below)
            return _in_region(region, place, len(k))

    else:
        centre, radius = window(drawing.within, region)
        mean = mean_length(drawing.length)
        n = int(stream(drawing.seed, "count").poisson(expected(drawing, region)))
        disc = math.pi * radius / (math.pi * radius + 2.0 * mean)
        biased = lengths.random(n) >= disc
        length = draw(drawing.length, lengths, n)
        longer = int(np.count_nonzero(biased))
        if isinstance(drawing.length, float | int):
            length[biased] = drawing.length
        else:
            length[biased] = drawing.length.biased(lengths, longer)

        def centres(k: Array, along: Array) -> Array:
            found: Array = centre + _in_stadium(radius, length[k], along, biased[k], place)
            return found

    angle = draw(drawing.angle, angles, n)
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    middle = centres(np.arange(n), along)
    if drawing.least_spacing is not None:
        for k in range(1, n):
            for _ in range(MOST_TRIES):
                apart = middle[:k] - middle[k]
                if np.einsum("ij,ij->i", apart, apart).min() >= drawing.least_spacing**2:
                    break
                middle[k] = centres(np.array([k]), along[k : k + 1])[0]
            else:
                what = f"no room for fracture {k + 1} of {n} so far from the others; take less"
                raise SceneError([("least_spacing", what)])
    half = 0.5 * length[:, None] * along
    return middle - half, middle + half


def _in_region(region: Region, rng: np.random.Generator, count: int) -> Array:
    """Points (count, 2) uniform in the region."""
    xmin, xmax, ymin, ymax = bounding_box(region)
    found = np.empty((0, 2))
    while len(found) < count:
        points = rng.random((max(count, 16), 2)) * (xmax - xmin, ymax - ymin) + (xmin, ymin)
        found = np.concatenate([found, points[contains(region, points)]])
    return found[:count]


def _in_stadium(
    radius: float, length: Array, along: Array, straight: Array, rng: np.random.Generator
) -> Array:
    """Points (n, 2) uniform in discs dilated by segments: in the straight part, or in its caps."""
    u = rng.random((len(length), 2))
    turn = 2.0 * math.pi * u[:, 1]
    disc = radius * np.sqrt(u[:, :1]) * np.column_stack([np.cos(turn), np.sin(turn)])
    side = np.sign(np.einsum("ij,ij->i", disc, along))
    caps = disc + 0.5 * (side * length)[:, None] * along
    across = np.column_stack([-along[:, 1], along[:, 0]])
    inner = (u[:, :1] - 0.5) * length[:, None] * along + radius * (2.0 * u[:, 1:] - 1.0) * across
    found: Array = np.where(straight[:, None], inner, caps)
    return found
