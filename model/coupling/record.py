"""What is recorded of a poroelastic rock: linear functionals of pressure and displacement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csr_array, vstack

from demflow.model.coupling.frame import WALLS
from demflow.model.coupling.rock import Rock
from demflow.model.flow.equation.outputs import Records
from demflow.model.mechanics.contact.grains import Array
from demflow.model.products import Packing

COMPONENTS = ("xx", "yy", "xy")


class Record(NamedTuple):
    """o outputs: those of `flow.equation.outputs`, the ways of the four walls, effective stresses.

    In SI: an output is `pressure` @ p + `place` @ u + `speed` @ du/dt in the units of the rock,
    besides what a unit source adds by itself. `kind` tells outputs that are compared.
    """

    pressure: csr_array  # (o, n)
    place: csr_array  # (o, m)
    speed: csr_array  # (o, m)
    direct: Array  # (sources of the flow, o)
    kind: Array  # (o,) 0 pressures, 1 flows, 2 ways of walls, 3 stresses
    flow_outputs: int  # those of the flow
    inflow: csr_array  # (fixed, n) flow through pipes from each fixed pressure by p
    volume: tuple[Array, Array]  # (n,), (m,) stored volume by p and u, m³


def record_of(rock: Rock, packing: Packing, records: Records) -> Record:
    """Set up the outputs of a case, whose flow records are given.

    Parameters
    ----------
    rock : grains and pores of the specimen
    packing : grains at rest under the packing pressure
    records : what was recorded at each step
    """
    system, m = rock.system, len(rock.frame.free)
    wells, fixed = records.well_rows, records.flow_rows
    o = records.rows.shape[0]
    held = rock.held.tocoo()  # m³ by u, times the unit of area
    speed = coo_array((rock.size * held.data, (wells + held.col, held.row)), shape=(o, m))
    kind = np.zeros(o, dtype=np.int64)
    kind[wells : wells + fixed] = 1
    ways = _ways(rock)
    stress = _stresses(rock, packing)
    more = len(WALLS) + len(COMPONENTS)
    squeeze = rock.squeeze @ np.ones(system.n) + rock.held @ np.ones(fixed)
    return Record(
        pressure=csr_array(vstack([records.rows * rock.modulus, csr_array((more, system.n))])),
        place=csr_array(vstack([csr_array((o, m)), ways, stress])),
        speed=csr_array(vstack([speed, csr_array((more, m))])),
        direct=np.pad(records.direct, ((0, 0), (0, more))),
        kind=np.concatenate([kind, np.full(len(WALLS), 2), np.full(len(COMPONENTS), 3)]),
        flow_outputs=o,
        inflow=csr_array(records.rows[wells : wells + fixed] * rock.modulus),
        volume=(rock.storage * rock.size, squeeze * rock.size),
    )


def _ways(rock: Rock) -> csr_array:
    """Outward ways of the walls by u, (4, m) m."""
    places = [rock.frame.wall(name) for name in WALLS]
    moves = [(row, at) for row, at in enumerate(places) if at >= 0]
    row, column = np.array(moves, dtype=np.int64).reshape(-1, 2).T
    value = rock.frame.unit * np.ones(len(row))
    return coo_array((value, (row, column)), shape=(len(WALLS), len(rock.frame.free))).tocsr()


def _stresses(rock: Rock, packing: Packing) -> csr_array:
    """Mean effective stress xx, yy, xy by u, (3, m) Pa, compression positive.

    What contacts bear is the work that K u does on a uniform strain: the sum of their forces
    times branches, over the area of the box, those with walls for the normal stresses.
    """
    frame, box = rock.frame, packing.box
    width, height = box[1] - box[0], box[3] - box[2]
    place = np.zeros((3, 3 * frame.grain_count + 4))
    x, y = packing.x - box[0], packing.y - box[2]
    place[0, 0:-4:3], place[0, -3] = x, width
    place[1, 1:-4:3], place[1, -1] = y, height
    place[2, 0:-4:3], place[2, 1:-4:3] = 0.5 * y, 0.5 * x
    strain = place[:, frame.free] / frame.unit
    ends = frame.standing @ np.diag([width, height]) / frame.unit
    bears = frame.stiffness @ strain[:2].T + ends
    by_u = np.column_stack([bears, frame.between @ strain[2]]).T
    return csr_array(-by_u * (rock.modulus * rock.size / (width * height)))
