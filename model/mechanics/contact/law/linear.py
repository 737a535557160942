"""Linear contact: F_n = k_n U_n, k_s across it (Cundall & Strack 1979)."""

from __future__ import annotations

from typing import Any, NamedTuple

from demflow.model.mechanics.contact.law.statements import energy, press, shear_stiffness, stiffness


class Linear(NamedTuple):
    """Stiffnesses in force per length, Coulomb friction."""

    kn: float
    ks: float
    friction: float


@press.of(Linear)
def linear_press(law: Any, un: float, r: float) -> float:
    """F_n = k_n U_n."""
    return max(law.kn * un, 0.0)


@stiffness.of(Linear)
def linear_stiffness(law: Any, un: float, r: float) -> float:
    """Of contacts that touch, k_n."""
    return law.kn


@shear_stiffness.of(Linear)
def linear_shear_stiffness(law: Any, un: float, r: float) -> float:
    """Of contacts that touch, k_s."""
    return law.ks


@energy.of(Linear)
def linear_energy(law: Any, un: float, r: float) -> float:
    """k_n U_n² / 2."""
    return 0.5 * law.kn * max(un, 0.0) ** 2
