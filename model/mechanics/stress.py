"""The stages *unit_loads* and *stress*: packed grains, bonded or not, loaded by four walls.

Bonded grains are tried by the static solver (`static`), whose states do not depend on a path
but for slip at cemented contacts; where a bond would break, and without bonds, grains are
moved along a path.

Path: bonds are installed on the contacts of the packed state, then the stresses of the walls
move on a straight line from those of the packed state (equal on all walls; LEAST_START of the
target in a lattice, which starts without force) to the target. The inertial number
I = ε̇ √(m/p) of the path is INERTIAL_NUMBER, and the path waits while the stresses lag behind
by more than BAND. So the state depends on this path, and little on the dynamics that follow
it: against a path taken five times more slowly, forces of unbonded packings (5,000 grains,
porosity 0.16 to 0.165, friction 0.5) differ by 0.2 to 1.1 % (L2) at 1.5:1 and by 1 to 2.7 % at
2:1, where the strength is near 2.4:1, whatever damping and gain.

Units inside are the mean radius, k_n and the mass of a grain; stresses are σ / k_n.
"""

from __future__ import annotations

import numpy as np

from model.mechanics import records, static
from model.mechanics.bonds import (
    INTACT,
    NO_BONDS,
    PARALLEL_BONDS,
    BondState,
    install,
    no_bonds,
    strengths,
)
from model.mechanics.contacts import ContactLaw
from model.mechanics.equilibrium import AT_REST, STRAINED, TIME_STEP, Specimen, Stop
from model.mechanics.grains import at_rest, scaled_mass
from model.mechanics.joints import Trace
from model.mechanics.neighbours import Pairs
from model.mechanics.servo import Servo, setpoint
from model.outcome import ModelError
from model.products import Packing, StressState, UnitLoads
from model.scene import Bonds, JointLine, Stress

INERTIAL_NUMBER = 5e-5
BAND = 0.02  # lag of the stresses behind the path at which it waits, relative
LEAST_START = 0.01  # of the target stress: where a path starts at least
MODULUS = 0.5  # stress per strain that the pace assumes, over k_n
DAMPING = 0.5  # local
MOST_STEPS = 200_000
REST_STEPS = 100_000  # besides those of the path: grains without friction took up to 40,000
PLASTIC_STRAIN = 0.01  # beyond twice the elastic one, at which a specimen counts as flowing


def unit_loads(
    packing: Packing, *, stiffness_ratio: float, friction: float, bonds: Bonds
) -> UnitLoads:
    """Linear response of the packed, bonded grains: what all their stress states share.

    Parameters as for `load`; strengths and stiffness do not matter, k_n is the unit.
    """
    specimen = specimen_of(packing, 1.0, stiffness_ratio, friction, bonds)
    pressure = float(packing.packing_pressure)
    return static.response(specimen, np.array([pressure, pressure, 0.0]))


