"""Regular lattices of equal discs: porosity, permeability and elastic constants.

All grains have radius R, all contacts alike, all pipes aperture w; depth 1 m. Each pipe is
a pair of parallel plates of length 2R, g = w³ / (12 μ · 2R) (Eq. 1).
"""

from __future__ import annotations

import math

SQUARE_POROSITY = 1.0 - math.pi / 4.0
HEXAGONAL_POROSITY = 1.0 - math.pi / (2.0 * math.sqrt(3.0))


def square_permeability(aperture: float, radius: float) -> float:
    """Permeability of a square lattice, k = w³ / (24 R), in m².

    One pore per 2R × 2R cell, one pipe to each neighbour: k = g μ. `aperture`, `radius` in m.
    """
    return aperture**3 / (24.0 * radius)


def hexagonal_permeability(aperture: float, radius: float) -> float:
    """Permeability of a hexagonal lattice, k = w³ / (24 √3 R), in m².

    The pores form a honeycomb of edge 2R/√3, for which k = g μ / √3. Isotropic.
    `aperture`, `radius` in m.
    """
    return aperture**3 / (24.0 * math.sqrt(3.0) * radius)


def hexagonal_elasticity(normal_stiffness: float, shear_stiffness: float) -> tuple[float, float]:
    """Young's modulus E (Pa) and Poisson's ratio ν of a hexagonal lattice, plane stress.

    E = 2√3 k_n (k_n + k_s) / (3 k_n + k_s), ν = (k_n − k_s) / (3 k_n + k_s): contacts that
    neither slip nor open, grains that do not rotate (exact under uniform strain).
    Stiffnesses in N/m for one metre of depth.
    """
    kn, ks = normal_stiffness, shear_stiffness
    return 2.0 * math.sqrt(3.0) * kn * (kn + ks) / (3.0 * kn + ks), (kn - ks) / (3.0 * kn + ks)
