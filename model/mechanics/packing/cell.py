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
from demflow.model.mechanics.contact.bonds import BondState, no_bonds
from demflow.model.mechanics.contact.contacts import NO_WALLS, Sums, contact_forces
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.joints import JointState, no_joints
from demflow.model.mechanics.contact.law import Law
from demflow.model.mechanics.contact.neighbours import Pairs, find_pairs, no_pairs, some_pairs
from demflow.model.mechanics.motion.equilibrium import (
    AT_REST,
    LIST_STALE,
    NOT_FINITE,
    OUT_OF_STEPS,
    Assembly,
    Run,
    Stop,
)
from demflow.model.mechanics.motion.motion import damped_velocities, fire_velocities, move
from demflow.model.mechanics.motion.servo import Servo, mean_stresses, setpoint, stretches
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
    """Let the images follow their owners."""
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
    total, loaded = 0.0, 0
    for i in range(n):
        size = np.sqrt(grains.fx[i] * grains.fx[i] + grains.fy[i] * grains.fy[i])
        if size > 0.0:
            total += size
            loaded += 1
    return total / max(loaded, 1)


@kernel
def advance_cell(
    grains: Grains,
    real: Grains,
    images: Images,
    pairs: Pairs,
    bonds: BondState,
    joints: JointState,
    law: Law,
    box: Array,
    no_walls: Array,
    servo: Servo,
    stop: Stop,
    run: Run,
    dt: float,
    damping: float,
    slack: float,
    reach: float,
    steps: int,
) -> tuple[int, int, Run, Sums]:
    """Step until at rest, until the list of pairs may be stale, or until a bound is met.

    As `equilibrium.advance`, with a cell of periods `box` in place of walls; `real` are the
    grains without their images, the first part of `grains`.
    """
    fire, last, stretch_x, stretch_y = run.fire, run.dt, run.stretch_x, run.stretch_y
    since_x, since_y, ratio, error = run.since_x, run.since_y, run.ratio, run.error
    taken = 0
    while True:
        place_images(grains, images, box)
        sums = contact_forces(
            grains, pairs, bonds, joints, law, no_walls, run.step + taken,
            last, stretch_x, stretch_y, None,
        )  # fmt: skip
        unbalanced = fold_forces(grains, images)
        mean = sums.force / max(sums.contacts, 1)
        if not np.isfinite(sums.virial_xx + sums.virial_yy):
            end = NOT_FINITE
            break
        wanted_xx, wanted_yy = setpoint(servo, 1.0)
        if servo.gain > 0.0:
            mean_xx, mean_yy = mean_stresses(sums, box)
            error = max(abs(mean_xx - wanted_xx) / wanted_xx, abs(mean_yy - wanted_yy) / wanted_yy)
        if error <= stop.stress and (unbalanced <= stop.ratio * mean or mean < stop.force):
            end = AT_REST
            break
        if taken >= steps:
            end = OUT_OF_STEPS
            break
        if servo.gain > 0.0:
            stretch_x, stretch_y = stretches(servo, sums, box, wanted_xx, wanted_yy)
            box[0] *= 1.0 + stretch_x
            box[1] *= 1.0 + stretch_x
            box[2] *= 1.0 + stretch_y
            box[3] *= 1.0 + stretch_y
        if damping < 0.0:
            fire = fire_velocities(real, fire, dt)
            last = fire.dt
        else:
            damped_velocities(real, dt, damping, None)
            last = dt
        fastest = move(real, last, stretch_x, stretch_y)
        since_x *= 1.0 + stretch_x
        since_y *= 1.0 + stretch_y
        slack -= last * np.sqrt(fastest) + reach * max(abs(stretch_x), abs(stretch_y))
        taken += 1
        if not slack >= 0.0:
            end = LIST_STALE
            break
    if end != LIST_STALE:  # the contacts have seen the last step
        last = stretch_x = stretch_y = 0.0
        ratio = unbalanced / max(mean, 1e-300)
    run = Run(
        fire=fire, step=run.step + taken, dt=last, stretch_x=stretch_x, stretch_y=stretch_y,
        since_x=since_x, since_y=since_y, strain_x=0.0, strain_y=0.0,
        progress=1.0, lead_x=0.0, lead_y=0.0, ratio=ratio, error=error,
    )  # fmt: skip
    return end, taken, run, sums


@dataclass
class Cell(Assembly):
    """Grains in a periodic cell, moved as `equilibrium.Specimen` moves those between walls.

    `grains` are n without images; `pairs.other` is a grain, or n + image. The origin is the
    middle of the cell, whose sides must be longer than six of the largest radii, so that no grain
    meets another, or itself, twice. A servo's target is held at once, without a path.
    """

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
        self, servo: Servo, stop: Stop, damping: float, slack: float, reach: float, steps: int
    ) -> tuple[int, int, Run, Sums]:
        ended: tuple[int, int, Run, Sums] = advance_cell(
            self._all, self.grains, self.images, self.pairs, no_bonds(), no_joints(), self.law,
            self.box, NO_WALLS, servo, stop, self.run, self.dt, damping, slack, reach, steps,
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
        return ((a * n + owner) * 3 + shift[:, 0] + 1) * 2 + shift[:, 1]

    def _list_pairs(self) -> None:
        """As every assembly does, with images made anew."""
        old_keys, old_shear = self._keys(), self.pairs.shear
        grains, n = self.grains, len(self.grains.x)
        sides = self.box[[1, 3]] - self.box[[0, 2]]
        at = np.column_stack((grains.x, grains.y))
        reach = 2.0 * float(grains.radius.max()) + self.skin
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
        found = find_pairs(self._all, self.skin, no_pairs(n + len(owner)))
        last = found.start[n]
        found.start[n:] = last  # images do not meet each other
        self.pairs = some_pairs(found, slice(last))
        keys = self._keys()
        kept = np.flatnonzero(np.isin(keys, old_keys))
        order = np.argsort(old_keys)
        self.pairs.shear[kept] = old_shear[
            order[np.searchsorted(old_keys, keys[kept], sorter=order)]
        ]
