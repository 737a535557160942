"""Hertz–Mindlin contact of spheres in a layer one mean grain diameter thick.

Two spheres press with (4/3) E* √r U_n^{3/2}, E* = E / (2 (1 − ν²)) for equal moduli (Hertz 1882;
Johnson 1985, Contact Mechanics, section 4.2), so that a layer of thickness 2 r̄ bears
(2/3) (E* / r̄) √r U_n^{3/2} per unit depth. Across the contact they have the stiffness without slip
of Mindlin (1949), k_s / k_n = 2 (1 − ν) / (2 − ν). The shear force grows by that of the moment
and is not cut back as the normal force falls: a cycle of both may make or lose a little energy
(Elata & Berryman 1996), which the ledger counts with slip.
"""

from __future__ import annotations

from typing import NamedTuple

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.law.statements import (
    energy,
    press,
    shear_stiffness,
    stiffest,
    stiffness,
)

CROWDED = 8.0  # times the mean force: what a contact of a force chain bears at the most


class Hertz(NamedTuple):
    """Stiffness grows with the root of the overlap; lengths in units of the mean radius."""

    kn: float  # tangent stiffness at the stress that is expected
    modulus: float  # E*
    shear_ratio: float  # k_s / k_n = 2 (1 − ν) / (2 − ν)
    friction: float


@kernel
def hertz_force(modulus: float, un: float, r: float) -> float:
    """Force of an overlap U_n, 0 where there is none: (2/3) E* √r U_n^{3/2}.

    Parameters
    ----------
    modulus : E*
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    u = max(un, 0.0)
    found: float = 2.0 / 3.0 * modulus * (r * u) ** 0.5 * u
    return found


@kernel
def hertz_stiffness(modulus: float, un: float, r: float) -> float:
    """Its derivative: E* √(r U_n).

    Parameters
    ----------
    modulus : E*
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    found: float = modulus * (r * max(un, 0.0)) ** 0.5
    return found


@press.of(Hertz)
def _press(law: Hertz, un: float, r: float) -> float:
    return hertz_force(law.modulus, un, r)


@stiffness.of(Hertz)
def _stiffness(law: Hertz, un: float, r: float) -> float:
    return hertz_stiffness(law.modulus, un, r)


@shear_stiffness.of(Hertz)
def _shear_stiffness(law: Hertz, un: float, r: float) -> float:
    return law.shear_ratio * hertz_stiffness(law.modulus, un, r)


@energy.of(Hertz)
def _energy(law: Hertz, un: float, r: float) -> float:
    return 0.4 * hertz_force(law.modulus, un, r) * max(un, 0.0)


@stiffest.of(Hertz)
def _stiffest(law: Hertz) -> float:
    found: float = law.kn * CROWDED ** (1.0 / 3.0)
    return found
