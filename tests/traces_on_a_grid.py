"""Steady flow around fractures on a fine grid of squares: slow, obvious, and apart from the model.

Lengths in units of the side of a square, permeability over viscosity 1. Nodes of the grid are
joined to their neighbours by five-point differences. A conductive trace adds T along itself to
the energy of the pressure that is linear on the halves of the squares; a barrier of resistance R
per area stands in series with each link that it cuts, by the part of its length that the link's
face covers. First order in the mesh.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve


class Grid(NamedTuple):
    """Pressures at nodes (i / n, j / n), (n + 1, n + 1)."""

    pressure: np.ndarray

    def at(self, points: np.ndarray) -> np.ndarray:
        """Pressure at points (k, 2), between the four nodes around."""
        n = len(self.pressure) - 1
        place = np.clip(points * n, 0, n)
        cell = np.minimum(place.astype(int), n - 1)
        x, y = (place - cell).T
        i, j = cell.T
        p = self.pressure
        low = p[i, j] * (1 - x) + p[i + 1, j] * x
        high = p[i, j + 1] * (1 - x) + p[i + 1, j + 1] * x
        found: np.ndarray = low * (1 - y) + high * y
        return found


def solved(
    n: int,
    traces: np.ndarray,
    transmissivity: float,
    barriers: np.ndarray,
    resistance: float,
    held: tuple[str, str],
    pressures: tuple[float, float],
) -> Grid:
    """Pressures on n × n squares, lines (k, 4) as x0, y0, x1, y1, two sides held.

    Parameters
    ----------
    n : squares along a side
    traces : (k, 4)
    transmissivity : of the traces, over the permeability of the rock
    barriers : (k, 4)
    resistance : of the barriers per area, as a length of the rock
    held : names of two sides that face each other
    pressures : of these
    """
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a = np.concatenate([number[:-1].ravel(), number[:, :-1].ravel()])
    b = np.concatenate([number[1:].ravel(), number[:, 1:].ravel()])
    half = np.ones((n, n + 1))
    half[:, [0, -1]] = 0.5  # links along a side have half a face
    face = np.concatenate([half.ravel(), half.T.ravel()])
    g = face.copy()
    x, y = (number // (n + 1) / n).ravel(), (number % (n + 1) / n).ravel()
    cut = np.zeros(len(a), dtype=bool)
    for x0, y0, x1, y1 in barriers:
        meets = _crosses(x[a], y[a], x[b], y[b], x0, y0, x1, y1)
        cut |= meets
        normal = np.abs([y1 - y0, x1 - x0]) / np.hypot(x1 - x0, y1 - y0)
        covered = np.where(x[a] != x[b], normal[0], normal[1]) * face / n
        g[meets] = 1 / (1 / g[meets] + resistance / covered[meets])
    behind = np.zeros((n + 1) ** 2, dtype=bool)
    behind[np.concatenate([a[cut], b[cut]])] = True

    rows, columns, values = [a, b, a, b], [a, b, b, a], [g, g, -g, -g]
    for line in traces:
        nodes, slope, length = _pieces(n, line)
        open_ = ~behind[nodes].any(axis=1)  # a trace that a barrier cuts ends beside it
        nodes, slope, length = nodes[open_], slope[open_], length[open_]
        for i in range(3):
            for j in range(3):
                rows.append(nodes[:, i])
                columns.append(nodes[:, j])
                values.append(transmissivity * length * slope[:, i] * slope[:, j])
    entries = (np.concatenate(rows), np.concatenate(columns))
    matrix = coo_array((np.concatenate(values), entries), ((n + 1) ** 2,) * 2).tocsr()
    p = np.full((n + 1, n + 1), np.nan)
    at = {"left": np.s_[0, :], "right": np.s_[-1, :], "bottom": np.s_[:, 0], "top": np.s_[:, -1]}
    for side, value in zip(held, pressures, strict=True):
        p[at[side]] = value
    p = p.ravel()
    free = np.flatnonzero(np.isnan(p))
    known = np.flatnonzero(~np.isnan(p))
    p[free] = spsolve(matrix[free][:, free].tocsc(), -matrix[free][:, known] @ p[known])
    return Grid(p.reshape(n + 1, n + 1))


def _crosses(ax, ay, bx, by, x0, y0, x1, y1):
    """Which links from a to b the line from 0 to 1 crosses."""
    dx, dy = x1 - x0, y1 - y0
    left = dx * (ay - y0) - dy * (ax - x0) > 0
    right = dx * (by - y0) - dy * (bx - x0) > 0
    ex, ey = bx - ax, by - ay
    first = ex * (y0 - ay) - ey * (x0 - ax) > 0
    last = ex * (y1 - ay) - ey * (x1 - ax) > 0
    return (left != right) & (first != last)


def _pieces(n: int, line: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pieces of a line in halves of squares: nodes (k, 3), slopes of their parts, lengths (k,)."""
    start, step = line[:2], line[2:] - line[:2]
    length = np.hypot(*step)
    place = [np.array([0.0, 1.0])]
    for across in (np.array([1.0, 0.0]), np.array([0.0, 1.0]), np.array([1.0, -1.0])):
        low, high = np.sort([start @ across * n, (start + step) @ across * n])
        if high > low:
            meets = np.arange(np.ceil(low), np.floor(high) + 1) / n
            place.append((meets - start @ across) / (step @ across))
    t = np.unique(np.clip(np.concatenate(place), 0, 1))
    t = t[np.append(True, np.diff(t) > 1e-12)]
    middle = start + 0.5 * (t[1:] + t[:-1])[:, None] * step
    cell = np.minimum((middle * n).astype(int), n - 1)
    below = (middle * n - cell) @ [1.0, -1.0] > 0  # the half at the corner of the x-axis
    i, j = cell.T
    corner, far = i * (n + 1) + j, (i + 1) * (n + 1) + j + 1
    third = np.where(below, (i + 1) * (n + 1) + j, i * (n + 1) + j + 1)
    ux, uy = step / length * n
    # along x the pressure changes from the corner to the third node below, from there to far above
    slope = np.where(below[:, None], np.array([[-ux, ux - uy, uy]]), np.array([[-uy, uy - ux, ux]]))
    return np.column_stack([corner, third, far]), slope, np.diff(t) * length