def load(
    packing: Packing,
    units: UnitLoads | None = None,
    *,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds | None,
    joints: tuple[JointLine, ...] = (),
    seed: int = 0,
    stress: Stress,
) -> StressState:
    """Grains in equilibrium under the walls' stresses, along the path stated above.

    Parameters
    ----------
    packing : the packed state; its forces over k_n are scaled with the stiffness, shear forces
        beyond friction are cut.
    units : its linear response (`unit_loads`), with which the static solver tries first; the
        explicit one takes over where a bond would break.
    normal_stiffness : k_n of contacts, also with the walls, N/m per metre of depth.
    stiffness_ratio : k_n / k_s.
    friction : Coulomb coefficient between grains; walls are frictionless.
    bonds : cement on all contacts of the packed state, or None.
    joints : smooth joints along straight traces; their contacts have no other cement.
    seed : of the bonds' strengths.
    stress : target stresses, Pa, compression positive.

    Raises
    ------
    ModelError : the specimen flows (beyond its strength), or did not come to rest in the
        number of steps that is allowed for; the text says how far it came and what to try.
    """
    radius = float(packing.radius.mean())
    wanted = np.array(stress.components) / normal_stiffness
    rock = (packing, normal_stiffness, stiffness_ratio, friction, bonds, joints, seed)
    specimen = specimen_of(*rock)
    why = "there are no bonds" if bonds is None else "there are joints"
    if units is not None and stress.method != "explicit":
        found = static.equilibrium(specimen, units, wanted, stress.tolerance)
        if found.reached:
            specimen.steps = found.corrections
            return _product(specimen, packing, radius, normal_stiffness, is_static=True)
        why = found.why
        specimen = specimen_of(*rock)
    if stress.method == "static":
        raise ModelError(
            f"the static solver does not reach these stresses: {why}; try stress.method auto, "
            "stronger bonds or smaller stresses"
        )
    if wanted[2] != 0.0:
        raise ModelError(
            "a stress at an angle to the walls needs grains that stay bonded (the static solver "
            f"finds it), but {why}; try stronger bonds, smaller stresses or no stress.angle"
        )
    path = straight_path(float(packing.packing_pressure), float(wanted[0]), float(wanted[1]))
    slowest = path.pace * np.sqrt(min(path.start_xx, path.start_yy, path.target_xx, path.target_yy))
    steps = int(min(MOST_STEPS, REST_STEPS + 2.0 / slowest))
    way = max(abs(path.target_xx - path.start_xx), abs(path.target_yy - path.start_yy))
    stop = Stop(
        ratio=stress.tolerance,
        stress=stress.tolerance,
        strain=PLASTIC_STRAIN + 2.0 * way / MODULUS,
    )
    reason = specimen.relax(path, stop, damping=DAMPING, steps=steps)
    if reason != AT_REST:
        raise ModelError(_why(specimen, path, reason, normal_stiffness, friction, steps))
    return _product(specimen, packing, radius, normal_stiffness, is_static=False)


def specimen_of(
    packing: Packing,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds | None,
    joints: tuple[JointLine, ...] = (),
    seed: int = 0,
) -> Specimen:
    """The packed grains in units of mean radius and k_n, centred, with bonds and joints."""
    unit = float(packing.radius.mean())
    box = packing.box / unit
    x = packing.x / unit - 0.5 * (box[0] + box[1])
    y = packing.y / unit - 0.5 * (box[2] + box[3])
    radius = packing.radius / unit
    a, b = packing.contact_a, packing.contact_b
    cement = no_bonds()
    if bonds is not None:
        random = np.random.Generator(np.random.PCG64([seed, len(a)]))
        drawn = (
            strengths(mean / normal_stiffness, deviation / normal_stiffness, len(a), random)
            for mean, deviation in (
                (bonds.tensile_strength, bonds.tensile_deviation),
                (bonds.shear_strength, bonds.shear_deviation),
            )
        )
        tensile, shear = drawn
        modulus = 1.0 if bonds.modulus is None else bonds.modulus / normal_stiffness
        cement = install(
            bonds.kind,
            tensile_strength=tensile,
            shear_strength=shear,
            friction=bonds.friction,
            radius_multiplier=bonds.radius_multiplier,
            modulus=modulus,  # the grains' E_c = k_n, where it has none of its own
            stiffness_ratio=bonds.stiffness_ratio or stiffness_ratio,
            radius_a=radius[a],
            radius_b=radius[b],
            distance=np.hypot(x[b] - x[a], y[b] - y[a]),
        )
    limit = friction * packing.normal_force
    contacts = Pairs(
        start=np.searchsorted(a, np.arange(len(x) + 1)),
        other=b.astype(np.int32),
        shear=np.clip(packing.shear_force, -limit, limit) / unit,
        bond=np.arange(len(a), dtype=np.int32) if bonds else np.full(len(a), -1, np.int32),
        x=x,
        y=y,
    )
    middle = 0.5 * np.array([box[0] + box[1], box[2] + box[3]])
    traces = [_trace(line, unit, middle, normal_stiffness) for line in joints]
    return Specimen(
        at_rest(x, y, radius, scaled_mass(radius, _stiffest(cement, radius, traces), TIME_STEP)),
        box - np.repeat(middle, 2),
        ContactLaw(1.0, 1.0 / stiffness_ratio, friction),
        bonds=cement,
        known=contacts,
        traces=traces,
    )


