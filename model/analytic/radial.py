"""Radial flow to a well at constant rate: bounded (Eqs 29, 30) and unbounded reservoirs.

Dimensionless: R_D = R / r_w, t_D = k t / (φ μ c r_w²). In a bounded reservoir pressure
falls are counted in units of the steady state's, q μ ln(R_De) / (2π k) (Eq. 33); in an
unbounded one, which has no steady state, in units of q μ / (2π k).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special
from scipy.special import exp1, ive, j0, j1, y0, y1

from demflow.model.analytic.laplace import Transform, invert, kept

# In units of (R_De − 1)². From the first on, Eq. 29 needs no more than 32 terms (the next is
# below e^(−31.5² π² 0.01) = 1e-42); up to the second the boundary is not felt at all (what
# it does is below erfc(1 / 2√0.001) = 1e-110); between them the Laplace transform is inverted.
_SERIES_FROM = 0.01
_UNBOUNDED_TO = 0.001
_ROOTS = 32


def radial_roots(R_De: float, count: int) -> np.ndarray:
    """First roots λ of Y1(λ) J0(λ R_De) − J1(λ) Y0(λ R_De) = 0 (Eq. 30), shape (count,).

    With J + iY = M e^{iθ} the left side is −M₁ M₀ sin ψ, ψ(λ) = θ₀(λ R_De) − θ₁(λ). Since
    M decreases and M₁ > M₀, ψ rises; since θ₀(x) − x rises from −π/2 to −π/4 and θ₁(x) − x
    falls from −π/2 to −3π/4, it stays between λ(R_De − 1) and λ(R_De − 1) + π/2. Hence the
    n-th root, ψ = nπ, is the only one between (n − ½)π/(R_De − 1) and nπ/(R_De − 1), with a
    known sign on either side: bisection finds it for every R_De > 1 and every n.

    Raises
    ------
    ValueError : R_De is not above 1.
    """
    if not R_De > 1:
        raise ValueError(f"the outer radius must exceed the well's: R_De = {R_De}")
    n = np.arange(1, count + 1)
    low, high = (n - 0.5) * np.pi / (R_De - 1.0), n * np.pi / (R_De - 1.0)
    sign_below = np.where(n % 2 == 0, 1.0, -1.0)
    for _ in range(60):  # halvings of a bracket no wider than its middle: past round-off
        middle = 0.5 * (low + high)
        value = y1(middle) * j0(middle * R_De) - j1(middle) * y0(middle * R_De)
        below = sign_below * value > 0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


@lru_cache(maxsize=32)
def _series(R_De: float) -> tuple[np.ndarray, np.ndarray]:
    """Roots λ_n and coefficients C_n of Eq. 114."""
    roots = radial_roots(R_De, _ROOTS)
    outer = j0(roots * R_De) ** 2
    return roots, np.pi * outer / (roots * (j1(roots) ** 2 - outer))


def radial_dimensionless_pressure(R_D: ArrayLike, t_D: ArrayLike, R_De: float) -> np.ndarray:
    """Pressure fall around a well at constant rate, outer boundary at the initial pressure.

    P_D = 1 − ln R_D / ln R_De + (1 / ln R_De) Σ C_n U_n(R_D) exp(−λ_n² t_D)      (Eq. 29)
    C_n = π J0²(λ_n R_De) / (λ_n (J1²(λ_n) − J0²(λ_n R_De)))                     (Eq. 114)
    U_n(R_D) = Y1(λ_n) J0(λ_n R_D) − J1(λ_n) Y0(λ_n R_D)

    At early times, where the series needs ever more terms, the Laplace transform of the
    same problem is inverted instead. The absolute error is below 1e-12 for R_De ≥ 1.001.

    Parameters
    ----------
    R_D : radius over the well's, in [1, R_De].
    t_D : k t / (φ μ c r_w²), not negative. Broadcasts with `R_D`.
    R_De : outer radius over the well's.

    Returns
    -------
    P_D = (P_i − P) / (P_i − P_w at steady state), of the broadcast shape.

    Raises
    ------
    ValueError : R_De ≤ 1, R_D outside [1, R_De] or t_D below zero.
    """
    radius, time = np.broadcast_arrays(np.asarray(R_D, dtype=float), np.asarray(t_D, dtype=float))
    R_De = float(R_De)
    if not R_De > 1:
        raise ValueError(f"the outer radius must exceed the well's: R_De = {R_De}")
    if not (np.all((radius >= 1) & (radius <= R_De)) and np.all(time >= 0)):
        raise ValueError("Eq. 29 holds for 1 ≤ R_D ≤ R_De and t_D ≥ 0")
    fall = np.zeros(radius.shape)
    late = time >= _SERIES_FROM * (R_De - 1.0) ** 2
    first = (time > 0) & (time < _UNBOUNDED_TO * (R_De - 1.0) ** 2)
    early = (time > 0) & ~first & ~late
    fall[late] = _bounded_late(radius[late], time[late], R_De)
    fall[early] = _bounded_early(radius[early], time[early], R_De)
    fall[first] = finite_radius_well(radius[first], time[first]) / np.log(R_De)
    return fall


def _kve(order: int, z: np.ndarray) -> np.ndarray:
    """K_n(z) e^z for complex z of any size; SciPy's gives NaN from some 1e9 on."""
    large = np.sqrt(np.pi / (2.0 * z)) * (1.0 + (4 * order**2 - 1) / (8.0 * z))
    return np.where(np.abs(z) > 1e8, large, special.kve(order, z))


