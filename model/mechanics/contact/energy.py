"""The energy ledger of a run: what was put in, what is stored, and every sink.

Velocities live half a step before the positions, so that the kinetic energy at a position is
½ m v₋ · v₊. Then it changes from position to position by exactly (F₀ + F₁) · Δx / 2, the work by
the trapezoidal rule, and so do the others here. Where a force begins or ends within a step that
rule makes or loses energy, which is counted too; what the sum leaves over is the error of
contacts whose normals turn, of second order. Damping is local.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.grains import Array, Grains

# Places in the ledger: stored, put in since the start, lost since the start.
ELASTIC, KINETIC, WALLS, STRETCH, LOADS, SLIP, BREAKAGE, DAMPING, JERKS = range(9)
MOVED = 9  # first of four: way of each wall in the step that its forces are still to see


class Energies(NamedTuple):
    """Balance of a run; input − stored − lost is the error."""

    elastic: float  # growth since the ledger was opened
    kinetic: float  # growth
    walls: float  # work of the walls on the grains
    stretch: float  # work of the servo's affine stretch
    loads: float  # work of the loads on grains
    slip: float  # lost to friction
    breakage: float  # lost with bonds that broke
    damping: float  # lost to damping
    jerks: float  # lost, or made where negative, by steps in which a contact opens or closes

    @property
    def input(self) -> float:
        """Work put in."""
        return self.walls + self.stretch + self.loads

    @property
    def error(self) -> float:
        """What the balance does not account for."""
        stored = self.elastic + self.kinetic
        lost = self.slip + self.breakage + self.damping + self.jerks
        return self.input - stored - lost


def new_ledger() -> Array:
    """An empty ledger, float64 (13,)."""
    return np.zeros(MOVED + 4)


def energies(ledger: Array, opening: Array) -> Energies:
    """The balance since the ledger stood at `opening`."""
    return Energies(*(ledger - opening)[:MOVED].tolist())


@kernel
def kinetic_energy(grains: Grains, dt: float) -> float:
    """½ m v₋ · v₊ over the grains; `dt` is the step of the velocities, damping left out."""
    total = 0.0
    for i in range(grains.x.size):
        w, r2 = grains.inverse_mass[i], grains.radius[i] * grains.radius[i]
        if w == 0.0:
            continue
        vx, vy, spin = grains.vx[i], grains.vy[i], grains.spin[i]
        total += 0.5 * (vx * vx + vy * vy + r2 * spin * spin) / w
        total += 0.5 * dt * (vx * grains.fx[i] + vy * grains.fy[i] + spin * grains.torque[i])
    return total


@kernel
def half_work(
    ledger: Array,
    grains: Grains,
    forces: tuple[float, float, float, float],
    dt: float,
    stretch_x: float,
    stretch_y: float,
    arrived: bool,
) -> None:
    """Work of the outer world in half a step, with the forces at its one end or the other.

    `forces` on the walls left, right, bottom, top outwards; `arrived` tells whether grains
    stand where the step ends, or where it begins with the velocities that it will have.

    Parameters
    ----------
    ledger : energies (13,), see `energy`, or None
    grains : the grains (n,), in units of mean radius and k_n
    forces : on the walls left, right, bottom, top outwards
    dt : time step
    stretch_x : affine strain of the step along x, extension positive
    stretch_y : the same along y
    arrived : whether grains stand where the step ends
    """
    for side in range(4):
        inwards = 1.0 if side % 2 == 0 else -1.0
        ledger[WALLS] += 0.5 * forces[side] * inwards * ledger[MOVED + side]
        if arrived:
            ledger[MOVED + side] = 0.0
    affine = loads = 0.0
    for i in range(grains.x.size):
        ux, uy = dt * grains.vx[i], dt * grains.vy[i]
        x, y = grains.x[i], grains.y[i]
        if arrived:
            x, y = (x - ux) / (1.0 + stretch_x), (y - uy) / (1.0 + stretch_y)
        fx, fy = grains.fx[i] - grains.load_x[i], grains.fy[i] - grains.load_y[i]
        affine -= fx * stretch_x * x + fy * stretch_y * y
        turn = dt * grains.spin[i]
        if grains.inverse_mass[i] > 0.0:
            loads += grains.load_x[i] * ux + grains.load_y[i] * uy + grains.load_torque[i] * turn
        else:  # who leads a grain on its way does the work on its contacts
            loads -= fx * ux + fy * uy + (grains.torque[i] - grains.load_torque[i]) * turn
    ledger[STRETCH] += 0.5 * affine
    ledger[LOADS] += 0.5 * loads