def _trace(line: JointLine, unit: float, middle: np.ndarray, normal_stiffness: float) -> Trace:
    """A joint in units of mean radius and k_n; a stiffness per area is one over length more."""
    start, end = ((np.array(point) / unit - middle).tolist() for point in (line.start, line.end))
    joint = line.joint
    return Trace(
        start=(start[0], start[1]),
        end=(end[0], end[1]),
        normal_stiffness=joint.normal_stiffness * unit / normal_stiffness,
        shear_stiffness=joint.shear_stiffness * unit / normal_stiffness,
        friction=joint.friction,
        tensile_strength=joint.tensile_strength / normal_stiffness,
        cohesion=joint.cohesion / normal_stiffness,
        dilation=float(np.tan(joint.dilation_angle)),
    )


def _stiffest(cement: BondState, radius: np.ndarray, traces: list[Trace]) -> float:
    """Stiffness of the stiffest contact."""
    bonded = 1.0 + (
        float(np.maximum(cement.kn, cement.ks).max(initial=0.0))
        if cement.kind == PARALLEL_BONDS
        else 0.0
    )
    joined = [
        2.0 * radius.max() * max(trace.normal_stiffness, trace.shear_stiffness) for trace in traces
    ]
    return max(bonded, *joined) if joined else bonded


def straight_path(pressure: float, xx: float, yy: float) -> Servo:
    """Path of the wall stresses from an isotropic pressure to (xx, yy), all over k_n."""
    start_xx, start_yy = max(pressure, LEAST_START * xx), max(pressure, LEAST_START * yy)
    way = max(abs(xx - start_xx), abs(yy - start_yy), 1e-3 * xx)
    return Servo(
        start_xx=start_xx,
        start_yy=start_yy,
        target_xx=xx,
        target_yy=yy,
        pace=MODULUS * INERTIAL_NUMBER * TIME_STEP / way,
        band=BAND,
    )


def _why(
    specimen: Specimen, path: Servo, reason: int, kn: float, friction: float, steps: int
) -> str:
    """What a specimen that did not come to rest has reached, and what to try."""
    run = specimen.run
    xx, yy = (kn * value for value in setpoint(path, run.progress))
    reached = (
        f"at xx {xx:.4g} Pa, yy {yy:.4g} Pa (ratio {max(xx, yy) / min(xx, yy):.2f}:1, "
        f"friction {friction:g}"
    )
    if specimen.bonds.kind != NO_BONDS:
        broken = np.count_nonzero(specimen.bonds.state != INTACT)
        reached += f", {broken} of {len(specimen.bonds.state)} bonds broken"
    reached += ")"
    target = f"the target of {kn * path.target_xx:.4g} and {kn * path.target_yy:.4g} Pa"
    remedy = "try a smaller stress difference, more friction, a lower porosity, or "
    remedy += "bonds" if specimen.bonds.kind == NO_BONDS else "stronger bonds"
    if reason == STRAINED:
        strain = max(abs(run.strain_x), abs(run.strain_y))
        return (
            f"the specimen flows {reached}: it strained by {strain:.1%} on the way to {target}, "
            f"which lies beyond its strength; {remedy}"
        )
    return (
        f"the specimen did not come to rest in {steps} steps {reached}: {run.progress:.0%} of the "
        f"way to {target}, stresses off by {run.error:.1%}, unbalanced force {run.ratio:.1e} of "
        "the contact force. It is close to its strength, or its stress is far below the "
        f"{kn * path.start_xx:.2g} Pa at which it was packed; {remedy}"
    )


def _product(
    specimen: Specimen, packing: Packing, unit: float, normal_stiffness: float, *, is_static: bool
) -> StressState:
    """The state in SI units, at the place of the packing."""
    grains, box, sums = specimen.grains, specimen.box, specimen.sums
    if is_static:  # its left and bottom walls stood
        shift_x, shift_y = 0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])
        grains.x[:] -= shift_x
        grains.y[:] -= shift_y
        box -= np.array([shift_x, shift_x, shift_y, shift_y])
    centre = 0.5 * np.array([packing.box[0] + packing.box[1], packing.box[2] + packing.box[3]])
    contacts, cracks = records.carried(specimen), records.broken(specimen)
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
        idle_joints=np.array(specimen.idle_traces),
        box=unit * box + np.repeat(centre, 2),
        stress=normal_stiffness * virial / (width * height),
        wall_stress=normal_stiffness * walls,
        unbalanced_ratio=np.array(specimen.run.ratio),
        broken_bonds=np.array(np.count_nonzero(specimen.bonds.state != INTACT)),
        static=np.array(int(is_static)),
        steps=np.array(specimen.steps),
    )
