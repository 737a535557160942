"""The pressure around a well whose traces nearby keep theirs: charges on the wall and on traces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.well_field import WellField, images
from demflow.model.region import Region

# Charges on traces lie this part of their distance from the well apart, those on the wall evenly;
# traces are charged up to this many times the distance at which the field is used.
STEP = 0.2
ON_WALL = 24
BEYOND = 1.5


class GroundedField(NamedTuple):
    """u(x) of a well of unit flow, as that of a `WellField`, zero on the traces around it if any.

    Charges of constant density on straight pieces, whose middles have the pressure that is known
    there: zero on traces, one that is to be found on the well's wall.
    """

    free: WellField
    start: np.ndarray  # (c,) of each piece, in isotropic coordinates, as complex numbers
    end: np.ndarray  # (c,)
    charge: np.ndarray  # (c,)
    image: np.ndarray  # (i,) of middles of pieces
    image_charge: np.ndarray  # (i,)
    at_wall: float  # pressure u of the well itself

    @property
    def at(self) -> np.ndarray:
        """Centre of the well, (2,) m."""
        return self.free.at

    @property
    def scale(self) -> np.ndarray:
        """(2, 2): coordinates along the principal directions, made isotropic."""
        return self.free.scale

    @property
    def reach(self) -> float:
        """How far the field holds, m."""
        return self.free.reach

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance from the axis in the coordinates in which the rock is isotropic, (n,) m."""
        return self.free.distance(points)

    def at_points(self, points: np.ndarray) -> np.ndarray:
        """Pressure u at points (n, 2) m, (n,)."""
        z = _isotropic(self.free, points)
        found: np.ndarray = _of_pieces(z, self.start, self.end, self.free.reach) @ self.charge
        if len(self.image):
            found = found + _of_points(z, self.image, self.free.reach) @ self.image_charge
        return found


def _isotropic(free: WellField, points: np.ndarray) -> np.ndarray:
    place = (points - free.at) @ free.scale.T
    found: np.ndarray = place[:, 0] + 1j * place[:, 1]
    return found


def grounded_field(
    free: WellField, start: np.ndarray, end: np.ndarray, region: Region, fixed: np.ndarray
) -> GroundedField:
    """The field with traces from `start` to `end` (t, 2) m at zero pressure; none meets the well.

    Parameters
    ----------
    free : the field without them
    start, end : of the traces, (t, 2) m
    region : where the case lies, m
    fixed : (sides,) bool, which sides keep a pressure
    """
    a, b = free.half_axes
    round_ = np.exp(2j * np.pi * np.arange(ON_WALL + 1) / ON_WALL)
    # corners outside of it, so that the polygon has its area, and its capacity
    wall = (a * round_.real + 1j * b * round_.imag) * (1.0 + (np.pi / ON_WALL) ** 2 / 3.0)
    pieces = [np.column_stack([wall[:-1], wall[1:]])]
    for p, q in zip(_isotropic(free, start), _isotropic(free, end), strict=True):
        places = _graded(p, q, BEYOND * free.reach)
        pieces.append(np.column_stack([places[:-1], places[1:]]))
    one, other = np.concatenate(pieces).T
    middle = 0.5 * (one + other)
    n = len(middle)
    points = np.column_stack([middle.real, middle.imag]) @ np.linalg.inv(free.scale).T + free.at
    mirrored, sign = images(points, free.at, free.scale, region, fixed, free.reach)
    image = mirrored[..., 0] + 1j * mirrored[..., 1]  # (i, n)
    matrix = np.zeros((n + 1, n + 1))
    matrix[:n, :n] = _of_pieces(middle, one, other, free.reach)
    for places, way in zip(image, sign, strict=True):
        matrix[:n, :n] += way * _of_points(middle, places, free.reach)
    matrix[:ON_WALL, n] = -1.0
    matrix[n, :ON_WALL] = 1.0
    known = np.zeros(n + 1)
    known[n] = 1.0
    found = np.linalg.solve(matrix, known)
    charge = found[:n]
    mirror = (sign[:, None] * charge).ravel()
    return GroundedField(free, one, other, charge, image.ravel(), mirror, float(found[n]))


def _graded(start: complex, end: complex, within: float) -> np.ndarray:
    """Places from one end of a line to the other, finer towards 0, where the well is.

    What lies further away than `within` is left out.
    """
    length = abs(end - start)
    along = (end - start) / length
    foot = -(start * along.conjugate()).real  # m along the line
    # of a line that points at the well the nearest place counts
    nearest = abs(start + np.clip(foot, 0.0, length) * along)
    away = max(abs(start + foot * along), 0.1 * nearest)
    half = np.sqrt(max(within**2 - away**2, 0.0))
    low, high = np.arcsinh((np.clip([0.0, length], foot - half, foot + half) - foot) / away)
    count = max(4, int(np.ceil((high - low) / STEP)))
    places = foot + away * np.sinh(np.linspace(low, high, count + 1))
    found: np.ndarray = start + places * along
    return found


def _of_points(z: np.ndarray, places: np.ndarray, unit: float) -> np.ndarray:
    """ln(distance / unit) of points (n,) from places (c,), (n, c)."""
    far = np.maximum(np.abs(z[:, None] - places), np.finfo(float).tiny)
    found: np.ndarray = np.log(far / unit)
    return found


def _of_pieces(z: np.ndarray, start: np.ndarray, end: np.ndarray, unit: float) -> np.ndarray:
    """Mean of ln(distance / unit) of points (n,) from straight pieces (c,), (n, c)."""
    step = end - start
    tiny = np.finfo(float).tiny
    first = (z[:, None] - start) / step
    last = first - 1.0
    parts = first * np.log(first + tiny) - last * np.log(last + tiny)
    found: np.ndarray = parts.real - 1.0 + np.log(np.abs(step) / unit)
    return found
