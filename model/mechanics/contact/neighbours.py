"""Verlet lists: the pairs of grains that may touch before the list is made again.

A list holds each pair once, under the grain with the smaller index, and carries what a
contact remembers (its shear force, its moment and its bond), so that the memory survives a rebuild.
It is complete as long as no grain moved by more than half the skin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.outcome import ModelError

JOINED = -2  # in place of a bond: a smooth joint runs between the two (`joints`)
RAN_AWAY = (
    "the grains ran away: a position or force is no finite number any more; try stiffnesses of "
    "bonds and joints nearer to that of the grains, or a smaller step of the strain"
)


class Pairs(NamedTuple):
    """Pairs (i, j), i < j, of n grains; those of grain i are start[i] … start[i + 1] − 1."""

    start: Array  # (n + 1,) int64
    one: Array  # (m,) int32: grain i
    other: Array  # (m,) int32: grain j
    shear: Array  # (m,) shear force of the pair
    moment: Array  # (m,) of its resistance to rolling
    bond: Array  # (m,) int32: index into the bonds, −1 for none, or JOINED
    x: Array  # (n,) centres when the list was made
    y: Array


def no_pairs(n: int) -> Pairs:
    """The empty list of n grains."""
    return Pairs(
        np.zeros(n + 1, np.int64),
        np.empty(0, np.int32),
        np.empty(0, np.int32),
        np.empty(0),
        np.empty(0),
        np.empty(0, np.int32),
        np.empty(n),
        np.empty(n),
    )


def some_pairs(pairs: Pairs, which: Array | slice) -> Pairs:
    """The list with some of its pairs; `start` is left to the caller."""
    return pairs._replace(
        one=pairs.one[which],
        other=pairs.other[which],
        shear=pairs.shear[which],
        moment=pairs.moment[which],
        bond=pairs.bond[which],
    )


def find_pairs(grains: Grains, skin: float, old: Pairs) -> Pairs:
    """All pairs closer than `skin`, with the forces, moments and bonds of the old list.

    Pairs are ordered by i, then by j. Raises ModelError where a grain's position is no finite
    number.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    skin : distance of surfaces up to which grains are paired
    old : the list before
    """
    x, y, radius = grains.x, grains.y, grains.radius
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ModelError(RAN_AWAY)
    low_x, low_y = float(x.min()), float(y.min())
    width, height = float(np.ptp(x)), float(np.ptp(y))
    size = 2.0 * float(radius.max()) + skin
    while (width / size + 1.0) * (height / size + 1.0) > 4.0 * len(x) + 16.0:
        size *= 2.0  # grains far apart need no more cells than there are grains
    nx, ny = int(width / size) + 1, int(height / size) + 1
    first, members = sort_into_cells(x, y, low_x, low_y, size, nx, ny)
    capacity = max(64, old.other.size + old.other.size // 8, 5 * len(x))
    while True:
        new = Pairs(
            np.empty(len(x) + 1, np.int64),
            np.empty(capacity, np.int32),
            np.empty(capacity, np.int32),
            np.empty(capacity),
            np.empty(capacity),
            np.empty(capacity, np.int32),
            x.copy(),
            y.copy(),
        )
        count = fill_pairs(new, radius, skin, low_x, low_y, size, nx, ny, first, members, old)
        if count >= 0:
            return some_pairs(new, slice(count))
        capacity *= 2


@kernel
def sort_into_cells(
    x: Array, y: Array, low_x: float, low_y: float, size: float, nx: int, ny: int
) -> tuple[Array, Array]:
    """Counting sort of the grains into nx × ny square cells of side `size`.

    Returns the first member of each cell, int64 (nx ny + 1,), and the members, (n,).

    Parameters
    ----------
    x, y : centres, (n,)
    low_x : left end of the cells
    low_y : lower end of the cells
    size : side of a cell
    nx : cells along x
    ny : cells along y
    """
    first = np.zeros(nx * ny + 1, np.int64)
    cell = np.empty(x.size, np.int64)
    for i in range(x.size):
        cell[i] = int((x[i] - low_x) / size) + nx * int((y[i] - low_y) / size)
        first[cell[i] + 1] += 1
    for c in range(nx * ny):
        first[c + 1] += first[c]
    fill = first[:-1].copy()
    members = np.empty(x.size, np.int64)
    for i in range(x.size):
        members[fill[cell[i]]] = i
        fill[cell[i]] += 1
    return first, members


@kernel
def fill_pairs(
    new: Pairs,
    radius: Array,
    skin: float,
    low_x: float,
    low_y: float,
    size: float,
    nx: int,
    ny: int,
    first: Array,
    members: Array,
    old: Pairs,
) -> int:
    """Fill the new list; returns the number of pairs, or −1 where there may be no room for them.

    Parameters
    ----------
    new : the list that is filled
    radius : radii, (n,)
    skin : distance of surfaces up to which grains are paired
    low_x : left end of the cells
    low_y : lower end of the cells
    size : side of a cell
    nx : cells along x
    ny : cells along y
    first : first member of each cell, (nx ny + 1,)
    members : grains by their cells, (n,)
    old : the list before
    """
    # indices without a sign need no look at whether they count from the end
    x, y, other = new.x, new.y, new.other
    room = other.size
    count = 0
    for i in range(x.size):
        new.start[i] = count
        cx, cy = int((x[i] - low_x) / size), int((y[i] - low_y) / size)
        left, right = max(cx - 1, 0), min(cx + 2, nx)
        bottom, top = max(cy - 1, 0), min(cy + 2, ny)
        around = 0
        for c in range(bottom, top):
            around += first[c * nx + right] - first[c * nx + left]
        if count + around > room:
            return -1
        begin, xi, yi, wide = count, x[i], y[i], radius[i]
        for c in range(bottom, top):
            for m in range(first[c * nx + left], first[c * nx + right]):
                j = np.uint64(members[np.uint64(m)])
                dx, dy = x[j] - xi, y[j] - yi
                reach = wide + radius[j] + skin
                other[np.uint64(count)] = j  # stays if it is near: no branch hard to foretell
                count += int((j > np.uint64(i)) & (dx * dx + dy * dy < reach * reach))
        for m in range(begin + 1, count):  # insertion brings the pairs of i in the order of j
            grain, k = other[np.uint64(m)], m
            while k > begin and other[np.uint64(k - 1)] > grain:
                other[np.uint64(k)] = other[np.uint64(k - 1)]
                k -= 1
            other[np.uint64(k)] = grain
        q, end = np.uint64(old.start[i]), np.uint64(old.start[i + 1])
        for p in range(np.uint64(begin), np.uint64(count)):
            new.one[p] = i
            while q < end and old.other[q] < other[p]:
                q += np.uint64(1)
            if q < end and old.other[q] == other[p]:
                new.shear[p], new.bond[p] = old.shear[q], old.bond[q]
                new.moment[p] = old.moment[q]
            else:
                new.shear[p], new.bond[p], new.moment[p] = 0.0, -1, 0.0
    new.start[x.size] = count
    return count


@kernel
def largest_displacement(grains: Grains, pairs: Pairs, stretch_x: float, stretch_y: float) -> float:
    """Largest displacement since the list was made, apart from the affine stretch about 0.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    pairs : pairs of grains near each other, (m,)
    stretch_x : affine strain along x since the list was made
    stretch_y : the same along y
    """
    largest = 0.0
    for i in range(grains.x.size):
        dx = grains.x[i] - stretch_x * pairs.x[i]
        dy = grains.y[i] - stretch_y * pairs.y[i]
        largest = max(largest, dx * dx + dy * dy)
    found: float = np.sqrt(largest)
    return found
