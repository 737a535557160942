"""Mandel's problem: a slab pressed between rigid plates drains at its two sides (Mandel 1953).

The slab |x| ≤ a is loaded by a stress σ on its plates, y apart, from t = 0 on. Its sides are free
and drained. With plane moduli D of the drained rock (σ'_x = D11 ε_x + D12 ε_y, and so on, Biot's
coefficient 1), storage S and mobility k/μ, and

    s = S + 1/D11,  g = 1 − D12/D11,  E* = D22 − D12²/D11,  r = g²/E*,  c = k/(μ s),

every pressure is at once p0 = σ (g/E*)/(s + r), and then rises further in the middle, which takes
over the load of the sides as these drain and soften. For an isotropic rock 1 + s/r is
(1 − ν)/(ν_u − ν): Cheng & Detournay (1988), Int. J. Numer. Anal. Methods Geomech. 12, 551; with
other moduli along x and y Abousleiman et al. (1996), Géotechnique 46, 187.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar

TERMS = 200


class Slab(NamedTuple):
    """What Mandel's problem depends on."""

    pressure: float  # p0 over the stress on the plates
    ratio: float  # 1 + s/r
    diffusivity: float  # c, m²/s


def slab(moduli: ArrayLike, storage: float, mobility: float) -> Slab:
    """The slab of a rock.

    Parameters
    ----------
    moduli : (2, 2) Pa, drained, plane: D11 across the slab, D22 along the load.
    storage : S, 1/Pa.
    mobility : k/μ across the slab, m²/(Pa s).
    """
    (d11, d12), (_, d22) = np.asarray(moduli, dtype=float)
    s, g, stiff = storage + 1.0 / d11, 1.0 - d12 / d11, d22 - d12**2 / d11
    r = g * g / stiff
    return Slab(g / stiff / (s + r), 1.0 + s / r, mobility / s)


def roots(ratio: float, count: int = TERMS) -> np.ndarray:
    """The first positive solutions (count,) of tan α = `ratio` α, ratio above 1."""
    if not ratio > 1.0:
        raise ValueError(f"Mandel's ratio lies above 1: {ratio}")
    found = []
    for k in range(count):
        low, high = k * np.pi, (k + 0.5) * np.pi

        def difference(alpha: float) -> float:
            return float(np.sin(alpha) - ratio * alpha * np.cos(alpha))

        found.append(brentq(difference, max(low, 1e-9), high, xtol=1e-14))
    return np.array(found)


def mandel_pressure(x_D: ArrayLike, t_D: ArrayLike, ratio: float) -> np.ndarray:
    """Pressure over p0, Σ 2 sin α / (α − sin α cos α) (cos(α x_D) − cos α) e^(−α² t_D).

    Parameters
    ----------
    x_D : place over the half width a, in [−1, 1].
    t_D : c t / a², above 0; the series is precise from some 1e-4 on. Broadcasts with `x_D`.
    ratio : of the slab.
    """
    x, t = np.broadcast_arrays(np.asarray(x_D, dtype=float), np.asarray(t_D, dtype=float))
    alpha = roots(ratio)
    weight = 2.0 * np.sin(alpha) / (alpha - np.sin(alpha) * np.cos(alpha))
    shape = np.cos(alpha * x[..., None]) - np.cos(alpha)
    return np.asarray(np.sum(weight * shape * np.exp(-(alpha**2) * t[..., None]), axis=-1))


def mandel_peak(ratio: float) -> tuple[float, float]:
    """Largest pressure in the middle over p0, and the t_D at which it stands."""
    found = minimize_scalar(
        lambda log_t: -float(mandel_pressure(0.0, np.exp(log_t), ratio)),
        bounds=(math.log(1e-3), 0.0),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return -float(found.fun), math.exp(float(found.x))
