"""Stresses around a round hole, and those of a rock's own weight."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def kirsch_stresses(
    r: ArrayLike,
    theta: ArrayLike,
    *,
    radius: float,
    greatest: float,
    least: float,
    angle: float = 0.0,
    pressure: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radial, hoop and shear stress around a hole in an elastic plate (Kirsch 1898), Pa.

    With m = (σ1 + σ3)/2, d = (σ1 − σ3)/2, ρ = a/r and φ the angle from the direction of σ1,
    σ_rr = m (1 − ρ²) + d (1 − 4ρ² + 3ρ⁴) cos 2φ + p ρ²,
    σ_θθ = m (1 + ρ²) − d (1 + 3ρ⁴) cos 2φ − p ρ²,
    σ_rθ = −d (1 + 2ρ² − 3ρ⁴) sin 2φ: Jaeger, Cook & Zimmerman (2007), Fundamentals of Rock
    Mechanics, section 8.5. They hold whatever the elastic constants are; compression positive.

    Parameters
    ----------
    r, theta : distance from the centre of the hole, m, and angle from the x axis, rad.
    radius : a, m.
    greatest, least : σ1 and σ3 far away, Pa.
    angle : direction of σ1 from the x axis, rad.
    pressure : p in the hole, Pa.
    """
    rho = (radius / np.asarray(r, dtype=float)) ** 2
    twice = 2.0 * (np.asarray(theta, dtype=float) - angle)
    mean, half = 0.5 * (greatest + least), 0.5 * (greatest - least)
    radial = mean * (1.0 - rho) + half * (1.0 - 4.0 * rho + 3.0 * rho**2) * np.cos(twice)
    hoop = mean * (1.0 + rho) - half * (1.0 + 3.0 * rho**2) * np.cos(twice)
    shear = -half * (1.0 + 2.0 * rho - 3.0 * rho**2) * np.sin(twice)
    return radial + pressure * rho, hoop - pressure * rho, shear


def lithostatic_stress(
    depth: ArrayLike, *, density: float, porosity: float, gravity: float
) -> np.ndarray:
    """Vertical stress by the weight of a dry rock above, (1 − φ) ρ g z, Pa.

    Parameters
    ----------
    depth : z below the surface, or below where stresses are counted from, m.
    density : ρ of the grains, kg/m³.
    porosity : φ.
    gravity : g, m/s².
    """
    return (1.0 - porosity) * density * gravity * np.asarray(depth, dtype=float)
