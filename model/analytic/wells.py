"""Wells after the transient: steady states, pseudo-steady state, inflow into a tunnel."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike


def thiem_pressure_fall(
    rate: float, viscosity: float, permeability: float, radius: ArrayLike, outer_radius: float
) -> np.ndarray:
    """Steady pressure fall P_e − P(R) around a well (Thiem 1906; Eqs 36 and 118), Pa.

    P_e − P = q μ ln(R_e / R) / (2π k) for unit depth.

    Parameters
    ----------
    rate : q in m³/s for one metre of depth, positive for production.
    viscosity, permeability : Pa s, m².
    radius, outer_radius : R and R_e in m; R may be an array.
    """
    radius = np.asarray(radius, dtype=float)
    return rate * viscosity * np.log(outer_radius / radius) / (2.0 * math.pi * permeability)


def closed_circle_pseudo_steady(R_D: ArrayLike, t_D: ArrayLike, R_De: float) -> np.ndarray:
    """Late pressure fall around a well at constant rate in a closed circle.

    p_D = (2 (R_D²/4 + t_D) − E² ln R_D) / (E² − 1) − (3E⁴ − 4E⁴ ln E − 2E² − 1) / (4 (E² − 1)²),
    E = R_De: van Everdingen & Hurst (1949); Matthews & Russell (1967), Eq. 2.36. For large E
    at the well: p_D = 2 t_D / E² + ln E − 3/4. Holds from t_D ≈ 0.25 E² on.

    Parameters
    ----------
    R_De : radius of the circle over that of the well
    R_D : radius over the well's, in [1, R_De].
    t_D : k t / (φ μ c r_w²). Broadcasts with `R_D`.

    Returns
    -------
    p_D = 2π k (P_i − P) / (q μ).
    """
    R, t = np.asarray(R_D, dtype=float), np.asarray(t_D, dtype=float)
    E2 = R_De**2
    constant = (3.0 * E2**2 - 4.0 * E2**2 * math.log(R_De) - 2.0 * E2 - 1.0) / (4.0 * (E2 - 1.0))
    found: np.ndarray = (2.0 * (0.25 * R**2 + t) - E2 * np.log(R) - constant) / (E2 - 1.0)
    return found


def tunnel_inflow(
    overpressure: float, viscosity: float, permeability: float, depth: float, radius: float
) -> float:
    """Steady inflow into a tunnel below a level of constant potential, m³/s for unit length.

    q = 2π k Δp / (μ ln(2h / r)): Goodman, Moye, van Schalkwyk & Javandel (1965), Bull. Ass. Eng.
    Geol. 2, 39–56. The tunnel is far below the level (h ≫ r), the rock below reaches without
    end, and the pressures are potentials p + ρ g z: a water table at the surface and a drained
    wall. At any h > r, with one potential along the wall, ln(2h/r) is arcosh(h/r).

    Parameters
    ----------
    overpressure : fall of the potential from the level to the tunnel, ρ g H, Pa.
    viscosity, permeability : Pa s, m².
    depth, radius : of the axis below the level, of the tunnel, m.
    """
    return (
        2.0 * math.pi * permeability * overpressure / (viscosity * math.log(2.0 * depth / radius))
    )


def doublet_pressure_fall(
    rate: float,
    viscosity: float,
    permeability: float,
    *,
    offset: float,
    radius: float,
    outer_radius: float,
) -> float:
    """Steady pressure fall at the producer of two wells at ±a in a circle of constant pressure, Pa.

    P_e − P_w = q μ / (2π k) [ln((R² − a²) / (R r_w)) − ln((R² + a²) / (2 a R))], and as much
    rise at the injector, which takes the same rate in: images of the wells in the rim (Carslaw
    & Jaeger 1959). For R ≫ a it is q μ ln(2a / r_w) / (2π k).

    Parameters
    ----------
    rate, viscosity, permeability : q in m³/s for unit depth, Pa s, m².
    offset : a, distance of each well from the middle, m.
    radius, outer_radius : r_w ≪ a and R, m.
    """
    a, R = offset, outer_radius
    own = math.log((R * R - a * a) / (R * radius))
    other = math.log((R * R + a * a) / (2.0 * a * R))
    return rate * viscosity * (own - other) / (2.0 * math.pi * permeability)
