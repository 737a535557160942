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
    """F_n = k_n U_n.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    found: float = max(law.kn * un, 0.0)
    return found


@stiffness.of(Linear)
def linear_stiffness(law: Any, un: float, r: float) -> float:
    """Of contacts that touch, k_n.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    found: float = law.kn
    return found


@shear_stiffness.of(Linear)
def linear_shear_stiffness(law: Any, un: float, r: float) -> float:
    """Of contacts that touch, k_s.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    found: float = law.ks
    return found


@energy.of(Linear)
def linear_energy(law: Any, un: float, r: float) -> float:
    """k_n U_n² / 2.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    found: float = 0.5 * law.kn * max(un, 0.0) ** 2
    return found
