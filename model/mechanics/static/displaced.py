"""Grains between walls, displaced from their packed state again and again, and their unbalance.

The displacement u (3 n + 2,) holds each grain's u_x, u_y and rotation, then the outward way of
the right and of the top wall; it is taken in one step. `Trial` adds the walls to what the
contacts give; `FrictionalTrial` gives the contacts by the law of the explicit solver.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod

import numpy as np

from demflow.model.mechanics.contact.bonds import INTACT, BondState
from demflow.model.mechanics.contact.contacts import NO_WALLS, Sums
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.contact.law import Law, presses
from demflow.model.mechanics.motion.equilibrium import Specimen, forces
from demflow.model.mechanics.specimen.measures import listed
from demflow.model.mechanics.static.load_carrying import load_carrying
from demflow.model.mechanics.static.walls import INWARD
from demflow.model.products import UnitLoads


class Trial(ABC):
    """Displaced grains; `bear` sets the forces of their contacts."""

    def __init__(self, grains: Grains, box: Array, law: Law, units: UnitLoads):
        self.grains, self.box, self.law = grains, box, law
        self.n = len(grains.x)
        self.x, self.y, self.first_box = grains.x.copy(), grains.y.copy(), box.copy()
        starts = units.wall_start
        self.walls = [units.wall_grain[a:b] for a, b in itertools.pairwise(starts)]
        self.share = [units.wall_share[a:b] for a, b in itertools.pairwise(starts)]
        self.sums: Sums

    @abstractmethod
    def bear(self) -> Sums:
        """Set the forces of the contacts between the displaced grains; what they add up to."""

    def forces(self, u: Array, tilt: float, wanted: Array) -> tuple[Array, float]:
        """Unbalanced forces (3 n + 2,) after a displacement, and their ratio to the contacts'.

        The wanted stresses act on the deformed box.

        Parameters
        ----------
        u : displacement (3 n + 2,): x, y and turn of each grain, then the strains of the box
        tilt : shear of the box
        wanted : stresses xx, yy, xy that are wanted, (3,) over k_n
        """
        grains, box, n = self.grains, self.box, self.n
        step = u[:-2].reshape(n, 3)
        grains.vx[:], grains.vy[:], grains.spin[:] = step.T
        grains.x[:], grains.y[:] = self.x + step[:, 0], self.y + step[:, 1]
        box[:] = self.first_box
        box[1] += u[-2]
        box[3] += u[-1]
        loads, self.sums = self._press(self.bear(), tilt, wanted)
        residual = np.empty(3 * n + 2)
        on_grains = residual[:-2].reshape(n, 3)
        on_grains[:, 0], on_grains[:, 1], on_grains[:, 2] = grains.fx, grains.fy, grains.torque
        width, height = box[1] - box[0], box[3] - box[2]
        residual[-2] = loads[1] - wanted[0] * height
        lift = -0.5 * float(grains.load_y.sum())  # of the weight on the bottom wall, see `Servo`
        residual[-1] = loads[3] - (wanted[1] * width - lift)
        mean = self.sums.force / max(self.sums.contacts, 1)
        unbalanced = np.sqrt(grains.fx**2 + grains.fy**2 + (grains.torque / grains.radius) ** 2)
        held = unbalanced > 0.0
        ratio = unbalanced[held].mean() / mean if held.any() else 0.0
        # the walls that stand are held to it as well: what all grains lack adds up on them
        across, along = wanted[0] * height, wanted[1] * width
        sides = ((across, across), (across, across), (along + lift, along), (along - lift, along))
        wall = max(
            abs(load - side) / max(scale, 1e-300)
            for load, (side, scale) in zip(loads, sides, strict=True)
        )
        return residual, float(max(ratio, wall))

    def _press(self, sums: Sums, tilt: float, wanted: Array) -> tuple[list[float], Sums]:
        """Add the forces of the walls to the grains and to what the contacts sum up."""
        grains, box = self.grains, self.box
        loads, counts = [], []
        virial = np.array([sums.virial_xx, sums.virial_yy, sums.virial_xy])
        force = sums.force
        sides = (box[3] - box[2], box[3] - box[2], box[1] - box[0], box[1] - box[0])
        for side, (held, share) in enumerate(zip(self.walls, self.share, strict=True)):
            sense = INWARD[side]
            across, along = (grains.x, grains.y) if side < 2 else (grains.y, grains.x)
            reached = box[side] + 0.5 * tilt * along[held]
            depth = sense * (reached - across[held]) + grains.radius[held]
            press = presses(self.law, depth, grains.radius[held])
            drag = sense * wanted[2] * sides[side] * share
            loads.append(float(press.sum()))
            counts.append(int(np.count_nonzero(press)))
            normal, tangential = (grains.fx, grains.fy) if side < 2 else (grains.fy, grains.fx)
            normal[held] += sense * press
            tangential[held] += drag
            arm = across[held] - box[side]
            grains.torque[held] -= (1.0 if side < 2 else -1.0) * sense * grains.radius[held] * drag
            virial[side // 2] += float(np.sum(sense * press * arm))
            virial[2] += 0.5 * float(np.sum(drag * arm))
            force += float(np.sum(np.hypot(press, drag)))
        left, right, bottom, top = loads
        return loads, sums._replace(
            contacts=sums.contacts + sum(counts),
            force=force,
            virial_xx=float(virial[0]),
            virial_yy=float(virial[1]),
            virial_xy=float(virial[2]),
            left=left,
            right=right,
            bottom=bottom,
            top=top,
        )

    def put_inside(self, a: Array, b: Array) -> None:
        """Move grains that no pair (a, b) touches off the walls."""
        grains, box = self.grains, self.box
        free = np.bincount(np.r_[a, b], minlength=self.n) == 0
        r = grains.radius[free]
        grains.x[free] = np.clip(grains.x[free], box[0] + r, box[1] - r)
        grains.y[free] = np.clip(grains.y[free], box[2] + r, box[3] - r)


class FrictionalTrial(Trial):
    """By the law of the explicit solver: contacts open, close and slip; bonds hold at first."""

    def __init__(self, specimen: Specimen, units: UnitLoads):
        super().__init__(specimen.grains, specimen.box, specimen.law, units)
        self.specimen, self.bonds = specimen, specimen.bonds
        specimen.pairs = load_carrying(specimen)
        self.shear = specimen.pairs.shear.copy()
        self.memory = (self.bonds.shear.copy(), self.bonds.moment.copy())

    def bear(self) -> Sums:
        """Set the forces of all contacts; bonds hold whatever they bear."""
        self.bonds.state[:] = INTACT
        return self._contacts(unbreakable(self.bonds))

    def broken_bonds(self) -> int:
        """Bonds that are beyond their strength in the present state."""
        grains = self.grains
        kept = tuple(f.copy() for f in (grains.fx, grains.fy, grains.torque))
        self._contacts(self.bonds)
        for field, value in zip((grains.fx, grains.fy, grains.torque), kept, strict=True):
            field[:] = value
        return int(np.count_nonzero(self.bonds.state != INTACT))

    def accept(self, ratio: float) -> None:
        """Leave the specimen in the present state."""
        self.put_inside(*listed(self.specimen.pairs))
        self.specimen.sums = self.sums
        self.specimen.run = self.specimen.run._replace(ratio=ratio, progress=1.0)

    def _contacts(self, bonds: BondState) -> Sums:
        specimen = self.specimen
        specimen.pairs.shear[:] = self.shear
        bonds.shear[:], bonds.moment[:] = self.memory
        return forces(
            self.grains, specimen.pairs, bonds, specimen.joints, specimen.law, NO_WALLS, dt=1.0
        )


def unbreakable(bonds: BondState) -> BondState:
    """The same bonds without a strength."""
    endless = np.full(len(bonds.state), np.inf)
    return bonds._replace(tensile_strength=endless, shear_strength=endless)
