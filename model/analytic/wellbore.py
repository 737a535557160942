"""A well with wellbore storage and skin: how they change any constant-rate solution.

Dimensionless: t_D = k t / (φ μ c r_w²), p_D = 2π k Δp / (q μ), C_D = C / (2π φ c r_w²) with the
wellbore storage C in m³/Pa for unit depth, skin S = 2π k Δp_skin / (q μ).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from demflow.model.analytic.laplace import Transform, invert
from demflow.model.analytic.radial import bounded_transform, unbounded_transform


def with_storage_and_skin(transform: Transform, C_D: float, skin: float) -> Transform:
    """p̄_wD of a well with storage and skin from p̄_D of the same well without them.

    p̄_wD = (s p̄_D + S) / (s (1 + C_D s (s p̄_D + S))): van Everdingen & Hurst (1949), Trans.
    AIME 186, for the storage; van Everdingen (1953), Trans. AIME 198, and Agarwal, Al-Hussainy
    & Ramey (1970), SPE J. 10, 279–290, with the skin. The inner solution may be that of
    any reservoir.

    Parameters
    ----------
    transform : p̄_D(s) of the well without them
    C_D : storage over 2π φ c h r_w²
    skin : S
    """

    def changed(s: np.ndarray) -> np.ndarray:
        resistance = s * transform(s) + skin
        return resistance / (s * (1.0 + C_D * s * resistance))

    return changed


def well_with_storage_and_skin(
    t_D: ArrayLike, C_D: float, skin: float, R_De: float = math.inf
) -> np.ndarray:
    """Pressure fall of a well at constant surface rate, of any shape of `t_D`.

    Early it is t_D / C_D, the wellbore emptying (unit slope); late it is the solution without
    storage plus S.

    Parameters
    ----------
    t_D : above zero.
    C_D : at least 0.
    skin : S, at least 0; a stimulated well (S < 0) is one of radius r_w e^(−S) instead.
    R_De : radius over the well's at which the pressure is kept; infinite for none.

    Raises
    ------
    ValueError : a negative storage or skin, R_De ≤ 1, or a time not above zero.
    """
    if C_D < 0 or skin < 0:
        raise ValueError(f"storage and skin must not be negative: C_D = {C_D}, S = {skin}")
    if not R_De > 1:
        raise ValueError(f"the outer radius must exceed the well's: R_De = {R_De}")
    plain = unbounded_transform(1.0) if math.isinf(R_De) else bounded_transform(1.0, R_De)
    return invert(with_storage_and_skin(plain, C_D, skin), t_D)


def horner_time(shut_in: ArrayLike, production: float) -> np.ndarray:
    """(t_p + Δt) / Δt, against whose logarithm a build-up is straight (Horner 1951).

    p_ws = p_i − q μ / (4π k) ln((t_p + Δt) / Δt) after a production of t_p at q.

    Parameters
    ----------
    shut_in : Δt since the shut-in, above zero, s.
    production : t_p, s.
    """
    shut_in = np.asarray(shut_in, dtype=float)
    found: np.ndarray = (production + shut_in) / shut_in
    return found
