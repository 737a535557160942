"""Branches of traces in the flow equation: where they meet wells."""

from __future__ import annotations

import numpy as np

from demflow.model.flow.equation.sites import WellSite
from demflow.model.products import Apertures

# The stretch of a branch between a node and a wellbore's wall keeps this part of the branch.
WALL_FLOOR = 1e-3

# A trace that ends this part of a well's radius before its wall meets it.
TOUCHES = 1e-9


def wells_of_nodes(apertures: Apertures, wells: tuple[WellSite, ...]) -> np.ndarray:
    """The well within whose wall each node of the traces lies, (m,), −1 outside of all."""
    well_of = np.full(len(apertures.node_x), -1)
    for k, well in enumerate(wells):
        distance = np.hypot(apertures.node_x - well.at[0], apertures.node_y - well.at[1])
        well_of[distance <= well.radius * (1.0 + TOUCHES)] = k
    return well_of


def branches(
    apertures: Apertures, wells: tuple[WellSite, ...], first_node: int, first_well: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Connections (k,) along traces between places and wells, conductances in m³/(s Pa).

    A branch that passes a wellbore ends at its wall from either side.

    Parameters
    ----------
    apertures : how far they are open, and traces with nodes of their own
    wells : the wells
    first_node : terminal of the first node of the traces
    first_well : terminal of the first well
    """
    a, b = first_node + apertures.branch_a, first_node + apertures.branch_b
    g = apertures.branch_conductance
    x = np.column_stack(
        [apertures.node_x[apertures.branch_a], apertures.node_x[apertures.branch_b]]
    )
    y = np.column_stack(
        [apertures.node_y[apertures.branch_a], apertures.node_y[apertures.branch_b]]
    )
    for k, well in enumerate(wells):
        low, high = _within(x, y, well)
        meets = np.flatnonzero(low < high)
        if len(meets) == 0:
            continue
        parts = []
        for part, ends, keep in (
            (low[meets], (a[meets], np.full(len(meets), first_well + k)), 0),
            (1.0 - high[meets], (np.full(len(meets), first_well + k), b[meets]), 1),
        ):
            outside = part > 0.0
            share = np.maximum(part[outside], WALL_FLOOR)
            at = (low if keep == 0 else high)[meets][outside]
            ours = meets[outside]
            wall = [c[ours, 0] + at * (c[ours, 1] - c[ours, 0]) for c in (x, y)]
            far = [c[ours, keep] for c in (x, y)]
            pairs = [
                np.column_stack([f, w] if keep == 0 else [w, f])
                for f, w in zip(far, wall, strict=True)
            ]
            parts.append((ends[0][outside], ends[1][outside], g[ours] / share, *pairs))
        rest = np.flatnonzero(~(low < high))
        whole = [(a[rest], b[rest], g[rest], x[rest], y[rest]), *parts]
        a, b, g, x, y = (np.concatenate(column) for column in zip(*whole, strict=True))
    return a, b, g


def _within(x: np.ndarray, y: np.ndarray, well: WellSite) -> tuple[np.ndarray, np.ndarray]:
    """Fractions of branches between which they run inside a well, low ≥ high where they do not."""
    px, py = x[:, 0] - well.at[0], y[:, 0] - well.at[1]
    dx, dy = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]
    square, half = dx * dx + dy * dy, px * dx + py * dy
    beyond = half * half - square * (px * px + py * py - well.radius**2)
    meets = (beyond > 0.0) & (square > 0.0)
    root = np.sqrt(np.where(meets, beyond, 0.0))
    square = np.where(meets, square, 1.0)
    low = np.where(meets, np.clip((-half - root) / square, 0.0, 1.0), 0.0)
    high = np.where(meets, np.clip((-half + root) / square, 0.0, 1.0), 0.0)
    return low, high
