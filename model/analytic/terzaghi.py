"""One-dimensional consolidation (Terzaghi 1923).

A layer of thickness H drains at z = 0 and is sealed at z = H; a load put on at t = 0 raises
the pore pressure everywhere by u0. By symmetry this is half of a layer 2H that drains at
both sides, hence a sum of two solutions of Eq. 24, which is precise at every time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from demflow.model.analytic.linear import linear_dimensionless_pressure


def excess_pressure(z_D: ArrayLike, T_v: ArrayLike) -> np.ndarray:
    """Pore pressure that is left, u / u0.

    u/u0 = Σ (2/M) sin(M z_D) exp(−M² T_v), M = (2m + 1)π/2, m = 0, 1, …

    Parameters
    ----------
    z_D : depth below the drained side over H, in [0, 1].
    T_v : c_v t / H², not negative; c_v = k E_oed / μ. Broadcasts with `z_D`.
    """
    x = 0.5 * np.asarray(z_D, dtype=float)
    t = 0.25 * np.asarray(T_v, dtype=float)
    found: np.ndarray = (
        1.0 - linear_dimensionless_pressure(x, t) - linear_dimensionless_pressure(1.0 - x, t)
    )
    return found


def consolidation_degree(T_v: ArrayLike) -> np.ndarray:
    """Settlement over its final value, U = 1 − Σ (2/M²) exp(−M² T_v), M = (2m + 1)π/2.

    For small T_v the equal form 2√(T_v/π) (1 + 2√π Σ (−1)ⁿ ierfc(n/√T_v)) is used, of which
    the first term suffices below T_v = 0.02 (the next is below e⁻⁵⁰).
    """
    time = np.asarray(T_v, dtype=float)
    M = (2.0 * np.arange(24) + 1.0) * np.pi / 2.0
    left = np.sum(2.0 / M**2 * np.exp(-(M**2) * time[..., None]), axis=-1)
    return np.where(time < 0.02, 2.0 * np.sqrt(time / np.pi), 1.0 - left)


def drainage_rate(T_v: ArrayLike) -> np.ndarray:
    """Flow out of the layer, dU/dT_v = 2 Σ exp(−M² T_v), M = (2m + 1)π/2; T_v above zero.

    For unit area q = (k u0 / (μ H)) dU/dT_v. Early it is 1/√(π T_v): with the images,
    1/√(πT_v) (1 + 2 Σ (−1)ⁿ e^(−n²/T_v)), whose first term suffices below T_v = 0.02.
    """
    time = np.asarray(T_v, dtype=float)
    M = (2.0 * np.arange(24) + 1.0) * np.pi / 2.0
    late = 2.0 * np.sum(np.exp(-(M**2) * time[..., None]), axis=-1)
    return np.where(time < 0.02, 1.0 / np.sqrt(np.pi * time), late)
