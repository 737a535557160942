"""The state of the grains that the kernels work on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

Array = np.ndarray


class Grains(NamedTuple):
    """Position, motion and forces of n grains; float64 arrays (n,) in any consistent units."""

    x: Array  # centre
    y: Array
    vx: Array  # velocity, without the affine strain rate of the servo
    vy: Array
    spin: Array  # angular velocity, counter-clockwise
    radius: Array
    inverse_mass: Array  # the moment of inertia is m r²
    fx: Array  # force and torque by contacts, walls and loads
    fy: Array
    torque: Array
    load_x: Array  # loads from outside, zero unless someone sets them
    load_y: Array
    load_torque: Array


def at_rest(x: Array, y: Array, radius: Array, mass: Array) -> Grains:
    """Grains without motion, forces and loads, from arrays (n,), which are copied.

    Parameters
    ----------
    x, y : centres, (n,)
    radius : radii, (n,)
    mass : (n,)
    """
    zeros = np.zeros((9, len(x)))
    return Grains(
        np.array(x, dtype=float),
        np.array(y, dtype=float),
        zeros[0],
        zeros[1],
        zeros[2],
        np.array(radius, dtype=float),
        1.0 / mass,
        *zeros[3:],
    )


def scaled_mass(radius: Array, stiffness: Array | float, step: float) -> Array:
    """Mass (n,) at which the time step is stable for a grain surrounded by contacts.

    `stiffness` is that of the stiffest contact, of all grains or of each (n,). Density scaling:
    statics do not feel the mass. A grain of radius r has room for z = π / asin(r_min / (r +
    r_min)) of the smallest grains; Δt = 0.5 √(m/k) holds for six contacts, hence
    m = (2 Δt)² k max(1, z/6).

    Parameters
    ----------
    radius : radii, (n,)
    stiffness : of the stiffest contact, one or (n,)
    step : time step that is to be stable
    """
    least = radius.min()
    room = np.pi / np.arcsin(least / (radius + least))
    found: Array = (2.0 * step) ** 2 * stiffness * np.maximum(1.0, room / 6.0)
    return found


def along_strips(x: Array, y: Array, height: float) -> Array:
    """Order (n,) that goes strip by strip of some `height`, from left to right in each.

    Neighbours in space are then near each other in memory, and none is further away than the
    grains of a strip. A Hilbert curve keeps more of them close but some very far, which is
    slower where the arrays exceed the cache.

    Parameters
    ----------
    x, y : centres, (n,)
    height : of a strip
    """
    return np.lexsort((x, np.floor((y - y.min()) / height)))
