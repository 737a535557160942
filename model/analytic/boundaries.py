"""Straight boundaries around a well: faults, channels, corners and rectangles by images.

Dimensionless as in `wellbore`, lengths in units of the well's radius. A side is sealed (its images
have the well's sign), keeps the initial pressure (the opposite sign) or is not there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import kve

from demflow.model.analytic.laplace import Transform, kept

SEALED, CONSTANT, NONE = 1.0, -1.0, 0.0  # reflection of a side

_EXACT = 30.0  # e^(−30) = 9e-14 is the error of the trapezoidal rule
_DECAY = 37.0  # e^(−37) = 9e-17
_AT_ONCE = 4096  # values of s
_MOST_MODES = 2_000


class Side(NamedTuple):
    """A straight boundary at a distance from the well."""

    distance: float  # over the well's radius; infinite where there is none
    reflection: float = SEALED  # SEALED, CONSTANT or NONE


NO_SIDE = Side(math.inf, NONE)


def _between(q: np.ndarray, first: Side, second: Side) -> np.ndarray:
    """Σ of the images between two parallel sides over the well's own wave e^(−q |x|), less 1.

    (1 + r₁ e^(−2 d₁ q)) (1 + r₂ e^(−2 d₂ q)) / (1 − r₁ r₂ e^(−2 (d₁ + d₂) q)) − 1, a geometric
    series of reflections.
    """
    a, b = (r * np.exp(-2.0 * d * q) if r != NONE else np.zeros_like(q) for d, r in (first, second))
    return (a + b + 2.0 * a * b) / (1.0 - a * b)


def _image(root: np.ndarray, distance: float, reflection: float) -> np.ndarray:
    """One image, twice as far away as the side: ± K0(2 d √s)."""
    if reflection == NONE:
        return np.zeros_like(root)
    return reflection * _wave(2.0 * distance * root)


@kept
def _wave(z: np.ndarray) -> np.ndarray:
    """K0(z)."""
    found: np.ndarray = kve(0, z) * np.exp(-z)
    return found


def _strip(s: np.ndarray, first: Side, second: Side) -> np.ndarray:
    """What the images in one or two parallel sides add to s p̄_D at the well.

    The sum of K0(√s d) over the row of images, by K0(z) = ∫ e^(−z cosh u) du (u from 0 on), in
    which they are one geometric series.
    """
    root = np.sqrt(s)
    nearest = min(first.distance, second.distance)
    if math.isinf(first.distance) or math.isinf(second.distance):
        one = first if second.reflection == NONE else second
        return _image(root, one.distance, one.reflection)
    flat = root.ravel()
    parts = range(0, len(flat), _AT_ONCE)
    sums = [_row(flat[k : k + _AT_ONCE], first, second, nearest) for k in parts]
    return np.concatenate(sums).reshape(root.shape)


def _row(root: np.ndarray, first: Side, second: Side, nearest: float) -> np.ndarray:
    """The integral over u by the trapezoidal rule, each with as many points as it needs.

    Its poles lie π/2 − |arg √s| from the line, or farther, and its error is e^(−2π that / step).
    """
    step = 2.0 * math.pi / _EXACT * (0.5 * math.pi - np.abs(np.angle(root)))
    reach = np.arccosh(np.maximum(_DECAY / (2.0 * nearest * root.real), 1.0))
    count = np.ceil(reach / step).astype(int) + 1
    begin = np.cumsum(count) - count
    number = np.arange(count.sum()) - np.repeat(begin, count)
    u = number * np.repeat(step, count)
    height = _between(np.repeat(root, count) * np.cosh(u), first, second)
    height[begin] *= 0.5
    found: np.ndarray = step * np.add.reduceat(height, begin)
    return found


def _modes(first: Side, second: Side, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Wave numbers between two sides, and c ψ² at the well of each: ψ is a cosine or a sine."""
    width = first.distance + second.distance
    n = np.arange(count)
    if first.reflection == second.reflection == SEALED:
        k, weight = n * math.pi / width, np.where(n == 0, 1.0, 2.0)
    elif first.reflection == second.reflection == CONSTANT:
        k, weight = (n + 1) * math.pi / width, np.full(count, 2.0)
    else:
        k, weight = (n + 0.5) * math.pi / width, np.full(count, 2.0)
    shape = np.cos if first.reflection == SEALED else np.sin
    return k, weight * shape(k * first.distance) ** 2


