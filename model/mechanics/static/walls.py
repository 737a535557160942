"""The four walls as the static solver has them: what unit loads they put on the grains.

The walls stay straight. Under a shear stress they tilt by the shear strain, and each grain at a
wall carries its part of the shear traction, in proportion to its force on the wall.
"""

from __future__ import annotations

import numpy as np

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.static.stiffness import TOUCHING

Walls = tuple[Array, ...]  # grains at left, right, bottom, top
INWARD = (1.0, -1.0, 1.0, -1.0)  # sense of the force of each wall


def wall_shares(specimen: Specimen, walls: Walls, carries: Array) -> tuple[Array, ...]:
    """Part of each wall's shear traction that each of its grains carries.

    In proportion to its force on the wall; none where the grain `carries` no load.

    Parameters
    ----------
    specimen : grains with bonds, joints and walls, in units of mean radius and k_n
    walls : grains at each wall
    carries : (n,) bool, which grains carry load
    """
    grains, box = specimen.grains, specimen.box
    shares = []
    for side, held in enumerate(walls):
        centre = (grains.x if side < 2 else grains.y)[held]
        press = np.maximum(grains.radius[held] - np.abs(centre - box[side]), 0.0)
        if not np.any(press > TOUCHING):  # a lattice at rest
            press[:] = 1.0
        press[~carries[held]] = 0.0
        shares.append(press / max(press.sum(), 1e-300))
    return tuple(shares)


def shear_load(specimen: Specimen, walls: Walls, share: tuple[Array, ...]) -> Array:
    """Forces and torques (3 n + 2,) by a unit shear traction σ_xy on the walls.

    Parameters
    ----------
    specimen : grains with bonds, joints and walls, in units of mean radius and k_n
    walls : grains at each wall
    share : of each of them in its wall’s traction
    """
    grains, box = specimen.grains, specimen.box
    load = np.zeros(3 * len(grains.x) + 2)
    sides = (box[3] - box[2], box[3] - box[2], box[1] - box[0], box[1] - box[0])
    for side, held in enumerate(walls):
        force = INWARD[side] * sides[side] * share[side]
        np.add.at(load, 3 * held + (1 - side // 2), force)
        # the arm points to the wall: −r e_x at the left, −r e_y at the bottom
        arm = -INWARD[side] * grains.radius[held] * (1.0 if side < 2 else -1.0)
        np.add.at(load, 3 * held + 2, arm * force)
    return load


def tilt_load(specimen: Specimen, walls: Walls) -> Array:
    """Forces (3 n + 2,) on grains and walls by a unit shear strain of the walls."""
    n = len(specimen.grains.x)
    load = np.zeros(3 * n + 2)
    for side, held in enumerate(walls):
        along = specimen.grains.y if side < 2 else specimen.grains.x
        force = 0.5 * specimen.law.kn * along[held]
        np.add.at(load, 3 * held + side // 2, force)
        if side % 2 == 1:
            load[3 * n + side // 2] -= force.sum()
    return load
