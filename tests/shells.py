"""Stresses around a hole: means over rings, from what the contacts carry."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from demflow.model.analytic.holes import kirsch_stresses
from demflow.model.products import StressState

PARTS = 16  # of a branch, to find how much of it lies in a ring

# mean radial and hoop stress; amplitudes of both as cos 2φ, and of the shear stress as sin 2φ
PARTS_OF_STRESS = ("σ_rr", "σ_θθ", "σ_rr cos", "σ_θθ cos", "σ_rθ sin")


def ring_stresses(state: StressState, edges: np.ndarray, angle: float) -> np.ndarray:
    """Means over rings around the origin, (rings, 5), by Σ f ⊗ l over area; φ from an angle."""
    x, y, a, b = state.x, state.y, state.contact_a, state.contact_b
    branch = np.column_stack([x[b] - x[a], y[b] - y[a]])
    normal = branch / np.hypot(*branch.T)[:, None]
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    force = state.normal_force[:, None] * normal + state.shear_force[:, None] * tangent
    sums = np.zeros((len(edges) - 1, 5))
    for part in (np.arange(PARTS) + 0.5) / PARTS:
        at = np.column_stack([x[a], y[a]]) + part * branch
        theta = np.arctan2(at[:, 1], at[:, 0])
        out = np.column_stack([np.cos(theta), np.sin(theta)])
        round_ = np.column_stack([-out[:, 1], out[:, 0]])
        f_r, f_t = (force * out).sum(axis=1), (force * round_).sum(axis=1)
        l_r, l_t = (branch * out).sum(axis=1), (branch * round_).sum(axis=1)
        rr, tt, rt = f_r * l_r, f_t * l_t, 0.5 * (f_r * l_t + f_t * l_r)
        cos, sin = 2.0 * np.cos(2.0 * (theta - angle)), 2.0 * np.sin(2.0 * (theta - angle))
        values = np.column_stack([rr, tt, rr * cos, tt * cos, rt * sin]) / PARTS
        ring = np.searchsorted(edges, np.hypot(*at.T)) - 1
        within = (ring >= 0) & (ring < len(sums))
        np.add.at(sums, ring[within], values[within])
    return sums / (np.pi * np.diff(edges**2))[:, None]


def kirsch_rings(edges: np.ndarray, **hole: float) -> np.ndarray:
    """The same of Kirsch's stresses; `hole` as `kirsch_stresses` takes it."""
    angle = hole.get("angle", 0.0)
    rows = []
    for inner, outer in pairwise(edges):
        middles = (np.arange(1000) + 0.5) / 1000
        r = np.sqrt(inner**2 + middles * (outer**2 - inner**2))  # equal areas
        along = kirsch_stresses(r, angle, **hole)
        mean = kirsch_stresses(r, angle + np.pi / 4.0, **hole)  # cos 2φ = 0, sin 2φ = 1
        rows.append(
            [
                mean[0].mean(),
                mean[1].mean(),
                (along[0] - mean[0]).mean(),
                (along[1] - mean[1]).mean(),
                mean[2].mean(),
            ]
        )
    return np.array(rows)
