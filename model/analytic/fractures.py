"""Vertical fractures through a well at constant rate in an unbounded reservoir.

Dimensionless: x_D = x / x_f with the half-length x_f, t_Dxf = k t / (φ μ c x_f²),
p_D = 2π k (P_i − P) / (q μ), F_CD = k_f w_f / (k x_f) = T μ / (k x_f) with the fracture's
transmissivity T.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf, exp1

# Where the uniform-flux fracture has the pressure of one of infinite conductivity
# (Gringarten, Ramey & Raghavan 1974).
EQUIVALENT_PLACE = 0.732


def uniform_flux_fracture(t_Dxf: ArrayLike, x_D: ArrayLike = 0.0) -> np.ndarray:
    """Pressure fall on a fracture into which fluid flows evenly along its length.

    p_D = √(πt)/2 [erf((1−x)/2√t) + erf((1+x)/2√t)]
          + (1−x)/4 E1((1−x)²/4t) + (1+x)/4 E1((1+x)²/4t),  t = t_Dxf, x = |x_D| ≤ 1:
    Gringarten, Ramey & Raghavan (1974), SPE J. 14, 347–360.

    Raises
    ------
    ValueError : a time not above zero, or a place off the fracture.
    """
    t, x = np.broadcast_arrays(np.asarray(t_Dxf, dtype=float), np.abs(np.asarray(x_D, dtype=float)))
    if not (np.all(t > 0) and np.all(x <= 1)):
        raise ValueError("the uniform-flux fracture is given for t_Dxf > 0 and |x_D| ≤ 1")
    width = 2.0 * np.sqrt(t)
    fall = np.zeros(t.shape)
    for reach in (1.0 - x, 1.0 + x):
        z = reach / width
        fall += 0.5 * np.sqrt(np.pi * t) * erf(z)
        # z² E1(z²) vanishes with z: at a tip, one of the two arms has no length
        fall += 0.25 * reach * exp1(np.where(z > 0, z, 1.0) ** 2) * (z > 0)
    return fall


def infinite_conductivity_fracture(t_Dxf: ArrayLike) -> np.ndarray:
    """Pressure fall of a well whose fracture has one pressure along its whole length.

    That of the uniform-flux fracture at x_D = 0.732: Gringarten, Ramey & Raghavan (1974);
    within 1 % of the exact solution. Early it is √(π t_Dxf) (linear flow, slope 1/2).
    """
    return uniform_flux_fracture(t_Dxf, EQUIVALENT_PLACE)


def bilinear_flow(t_Dxf: ArrayLike, F_CD: float) -> np.ndarray:
    """Early pressure fall of a well whose fracture has a finite conductivity.

    p_D = π / (Γ(5/4) √(2 F_CD)) t_Dxf^{1/4} = 2.451 t_Dxf^{1/4} / √F_CD: Cinco-Ley & Samaniego
    (1981), J. Petrol. Technol. 33, 1749–1766. It ends where the tip is felt, at
    t_Dxf = 0.1 / F_CD² for F_CD ≥ 3.
    """
    t = np.asarray(t_Dxf, dtype=float)
    return math.pi / (math.gamma(1.25) * math.sqrt(2.0 * F_CD)) * t**0.25
