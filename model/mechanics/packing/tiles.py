"""A periodic cell repeated side by side until it covers a rectangle, and cut to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.packing.cell import Cell
from demflow.model.mechanics.packing.floaters import fit


class Tiled(NamedTuple):
    """Copies of the grains and contacts of a cell, in its units, about the origin."""

    x: Array  # (n,)
    y: Array
    radius: Array
    twin: Array  # (n,) the grain of the cell of which each is a copy
    a: Array  # (c,) contacts, a < b, sorted by (a, b)
    b: Array
    overlap: Array  # (c,)
    shear: Array  # (c,)
    counts: Array  # (n,) contacts of each grain, those too that the rectangle's end cuts


def tiled(cell: Cell, size: Array, *, fits: bool = False) -> Tiled:
    """Copies of the grains of a cell that lie in a rectangle of `size` (width, height).

    Contacts across the edges of the copies are those of the cell with its images, so that an
    edge is like any other place; a contact is cut only where the rectangle ends. `fits` fits
    floaters into their voids, so that they touch three others without force.

    Parameters
    ----------
    cell : the grains of a cell that repeats itself
    size : of the rectangle, (2,)
    fits : whether floaters are fitted into their voids
    """
    grains, n = cell.grains, len(cell.grains.x)
    sides = cell.box[[1, 3]] - cell.box[[0, 2]]
    # grains may lie beyond the cell's edges by some radii: a ring of copies more than needed
    count = np.ceil(size / sides).astype(int) + 2
    column, row = (k.ravel() for k in np.meshgrid(np.arange(count[0]), np.arange(count[1])))
    copy = np.arange(len(column))
    x = (grains.x + (column - 0.5 * (count[0] - 1))[:, None] * sides[0]).ravel()
    y = (grains.y + (row - 0.5 * (count[1] - 1))[:, None] * sides[1]).ravel()
    inside = (np.abs(x) <= 0.5 * size[0]) & (np.abs(y) <= 0.5 * size[1])
    number = np.where(inside, np.cumsum(inside) - 1, -1)

    a, b, shift_x, shift_y, overlap, shear = cell.contacts()
    to_column, to_row = column[:, None] + shift_x, row[:, None] + shift_y
    exists = (to_column >= 0) & (to_column < count[0]) & (to_row >= 0) & (to_row < count[1])
    to = np.where(exists, to_row * count[0] + to_column, 0)
    one, two = number[(copy[:, None] * n + a)], number[to * n + b]
    kept = exists & (one >= 0) & (two >= 0)
    one, two = one[kept], two[kept]
    of = np.broadcast_to(np.arange(len(a)), kept.shape)[kept]
    # a shear force keeps its sign when the two grains change places (see `contacts`)
    first, second = np.minimum(one, two), np.maximum(one, two)
    order = np.lexsort((second, first))
    of = of[order]
    twin = np.tile(np.arange(n), len(copy))
    counts = np.bincount(a, minlength=n) + np.bincount(b, minlength=n)
    part = Tiled(
        x[inside],
        y[inside],
        np.tile(grains.radius, len(copy))[inside],
        twin[inside],
        first[order],
        second[order],
        overlap[of],
        shear[of],
        counts[twin[inside]],
    )
    return _fitted(part) if fits else part


def _fitted(part: Tiled) -> Tiled:
    """The same with floaters fitted into their voids; `floaters.fit`."""
    x, y, radius = part.x.copy(), part.y.copy(), part.radius.copy()
    one, two = fit(x, y, radius, part.counts < 2, bounds(x, y, radius))
    moved = radius != part.radius
    stays = ~(moved[part.a] | moved[part.b])
    gone = np.concatenate((part.a[~stays], part.b[~stays]))
    counts = part.counts + np.bincount(np.concatenate((one, two)), minlength=len(x))
    counts -= np.bincount(gone, minlength=len(x))
    a, b = np.concatenate((part.a[stays], one)), np.concatenate((part.b[stays], two))
    order, none = np.lexsort((b, a)), np.zeros(len(one))
    overlap, shear = (np.concatenate((f[stays], none))[order] for f in (part.overlap, part.shear))
    return Tiled(x, y, radius, part.twin, a[order], b[order], overlap, shear, counts)


def bounds(x: Array, y: Array, radius: Array) -> Array:
    """The box (4,) xmin, xmax, ymin, ymax around discs.

    Parameters
    ----------
    x, y : centres, (n,)
    radius : radii, (n,)
    """
    low_x, low_y = (x - radius).min(), (y - radius).min()
    return np.array([low_x, (x + radius).max(), low_y, (y + radius).max()])
