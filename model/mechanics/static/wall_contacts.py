"""Grains that may meet a wall or leave it: the few contacts that a factored stiffness lacks.

A packing always has grains a hair away from a wall, or pressed on it by next to nothing. As the
stresses change they touch, or let go, and the stiffness changes by k_n in one direction each.
Its inverse follows from the factored one and its responses Y = K⁻¹ B to a unit press of each
(Woodbury 1950), so that one solve stays one solve.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.static.walls import INWARD, Walls
from demflow.model.products import UnitLoads

NEAR_GAP, LIGHT_PRESS = 0.01, 4e-5  # gap and overlap, mean radii, that stresses may undo
LAST_HOLD = 0.99  # give of a wall contact times k_n, at which it is all that holds its grain
MOST_CHANGES = 30


class Loose(NamedTuple):
    """Wall contacts that stresses may open or close, q of them."""

    which: Array  # (q,) of all grains near walls
    touching: Array  # (q,) bool, in the packed state
    response: Array  # (q, 3 n + 2) float32: displacement by a unit press of the wall


def loose_contacts(
    specimen: Specimen, near: Walls, touching: Walls, displaced: Callable[[Array], Array]
) -> Loose:
    """Find them among the grains near each wall, and how they answer a press of it.

    Left out are those without whose wall nothing would hold the grain.

    Parameters
    ----------
    specimen : grains with bonds, joints and walls, in units of mean radius and k_n
    near : grains near each wall
    touching : grains that touch it
    displaced : displacement (3 n + 2,) by forces (3 n + 2,)
    """
    grains, box, n = specimen.grains, specimen.box, len(specimen.grains.x)
    grain = np.concatenate(near)
    side = np.repeat(np.arange(4), [len(held) for held in near])
    touch = np.concatenate([np.isin(n, w) for n, w in zip(near, touching, strict=True)])
    place = np.where(side < 2, grains.x[grain], grains.y[grain])
    overlap = np.array(INWARD)[side] * (box[side] - place) + grains.radius[grain]
    which, response = [], []
    for k in np.flatnonzero(np.where(touch, overlap < LIGHT_PRESS, overlap > -NEAR_GAP)):
        press = press_load(int(grain[k]), int(side[k]), n)
        answer = displaced(press)
        if not touch[k] or press @ answer < LAST_HOLD:
            which.append(k)
            response.append(answer)
    kept = np.array(which, dtype=np.int64)
    answers = np.array(response, dtype=np.float32).reshape(len(kept), 3 * n + 2)
    return Loose(kept, touch[kept], answers)


def press_load(grain: int, side: int, n: int) -> Array:
    """Forces (3 n + 2,) on grains and walls where a wall presses a grain by one.

    Parameters
    ----------
    grain : which
    side : wall, 0 to 3
    n : number of grains
    """
    load = np.zeros(3 * n + 2)
    load[3 * grain + side // 2] = INWARD[side]
    if side % 2 == 1:
        load[3 * n + side // 2] = 1.0
    return load


class WallContacts:
    """Wall contacts of a rock that open or close, q of them; stiffness k_n = 1."""

    def __init__(self, units: UnitLoads, x: Array, y: Array, radius: Array, box: Array):
        n, which = len(x), units.loose
        side = np.searchsorted(units.wall_start, which, side="right") - 1
        grain = units.wall_grain[which]
        self.sense = np.array(INWARD)[side]
        self.normal = 3 * grain + side // 2
        self.wall = np.where(side % 2 == 1, 3 * n + side // 2, -1)
        self.across = self.wall >= 0
        vertical = side < 2
        self.along = np.where(vertical, y[grain], x[grain])
        place = np.where(vertical, x[grain], y[grain])
        self.overlap = self.sense * (box[side] - place) + radius[grain]
        self.touching = units.loose_touching
        self.sign = np.where(self.touching, -1.0, 1.0)  # of the press that the factor lacks
        self.response = units.loose_response
        self.compliance = np.array([self.gained(row) for row in self.response]).reshape(
            len(which), len(which)
        )
        self.settled = True  # whether the last sum of unit loads did
        self.lacked = np.maximum(self.sign * (self.overlap - self.gained(units.base)), 0.0)

    def gained(self, u: Array) -> Array:
        """Bᵀ u: what each gap gains by a displacement, (q,)."""
        gain: Array = self.sense * u[self.normal]
        gain[self.across] += u[self.wall[self.across]]
        return gain

    def settle(self, u: Array, tilt: float) -> None:
        """Add to a sum of unit loads what contacts change that close or open, until none does.

        Where they go on in turns, MOST_CHANGES of them, it is not `settled`: a first guess.
        The press that the factor lacks is e = max(±o, 0), + where the grain did not touch, and
        o = o_u − S (e − e₀) its overlap, e₀ that of the packed state.
        """
        sign = self.sign
        overlap = self.overlap + 0.5 * self.sense * tilt * self.along - self.gained(u)
        overlap += self.compliance @ self.lacked
        lacks = np.zeros(len(sign))
        active = np.zeros(len(sign), bool)
        self.settled = False
        for _ in range(MOST_CHANGES):
            now = sign * (overlap - self.compliance @ lacks) > 0.0
            self.settled = np.array_equal(now, active)
            if self.settled:
                break
            active = now
            lacks = np.zeros(len(sign))
            inner = self.compliance[np.ix_(active, active)]
            lacks[active] = np.linalg.solve(
                np.eye(len(inner)) + sign[active, None] * inner, (sign * overlap)[active]
            )
        u += (lacks - self.lacked) @ self.response

    def corrected(self, step: Array, u: Array, tilt: float) -> Array:
        """A step of the factored stiffness, for the contacts as they are at u.

        Parameters
        ----------
        step : displacement by the factored stiffness, (3 n + 2,)
        u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
        tilt : shear of the box
        """
        overlap = self.overlap + 0.5 * self.sense * tilt * self.along - self.gained(u)
        differs = (overlap > 0.0) != self.touching
        sign = self.sign[differs]
        inner = self.compliance[np.ix_(differs, differs)]
        lacks = np.linalg.solve(
            np.eye(len(inner)) + sign[:, None] * inner, sign * self.gained(step)[differs]
        )
        found: Array = step - lacks @ self.response[differs]
        return found
