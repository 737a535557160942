"""The state of the grains that the kernels work on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.compile import kernel

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
    """Grains without motion, forces and loads, from arrays (n,), which are copied."""
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
    """
    least = radius.min()
    room = np.pi / np.arcsin(least / (radius + least))
    return (2.0 * step) ** 2 * stiffness * np.maximum(1.0, room / 6.0)


@kernel
def hilbert_keys(x: Array, y: Array, low_x: float, low_y: float, size: float, bits: int) -> Array:
    """Place of each point along a Hilbert curve of 4^bits cells over a square: int64 (n,)."""
    keys = np.empty(x.size, np.int64)
    n = 1 << bits
    for k in range(x.size):
        i = min(n - 1, max(0, int((x[k] - low_x) / size * n)))
        j = min(n - 1, max(0, int((y[k] - low_y) / size * n)))
        key = 0
        s = n >> 1
        while s > 0:
            right = 1 if i & s else 0
            up = 1 if j & s else 0
            key += s * s * ((3 * right) ^ up)
            if up == 0:
                if right == 1:
                    i = n - 1 - i
                    j = n - 1 - j
                i, j = j, i
            s >>= 1
        keys[k] = key
    return keys


def along_hilbert_curve(x: Array, y: Array) -> Array:
    """Order in which neighbours in space are neighbours in memory: a permutation (n,)."""
    size = max(np.ptp(x), np.ptp(y), np.finfo(float).tiny)
    return np.argsort(hilbert_keys(x, y, x.min(), y.min(), size, 16), kind="stable")
