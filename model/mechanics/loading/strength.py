"""The stage *strength*: a specimen is tested to failure, between platens or in tension.

Before the test the packed grains are relieved to INSTALLED, with the friction at which they
were packed: grains packed without any keep their contacts closed, and little stress is locked in
by the bonds that are then installed. *Biaxial*: all walls are led to the confining stress and
come to rest there; then the lateral walls hold it, lagging a little behind grains that strain
and break (what they did is told: CONFINED), and
the platens (bottom and top) approach each other at a constant strain rate, as in Potyondy &
Cundall (2004); a membrane may stand in for the lateral walls, without which parts of a jointed
specimen would not slide apart. *Tension*: the grains next to the platens are gripped and pulled
apart, the sides are free. A test ends when the stress has fallen to FALLEN of its peak, or at the
largest strain, where grains that flow have reached their strength as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.loading.stress import path_between
from demflow.model.mechanics.motion.equilibrium import (
    AT_REST,
    FIRE,
    NEVER,
    OSCILLATES,
    SKIN,
    Specimen,
    Stop,
)
from demflow.model.mechanics.motion.servo import STANDING, TOO_STIFF, Servo
from demflow.model.mechanics.specimen import measures, records
from demflow.model.mechanics.specimen.rock import build_specimen, elasticity
from demflow.model.outcome import ModelError
from demflow.model.products import Packing, StrengthTest
from demflow.model.scene import Bonds, Contact, FailureTest, JointLine

INSTALLED = 1e-5  # pressure over k_n at which bonds are installed
RELIEVED = Stop(ratio=0.01, stress=0.05)  # at rest at that pressure
# Most steps to it; packings of 300 to 4,000 grains took 1,000 to 33,000: without friction the last
# motion dies slowly. A slower way to the pressure lets grains roll off more of their contacts.
RELIEVING = 100_000
HELD = Stop(ratio=0.01, stress=0.01)  # at rest under the confining stress
HOLDING = 40_000  # most steps to it; 70 MPa took 5,000
CONFINED = 0.01  # deviation of a wall from the confining stress, over the peak strength, up to
# which it counts as held: the strength follows it two- to threefold
GRIP = 3.0  # mean radii from the platens within which grains are gripped in tension
GAUGE = 0.7  # part of the width and the height over which strains are measured
FALLEN = 0.7  # part of the peak stress at which a test ends
FLOWING = 1.1  # rise of the mean stress over the last two quarters of a test at which grains flow
RECORDS = 1000  # along the largest strain
ELASTIC = 0.5  # part of the peak stress below which the moduli are read
DAMPING = 0.7  # local: strain rates are small, waves should die
FAR = 10.0  # widths and heights by which walls are taken away
EXPECTED = 1e-4  # stress over Young's modulus for which a step is fitted at the least
LEAST_STRESS = 1e-7  # over k_n, that a servo can hold
OVERSHOOTS = f"the servo of the confining stress oscillates, for {TOO_STIFF}"


class Record(NamedTuple):
    """One line of a test; stresses over k_n, strains and axial stress in the sense of the test."""

    step: int  # since the specimen was made
    stress: float  # axial
    strain: float  # axial
    lateral: float  # strain, opposite to that sense
    left: float  # stress on the lateral walls
    right: float
    cracks: int  # bonds and joint contacts broken


def strength(
    packing: Packing,
    specimen_packing: Packing | None = None,
    *,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds | None,
    test: FailureTest,
    contact: Contact | None = None,
    joints: tuple[JointLine, ...] = (),
    seed: int = 0,
    energy: bool | None = None,
) -> StrengthTest:
    """Test a packing to failure, see the head of this file.

    Parameters
    ----------
    packing : the packed state; all of it is the specimen, unless one was packed for itself,
    specimen_packing : as where the same scene has flow, which needs grains beyond its region.
    normal_stiffness, stiffness_ratio, friction, bonds, contact, joints : as for `stress.load`.
    test : what is done to it.
    seed : of the bonds' strengths.
    energy : whether energies are counted, from the confining stress on.

    Raises
    ------
    ModelError : the specimen does not come to rest before the test, relieved or under the
        confining stress, or comes to no peak within the largest strain.
    """
    packing = specimen_packing or packing
    relieved = relieve(packing)
    unit, middle = float(packing.radius.mean()), _middle(relieved.box)
    pressure = max(test.confining_stress, EXPECTED * normal_stiffness)
    elastic = elasticity(contact, normal_stiffness, stiffness_ratio, friction, pressure)
    normal_stiffness = elastic.normal_stiffness
    specimen = build_specimen(
        relieved, normal_stiffness, stiffness_ratio, friction, bonds, joints, seed, elastic
    )
    confining = max(test.confining_stress / normal_stiffness, LEAST_STRESS)
    if test.kind == "tension":
        confining = 0.0
        rows = _pull(specimen, test)
    else:
        _hold(specimen, confining, test.confining_stress)
        records.overlap_of(specimen)
        rows = _press(specimen, test, confining, counted=bool(energy))
    step, stress, axial, lateral, left, right, cracks = np.array(rows).T
    peak = int(np.argmax(stress))
    if stress[peak] <= 0.0 or not (stress[-1] <= FALLEN * stress[peak] or flows(stress)):
        raise ModelError(_no_peak(test, normal_stiffness * stress, float(axial[-1])))
    start = 0.0 if test.kind == "tension" else float(stress[0])
    half = np.flatnonzero(stress[: peak + 1] - start >= ELASTIC * (stress[peak] - start))[0]
    half = max(int(half), 1)
    modulus = (stress[half] - stress[0]) / (axial[half] - axial[0])
    ratio = (lateral[half] - lateral[0]) / (axial[half] - axial[0])
    walls = np.array([left, right])
    deviation = np.abs(walls[:, : peak + 1] - confining).max()
    broken = records.broken(specimen)
    return StrengthTest(
        youngs_modulus=np.array(normal_stiffness * modulus),
        poissons_ratio=np.array(ratio),
        peak_strength=np.array(normal_stiffness * stress[peak]),
        confining_stress_achieved=np.array(normal_stiffness * walls[:, : peak + 1].mean()),
        confining_deviation=np.array(normal_stiffness * deviation),
        confinement_held=np.array(int(deviation <= CONFINED * stress[peak])),
        crack_count=np.array(cracks[-1]),
        cracks_at_peak=np.array(cracks[peak]),
        largest_overlap=np.array(records.overlap_of(specimen)),
        axial_stress=normal_stiffness * stress,
        lateral_stress=normal_stiffness * walls.mean(axis=0),
        axial_strain=axial,
        lateral_strain=lateral,
        cracks=cracks,
        crack_x=middle[0] + unit * broken.x,
        crack_y=middle[1] + unit * broken.y,
        crack_mode=broken.mode,
        crack_step=broken.step,
        crack_strain=np.interp(broken.step, step, axial),
        box=relieved.box,
        steps=np.array(specimen.steps),
        energy=normal_stiffness * unit**2 * _spent(specimen) if energy else np.empty(0),
    )


def _spent(specimen: Specimen) -> Array:
    """Energies (7,) since the ledger was opened, in the order of `products.ENERGIES`."""
    found = specimen.energies()
    lost = found.damping + found.jerks
    return np.array(
        [found.input, found.elastic, found.kinetic, found.slip, found.breakage, lost, found.error]
    )


def flows(stress: Array) -> bool:
    """Whether stresses (k,) at equal strain steps level off: grains in their critical state.

    Unbonded grains bear their frictional strength for good, and never fall to a part of it.
    """
    quarter = max(len(stress) // 4, 1)
    last, before = stress[-quarter:].mean(), stress[-2 * quarter : -quarter].mean()
    return bool(0.0 < last <= FLOWING * before)


def _no_peak(test: FailureTest, stress: Array, strain: float) -> str:
    """What a test without a peak stress has come to, and what to try; stresses (k,) in Pa."""
    if test.kind == "tension" and stress.max() <= 0.0:
        return (
            "the specimen comes apart at once, before it bears any tension; try bonds of more "
            "strength"
        )
    remedy = "stronger bonds" if stress[-1] <= 0.0 else "a larger test.largest_strain"
    if test.kind == "biaxial":
        remedy += ", a smaller confining stress or more friction"
    return (
        f"the specimen came to no peak within a strain of {strain:.2%}, where it bears "
        f"{stress[-1]:.4g} Pa; try {remedy}"
    )


def relieve(packing: Packing) -> Packing:
    """The packing at rest at the pressure INSTALLED; a lattice is at rest without one.

    Raises ModelError where it does not come to rest there.
    """
    if float(packing.packing_pressure) <= INSTALLED:
        return packing
    specimen = build_specimen(packing, 1.0, 2.5, float(packing.packing_friction), None)
    held = Servo(INSTALLED, INSTALLED, INSTALLED, INSTALLED)
    if specimen.relax(held, RELIEVED, damping=FIRE, steps=RELIEVING) != AT_REST:
        run = specimen.run
        raise ModelError(
            f"the packing does not come to rest in {RELIEVING} steps when it is relieved before "
            f"the test: unbalanced force {run.ratio:.1e} of the contact force, stresses off by "
            f"{run.error:.1%}; try another grains.seed or a higher grains.packing_friction"
        )
    specimen.list_within(SKIN)
    unit = float(packing.radius.mean())
    grains, pairs = specimen.grains, specimen.pairs
    centre = _middle(packing.box)
    a, b = measures.listed(pairs)
    overlap = measures.overlaps(grains.x, grains.y, grains.radius, a, b)
    # cement stands at every contact of the packed state, also where that opened
    n = len(grains.x)
    touch = (overlap > 0.0) | np.isin(a * n + b, packing.contact_a * n + packing.contact_b)
    return packing._replace(
        x=centre[0] + unit * grains.x,
        y=centre[1] + unit * grains.y,
        contact_a=a[touch],
        contact_b=b[touch],
        normal_force=unit * np.maximum(overlap[touch], 0.0),
        shear_force=unit * pairs.shear[touch],
        box=unit * specimen.box + np.repeat(centre, 2),
        packing_pressure=np.array(INSTALLED),
        unbalanced_ratio=np.array(specimen.run.ratio),
    )


def _hold(specimen: Specimen, confining: float, wanted: float) -> None:
    """Lead all walls to the confining stress, over k_n, and come to rest; `wanted` is it in Pa."""
    path = path_between((INSTALLED, INSTALLED), (confining, confining))
    path = path._replace(calm=np.inf)  # far from any strength
    reason = specimen.relax(path, HELD, damping=DAMPING, steps=HOLDING)
    if reason == OSCILLATES:
        raise ModelError(OVERSHOOTS)
    if reason != AT_REST:
        run = specimen.run
        raise ModelError(
            f"the specimen does not hold the confining stress of {wanted:.4g} Pa: after {HOLDING} "
            f"steps it is {run.progress:.0%} of the way there, stresses off by {run.error:.1%}, "
            f"unbalanced force {run.ratio:.1e} of the contact force; try a lower one, more "
            "friction or bonds"
        )


def _press(
    specimen: Specimen, test: FailureTest, confining: float, *, counted: bool
) -> list[Record]:
    """A biaxial test under a confining stress over k_n."""
    drive = Servo(confining, confining, confining, confining, drive_y=-test.strain_step)
    gauge = Gauge(specimen)
    width = float(specimen.box[1] - specimen.box[0])
    if test.confinement == "membrane":
        wrap(specimen, confining)
        drive = drive._replace(drive_x=0.0)
    if counted:
        specimen.open_ledger()
    per_record = max(1, round(test.largest_strain / RECORDS / test.strain_step))
    peak, taken, rows = 0.0, 0, list[Record]()
    while True:
        lateral, axial = gauge.strains()
        left = right = confining  # of a membrane
        if test.confinement == "walls":
            width, height = np.diff(specimen.box)[[0, 2]]
            left, right = specimen.sums.left / height, specimen.sums.right / height
        stress = 0.5 * (specimen.sums.bottom + specimen.sums.top) / width
        cracks = records.crack_count(specimen)
        rows.append(Record(specimen.run.step, stress, -axial, lateral, left, right, cracks))
        peak = max(peak, stress)
        fallen = stress < FALLEN * peak and peak > 1.2 * rows[0].stress
        if fallen or taken * test.strain_step >= test.largest_strain:
            return rows
        if specimen.relax(drive, NEVER, damping=DAMPING, steps=per_record) == OSCILLATES:
            raise ModelError(OVERSHOOTS)
        taken += per_record


def wrap(specimen: Specimen, confining: float) -> None:
    """Put a membrane in place of the lateral walls: the confining stress stays, they go.

    Each grain that touched a wall bears the stress on the height between the middles to its
    neighbours there, and keeps this load wherever it goes, as by a fluid behind a membrane.
    """
    grains, box = specimen.grains, specimen.box
    for gap, sign in ((grains.x - box[0], 1.0), (box[1] - grains.x, -1.0)):
        held = np.flatnonzero(gap < grains.radius)
        held = held[np.argsort(grains.y[held])]
        middle = 0.5 * (grains.y[held][1:] + grains.y[held][:-1])
        grains.load_x[held] += sign * confining * np.diff(middle, prepend=box[2], append=box[3])
    box[:2] += FAR * (box[1] - box[0]) * np.array([-1.0, 1.0])


def _pull(specimen: Specimen, test: FailureTest) -> list[Record]:
    """A direct tension test; tension and elongation positive."""
    grains, box = specimen.grains, specimen.box
    width, height = box[1] - box[0], box[3] - box[2]
    top, bottom = grains.y > box[3] - GRIP, grains.y < box[2] + GRIP
    grains.inverse_mass[top | bottom] = 0.0
    gauge = Gauge(specimen)
    box += FAR * np.array([-width, width, -height, height])
    length = height - GRIP
    speed = 0.5 * test.strain_step * length / specimen.dt
    grains.vy[:] = 2.0 * speed * grains.y / length
    grains.vy[top], grains.vy[bottom] = speed, -speed
    per_record = max(1, round(test.largest_strain / RECORDS / test.strain_step))
    rows = [Record(specimen.run.step, 0.0, 0.0, 0.0, 0.0, 0.0, 0)]
    taken, peak = 0, 0.0
    while taken * test.strain_step < test.largest_strain:
        specimen.relax(STANDING, NEVER, damping=DAMPING, steps=per_record)
        taken += per_record
        force = 0.5 * float(grains.fy[bottom].sum() - grains.fy[top].sum())
        lateral, axial = gauge.strains()
        stress, cracks = force / width, records.crack_count(specimen)
        rows.append(Record(specimen.run.step, stress, axial, -lateral, 0.0, 0.0, cracks))
        peak = max(peak, stress)
        if taken > 4 * per_record and stress < FALLEN * peak:
            break
    return rows


class Gauge:
    """Strains of the middle of a specimen, away from walls and grips, since it was put on."""

    def __init__(self, specimen: Specimen):
        grains, box = specimen.grains, specimen.box
        half = 0.5 * GAUGE * np.array([box[1] - box[0], box[3] - box[2]])
        self.specimen = specimen
        self.inside = (np.abs(grains.x) < half[0]) & (np.abs(grains.y) < half[1])
        if np.count_nonzero(self.inside) < 3:
            raise ModelError(
                "fewer than three grains lie in the middle of the specimen, where its strains are "
                "measured; raise grains.count"
            )
        self.x, self.y = grains.x[self.inside].copy(), grains.y[self.inside].copy()

    def strains(self) -> tuple[float, float]:
        """Strains xx and yy, extension positive."""
        grains = self.specimen.grains
        u, v = grains.x[self.inside] - self.x, grains.y[self.inside] - self.y
        tensor = measures.affine_strain(self.x, self.y, u, v)
        return float(tensor[0, 0]), float(tensor[1, 1])


def _middle(box: Array) -> Array:
    return 0.5 * np.array([box[0] + box[1], box[2] + box[3]])
