"""Linear flow between two boundaries at constant pressure (Eqs 15–24 and 74 of the paper)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfc

# Below this t_D images of the boundaries converge faster, above it the Fourier series.
# Five images leave erfc(9 / 2√0.2) < 1e-40, six modes e^(−49 π² 0.2) < 1e-41.
_EARLY = 0.2
_IMAGES = 5
_MODES = 6


def linear_dimensionless_pressure(x_D: ArrayLike, t_D: ArrayLike) -> np.ndarray:
    """Pressure fall P_D between a side kept at the initial pressure and one that is lowered.

    P_D = x_D + (2/π) Σ (−1)ⁿ/n exp(−n²π² t_D) sin(nπ x_D), n = 1, 2, …      (Eq. 24)

    and, the same for small t_D, with images of the boundaries (Carslaw & Jaeger 1959,
    §12.5): P_D = Σ erfc((2n+1−x_D)/2√t_D) − erfc((2n+1+x_D)/2√t_D), n = 0, 1, …
    The absolute error is below 1e-14 at every t_D ≥ 0.

    Parameters
    ----------
    x_D : distance from the side at the initial pressure over the length, in [0, 1].
    t_D : α² t / L², not negative; α² = k / (φ μ c). Broadcasts with `x_D`.

    Returns
    -------
    P_D = (P_1 − P) / (P_1 − P_2), of the broadcast shape.

    Raises
    ------
    ValueError : x_D outside [0, 1] or t_D below zero.
    """
    x, t = np.broadcast_arrays(np.asarray(x_D, dtype=float), np.asarray(t_D, dtype=float))
    if not (np.all((x >= 0) & (x <= 1)) and np.all(t >= 0)):
        raise ValueError("Eq. 24 holds for 0 ≤ x_D ≤ 1 and t_D ≥ 0")
    return np.where(t < _EARLY, _images(x, np.minimum(t, _EARLY)), _fourier(x, t))


def _images(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    x, width = x[..., None], 2.0 * np.sqrt(t)[..., None]
    place = 2.0 * np.arange(_IMAGES) + 1.0

    def wave(distance: np.ndarray) -> np.ndarray:
        # at t = 0 every distance is infinitely many widths away, but that of the side itself
        far = np.where(distance > 0, np.inf, 0.0)
        found: np.ndarray = erfc(np.divide(distance, width, out=far, where=width > 0))
        return found

    found: np.ndarray = np.sum(wave(place - x) - wave(place + x), axis=-1)
    return found


def _fourier(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    n = np.arange(1, _MODES + 1)
    decay = np.exp(-((n * np.pi) ** 2) * t[..., None])
    terms = (-1.0) ** n / n * decay * np.sin(n * np.pi * x[..., None])
    found: np.ndarray = x + 2.0 / np.pi * np.sum(terms, axis=-1)
    return found


def linear_flux_response(
    x: ArrayLike, t: ArrayLike, *, length: float, diffusivity: float, sealed: bool
) -> np.ndarray:
    """Pressure rise over q μ / k between a side with a constant flux q and the other side.

    The other side, at x = L, is sealed, or keeps the initial pressure. Images of the first side in
    both (Carslaw & Jaeger 1959, §2.9 and §12.5): with the rise 2 √(α² t) ierfc(z / 2 √(α² t)) of a
    half-space at a distance z, Σ (±1)ⁿ (rise(2nL + x) ± rise(2(n+1)L − x)), n = 0, 1, …, plus where
    the other side is sealed. It converges for every t; some √(α² t) / L terms count.

    Parameters
    ----------
    x : distance from the side with the flux, m.
    t : time since the flux began, s, above zero. Broadcasts with `x`.
    length : L, distance between the sides, m.
    diffusivity : α² = k / (φ μ c), m²/s.
    sealed : whether the other side is sealed; else it keeps the initial pressure.

    Returns
    -------
    Rise in m: times q μ / k, q in m/s, that is Pa.
    """
    x, t = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(t, dtype=float))
    width = 2.0 * np.sqrt(diffusivity * t)[..., None]
    n = np.arange(4 + int(4.0 * width.max(initial=0.0) / length))
    sign = 1.0 if sealed else -1.0

    def rise(distance: np.ndarray) -> np.ndarray:
        z = distance / width
        found: np.ndarray = width * (np.exp(-z * z) / np.sqrt(np.pi) - z * erfc(z))
        return found

    near, far = 2.0 * n * length + x[..., None], 2.0 * (n + 1) * length - x[..., None]
    total: np.ndarray = (sign**n * (rise(near) + sign * rise(far))).sum(axis=-1)
    return total


def linear_pressure(
    x: ArrayLike,
    t: ArrayLike,
    *,
    length: float,
    diffusivity: float,
    initial: float,
    first: float,
    second: float,
) -> np.ndarray:
    """Pressure between two sides at any constant pressures, from any uniform initial one.

    Eqs 20 and 74 of the paper, summed as the superposition of a change at each side:
    P = P_i + (P_1 − P_i) P_D(1 − x/L, t_D) + (P_2 − P_i) P_D(x/L, t_D), P_D from Eq. 24.

    Parameters
    ----------
    x : distance from the first side, m.
    t : time since the sides took their pressures, s. Broadcasts with `x`.
    length : L, distance between the sides, m.
    diffusivity : α² = k / (φ μ c), m²/s.
    initial, first, second : P_i, P_1 at x = 0, P_2 at x = L, Pa.

    Returns
    -------
    Pressure in Pa, of the broadcast shape.
    """
    x_D = np.asarray(x, dtype=float) / length
    t_D = np.asarray(t, dtype=float) * diffusivity / length**2
    return (
        initial
        + (first - initial) * linear_dimensionless_pressure(1.0 - x_D, t_D)
        + (second - initial) * linear_dimensionless_pressure(x_D, t_D)
    )
