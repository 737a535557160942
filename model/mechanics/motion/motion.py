"""Steps of Newton's second law, damped towards rest: local damping or FIRE.

Velocities live half a step before the positions (leapfrog, second order). Damping changes
how rest is reached, not what rest is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.batches import BLOCK
from demflow.model.mechanics.contact.energy import DAMPING
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.laws import local_damping

START_MIXING = 0.1  # FIRE's α
PATIENCE = 20  # steps downhill before FIRE speeds up


class Fire(NamedTuple):
    """State of the FIRE minimiser (Bitzek et al. 2006, Phys. Rev. Lett. 97, 170201)."""

    dt: float  # present step
    mixing: float  # share of the velocity that is turned towards the force
    downhill: int  # steps since the power was last negative


@kernel
def damped_velocities(grains: Grains, dt: float, alpha: float, ledger: Array | None) -> None:
    """Advance velocities with locally damped forces: v ← v + Δt F_damped / m.

    `dt` is the time step, `alpha` the coefficient of damping; a `ledger` (`energy`) counts what
    it takes where it is given.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    dt : time step
    alpha : coefficient of damping
    ledger : energies (13,), see `energy`, or None
    """
    for i in range(grains.x.size):
        step = dt * grains.inverse_mass[i]
        r = grains.radius[i]
        fx, fy, t = grains.fx[i], grains.fy[i], grains.torque[i]
        vx, vy, s = grains.vx[i], grains.vy[i], grains.spin[i]
        dx, dy, ds = (
            local_damping(fx, vx, alpha),
            local_damping(fy, vy, alpha),
            local_damping(t, s, alpha),
        )
        grains.vx[i] = vx + step * dx
        grains.vy[i] = vy + step * dy
        grains.spin[i] = s + step / (r * r) * ds
        if ledger is not None and step > 0.0:
            taken = (fx - dx) * (vx + grains.vx[i]) + (fy - dy) * (vy + grains.vy[i])
            ledger[DAMPING] += 0.5 * dt * (taken + (t - ds) * (s + grains.spin[i]))


@kernel
def fire_velocities(grains: Grains, fire: Fire, dt: float) -> Fire:
    """Advance velocities, turned towards the accelerations while F·v > 0, else stopped first.

    v ← (1 − α) v + α |v| a / |a| + Δt a, norms weighted with the mass; rotations count as r
    times their angle. `dt` bounds the step. Returns the new state.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    fire : state of FIRE
    dt : largest time step
    """
    n = grains.x.size
    work, speed, pull = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    power = speed2 = force2 = 0.0
    for begin in range(0, n, BLOCK):
        count = min(BLOCK, n - begin)
        for q in range(count):  # apart from the sums, so that several are taken at a time
            k = np.uint64(begin + q)
            r, w = grains.radius[k], grains.inverse_mass[k]
            fx, fy, t = grains.fx[k], grains.fy[k], grains.torque[k] / r
            vx, vy, s = grains.vx[k], grains.vy[k], grains.spin[k] * r
            work[q] = fx * vx + fy * vy + t * s
            speed[q] = (vx * vx + vy * vy + s * s) / w
            pull[q] = (fx * fx + fy * fy + t * t) * w
        for q in range(count):
            power += work[q]
            speed2 += speed[q]
            force2 += pull[q]
    if power > 0.0:
        keep = 1.0 - fire.mixing
        turn = fire.mixing * np.sqrt(speed2 / force2)
        if fire.downhill > PATIENCE:
            new = Fire(min(1.1 * fire.dt, dt), 0.99 * fire.mixing, fire.downhill + 1)
        else:
            new = Fire(fire.dt, fire.mixing, fire.downhill + 1)
    else:
        keep = turn = 0.0
        new = Fire(max(0.5 * fire.dt, 0.05 * dt), START_MIXING, 0)
    turn += new.dt
    for i in range(grains.x.size):
        w, r = grains.inverse_mass[i], grains.radius[i]
        grains.vx[i] = keep * grains.vx[i] + turn * w * grains.fx[i]
        grains.vy[i] = keep * grains.vy[i] + turn * w * grains.fy[i]
        grains.spin[i] = keep * grains.spin[i] + turn * w / (r * r) * grains.torque[i]
    return new


@kernel
def move(grains: Grains, dt: float, stretch_x: float, stretch_y: float) -> float:
    """Move grains by Δt v and an affine stretch about the origin; returns the largest speed².

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    dt : time step
    stretch_x : affine strain of the step along x, extension positive
    stretch_y : the same along y
    """
    fastest = 0.0
    for i in range(grains.x.size):
        vx, vy = grains.vx[i], grains.vy[i]
        grains.x[i] += dt * vx + stretch_x * grains.x[i]
        grains.y[i] += dt * vy + stretch_y * grains.y[i]
        fastest = max(fastest, vx * vx + vy * vy)
    return fastest
