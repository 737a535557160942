"""Inverse Laplace transforms, for solutions that are simple only in Laplace space."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

Transform = Callable[[np.ndarray], np.ndarray]

NODES = 24  # 3.89⁻²⁴ = 7e-15: what double precision can hold
KEPT = 8  # arrays of points whose values are kept


def kept(function: Transform) -> Transform:
    """Keep what a function of complex points answered last, (...) to (...), not to be written to.

    Most trials of a fit ask for the same points: only the permeability and a negative skin change
    those at which a transform is inverted.

    Parameters
    ----------
    function : of each point by itself
    """

    @lru_cache(maxsize=KEPT)
    def answer(points: bytes) -> np.ndarray:
        found = function(np.frombuffer(points, dtype=complex))
        found.flags.writeable = False
        return found

    def look(points: np.ndarray) -> np.ndarray:
        return answer(points.astype(complex, copy=False).tobytes()).reshape(points.shape)

    return look


def _contour(nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Points z and weights of the contour for t = 1, upper half, shape (nodes / 2,).

    z(θ) = N (0.5017 θ cot(0.6407 θ) − 0.6122 + 0.2645 i θ) at the midpoints of [−π, π]:
    Trefethen, Weideman & Schmelzer (2006), BIT 46, 653–670, Eq. 3.1.
    """
    theta = np.pi * np.arange(1, nodes, 2) / nodes
    a, b = 0.5017, 0.6407
    sine = np.sin(b * theta)
    z = nodes * (a * theta * np.cos(b * theta) / sine - 0.6122 + 0.2645j * theta)
    slope = nodes * (a * np.cos(b * theta) / sine - a * b * theta / sine**2 + 0.2645j)
    # the lower half is the complex conjugate: twice the real part of the upper one
    return z, 2.0 / (1j * nodes) * np.exp(z) * slope


def invert(transform: Transform, time: ArrayLike, nodes: int = NODES) -> np.ndarray:
    """Value at each time of a function given by its Laplace transform.

    f(t) = 1/(2πi) ∫ e^{st} F(s) ds on Talbot's contour, by the midpoint rule. For
    transforms whose singularities lie on the negative real axis or at zero, as those of
    diffusion do; the absolute error is then some 1e-12 of |f|.

    Parameters
    ----------
    transform : F(s) for complex s of shape (..., k), where (...) is the shape of `time`.
    time : times above zero, any shape.
    nodes : of the contour; the relative error is some 3.9^−nodes.

    Raises
    ------
    ValueError : a time is not above zero.
    """
    time = np.asarray(time, dtype=float)
    if not np.all(time > 0):
        raise ValueError("a Laplace transform can be inverted only at times above zero")
    z, weight = _contour(nodes)
    values = transform(z / time[..., None])
    found: np.ndarray = np.real(np.sum(weight * values, axis=-1)) / time
    return found
