"""Grains in a cell that repeats itself in x and y: a packing without walls.

Contacts across an edge of the cell are contacts with images: copies of grains, moved by a period,
that follow their owners in every step and hand them their forces. Of two neighbours across an
edge one sees an image of the other (SHIFTS are half of all directions), so that every contact
is there once and the law is that of `contacts`. Grains are never put back into the cell while
they move; a contact keeps its image, and with it its memory.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.bonds import no_bonds
from demflow.model.mechanics.contact.contacts import NO_WALLS, Sums, mean_size
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.neighbours import find_pairs, no_pairs, some_pairs
from demflow.model.mechanics.motion.bounds import (
    follow,
    follows_path,
    movers,
    off_target,
    stretch_bounds,
    swings_for_ever,
    unbalance,
    walls_of,
)
from demflow.model.mechanics.motion.equilibrium import Assembly, Run, Stop, advance
from demflow.model.mechanics.motion.servo import Servo, mean_stresses
from demflow.model.mechanics.specimen.measures import listed
from demflow.model.outcome import ModelError

SHIFTS = np.array([(1, 0), (0, 1), (1, 1), (-1, 1)])


class Images(NamedTuple):
    """Copies of grains beyond the edges of the cell; they stand behind the grains themselves."""

    owner: Array  # (k,) int64
    shift_x: Array  # (k,) periods
    shift_y: Array


@kernel
def place_images(grains: Grains, images: Images, box: Array) -> None:
    """Let the images follow their owners.

    Parameters
    ----------
    grains : the grains (n,), in units of mean radius and k_n
    images : owner of each image, and the sides that it is away
    box : walls xmin, xmax, ymin, ymax, (4,)
    """
    n = grains.x.size - images.owner.size
    width, height = box[1] - box[0], box[3] - box[2]
    for k in range(images.owner.size):
        i = images.owner[k]
        grains.x[n + k] = grains.x[i] + images.shift_x[k] * width
        grains.y[n + k] = grains.y[i] + images.shift_y[k] * height
        grains.vx[n + k], grains.vy[n + k] = grains.vx[i], grains.vy[i]
        grains.spin[n + k] = grains.spin[i]


@kernel
def fold_forces(grains: Grains, images: Images) -> float:
    """Hand forces on images to their owners; returns the mean |F| of grains on which any acts."""
    n = grains.x.size - images.owner.size
    for k in range(images.owner.size):
        i = images.owner[k]
        grains.fx[i] += grains.fx[n + k]
        grains.fy[i] += grains.fy[n + k]
        grains.torque[i] += grains.torque[n + k]
    found: float = mean_size(grains.fx, grains.fy, n)
    return found


class Period(NamedTuple):
    """A cell of sides `box`, whose grains are `real`, the first part of all with their images."""

    box: Array  # (4,)
    real: Grains
    images: Images
    no_walls: Array


@walls_of.of(Period)
def _walls_of(bounds: Period) -> Array:
    return bounds.no_walls


@movers.of(Period)
def _movers(bounds: Period, grains: Grains) -> Grains:
    return bounds.real


@follow.of(Period)
def _follow(bounds: Period, grains: Grains) -> None:
    place_images(grains, bounds.images, bounds.box)


@unbalance.of(Period)
def _unbalance(bounds: Period, grains: Grains, sums: Sums) -> float:
    return fold_forces(grains, bounds.images)


@follows_path.of(Period)
def _follows_path(bounds: Period) -> bool:
    return False


@off_target.of(Period)
def _off_target(
    bounds: Period, servo: Servo, sums: Sums, wanted_xx: float, wanted_yy: float
) -> float:
    mean_xx, mean_yy = mean_stresses(sums, bounds.box)
    return max(abs(mean_xx - wanted_xx) / wanted_xx, abs(mean_yy - wanted_yy) / wanted_yy)


@swings_for_ever.of(Period)
def _swings_for_ever(
    bounds: Period, servo: Servo, swings: Array, sums: Sums, wanted_xx: float, wanted_yy: float
) -> bool:
    return False


@stretch_bounds.of(Period)
def _stretch_bounds(
    bounds: Period,
    servo: Servo,
    sums: Sums,
    kn: float,
    wanted_xx: float,
    wanted_yy: float,
    stretch_x: float,
    stretch_y: float,
) -> None:
    box = bounds.box
    box[0] *= 1.0 + stretch_x
    box[1] *= 1.0 + stretch_x
    box[2] *= 1.0 + stretch_y
    box[3] *= 1.0 + stretch_y


@dataclass
class Cell(Assembly):
    """Grains in a periodic cell, moved as `equilibrium.Specimen` moves those between walls.

    `grains` are n without images; `pairs.other` is a grain, or n + image. The origin is the
    middle of the cell, whose sides must be longer than six of the largest radii, so that no grain
    meets another, or itself, twice. A servo's target is held at once, without a path.
    """

    LIST_COST = 75.0  # images are made anew, too

    images: Images = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        sides = self.box[[1, 3]] - self.box[[0, 2]]
        if sides.min() < 6.0 * self.grains.radius.max():
            raise ModelError(
                "a periodic tile must be wider than six of its largest radii; raise grains.tile"
            )
        none = np.empty(0, np.int64)
        self.images = Images(none, none, none)
        self.pairs = no_pairs(len(self.grains.x))
        self._list_pairs()

    @property
    def porosity(self) -> float:
        """Part of the cell that no disc covers."""
        area = (self.box[1] - self.box[0]) * (self.box[3] - self.box[2])
        return float(1.0 - np.pi * np.sum(self.grains.radius**2) / area)

    def _advance(
        self, servo: Servo, stop: Stop, damping: float, slack: float, lasts: int, steps: int
    ) -> tuple[int, int, Run, Sums]:
        period = Period(self.box, self.grains, self.images, NO_WALLS)
        ended: tuple[int, int, Run, Sums] = advance(
            self._all, self.pairs, no_bonds(), None, self.law, period, servo, stop,
            self.run, self.dt, damping, slack, self._reach(), lasts, steps, self.swings, None,
        )  # fmt: skip
        return ended

    def contacts(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Touching pairs: grains a and b, periods by which b is moved, overlap, shear; all (c,)."""
        n = len(self.grains.x)
        place_images(self._all, self.images, self.box)
        a, other = listed(self.pairs)
        x, y, radius = self._all.x, self._all.y, self._all.radius
        overlap = radius[a] + radius[other] - np.hypot(x[other] - x[a], y[other] - y[a])
        touch = overlap > 0.0
        owner, shift = self._owners(other[touch], n)
        return a[touch], owner, shift[:, 0], shift[:, 1], overlap[touch], self.pairs.shear[touch]

    def _owners(self, other: Array, n: int) -> tuple[Array, Array]:
        """The grain behind each index (m,) of a list, and its shift (m, 2) in periods."""
        owner, shift = other.copy(), np.zeros((len(other), 2), np.int64)
        beyond = other >= n
        k = other[beyond] - n
        owner[beyond] = self.images.owner[k]
        shift[beyond] = np.column_stack((self.images.shift_x[k], self.images.shift_y[k]))
        return owner, shift

    def _keys(self) -> Array:
        """A number for each pair of the list that stays its own when images are made anew."""
        n = len(self.grains.x)
        a, other = listed(self.pairs)
        owner, shift = self._owners(other, n)
        found: Array = ((a * n + owner) * 3 + shift[:, 0] + 1) * 2 + shift[:, 1]
        return found

    def _list_pairs(self) -> None:
        """As every assembly does, with images made anew."""
        old_keys, old_shear = self._keys(), self.pairs.shear
        grains, n = self.grains, len(self.grains.x)
        sides = self.box[[1, 3]] - self.box[[0, 2]]
        at = np.column_stack((grains.x, grains.y))
        reach = 2.0 * float(grains.radius.max()) + self.width
        low, high = at.min(axis=0) - reach, at.max(axis=0) + reach
        owners, shifts = [], []
        for shift in SHIFTS:
            moved = at + shift * sides
            near = np.flatnonzero(np.all((moved > low) & (moved < high), axis=1))
            owners.append(near)
            shifts.append(np.tile(shift, (len(near), 1)))
        owner, by = np.concatenate(owners), np.concatenate(shifts)
        self.images = Images(owner, by[:, 0].copy(), by[:, 1].copy())
        self._all = Grains(*(np.concatenate((part, part[owner])) for part in grains))
        self._all.inverse_mass[n:] = 0.0
        # what moves is the first part of the same memory
        self.grains = Grains(*(part[:n] for part in self._all))
        place_images(self._all, self.images, self.box)
        found = find_pairs(self._all, self.width, no_pairs(n + len(owner)))
        last = found.start[n]
        found.start[n:] = last  # images do not meet each other
        self.pairs = some_pairs(found, slice(last))
        keys = self._keys()
        kept = np.flatnonzero(np.isin(keys, old_keys))
        order = np.argsort(old_keys)
        self.pairs.shear[kept] = old_shear[
            order[np.searchsorted(old_keys, keys[kept], sorter=order)]
        ]