def images_of_sides(
    s: np.ndarray,
    west: Side = NO_SIDE,
    east: Side = NO_SIDE,
    south: Side = NO_SIDE,
    north: Side = NO_SIDE,
) -> np.ndarray:
    """What up to four sides of a rectangle add to s p̄_D of a well, shape of `s`.

    One side is a fault, two parallel ones a channel, two at right angles a corner, three a closed
    end, four a rectangle. Between two parallel sides the well's row of images is taken as a line
    in an endless channel, and each of the channel's modes is reflected by the sides across it.

    Parameters
    ----------
    west : what stands on that side of the well, and how far, over its radius
    east : the same on the other side
    south, north : the same
    s : Laplace variable off the negative real axis.

    Raises
    ------
    ValueError : a side that is not beyond the well (distance at most 1).
    """
    sides = [side if side.reflection != NONE else NO_SIDE for side in (west, east, south, north)]
    if not all(side.distance > 1.0 for side in sides):
        raise ValueError("a boundary lies outside the well: its distance must exceed r_w")
    pairs = [(sides[0], sides[1]), (sides[2], sides[3])]
    bounded = [not math.isinf(a.distance + b.distance) for a, b in pairs]

    def cost(number: int) -> float:  # modes that are needed when this pair makes the channel
        across = min(side.distance for side in pairs[1 - number])
        return (pairs[number][0].distance + pairs[number][1].distance) / across

    if not any(bounded):
        x, y = (min(pair) for pair in pairs)
        total: np.ndarray = _strip(s, *pairs[0]) + _strip(s, *pairs[1])
        if not math.isinf(x.distance + y.distance):
            across = math.hypot(x.distance, y.distance)
            total = total + _image(np.sqrt(s), across, x.reflection * y.reflection)
        return total
    along = min((number for number in (0, 1) if bounded[number]), key=cost)
    first, second = pairs[along]
    total = _strip(s, first, second)
    ends = pairs[1 - along]
    nearest = min(side.distance for side in ends)
    if math.isinf(nearest):
        return total
    width = first.distance + second.distance
    count = math.ceil(_DECAY * width / (2.0 * math.pi * nearest)) + 2
    k, weight = _modes(first, second, min(count, _MOST_MODES))
    for wave, size in zip(k, weight, strict=True):
        decay = np.sqrt(s + wave**2)
        total = total + math.pi / width * size / decay * _between(decay, *ends)
    return total


def with_sides(
    transform: Transform,
    west: Side = NO_SIDE,
    east: Side = NO_SIDE,
    south: Side = NO_SIDE,
    north: Side = NO_SIDE,
) -> Transform:
    """p̄_D(s) of a well in an unbounded reservoir, with up to four sides (`images_of_sides`).

    Parameters
    ----------
    transform : p̄_D(s) of the well in an unbounded reservoir
    west : what stands on that side of the well, and how far, over its radius
    east : the same on the other side
    south, north : the same
    """

    def bounded(s: np.ndarray) -> np.ndarray:
        found: np.ndarray = transform(s) + images_of_sides(s, west, east, south, north) / s
        return found

    return bounded


def with_double_porosity(
    transform: Transform, storativity: float, interporosity: float, *, slabs: bool = False
) -> Transform:
    """p̄_D(s) of a well in rock whose fractures carry the flow and whose matrix feeds them.

    p̄_D(s) = f(s) p̄_1(s f(s)) with that of one porosity, p̄_1, and
    f = (ω (1 − ω) s + λ) / ((1 − ω) s + λ), pseudo-steady flow out of the blocks (Warren & Root
    1963, SPE J. 3, 245–255), or for slabs with transient flow (de Swaan 1976; Kazemi 1969)
    f = ω + √(λ (1 − ω) / (3 s)) tanh √(3 (1 − ω) s / λ).

    Parameters
    ----------
    transform : p̄_D(s) of the same well in rock of one porosity
    slabs : whether the matrix lies in slabs with transient flow; else flow out of blocks is
        pseudo-steady
    storativity : ω, the fractures' share of the storage, in (0, 1].
    interporosity : λ = α k_m r_w² / k_f, above zero.
    """
    rest = 1.0 - storativity

    def double(s: np.ndarray) -> np.ndarray:
        if slabs:
            arm = np.sqrt(3.0 * rest * s / interporosity)
            f = storativity + rest * np.tanh(arm) / arm
        else:
            f = (storativity * rest * s + interporosity) / (rest * s + interporosity)
        return f * transform(s * f)

    return double
