"""The stages *unit_loads* and *stress*: packed grains, bonded or not, loaded by four walls.

Bonded grains are tried by the static solver (`static`), whose states do not depend on a path
but for slip at cemented contacts; where a bond would break, and without bonds, grains are
moved along a path.

Path: bonds are installed on the contacts of the packed state, then the stresses of the walls
move on a straight line from those of the packed state (equal on all walls; LEAST_START of the
target in a lattice, which starts without force) to the target. Grains first come to rest at the
start of the path. Its inertial number I = ε̇ √(m/p) is INERTIAL_NUMBER, less the further grains
are from the equilibrium that is asked for (CALM), and the path waits while the stresses lag
behind by more than BAND.
So the state depends on this path, and little on the dynamics that follow it: at a tolerance of
1e-4, damping, gain or half the increments change the forces of unbonded packings (5,000 grains,
3.86 to 3.90 contacts a grain, friction 0.5) by up to 0.2 % (L2) at 1.5:1 and 0.6 % at 1.9:1,
where the strength is near 2.4:1; one of five further packings differed by 0.7 %. At 3.80
contacts a grain and 1.9:1 the forces are less unique: they differ by up to 1.4 %, by noise of
1e-8 radii alone by up to 0.7 %. What is left comes from small groups of grains that snap;
slower paths do not lessen it.

Units inside are the mean radius, k_n and the mass of a grain; stresses are σ / k_n.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.bonds import INTACT, NO_BONDS
from demflow.model.mechanics.contact.grains import Array, at_rest
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.loading.ground import dig, least_pressure, weigh, with_holes
from demflow.model.mechanics.loading.state import held_state, state_of
from demflow.model.mechanics.motion.equilibrium import (
    AT_REST,
    OSCILLATES,
    STRAINED,
    TIME_STEP,
    Specimen,
    Stop,
)
from demflow.model.mechanics.motion.servo import TOO_STIFF, Servo, advanced, setpoint
from demflow.model.mechanics.specimen.records import overlap_of
from demflow.model.mechanics.specimen.rock import (
    Elasticity,
    build_specimen,
    cemented,
    elasticity,
    packed_pressure,
    scaled,
)
from demflow.model.mechanics.static import static
from demflow.model.mechanics.static.sticking import StickingTrial
from demflow.model.outcome import ModelError
from demflow.model.products import Packing, StressState, UnitLoads
from demflow.model.scene import Bonds, Contact, Ground, JointLine, Stress

INERTIAL_NUMBER = 5e-5
CALM = 1.0  # unbalance, over what a run allows at its end, at which its path goes half as fast
BAND = 0.02  # lag of the stresses behind the path at which it waits, relative
LEAST_START = 0.01  # of the target stress: where a path starts at least
MODULUS = 0.5  # stress per strain that the pace assumes, over k_n
DAMPING = 0.5  # local
MOST_STEPS = 200_000
REST_STEPS = 100_000  # besides those of the path: grains without friction took up to 40,000
LEAST_RATIO = 1e-6  # mean unbalanced over mean contact force that explicit runs reach well
PLASTIC_STRAIN = 0.01  # beyond twice the elastic one, at which a specimen counts as flowing


def unit_loads(
    packing: Packing,
    *,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds,
    ground: Ground | None = None,
) -> UnitLoads:
    """Linear response of the packed, bonded grains: what all their stress states share.

    Parameters as for `load`; strengths and stiffness do not matter, k_n is the unit, also of
    `ground`.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    stiffness_ratio : k_n / k_s
    friction : Coulomb coefficient of contacts
    bonds : cement on all contacts of the packed state
    ground : holes and weight, over k_n, or None
    """
    specimen = build_specimen(packing, 1.0, stiffness_ratio, friction, bonds)
    if ground is not None:
        specimen, _ = dig(specimen, packing, ground)
    pressure = max(float(packing.packing_pressure), least_pressure(specimen))
    return static.response(specimen, np.array([pressure, pressure, 0.0]))


def load(
    packing: Packing,
    units: UnitLoads | None = None,
    *,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds | None,
    contact: Contact | None = None,
    joints: tuple[JointLine, ...] = (),
    seed: int = 0,
    stress: Stress,
    ground: Ground | None = None,
) -> StressState:
    """Grains in equilibrium under the walls' stresses, along the path stated above.

    Where there is a `ground`, the weight of the grains acts along the path, holes are dug at its
    end, and the grains come to rest anew under the same stresses.

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
    contact : a law of contact other than the linear one; of a Hertz-Mindlin one
        `normal_stiffness` is the grains' Young's modulus.
    joints : smooth joints along straight traces; their contacts have no other cement.
    seed : of the bonds' strengths.
    stress : target stresses, Pa, compression positive; with a weight those at mid-height.
    ground : weight of the grains and holes between them, in SI; `units` are then theirs.

    Raises
    ------
    ModelError : the specimen flows (beyond its strength), its grains pass through one another, or
        it did not come to rest in the number of steps that is allowed for; the text says how far
        it came and what to try.
    """
    elastic = elasticity(
        contact, normal_stiffness, stiffness_ratio, friction, max(stress.xx, stress.yy)
    )
    rock = _Rock(
        packing, elastic, stiffness_ratio, friction, bonds, joints, seed,
        None if ground is None else ground.over(elastic.normal_stiffness),
    )  # fmt: skip
    wanted = np.array(stress.components) / elastic.normal_stiffness
    why = "there are no bonds" if bonds is None else "there are joints"
    if contact is not None:
        why = "contacts are not linear, or resist rolling"
    if units is not None and bonds is not None and contact is None and stress.method != "explicit":
        found = _by_unit_loads(rock, bonds, units, wanted, stress.tolerance)
        if not isinstance(found, str):
            return found
        why = found
    if stress.method == "static":
        raise ModelError(
            f"the static solver does not reach these stresses: {why}; try stress.method auto, "
            "stronger bonds or smaller stresses"
        )
    if wanted[2] != 0.0:
        raise ModelError(
            "a stress at an angle to the walls needs grains that stay bonded (the static solver "
            f"finds it), but {why}; leave stress.angle out and turn fractures, wells and probes by "
            "minus the angle instead, or try stronger bonds or smaller stresses"
        )
    return _along_a_path(rock, wanted, stress.tolerance)


class _Rock(NamedTuple):
    """What is loaded; parameters as for `load`."""

    packing: Packing
    elastic: Elasticity
    stiffness_ratio: float
    friction: float
    bonds: Bonds | None
    joints: tuple[JointLine, ...]
    seed: int
    ground: Ground | None  # over k_n

    def built(self) -> Specimen:
        """The packed grains, with cement and joints."""
        kn = self.elastic.normal_stiffness
        return build_specimen(self.packing, kn, *self[2:7], self.elastic)

    def dug(self, specimen: Specimen) -> tuple[Specimen, Array]:
        """The specimen without what the holes take, and which of the grains are kept."""
        if self.ground is None:
            return specimen, np.ones(len(self.packing.x), bool)
        return dig(specimen, self.packing, self.ground)

    def state(self, specimen: Specimen, kept: Array, found: static.Found | None) -> StressState:
        """The product, of a state that the static solver `found` or the explicit one."""
        state = state_of(specimen, self.packing, self.elastic.normal_stiffness, found)
        return with_holes(state, kept)


def _by_unit_loads(
    rock: _Rock, bonds: Bonds, units: UnitLoads, wanted: Array, tolerance: float
) -> StressState | str:
    """The state by the static solver, or why it finds none."""
    if rock.ground is None:
        trial = _held(rock.packing, units, rock.elastic, rock.stiffness_ratio, bonds, rock.seed)
        found = static.superpose(trial, units, wanted, tolerance)
        if found.reached:
            return held_state(trial, found, rock.packing, rock.elastic.normal_stiffness)
        if found.breaks:
            return found.why
    specimen, kept = rock.dug(rock.built())
    found = static.equilibrium(specimen, units, wanted, tolerance)
    return rock.state(specimen, kept, found) if found.reached else found.why


def _along_a_path(rock: _Rock, wanted: Array, tolerance: float) -> StressState:
    """The state by the explicit solver; holes are dug at the end of the path."""
    specimen, kn = rock.built(), rock.elastic.normal_stiffness
    pressure = packed_pressure(rock.packing, rock.elastic.law)
    path = straight_path(pressure, float(wanted[0]), float(wanted[1]))
    ratio = tolerance
    if rock.ground is not None:
        weigh(specimen, rock.ground.unit_weight * float(rock.packing.radius.mean()))
        path = _carrying_weight(path, specimen)
        ratio = _fine_enough(ratio, specimen, wanted)
    ends = (path.start_xx, path.start_yy), (path.target_xx, path.target_yy)
    slowest = min(advanced(path, *end, ratio=0.0) for end in ends)
    steps = int(min(MOST_STEPS, REST_STEPS + 2.0 / slowest))
    way = max(abs(path.target_xx - path.start_xx), abs(path.target_yy - path.start_yy))
    stop = Stop(
        ratio=ratio,
        stress=tolerance,
        strain=PLASTIC_STRAIN + 2.0 * way / MODULUS,
    )
    specimen.watch = overlap_of  # grains that are too soft are told before the path's end
    reason = specimen.relax(path, stop, damping=DAMPING, steps=steps)
    if reason != AT_REST:
        raise ModelError(_why(specimen, path, reason, kn, rock.friction, steps))
    specimen, kept = rock.dug(specimen)
    if not kept.all():
        end = path.target_xx, path.target_yy
        held = _carrying_weight(path_between(end, end), specimen)
        reason = specimen.relax(held, stop, damping=DAMPING, steps=REST_STEPS)
        if reason != AT_REST:
            why = _why(specimen, held, reason, kn, rock.friction, REST_STEPS)
            raise ModelError(f"around the holes: {why}")
    return rock.state(specimen, kept, None)


def _carrying_weight(path: Servo, specimen: Specimen) -> Servo:
    """A path on which the bottom wall bears the grains' weight, and the top wall stays pressed."""
    least = least_pressure(specimen)
    start_xx = max(path.start_xx, min(least, path.target_xx))
    start_yy = max(path.start_yy, min(least, path.target_yy))
    lift = -0.5 * float(specimen.grains.load_y.sum())
    way = path_between((start_xx, start_yy), (path.target_xx, path.target_yy))
    return way._replace(lift=lift)


