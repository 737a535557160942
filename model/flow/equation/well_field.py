"""The pressure around one well in uniform rock: a logarithm, with images in the sides nearby."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from demflow.model.region import Circle, Region, parts_of

# Two sides that meet at a right angle, within this cosine, have an image of their images.
UPRIGHT = 0.05


class WellField(NamedTuple):
    """u(x) of a well that produces 2π √det(k/μ) m³/s from rock of mobility k/μ, in Pa.

    In coordinates ζ that make the rock isotropic the well's circle is an ellipse, around which
    u = ln |ζ + √(ζ² − c²)| / 2, c half the distance of its foci: the logarithm of the distance
    far away, a constant on the wall. A side at fixed pressure adds an image of the other sign, a
    sealed one an image of the same.
    """

    at: np.ndarray  # (2,) m
    scale: np.ndarray  # (2, 2): coordinates along the principal directions, made isotropic
    half_axes: tuple[float, float]  # m, of the wall in those coordinates
    image: np.ndarray  # (i, 2) m, in those coordinates, from the well
    sign: np.ndarray  # (i,)
    reach: float  # m: how far it holds, and the distance of which its logarithm is zero
    at_wall: float  # pressure u of the well itself

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance from the axis in the coordinates in which the rock is isotropic, (n,) m."""
        found: np.ndarray = np.linalg.norm((points - self.at) @ self.scale.T, axis=1)
        return found

    def at_points(self, points: np.ndarray) -> np.ndarray:
        """Pressure u at points (n, 2) m, (n,)."""
        place = (points - self.at) @ self.scale.T
        a, b = self.half_axes
        z = place[:, 0] + 1j * place[:, 1]
        focus = np.sqrt(max(a * a - b * b, 0.0))
        root = np.sqrt(z - focus + 0j) * np.sqrt(z + focus + 0j)
        own = np.log(np.maximum(np.abs(z + root) / 2, 0.5 * (a + b)) / self.reach)
        found: np.ndarray = own + self._of_images(place)
        return found

    def _of_images(self, place: np.ndarray) -> np.ndarray:
        if len(self.image) == 0:
            return np.zeros(len(place))
        distance = np.linalg.norm(place[:, None, :] - self.image, axis=2)
        found: np.ndarray = np.log(distance / self.reach) @ self.sign
        return found


def well_field(
    at: tuple[float, float],
    radius: float,
    mobility: np.ndarray,
    region: Region,
    fixed: np.ndarray,
    reach: float,
) -> WellField:
    """The field of a well of a radius (m) in rock of mobility k/μ (2, 2), m²/(Pa s).

    `fixed` (sides,) tells which sides of the region keep a pressure; those within `reach` (m) of
    the well have images, and two of them at a right angle one in the corner. A circular rim has
    the image at R²/ρ.

    Parameters
    ----------
    at : centre of the well, m
    radius : of the well, m
    mobility : k/μ of the rock, (2, 2) m²/(Pa s)
    region : where the case lies, m
    fixed : (sides,) bool, which sides keep a pressure
    reach : distance within which sides have images, m
    """
    values, vectors = np.linalg.eigh(mobility)
    mean = np.sqrt(np.prod(values))
    stretch = np.sqrt(mean / values)
    scale = stretch[:, None] * vectors.T
    here = np.asarray(at, dtype=float)
    image, sign = images(here[None], here, scale, region, fixed, reach)
    a, b = (float(radius * s) for s in stretch)
    at_wall = float(np.log(0.5 * (a + b) / reach))
    return WellField(here, scale, (a, b), image[:, 0], sign, reach, at_wall)


def images(
    points: np.ndarray,
    at: np.ndarray,
    scale: np.ndarray,
    region: Region,
    fixed: np.ndarray,
    reach: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Images (i, n, 2) of points (n, 2), in the coordinates of `scale` from a well, and signs (i,).

    They are those in the sides that are within `reach` of the well.

    Parameters
    ----------
    points : what has images, (n, 2) m
    at : centre of the well, (2,) m
    scale : (2, 2), of coordinates that make the rock isotropic
    region : where the case lies, m
    fixed : (sides,) bool, which sides keep a pressure
    reach : distance of the well within which sides count, m
    """
    found: list[np.ndarray] = []
    sign: list[float] = []
    for shape, place, sides in parts_of(region):
        here = at - place
        if isinstance(shape, Circle):
            distance = float(np.linalg.norm(here))
            if abs(shape.radius - distance) > reach or distance == 0.0:
                continue
            ours = points - place
            square = np.maximum((ours * ours).sum(axis=1), np.finfo(float).tiny)
            found.append((ours * (shape.radius**2 / square)[:, None] - here) @ scale.T)
            sign.append(-1.0 if fixed[sides[0]] else 1.0)
            if sides[0] > 0 and not fixed[sides[0]]:  # nothing flows into a sealed hole
                found.append(np.broadcast_to(scale @ -here, points.shape))
                sign.append(-1.0)
        else:
            corners = np.asarray(shape.vertices, dtype=float) + place
            more, signs = _in_edges(points, at, scale, corners, fixed[sides], reach)
            found += more
            sign += signs
    return np.array(found).reshape(-1, len(points), 2), np.array(sign)


def _in_edges(
    points: np.ndarray,
    at: np.ndarray,
    scale: np.ndarray,
    corners: np.ndarray,
    fixed: np.ndarray,
    reach: float,
) -> tuple[list[np.ndarray], list[float]]:
    """Images of points in the edges of a polygon and in its right angles, and their signs."""
    place = (points - at) @ scale.T
    near: list[tuple[np.ndarray, np.ndarray, float]] = []  # feet of all points, normal, sign
    for k, (start, end) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        part = np.clip((at - start) @ (end - start) / ((end - start) @ (end - start)), 0.0, 1.0)
        if np.linalg.norm(start + part * (end - start) - at) > reach:
            continue
        along = scale @ (end - start)
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        offset = float(scale @ (start - at) @ normal)
        if offset == 0.0:
            continue
        foot = (offset - place @ normal)[:, None] * normal
        near.append((foot, normal, -1.0 if fixed[k] else 1.0))
    found = [place + 2.0 * foot for foot, _, _ in near]
    signs = [sign for _, _, sign in near]
    for (foot, normal, sign), (other, other_normal, other_sign) in combinations(near, 2):
        if abs(normal @ other_normal) < UPRIGHT:
            found.append(place + 2.0 * (foot + other))
            signs.append(sign * other_sign)
    return found, signs
