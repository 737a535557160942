"""An error in time from one at complex frequencies, along a contour around the negative axis.

An error of a response to a step is e(t) = (1/2πi) ∫ e^{st} E(s) / s ds along any contour that has
the decay rates, and zero, to its left: an arc of some radius ρ about zero from its point at −φ to
that at φ, and from there rays outwards, φ beyond a right angle. Where |E| is known, so is a bound
of |e|; the best of some radii counts, at each time by itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Angle of the rays: beyond a right angle, else nothing decays along them; not far beyond, since
# what interpolates at real frequencies is better the nearer a frequency is to these.
ANGLE = np.radians(100.0)
STEP = 3.0  # from one radius to the next

# Radii beside the inverse of the least and of the largest time that the contour reaches to.
INNER, OUTER = 0.1, 80.0
RADII = 5  # arcs of that many radii are tried

# Simpson's rule of three eighths on half of the arc.
ARC = np.array([1.0, 3.0, 3.0, 1.0]) / 8.0


class Contour(NamedTuple):
    """Frequencies at which an error has to be known, and what it then is in time."""

    radius: np.ndarray  # (r,) 1/s
    frequency: np.ndarray  # (r, a) complex, 1/s, on the upper half
    leaning: np.ndarray  # (r, a) cosine of half of its angle
    weight: np.ndarray  # (radii, l, r, a) of |E| in the bound at each lag

    def in_time(self, error: np.ndarray) -> np.ndarray:
        """Bound of |e| at each lag, (…, l), from that of |E| (…, r, a)."""
        return np.asarray(self._trials(error).min(axis=-2))

    def shares(self, error: np.ndarray) -> np.ndarray:
        """What each radius has in that bound, (…, l, r)."""
        best = self._trials(error).argmin(axis=-2)
        weight = self.weight[best, np.arange(best.shape[-1])]
        return np.asarray((weight * error[..., None, :, :]).sum(axis=-1))

    def _trials(self, error: np.ndarray) -> np.ndarray:
        """The bound by each of the arcs, (…, radii, l)."""
        trials, lags = self.weight.shape[:2]
        flat = error.reshape(*error.shape[:-2], -1) @ self.weight.reshape(trials * lags, -1).T
        return np.asarray(flat.reshape(*error.shape[:-2], trials, lags))


def radii(lag: np.ndarray) -> np.ndarray:
    """Radii of a contour for lags (l,) > 0 s, 1/s."""
    low, high = INNER / lag.max(), OUTER / lag.min()
    return np.asarray(low * STEP ** np.arange(np.ceil(np.log(high / low) / np.log(STEP)) + 1))


def contour(lag: np.ndarray) -> Contour:
    """The contour for lags (l,) > 0 s."""
    radius = radii(lag)
    angle = ANGLE * np.linspace(0.0, 1.0, len(ARC))
    weight = np.zeros((RADII, len(lag), len(radius), len(ARC)))
    nearest = np.abs(np.log(radius * lag[:, None])).argmin(axis=1)
    for k, time in enumerate(lag):
        for trial in range(RADII):
            arc = min(max(0, nearest[k] - RADII + 2 + trial), len(radius) - 1)
            along = np.exp(radius[arc] * time * np.cos(angle)) * ARC * ANGLE
            weight[trial, k, arc] += along / np.pi
            outwards = np.full(len(radius) - arc, np.log(STEP))
            outwards[0] *= 0.5
            decay = np.exp(radius[arc:] * time * np.cos(ANGLE))
            weight[trial, k, arc:, -1] += outwards * decay / np.pi
    frequency = radius[:, None] * np.exp(1j * angle)
    leaning = np.tile(np.cos(0.5 * angle), (len(radius), 1))
    return Contour(radius, frequency, leaning, weight)
