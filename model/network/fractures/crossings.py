"""Which pipes lines cross, and where: kernels on the segments between the pores' centroids."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import Array, kernel
from demflow.model.network.cells import Cells, cell_of, into_cells
from demflow.model.products import Network


class Crossings(NamedTuple):
    """Places where lines cross pipes, sorted by line and then along it."""

    line: np.ndarray  # (c,)
    pipe: np.ndarray  # (c,)
    fraction: np.ndarray  # (c,) of the segment from the centroid of pipe_from to that of pipe_to
    along: np.ndarray  # (c,) m from the start of the line


def crossings(network: Network, start: np.ndarray, end: np.ndarray) -> Crossings:
    """Pipes with an end inside the region that lines (l, 2), (l, 2) cross.

    Each centroid has one side of each line, zero counting as minus, so that no line slips
    between two pipes that meet in a pore.

    Parameters
    ----------
    network : pores and pipes of the matrix
    start, end : of the lines, (l, 2) m
    """
    near = network.inside[network.pipe_from] | network.inside[network.pipe_to]
    pipes = np.flatnonzero(near)
    if len(start) == 0 or len(pipes) == 0:
        none = np.empty(0, dtype=np.int64)
        return Crossings(none, none, np.empty(0), np.empty(0))
    i, j = network.pipe_from[pipes], network.pipe_to[pipes]
    ends = (network.x[i], network.y[i], network.x[j], network.y[j])
    size = 2.0 * float(np.hypot(ends[2] - ends[0], ends[3] - ends[1]).mean())
    lines = (start[:, 0].copy(), start[:, 1].copy(), end[:, 0].copy(), end[:, 1].copy())
    line, pipe, fraction, along = _crossed(*lines, *ends, into_cells(*ends, size))
    order = np.lexsort((pipe, along, line))
    return Crossings(line[order], pipes[pipe[order]], fraction[order], along[order])


@kernel
def _crossed(
    ax: Array,
    ay: Array,
    bx: Array,
    by: Array,
    px: Array,
    py: Array,
    qx: Array,
    qy: Array,
    cells: Cells,
) -> tuple[Array, Array, Array, Array]:
    """Line, segment, fraction of the segment and distance along the line of each crossing."""
    first, member, size = cells.first, cells.member, cells.size
    west, south, columns, rows = cells.west, cells.south, cells.columns, cells.rows
    seen = np.full(px.size, -1, np.int64)
    count = 0
    line, pipe = np.empty(0, np.int64), np.empty(0, np.int64)
    fraction, along = np.empty(0), np.empty(0)
    for filling in (False, True):
        if filling:
            line, pipe = np.empty(count, np.int64), np.empty(count, np.int64)
            fraction, along = np.empty(count), np.empty(count)
            count = 0
        seen[:] = -1
        for k in range(ax.size):
            dx, dy = bx[k] - ax[k], by[k] - ay[k]
            length = np.hypot(dx, dy)
            r0 = cell_of(min(ay[k], by[k]), south, size, rows)
            r1 = cell_of(max(ay[k], by[k]), south, size, rows)
            for row in range(r0, r1 + 1):
                # the stretch of the line in this row of cells, and a little more
                x0, x1 = min(ax[k], bx[k]), max(ax[k], bx[k])
                if r1 > r0:
                    low = (south + (row - 0.001) * size - ay[k]) / dy
                    high = (south + (row + 1.001) * size - ay[k]) / dy
                    low, high = min(low, high), max(low, high)
                    low = max(low, 0.0) if row not in (0, rows - 1) else 0.0
                    high = min(high, 1.0) if row not in (0, rows - 1) else 1.0
                    x0 = min(ax[k] + low * dx, ax[k] + high * dx)
                    x1 = max(ax[k] + low * dx, ax[k] + high * dx)
                c0 = cell_of(x0 - 0.001 * size, west, size, columns)
                c1 = cell_of(x1 + 0.001 * size, west, size, columns)
                for column in range(c0, c1 + 1):
                    cell = row * columns + column
                    for s in range(first[cell], first[cell + 1]):
                        e = member[s]
                        if seen[e] == k:
                            continue
                        seen[e] = k
                        # side of the line on which either centroid lies
                        p = dx * (py[e] - ay[k]) - dy * (px[e] - ax[k])
                        q = dx * (qy[e] - ay[k]) - dy * (qx[e] - ax[k])
                        if (p > 0.0) == (q > 0.0):
                            continue
                        # side of the segment on which either end of the line lies
                        ex, ey = qx[e] - px[e], qy[e] - py[e]
                        a = ex * (ay[k] - py[e]) - ey * (ax[k] - px[e])
                        b = ex * (by[k] - py[e]) - ey * (bx[k] - px[e])
                        if (a > 0.0) == (b > 0.0):
                            continue
                        if filling:
                            line[count], pipe[count] = k, e
                            fraction[count] = p / (p - q)
                            along[count] = length * a / (a - b)
                        count += 1
    return line, pipe, fraction, along
