"""Strength of rock with one plane of weakness (Jaeger 1960, Geological Magazine 97, 65)."""

from __future__ import annotations

import numpy as np


def jaeger_strength(
    confining: float, angle: np.ndarray | float, friction: float, cohesion: float = 0.0
) -> np.ndarray:
    """Largest axial stress σ1 at which a plane of weakness does not slip, Pa.

    σ1 = σ3 + 2 (c + μ σ3) / ((1 − μ cot β) sin 2β), least at β = 45° + φ/2; infinite where
    β ≤ φ = arctan μ or β = 90°, for then it never slips.

    Parameters
    ----------
    confining : σ3, Pa.
    angle : β between the plane and the direction of σ3, rad, 0 to π/2; any shape.
    friction, cohesion : μ and c (Pa) of the plane.
    """
    beta = np.asarray(angle, dtype=float)
    with np.errstate(divide="ignore"):
        slope = np.sin(2.0 * beta) - 2.0 * friction * np.cos(beta) ** 2
        slips = slope > 1e-12
        more = 2.0 * (cohesion + friction * confining) / np.where(slips, slope, 1.0)
    return np.where(slips, confining + more, np.inf)


def mobilised_friction(axial: np.ndarray | float, confining: float, angle: float) -> np.ndarray:
    """Angle between the traction on a plane and its normal, rad, under stresses σ1 and σ3.

    `axial` is σ1, Pa, any shape; `angle` that between the plane and the direction of σ3, rad.

    Parameters
    ----------
    axial : σ1, Pa, any shape
    confining : σ3, Pa
    angle : between the plane and the direction of σ3, rad
    """
    normal = axial * np.cos(angle) ** 2 + confining * np.sin(angle) ** 2
    found: np.ndarray = np.arctan2(0.5 * (axial - confining) * np.sin(2.0 * angle), normal)
    return found
