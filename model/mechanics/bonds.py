"""Cement between grains: contact bonds and parallel bonds (Potyondy & Cundall 2004).

A *contact bond* lets the contact carry tension and shear without slip until the stress over
its cross-section, force / (2 R̄), reaches a strength. A *parallel bond* is an elastic beam beside
the grain contact that carries force and moment, with stiffnesses such that its modulus equals
the grains' and the ratio of its stiffnesses the contact's. Bonds carry nothing when they are
installed. A broken bond never heals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.compile import kernel
from model.mechanics.grains import Array
from model.mechanics.laws import bond_shear, bond_tension

NO_BONDS, CONTACT_BONDS, PARALLEL_BONDS = 0, 1, 2  # kinds
INTACT, BROKEN_IN_TENSION, BROKEN_IN_SHEAR = 0, 1, 2  # states


class BondState(NamedTuple):
    """All bonds of a specimen, m of them, of one kind."""

    kind: int
    tensile_strength: float  # stress
    shear_strength: float
    half_width: Array  # (m,) R̄
    length: Array  # (m,) distance of the centres at installation
    kn: Array  # (m,) normal stiffness of a parallel bond, force per length
    ks: Array  # (m,) its shear stiffness
    kr: Array  # (m,) its bending stiffness, moment per angle
    shear: Array  # (m,) its shear force
    moment: Array  # (m,) its moment
    state: Array  # (m,) int8


def no_bonds() -> BondState:
    """The bonds of unbonded grains."""
    none = np.empty(0)
    return BondState(
        NO_BONDS, 0.0, 0.0, none, none, none, none, none, none, none, np.empty(0, np.int8)
    )


def install(
    kind: str,
    *,
    tensile_strength: float,
    shear_strength: float,
    radius_multiplier: float,
    kn: float,
    ks: float,
    radius_a: Array,
    radius_b: Array,
    distance: Array,
) -> BondState:
    """Unstressed bonds between grains of radii (m,) at centre distances (m,).

    Half-width R̄ = λ min(R_a, R_b), cross-section A = 2 R̄ and I = 2 R̄³ / 3 for unit depth;
    k̄_n = Ē_c / (R_a + R_b) with Ē_c = E_c = k_n / 2 (ibid., Eqs 12, 13, 21, 22).
    """
    half = np.minimum(radius_a, radius_b) * radius_multiplier
    stiffness = 0.5 * kn / (radius_a + radius_b) * 2.0 * half  # k̄_n A
    return BondState(
        kind=CONTACT_BONDS if kind == "contact" else PARALLEL_BONDS,
        tensile_strength=float(tensile_strength),
        shear_strength=float(shear_strength),
        half_width=half,
        length=distance.copy(),
        kn=stiffness,
        ks=stiffness * (ks / kn),
        kr=stiffness * half**2 / 3.0,  # k̄_n I
        shear=np.zeros(len(half)),
        moment=np.zeros(len(half)),
        state=np.zeros(len(half), np.int8),
    )


@kernel
def contact_bond_state(bonds: BondState, b: int, fn: float, fs: float) -> int:
    """State of contact bond b under these contact forces."""
    if bond_tension(fn, 0.0, bonds.half_width[b]) > bonds.tensile_strength:
        return BROKEN_IN_TENSION
    if bond_shear(fs, bonds.half_width[b]) > bonds.shear_strength:
        return BROKEN_IN_SHEAR
    return INTACT


@kernel
def load_parallel_bond(
    bonds: BondState, b: int, distance: float, us: float, rotation: float
) -> tuple[float, float, float]:
    """Advance parallel bond b by a tangential step and a relative rotation of its ends.

    Returns its normal force, shear force and moment, all zero if it breaks.
    """
    fn = bonds.kn[b] * (bonds.length[b] - distance)
    fs = bonds.shear[b] - bonds.ks[b] * us
    moment = bonds.moment[b] - bonds.kr[b] * rotation
    if bond_tension(fn, moment, bonds.half_width[b]) > bonds.tensile_strength:
        bonds.state[b] = BROKEN_IN_TENSION
    elif bond_shear(fs, bonds.half_width[b]) > bonds.shear_strength:
        bonds.state[b] = BROKEN_IN_SHEAR
    if bonds.state[b] != INTACT:
        fn = fs = moment = 0.0
    bonds.shear[b] = fs
    bonds.moment[b] = moment
    return fn, fs, moment
