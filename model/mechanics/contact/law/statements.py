"""What a contact law states: functions whose first argument, the law, decides what they do.

Every law is a named tuple with the fields `kn`, the stiffness that sets the scale of walls, servo
and joints, and `friction`, the Coulomb coefficient μ. `un` is the overlap U_n; `r` is the
relative radius r_a r_b / (r_a + r_b), of a contact with a wall the grain's own. Forces are
per unit depth.
"""

from __future__ import annotations

from typing import Any

from demflow.model.compile import by_type


@by_type
def press(law: Any, un: float, r: float) -> float:
    """Normal force F_n, never negative: grains that part bear nothing.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    raise TypeError("the law states no normal force")


@by_type
def stiffness(law: Any, un: float, r: float) -> float:
    """Tangent normal stiffness dF_n / dU_n of a closed contact.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    raise TypeError("the law states no normal stiffness")


@by_type
def shear_stiffness(law: Any, un: float, r: float) -> float:
    """Tangent shear stiffness, by which the shear force grows before it slips.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    raise TypeError("the law states no shear stiffness")


@by_type
def energy(law: Any, un: float, r: float) -> float:
    """Elastic energy that the normal force stores, ∫ F_n dU_n.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    raise TypeError("the law states no energy")


@by_type
def stiffest(law: Any) -> float:
    """Stiffness that no contact exceeds, to which the time step is fitted."""
    found: float = max(law.kn, law.ks)
    return found


@by_type
def rolls(law: Any) -> bool:
    """Whether grains resist rolling on each other; where not, the next two are never called."""
    return False


@by_type
def rolling_stiffness(law: Any, un: float, r: float) -> float:
    """Moment per angle by which one grain rolls on the other.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    un : overlap U_n
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    return 0.0


@by_type
def rolling_limit(law: Any, fn: float, r: float) -> float:
    """Largest moment that a contact bears.

    Parameters
    ----------
    law : law of contact, a named tuple that chooses what is done by its type
    fn : normal force, compression positive
    r : relative radius r_a r_b / (r_a + r_b), at a wall that of the grain
    """
    return 0.0
