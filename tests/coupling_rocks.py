"""Poroelastic specimens between walls, small, and what theory says of them."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from demflow.model.coupling.duality import pores_of
from demflow.model.coupling.frame import WALLS, frame_of
from demflow.model.coupling.record import Record, record_of
from demflow.model.coupling.rock import Rock, rock_of
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.probes import at_pores
from demflow.model.flow.equation.system import assemble
from demflow.model.mechanics.packing.lattices import lattice
from demflow.model.mechanics.packing.packing import pack
from demflow.model.network.apertures import uniform
from demflow.model.network.domains import network
from demflow.model.products import Network, Packing
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds

STIFFNESS, FLUID, APERTURE, VISCOSITY = 2e10, 2.2e9, 1e-4, 1e-3
CEMENT = Bonds(kind="parallel", tensile_strength=0.0, shear_strength=0.0, modulus=1.0)


class Specimen(NamedTuple):
    """A rock and what it is made of."""

    packing: Packing
    network: Network
    rock: Rock
    record: Record  # the flow's, one probe in the pore nearest to the middle, walls, stresses
    width: float
    height: float

    @property
    def storage(self) -> float:
        """Storage of the fluid in all pores, m³/Pa."""
        return float(self.network.volume.sum()) / FLUID

    def drained(self, wall: str, length: float) -> np.ndarray:
        """Ways (4,) of the walls by 1 Pa on one of them, pressures as they are, m."""
        rock, record = self.rock, self.record
        moved = rock.frame.moved(rock.unit_load(wall, length).force)
        ways: np.ndarray = (record.place @ moved)[record.flow_outputs : record.flow_outputs + 4]
        return ways

    def moduli(self) -> np.ndarray:
        """Drained moduli (2, 2) Pa along x and y, by the ways of the walls."""
        x, y = self.drained("right", self.height), self.drained("top", self.width)
        size = np.array([self.width, self.height])
        compliance = -np.array([x[[1, 3]], y[[1, 3]]]).T / size[:, None]
        return np.linalg.inv(compliance)


def specimen_of(
    packing: Packing, *, sides: tuple[str, ...] = (), held: tuple[str, ...] = (), fluid=FLUID
) -> Specimen:
    """A packing as a rock, some of its walls drained."""
    box = packing.box
    width, height = float(box[1] - box[0]), float(box[3] - box[2])
    region = Rectangle(width, height)
    net = network(packing, region=region, walled=True)
    frame = frame_of(packing, stiffness_ratio=2.5, friction=0.5, bonds=CEMENT, held=held)
    at_side = np.full(len(net.x), -1)
    for k, side in enumerate(sides):
        at_side[pores_of(packing, net).walls[:, WALLS.index(side)]] = k
    system = assemble(
        net,
        uniform(net, APERTURE, VISCOSITY),
        region=region,
        bulk_modulus=fluid,
        wells=(),
        sides=sides,
        at_side=at_side,
    )
    rock = rock_of(packing, net, frame, system, STIFFNESS)
    middle = np.argsort(np.hypot(net.x, net.y))[:1]
    record = record_of(rock, packing, outputs(system, at_pores(middle)))
    return Specimen(packing, net, rock, record, width, height)


@cache
def random_packing(seed: int = 1, count: int = 800) -> Packing:
    """Random grains between walls."""
    return pack(
        region=Rectangle(1.0, 1.0),
        count=count,
        mean_radius=None,
        packing="random",
        radius_ratio=1.66,
        porosity=0.17,
        seed=seed,
        specimen=True,
    )


def square_packing(rows: int, columns: int = 10, radius: float = 0.01) -> Packing:
    """Equal grains on a square lattice, some rows high."""
    half = (columns * radius, rows * radius)
    return lattice("square", radius, (-half[0], half[0], -half[1], half[1]))
