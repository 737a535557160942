"""Laws of contact between grains: `statements` says what a law is, each other file is one law."""

from __future__ import annotations

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.law.hertz import Hertz
from demflow.model.mechanics.contact.law.linear import Linear
from demflow.model.mechanics.contact.law.rolling import Rolling
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

__all__ = [
    "Hertz",
    "Law",
    "Linear",
    "Rolling",
    "energy",
    "press",
    "presses",
    "relative_radius",
    "rolling_limit",
    "rolling_stiffness",
    "rolls",
    "shear_stiffness",
    "stiffest",
    "stiffness",
    "stiffnesses",
]

Law = Linear | Hertz | Rolling


def relative_radius(radius_a: np.ndarray, radius_b: np.ndarray) -> np.ndarray:
    """Relative radius r_a r_b / (r_a + r_b) of contacts, of the shape of the radii."""
    found: np.ndarray = radius_a * radius_b / (radius_a + radius_b)
    return found


@kernel
def presses(law: Law, overlap: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Normal forces (c,) of contacts by their overlap and relative radius (c,).

    Parameters
    ----------
    law : law of contact
    overlap : U_n (c,)
    radius : relative radius (c,)
    """
    forces = np.empty(overlap.size)
    for k in range(overlap.size):
        forces[k] = press(law, overlap[k], radius[k])
    return forces


@kernel
def stiffnesses(law: Law, overlap: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal and shear stiffness (c,) of contacts by their overlap and relative radius (c,).

    Parameters
    ----------
    law : law of contact
    overlap : U_n (c,)
    radius : relative radius (c,)
    """
    normal, shear = np.empty(overlap.size), np.empty(overlap.size)
    for k in range(overlap.size):
        normal[k] = stiffness(law, overlap[k], radius[k])
        shear[k] = shear_stiffness(law, overlap[k], radius[k])
    return normal, shear
