"""Segments and points sorted into square cells, so that what is near is found at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import Array, kernel


class Cells(NamedTuple):
    """What lies in each cell of a grid, row by row from the south-west."""

    first: Array  # (cells + 1,) where the members of each cell begin
    member: Array
    west: float  # m
    south: float  # m
    size: float  # m: side of a cell
    columns: int
    rows: int


def into_cells(px: Array, py: Array, qx: Array, qy: Array, size: float) -> Cells:
    """Sort segments p–q into the cells that their boxes meet.

    Parameters
    ----------
    px, py, qx, qy : their ends, (k,) m, k > 0
    size : side of a cell, m
    """
    west, south = float(min(px.min(), qx.min())), float(min(py.min(), qy.min()))
    columns = int((max(px.max(), qx.max()) - west) / size) + 1
    rows = int((max(py.max(), qy.max()) - south) / size) + 1
    count = np.zeros(columns * rows + 1, np.int64)
    cells = Cells(count, np.empty(0, np.int64), west, south, size, columns, rows)
    _enter(cells, px, py, qx, qy, False)
    ends = np.cumsum(count)
    cells = cells._replace(first=ends, member=np.empty(ends[-1], np.int64))
    _enter(cells, px, py, qx, qy, True)
    return cells


@kernel
def cell_of(value: float, low: float, size: float, count: int) -> int:
    """Cell of a row of `count` in which a coordinate lies; what lies outside is in the last.

    Parameters
    ----------
    value : coordinate, m
    low : where the first cell begins, m
    size : side of a cell, m
    count : cells in the row
    """
    return min(max(int((value - low) / size), 0), count - 1)


@kernel
def _enter(cells: Cells, px: Array, py: Array, qx: Array, qy: Array, filling: bool) -> None:
    """Count what lies in each cell, or fill it from its end downwards."""
    west, south, size, columns = cells.west, cells.south, cells.size, cells.columns
    first, member = cells.first, cells.member
    for e in range(px.size):
        c0 = cell_of(min(px[e], qx[e]), west, size, columns)
        c1 = cell_of(max(px[e], qx[e]), west, size, columns)
        r0 = cell_of(min(py[e], qy[e]), south, size, cells.rows)
        r1 = cell_of(max(py[e], qy[e]), south, size, cells.rows)
        for row in range(r0, r1 + 1):
            for cell in range(row * columns + c0, row * columns + c1 + 1):
                if filling:
                    first[cell] -= 1
                    member[first[cell]] = e
                else:
                    first[cell] += 1
