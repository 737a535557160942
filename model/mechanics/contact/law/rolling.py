"""Linear contact that resists rolling, as the angular grains that discs stand for do.

An elastic hinge that yields: M grows by k_r per angle of rolling, k_r = k_s r², up to μ_r r F_n
(Iwashita & Oda 1998, J. Eng. Mech. 124, 285–292; Ai, Chen, Rotter & Ooi 2011, Powder Technol.
206, 269–282, model C without its viscous part).
"""

from __future__ import annotations

from typing import NamedTuple

from demflow.model.mechanics.contact.law.linear import (
    linear_energy,
    linear_press,
    linear_shear_stiffness,
    linear_stiffness,
)
from demflow.model.mechanics.contact.law.statements import (
    energy,
    press,
    rolling_limit,
    rolling_stiffness,
    rolls,
    shear_stiffness,
    stiffest,
    stiffness,
)


class Rolling(NamedTuple):
    """A linear contact, and the coefficient of rolling friction μ_r."""

    kn: float
    ks: float
    friction: float
    rolling_friction: float


press.of(Rolling)(linear_press)
stiffness.of(Rolling)(linear_stiffness)
shear_stiffness.of(Rolling)(linear_shear_stiffness)
energy.of(Rolling)(linear_energy)


@rolls.of(Rolling)
def _rolls(law: Rolling) -> bool:
    return True


@rolling_stiffness.of(Rolling)
def _rolling_stiffness(law: Rolling, un: float, r: float) -> float:
    return law.ks * r * r


@rolling_limit.of(Rolling)
def _rolling_limit(law: Rolling, fn: float, r: float) -> float:
    return law.rolling_friction * r * fn


@stiffest.of(Rolling)
def _stiffest(law: Rolling) -> float:
    return max(law.kn, 1.25 * law.ks)  # grains that turn against each other feel k_s r² / 4 more
