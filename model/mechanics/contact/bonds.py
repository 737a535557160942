"""Cement between grains: contact bonds and parallel bonds (Potyondy & Cundall 2004).

A *contact bond* lets the contact carry tension and shear without slip until the stress over
its cross-section, force / (2 R̄), reaches a strength; between grains that do not touch it is
as stiff as a contact, and counts from their distance at installation. A *parallel bond* is an
elastic beam beside the grain contact that carries force and moment, with a modulus and a ratio of
stiffnesses of its own. Bonds carry nothing when they are installed. A broken bond never heals;
when, where and how it broke is kept with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.contact.laws import bond_shear, bond_shear_strength, bond_tension

NO_BONDS, CONTACT_BONDS, PARALLEL_BONDS = 0, 1, 2  # kinds
INTACT, BROKEN_IN_TENSION, BROKEN_IN_SHEAR = 0, 1, 2  # states


class Cracks(NamedTuple):
    """When and where each of m bonds or joint contacts broke; meaningless while it holds."""

    step: Array  # (m,) int64 since the specimen was made, −1 while it holds
    mode: Array  # (m,) int8 BROKEN_IN_TENSION or BROKEN_IN_SHEAR
    x: Array  # (m,) contact
    y: Array
    width: Array  # (m,) of the box at that time
    height: Array


class BondState(NamedTuple):
    """All bonds of a specimen, m of them, of one kind."""

    kind: int
    friction: float  # by which compression adds to the shear strength
    tensile_strength: Array  # (m,) stress
    shear_strength: Array  # (m,)
    half_width: Array  # (m,) R̄
    length: Array  # (m,) distance of the centres at which its normal force is zero
    kn: Array  # (m,) normal stiffness of a parallel bond, force per length
    ks: Array  # (m,) its shear stiffness
    kr: Array  # (m,) its bending stiffness, moment per angle
    shear: Array  # (m,) its shear force
    moment: Array  # (m,) its moment
    state: Array  # (m,) int8
    cracks: Cracks


def no_cracks(m: int) -> Cracks:
    """Room for what may break."""
    places = np.zeros((4, m))
    return Cracks(np.full(m, -1, np.int64), np.zeros(m, np.int8), *places)


def no_bonds() -> BondState:
    """The bonds of unbonded grains."""
    fields = [np.empty(0) for _ in range(9)]
    return BondState._make([NO_BONDS, 0.0, *fields, np.empty(0, np.int8), no_cracks(0)])


def strengths(mean: float, deviation: float, count: int, random: np.random.Generator) -> Array:
    """Normally distributed strengths (count,); what would be negative is zero.

    Parameters
    ----------
    mean : Pa
    deviation : standard deviation, Pa
    count : how many bonds
    random : source of randomness
    """
    if deviation == 0.0:
        return np.full(count, float(mean))
    return np.maximum(random.normal(mean, deviation, count), 0.0)


def install(
    kind: str,
    *,
    tensile_strength: Array,
    shear_strength: Array,
    friction: float = 0.0,
    radius_multiplier: float = 1.0,
    modulus: float,
    stiffness_ratio: float,
    radius_a: Array,
    radius_b: Array,
    distance: Array,
) -> BondState:
    """Unstressed bonds between grains of radii (m,) at centre distances (m,).

    Half-width R̄ = λ min(R_a, R_b), cross-section A = 2 R̄ and I = 2 R̄³ / 3 for unit depth;
    k̄_n = Ē_c / (R_a + R_b) with `modulus` Ē_c and k̄_n / k̄_s the `stiffness_ratio` (ibid.,
    Eqs 12, 13, 22). Strengths (m,) or one for all; a contact bond reads nothing else.

    Parameters
    ----------
    kind : contact or parallel
    tensile_strength, shear_strength : (b,) or one, Pa
    friction : μ̄ of the cement
    radius_multiplier : λ
    modulus : Ē_c, Pa
    stiffness_ratio : k̄_n / k̄_s
    radius_a : radii of the first grains, (b,) m
    radius_b : of the second, (b,) m
    distance : of their centres, (b,) m
    """
    reach = radius_a + radius_b
    half = np.minimum(radius_a, radius_b) * radius_multiplier
    stiffness = modulus / reach * 2.0 * half  # k̄_n A
    return BondState(
        kind=CONTACT_BONDS if kind == "contact" else PARALLEL_BONDS,
        friction=float(friction),
        tensile_strength=np.full(len(half), tensile_strength, dtype=float),
        shear_strength=np.full(len(half), shear_strength, dtype=float),
        half_width=half,
        length=np.maximum(distance, reach) if kind == "contact" else distance.copy(),
        kn=stiffness,
        ks=stiffness / stiffness_ratio,
        kr=stiffness * half**2 / 3.0,  # k̄_n I
        shear=np.zeros(len(half)),
        moment=np.zeros(len(half)),
        state=np.zeros(len(half), np.int8),
        cracks=no_cracks(len(half)),
    )


@kernel
def bond_state(bonds: BondState, b: int, fn: float, fs: float, moment: float) -> int:
    """State of bond b under this force and moment.

    Parameters
    ----------
    bonds : bonds (b,)
    b : number of the bond
    fn : normal force, compression positive
    fs : shear force
    moment : bending moment
    """
    half = bonds.half_width[b]
    if bond_tension(fn, moment, half) > bonds.tensile_strength[b]:
        return BROKEN_IN_TENSION
    held = bond_shear_strength(bonds.shear_strength[b], bonds.friction, fn, half)
    if bond_shear(fs, half) > held:
        return BROKEN_IN_SHEAR
    return INTACT


@kernel
def load_parallel_bond(
    bonds: BondState, b: int, distance: float, us: float, rotation: float
) -> tuple[float, float, float]:
    """Advance parallel bond b by a tangential step and a relative rotation of its ends.

    Returns its normal force, shear force and moment, all zero if it breaks.

    Parameters
    ----------
    bonds : bonds (b,)
    b : number of the bond
    distance : of the centres
    us : tangential step of b past a
    rotation : of b relative to a in the step
    """
    fn = bonds.kn[b] * (bonds.length[b] - distance)
    fs = bonds.shear[b] - bonds.ks[b] * us
    moment = bonds.moment[b] - bonds.kr[b] * rotation
    state = bond_state(bonds, b, fn, fs, moment)
    if state != INTACT:
        bonds.state[b] = state
        fn = fs = moment = 0.0
    bonds.shear[b] = fs
    bonds.moment[b] = moment
    return fn, fs, moment


@kernel
def note_crack(
    cracks: Cracks, b: int, mode: int, step: int, x: float, y: float, box: Array
) -> None:
    """Note that b broke now at (x, y).

    Parameters
    ----------
    cracks : list of cracks, which is added to
    b : number of the bond
    mode : 1 in tension, 2 in shear
    step : number of the time step
    x, y : place
    box : walls xmin, xmax, ymin, ymax, (4,)
    """
    cracks.step[b], cracks.mode[b] = step, mode
    cracks.x[b], cracks.y[b] = x, y
    cracks.width[b], cracks.height[b] = box[1] - box[0], box[3] - box[2]