def _bounded_late(radius: np.ndarray, time: np.ndarray, R_De: float) -> np.ndarray:
    roots, coefficients = _series(R_De)
    reach = roots * radius[..., None]
    modes = y1(roots) * j0(reach) - j1(roots) * y0(reach)
    transient = np.sum(coefficients * modes * np.exp(-(roots**2) * time[..., None]), axis=-1)
    found: np.ndarray = 1.0 + (transient - np.log(radius)) / np.log(R_De)
    return found


def _bounded_early(radius: np.ndarray, time: np.ndarray, R_De: float) -> np.ndarray:
    found: np.ndarray = invert(bounded_transform(radius[..., None], R_De), time) / np.log(R_De)
    return found


def bounded_transform(R: ArrayLike, R_De: float) -> Transform:
    """p̄_D(s) around a well at constant rate, the pressure kept at R_De, in units of q μ / (2π k).

    Eq. 82 with its conditions 83–85 in Laplace space, q = √s, E = R_De:
    s^{3/2} p̄_D = (I0(qE) K0(qR) − K0(qE) I0(qR)) / (I1(q) K0(qE) + K1(q) I0(qE)), written
    with scaled Bessel functions so that large arguments neither overflow nor vanish.
    """
    R = np.asarray(R, dtype=float)

    def transform(s: np.ndarray) -> np.ndarray:
        q = np.sqrt(s)
        grow = q.real  # ive(n, z) is scaled by e^(−|Re z|), _kve(n, z) by e^z
        direct = ive(0, q * R_De) * _kve(0, q * R) * np.exp(-q * (R - 1.0))
        image = np.exp(-q * (R_De - 1.0) - grow * (R_De - R))
        reflected = _kve(0, q * R_De) * ive(0, q * R) * image
        at_well = _kve(1, q) * ive(0, q * R_De)
        far_image = np.exp(-q * (R_De - 1.0) - grow * (R_De - 1.0))
        at_well = at_well + ive(1, q) * _kve(0, q * R_De) * far_image
        found: np.ndarray = (direct - reflected) / (at_well * s * q)
        return found

    return transform


def closed_transform(R: ArrayLike, R_De: float) -> Transform:
    """p̄_D(s) around a well at constant rate, no flow through R_De, in units of q μ / (2π k).

    s^{3/2} p̄_D = (K0(qR) I1(qE) + I0(qR) K1(qE)) / (K1(q) I1(qE) − I1(q) K1(qE)), q = √s,
    E = R_De: van Everdingen & Hurst (1949), Trans. AIME 186.
    """
    R = np.asarray(R, dtype=float)

    def transform(s: np.ndarray) -> np.ndarray:
        q = np.sqrt(s)
        grow = q.real
        direct = ive(1, q * R_De) * _kve(0, q * R) * np.exp(-q * (R - 1.0))
        image = np.exp(-q * (R_De - 1.0) - grow * (R_De - R))
        reflected = _kve(1, q * R_De) * ive(0, q * R) * image
        far_image = np.exp(-q * (R_De - 1.0) - grow * (R_De - 1.0))
        at_well = _kve(1, q) * ive(1, q * R_De) - ive(1, q) * _kve(1, q * R_De) * far_image
        found: np.ndarray = (direct + reflected) / (at_well * s * q)
        return found

    return transform


def unbounded_transform(R: ArrayLike) -> Transform:
    """p̄_D(s) = K0(R √s) / (s^{3/2} K1(√s)) around a well at constant rate, no boundary.

    van Everdingen & Hurst (1949), Trans. AIME 186.
    """
    R = np.asarray(R, dtype=float)

    def transform(s: np.ndarray) -> np.ndarray:
        q = np.sqrt(s)
        found: np.ndarray = _kve(0, q * R) * np.exp(-q * (R - 1.0)) / (s * q * _kve(1, q))
        return found

    return _at_the_well if R.ndim == 0 and R == 1.0 else transform


@kept
def _at_the_well(s: np.ndarray) -> np.ndarray:
    """K0(√s) / (s √s K1(√s)): the pressure at the wall of a well of unit rate."""
    q = np.sqrt(s)
    found: np.ndarray = _kve(0, q) / (s * q * _kve(1, q))
    return found


def finite_radius_well(R_D: ArrayLike, t_D: ArrayLike) -> np.ndarray:
    """Pressure fall around a well of finite radius in an unbounded reservoir.

    By inversion of `unbounded_transform`.

    Parameters
    ----------
    R_D : radius over the well's, at least 1.
    t_D : k t / (φ μ c r_w²), above zero. Broadcasts with `R_D`.

    Returns
    -------
    p_D = 2π k (P_i − P) / (q μ), of the broadcast shape, to some 1e-12.

    Raises
    ------
    ValueError : a time is not above zero, or R_D is below 1.
    """
    radius, time = np.broadcast_arrays(np.asarray(R_D, dtype=float), np.asarray(t_D, dtype=float))
    if not np.all(radius >= 1):
        raise ValueError("R_D must be at least 1")
    return invert(unbounded_transform(radius[..., None]), time)


def line_source(R_D: ArrayLike, t_D: ArrayLike) -> np.ndarray:
    """Pressure fall around a line source in an unbounded reservoir (Theis 1935).

    p_D = ½ E1(R_D² / (4 t_D)); only R_D² / t_D matters, so any length may scale both.

    Parameters
    ----------
    R_D : radius over the scaling length, above zero.
    t_D : k t / (φ μ c r²) with the same length, above zero. Broadcasts with `R_D`.

    Returns
    -------
    p_D = 2π k (P_i − P) / (q μ).
    """
    found: np.ndarray = 0.5 * exp1(
        np.asarray(R_D, dtype=float) ** 2 / (4.0 * np.asarray(t_D, dtype=float))
    )
    return found
