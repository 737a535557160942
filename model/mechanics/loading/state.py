"""The product of the stage *stress*: a state of rest in SI units, at the place of the packing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.bonds import INTACT
from demflow.model.mechanics.contact.contacts import Sums
from demflow.model.mechanics.contact.grains import Array, Grains
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.specimen import records
from demflow.model.mechanics.specimen.measures import largest_overlap
from demflow.model.mechanics.specimen.records import Broken, Carried
from demflow.model.mechanics.static.static import Found
from demflow.model.mechanics.static.sticking import StickingTrial
from demflow.model.products import Packing, StressState


class Rest(NamedTuple):
    """Grains at rest, in units of mean radius and k_n."""

    grains: Grains
    box: Array  # (4,)
    sums: Sums
    contacts: Carried
    cracks: Broken
    idle_joints: int
    broken_bonds: int
    ratio: float  # mean unbalanced over mean contact force
    steps: int  # time steps, or corrections of the static solver
    is_static: bool


def state_of(
    specimen: Specimen, packing: Packing, normal_stiffness: float, found: Found | None = None
) -> StressState:
    """The state of a specimen, by the static solver where that `found` it.

    Parameters
    ----------
    specimen : grains with bonds, joints and walls, in units of mean radius and k_n
    packing : grains at rest under the packing pressure
    normal_stiffness : k_n of contacts, N/m per metre of depth
    found : what the static solver found
    """
    rest = Rest(
        specimen.grains,
        specimen.box,
        specimen.sums,
        records.carried(specimen),
        records.broken(specimen),
        specimen.idle_traces,
        int(np.count_nonzero(specimen.bonds.state != INTACT)),
        specimen.run.ratio,
        specimen.steps if found is None else found.corrections,
        found is not None,
    )
    return _product(rest, packing, normal_stiffness)


def held_state(
    trial: StickingTrial, found: Found, packing: Packing, normal_stiffness: float
) -> StressState:
    """The state in which all cemented contacts hold.

    Parameters
    ----------
    trial : displaced grains whose cemented contacts hold
    found : what the static solver found
    packing : grains at rest under the packing pressure
    normal_stiffness : k_n of contacts, N/m per metre of depth
    """
    units, count = trial.units, len(trial.normal)
    contacts = Carried(
        units.contact_a,
        units.contact_b,
        trial.normal,
        trial.shear,
        np.ones(count, bool),
        np.full(count, np.nan),
        np.zeros(count),
    )
    none = np.empty(0)
    whole = np.empty(0, np.int64)
    cracks = Broken(none, none, whole, whole, none, none)
    trial.put_inside(units.contact_a, units.contact_b)
    rest = Rest(
        trial.grains, trial.box, trial.sums, contacts, cracks, 0, 0, found.ratio,
        found.corrections, True,
    )  # fmt: skip
    return _product(rest, packing, normal_stiffness)


def _product(rest: Rest, packing: Packing, normal_stiffness: float) -> StressState:
    grains, box, sums, contacts, cracks = rest[:5]
    unit = float(packing.radius.mean())
    grainy = np.isnan(contacts.joint_gap)  # along a smooth joint grains slide past each other
    pairs = contacts.a[grainy], contacts.b[grainy]
    overlap = largest_overlap(grains.x, grains.y, grains.radius, *pairs)
    if rest.is_static:  # its left and bottom walls stood
        shift_x, shift_y = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
        grains.x[:] -= shift_x
        grains.y[:] -= shift_y
        box -= np.array([shift_x, shift_x, shift_y, shift_y])
    centre = 0.5 * np.array([packing.box[0] + packing.box[1], packing.box[2] + packing.box[3]])
    force = unit * normal_stiffness
    width, height = box[1] - box[0], box[3] - box[2]
    virial = np.array([sums.virial_xx, sums.virial_yy, sums.virial_xy])
    walls = np.array(
        [sums.left / height, sums.right / height, sums.bottom / width, sums.top / width]
    )
    return StressState(
        x=centre[0] + unit * grains.x,
        y=centre[1] + unit * grains.y,
        contact_a=contacts.a,
        contact_b=contacts.b,
        normal_force=force * contacts.normal,
        shear_force=force * contacts.shear,
        bonded=contacts.bonded,
        joint_gap=unit * contacts.joint_gap,
        crack_x=centre[0] + unit * cracks.x,
        crack_y=centre[1] + unit * cracks.y,
        crack_mode=cracks.mode,
        crack_step=cracks.step,
        crack_strain_xx=cracks.strain_xx,
        crack_strain_yy=cracks.strain_yy,
        idle_joints=np.array(rest.idle_joints),
        box=unit * box + np.repeat(centre, 2),
        stress=normal_stiffness * virial / (width * height),
        wall_stress=normal_stiffness * walls,
        unbalanced_ratio=np.array(rest.ratio),
        broken_bonds=np.array(rest.broken_bonds),
        largest_overlap=np.array(overlap),
        static=np.array(int(rest.is_static)),
        steps=np.array(rest.steps),
        joint_slip=unit * contacts.joint_slip if contacts.joint_slip.any() else np.empty(0),
    )
