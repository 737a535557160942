"""A straight hydraulic fracture in plane strain, driven at a constant rate (KGD), without leak-off.

Khristianovic & Zheltov (1955); Geertsma & de Klerk (1969), J. Pet. Technol. 21, 1571. Where the
rock's toughness alone resists, pressure is uniform and the fracture Griffith's. Where friction in
the fluid alone resists, the solution is Spence & Sharp's (1985, Proc. R. Soc. A 400, 289) with the
first terms of Adachi & Detournay (2002, Int. J. Numer. Anal. Meth. Geomech. 26, 579): lengths and
pressures to 0.3 %, volumes to 0.7 %. Which of them holds says K_m (Detournay 2004, Int. J.
Geomech. 4, 35): below 1 friction in the fluid, above 4 toughness.

E′ is E / (1 − ν²) of a rock in plane strain, the Young's modulus in the plane of a slice. Rates
are of both wings, for a unit of depth; pressures are those over the stress across the fracture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import beta, hyp2f1, xlogy

Array = np.ndarray

HALF_LENGTH = 0.6152  # γ of the fluid-friction limit
A0, A1, B1 = math.sqrt(3.0), -0.156, 0.0663
TOUGHNESS_ABOVE, VISCOSITY_BELOW = 4.0, 1.0  # K_m


class Kgd(NamedTuple):
    """The fracture at the times asked for."""

    half_length: Array  # m: of each wing
    width: Array  # m: opening at the well
    pressure: Array  # Pa: at the well, over the stress across the fracture


def toughness_dominated(time: Array, *, plane_modulus: float, toughness: float, rate: float) -> Kgd:
    """The limit of a fluid without viscosity: p = K_Ic / √(π ℓ), w = 4 p ℓ / E′, volume Q t.

    Parameters
    ----------
    time : (t,) s since injection began
    plane_modulus : E′, Pa
    toughness : K_Ic, Pa √m
    rate : Q, m²/s
    """
    half = (plane_modulus * rate * time / (2.0 * math.sqrt(math.pi) * toughness)) ** (2.0 / 3.0)
    pressure = toughness / np.sqrt(np.pi * half)
    return Kgd(half, 4.0 * pressure * half / plane_modulus, pressure)


def viscosity_dominated(time: Array, *, plane_modulus: float, viscosity: float, rate: float) -> Kgd:
    """The limit of a rock without toughness.

    Parameters
    ----------
    time : (t,) s since injection began
    plane_modulus : E′, Pa
    viscosity : μ, Pa s
    rate : Q, m²/s
    """
    length, small = _scales(time, plane_modulus, viscosity, rate)
    half = HALF_LENGTH * length
    opening, pressure = _profile(np.zeros(1))
    return Kgd(half, small * half * opening[0], small * plane_modulus * pressure[0])


def opening_and_pressure(
    place: Array, time: float, *, plane_modulus: float, viscosity: float, rate: float
) -> tuple[Array, Array]:
    """Opening, m, and net pressure, Pa, along the fracture in the limit of no toughness.

    Parameters
    ----------
    place : (n,) distances from the well over the half-length, 0 ≤ ξ < 1
    time : s
    plane_modulus : E′, Pa
    viscosity : μ, Pa s
    rate : Q, m²/s
    """
    length, small = _scales(np.asarray(time), plane_modulus, viscosity, rate)
    opening, pressure = _profile(place)
    return small * HALF_LENGTH * length * opening, small * plane_modulus * pressure


def dimensionless_toughness(
    *, plane_modulus: float, toughness: float, viscosity: float, rate: float
) -> float:
    """K_m = K′ / (E′³ μ′ Q)^¼, K′ = 4 √(2/π) K_Ic, μ′ = 12 μ: of a KGD fracture at any time.

    Parameters
    ----------
    plane_modulus : E′, Pa
    toughness : K_Ic, Pa √m
    viscosity : μ, Pa s
    rate : Q, m²/s
    """
    resists = 4.0 * math.sqrt(2.0 / math.pi) * toughness
    return resists / (plane_modulus**3 * 12.0 * viscosity * rate) ** 0.25


def _scales(
    time: Array, plane_modulus: float, viscosity: float, rate: float
) -> tuple[Array, Array]:
    """L and ε of the scaling by friction in the fluid."""
    thick = 12.0 * viscosity
    length = (plane_modulus * rate**3 * time**4 / thick) ** (1.0 / 6.0)
    return length, (thick / (plane_modulus * time)) ** (1.0 / 3.0)


def _profile(place: Array) -> tuple[Array, Array]:
    """Opening over ε γ L, and pressure over ε E′."""
    square, root = place**2, np.sqrt(1.0 - place**2)
    # ξ² ln|(1 − √(1 − ξ²)) / (1 + √(1 − ξ²))|, 0 at ξ = 0
    logs = 2.0 * xlogy(square, square) - 4.0 * square * np.log1p(root)
    opening = A0 * root ** (4.0 / 3.0) + A1 * root ** (10.0 / 3.0) + B1 * (4.0 * root + logs)
    first = A0 * hyp2f1(-1.0 / 6.0, 1.0, 0.5, square)
    first = first + 10.0 / 7.0 * A1 * hyp2f1(-7.0 / 6.0, 1.0, 0.5, square)
    pressure = beta(0.5, 2.0 / 3.0) / (3.0 * math.pi) * first + B1 * (2.0 - math.pi * place)
    return opening, pressure
