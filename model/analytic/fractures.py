"""Vertical fractures through a well at constant rate in an unbounded reservoir.

Dimensionless: x_D = x / x_f with the half-length x_f, t_Dxf = k t / (φ μ c x_f²),
p_D = 2π k (P_i − P) / (q μ), F_CD = k_f w_f / (k x_f) = T μ / (k x_f) with the fracture's
transmissivity T.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import digamma, erf, exp1

from demflow.model.analytic.laplace import Transform

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


_SERIES_TO = 18.0  # |z| up to which the power series serves; beyond, the asymptotic one
_TERMS = 48  # of the power series: the last is below 1e-16 of the first at _SERIES_TO
_BEYOND = 18  # terms of the asymptotic series, whose least is e^(−18) there
_WELL_SIDE, _TIP_SIDE = 1e-3, 2e-3  # length of the first and last piece of a wing, over x_f
_PIECES = (13, 7)  # of the two halves of a wing


def _series() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients of ∫ K0: two power series in (z/2)², one of them with ln(z/2); then in 1/z."""
    k = np.arange(_TERMS)
    factorial = np.cumprod(np.maximum(k, 1.0))
    power = 1.0 / (factorial**2 * (2 * k + 1))
    constant = power * (digamma(k + 1) + 1.0 / (2 * k + 1))
    # K0 ~ √(π/2z) e^(−z) Σ a_m z^(−m); the integral of it by parts: b_m = a_m − (m − ½) b_(m−1)
    a = np.ones(_BEYOND)
    for m in range(1, _BEYOND):
        a[m] = -a[m - 1] * (2 * m - 1) ** 2 / (8.0 * m)
    b = a.copy()
    for m in range(1, _BEYOND):
        b[m] = a[m] - (m - 0.5) * b[m - 1]
    return power, constant, b


_POWER, _CONSTANT, _ASYMPTOTIC = _series()


def integral_of_K0(z: ArrayLike) -> np.ndarray:
    """∫ K0(u) du from 0 to z for complex z with a real part that is not negative.

    By the power series of K0 (Abramowitz & Stegun 1964, 9.6.13), integrated term by term, and
    π/2 less the asymptotic series of the rest (9.7.2); to 1e-8.
    """
    z = np.asarray(z, dtype=complex)
    integral = np.zeros_like(z)
    near = (np.abs(z) <= _SERIES_TO) & (z != 0.0)
    small = z[near]
    logarithm = np.log(0.5 * small)
    square = 0.25 * small * small
    power, constant = np.zeros_like(square), np.zeros_like(square)
    for p, c in zip(_POWER[::-1], _CONSTANT[::-1], strict=True):
        power = power * square + p
        constant = constant * square + c
    integral[near] = small * (constant - logarithm * power)
    far = np.abs(z) > _SERIES_TO
    large = z[far]
    rest = np.zeros_like(large)
    for b in _ASYMPTOTIC[::-1]:
        rest = rest / large + b
    integral[far] = 0.5 * math.pi - np.sqrt(0.5 * math.pi / large) * np.exp(-large) * rest
    return integral


def uniform_flux_transform(x_D: float = 0.0) -> Transform:
    """p̄_D(s) of `uniform_flux_fracture`, s of t_Dxf; at 0.732 that of infinite conductivity."""

    def transform(s: np.ndarray) -> np.ndarray:
        root = np.sqrt(s)
        arms = integral_of_K0((1.0 - x_D) * root) + integral_of_K0((1.0 + x_D) * root)
        found: np.ndarray = 0.5 * arms / (s * root)
        return found

    return transform


def finite_conductivity_transform(F_CD: ArrayLike) -> Transform:
    """p̄_D(s) of a well whose fracture resists the flow along it, s of t_Dxf.

    Each wing is parted into pieces with an even inflow each, finer towards the well and the tip,
    and the pressure of rock and fracture is the same at the middle of each:
    p̄_w − ½ Σ q̄_j ∫ [K0(|x − x'| √s) + K0(|x + x'| √s)] dx'
        = (π / F_CD) (x / s − ∫∫ q̄), ∫ q̄ = 1 / s
    (Cinco-Ley & Meng 1988, SPE 18172; Cinco-Ley, Samaniego & Dominguez 1978, SPE J. 18, 253–264).
    p_D comes out within 0.8 % of the same with finer pieces, within 0.4 % from t_Dxf = 1e-3 on.

    Parameters
    ----------
    F_CD : above zero; of several, p̄_D has their shape before that of s.
    """
    resistance = math.pi / np.asarray(F_CD, dtype=float)
    wing = np.geomspace(_WELL_SIDE, 0.5, _PIECES[0])
    tip = 1.0 - np.geomspace(0.5, _TIP_SIDE, _PIECES[1])[1:]
    edge = np.concatenate([[0.0], wing, tip, [1.0]])
    n = len(edge) - 1
    middle = 0.5 * (edge[1:] + edge[:-1])
    length = np.diff(edge)
    # ∫∫ of an even inflow of 1 on piece j, up to the middle of piece i
    into = np.clip(middle[:, None] - edge[:-1], 0.0, length)
    past = np.clip(middle[:, None] - edge[1:], 0.0, None)
    twice = 0.5 * into**2 + past * length

    def transform(s: np.ndarray) -> np.ndarray:
        root = np.sqrt(s)[..., None, None]
        reach = middle[:, None] - edge
        arm = np.sign(reach) * integral_of_K0(np.abs(reach) * root)
        far = integral_of_K0((middle[:, None] + edge) * root)
        rock = 0.5 * (arm[..., :-1] - arm[..., 1:] + far[..., 1:] - far[..., :-1]) / root
        each = resistance.reshape(resistance.shape + (1,) * s.ndim)
        shape = (*resistance.shape, *s.shape)
        matrix = np.zeros((*shape, n + 1, n + 1), dtype=complex)
        matrix[..., :n, :n] = each[..., None, None] * twice - rock
        matrix[..., :n, n] = 1.0
        matrix[..., n, :n] = length
        right = np.ones((*shape, n + 1, 1))
        right[..., :n, 0] = each[..., None] * middle
        found: np.ndarray = np.linalg.solve(matrix, right)[..., n, 0] / s
        return found

    return transform
