"""What is measured on grains at rest: contacts, porosity, coordination."""

from __future__ import annotations

import numpy as np

from model.mechanics.grains import Array
from model.mechanics.neighbours import Pairs


def listed(pairs: Pairs) -> tuple[Array, Array]:
    """The pairs of a list as two int64 arrays (a, b), a < b, sorted by (a, b)."""
    a = np.repeat(np.arange(len(pairs.start) - 1), np.diff(pairs.start))
    return a, pairs.other.astype(np.int64)


def overlaps(x: Array, y: Array, radius: Array, a: Array, b: Array) -> Array:
    """Overlap r_a + r_b − distance of each pair, (c,); negative for a gap."""
    return radius[a] + radius[b] - np.hypot(x[b] - x[a], y[b] - y[a])


def contact_counts(x: Array, y: Array, radius: Array, box: Array, a: Array, b: Array) -> Array:
    """Number of contacts of each grain, (n,), walls included; a, b are those between grains."""
    walls = (
        (x - radius < box[0]).astype(np.int64)
        + (x + radius > box[1])
        + (y - radius < box[2])
        + (y + radius > box[3])
    )
    return walls + np.bincount(a, minlength=len(x)) + np.bincount(b, minlength=len(x))


def porosity(x: Array, y: Array, radius: Array, box: Array) -> float:
    """Part of a box (xmin, xmax, ymin, ymax) that no disc covers, cut discs exactly.

    Overlaps of discs count twice; in a packing at rest they are of order 1e-6 of the area.
    """
    left, right = (box[0] - x) / radius, (box[1] - x) / radius
    below, above = (box[2] - y) / radius, (box[3] - y) / radius
    part = (
        _corner_area(right, above)
        - _corner_area(left, above)
        - _corner_area(right, below)
        + _corner_area(left, below)
    )
    return float(1.0 - np.sum(part * radius**2) / ((box[1] - box[0]) * (box[3] - box[2])))


def _corner_area(a: Array, b: Array) -> Array:
    """Area of the unit disc where x < a and y < b."""
    a, b = np.clip(a, -1.0, 1.0), np.clip(b, -1.0, 1.0)
    to_a = a * np.sqrt(1.0 - a * a) + np.arcsin(a)
    to_b = b * np.sqrt(1.0 - b * b) + np.arcsin(b)
    cut = a * b + 0.5 * (to_a + to_b) + 0.25 * np.pi
    half_a, half_b = to_a + 0.5 * np.pi, to_b + 0.5 * np.pi
    whole = np.select(
        [(a >= 0) & (b >= 0), a >= 0, b >= 0], [half_a + half_b - np.pi, half_b, half_a], 0.0
    )
    return np.where(a * a + b * b < 1.0, cut, whole)
