"""Slip of a plane of weakness by Mohr and Coulomb, under pore pressure as Terzaghi has it."""

from __future__ import annotations

import numpy as np

Number = np.ndarray | float


def tractions(xx: Number, yy: Number, angle: Number) -> tuple[np.ndarray, np.ndarray]:
    """Normal stress (compression positive) and shear stress on a plane, Pa.

    Parameters
    ----------
    xx, yy : principal stresses along the axes, Pa
    angle : of the plane from the x axis, rad
    """
    across = np.asarray(xx * np.sin(angle) ** 2 + yy * np.cos(angle) ** 2)
    return across, np.asarray(0.5 * (yy - xx) * np.sin(2.0 * np.asarray(angle)))


def slip_pressure(
    xx: Number, yy: Number, angle: Number, friction: Number, cohesion: Number = 0.0
) -> np.ndarray:
    """Pore pressure at which a plane slides, σn − (|τ| − c) / μ, Pa; negative: it slides dry.

    |τ| = c + μ (σn − p) (Hubbert & Rubey 1959, GSA Bulletin 70, 115). A plane without shear, or
    with more cohesion than shear, slides at no pressure below σn, at which it opens.

    Parameters
    ----------
    xx, yy : principal stresses along the axes, Pa
    angle : of the plane from the x axis, rad
    friction, cohesion : μ above 0 and c (Pa) of the plane
    """
    normal, shear = tractions(xx, yy, angle)
    return np.asarray(normal - np.maximum(np.abs(shear) - cohesion, 0.0) / friction)