def _fine_enough(tolerance: float, specimen: Specimen, wanted: Array) -> float:
    """Unbalance, over the contact force, that is small beside the weight of a grain too."""
    weights = -specimen.grains.load_y
    if not weights.any():
        return tolerance
    force = 2.0 * float(wanted[:2].mean())  # of a contact, in mean radii
    return min(tolerance, max(LEAST_RATIO, 0.1 * float(weights.mean()) / force))


def _held(
    packing: Packing,
    units: UnitLoads,
    elastic: Elasticity,
    stiffness_ratio: float,
    bonds: Bonds,
    seed: int,
) -> StickingTrial:
    """The packed grains with their cement, to be displaced; parameters as for `load`."""
    _, x, y, radius, box, _ = scaled(packing)
    a, b = units.contact_a, units.contact_b
    cement = cemented(
        bonds, radius[a], radius[b], units.contact_distance, elastic, stiffness_ratio, seed
    )
    assert isinstance(elastic.law, Linear)
    return StickingTrial(at_rest(x, y, radius, np.ones(len(x))), box, elastic.law, cement, units)


def straight_path(pressure: float, xx: float, yy: float) -> Servo:
    """Path of the wall stresses from an isotropic pressure to (xx, yy), all over k_n.

    Parameters
    ----------
    pressure : isotropic, at the start, over k_n
    xx, yy : stress at the end, over k_n
    """
    start = max(pressure, LEAST_START * xx), max(pressure, LEAST_START * yy)
    return path_between(start, (xx, yy))


def path_between(start: tuple[float, float], end: tuple[float, float]) -> Servo:
    """Straight path of the wall stresses (xx, yy) over k_n, at the pace stated above."""
    (start_xx, start_yy), (xx, yy) = start, end
    way = max(abs(xx - start_xx), abs(yy - start_yy), 1e-3 * xx)
    return Servo(
        start_xx=start_xx,
        start_yy=start_yy,
        target_xx=xx,
        target_yy=yy,
        pace=MODULUS * INERTIAL_NUMBER * TIME_STEP / way,
        band=BAND,
        calm=CALM,
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
    if reason == OSCILLATES:
        return (
            f"the servo oscillates {reached}: the stresses swing by {run.error:.0%} about their "
            f"targets without decay, for {TOO_STIFF}, or stress.method static"
        )
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
