"""The rock in units of mean radius and k_n: packed grains, cement on them, joints through it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.mechanics.contact.bonds import (
    PARALLEL_BONDS,
    BondState,
    install,
    no_bonds,
    strengths,
)
from demflow.model.mechanics.contact.grains import Array, at_rest, scaled_mass
from demflow.model.mechanics.contact.joints import Trace
from demflow.model.mechanics.contact.law import (
    Hertz,
    Law,
    Linear,
    Rolling,
    presses,
    relative_radius,
    stiffest,
)
from demflow.model.mechanics.contact.neighbours import Pairs, find_pairs, no_pairs
from demflow.model.mechanics.motion.equilibrium import TIME_STEP, Specimen
from demflow.model.mechanics.specimen.measures import listed
from demflow.model.products import Packing
from demflow.model.scene import Bonds, Contact, JointLine

MOST_DAMPING = 0.7  # local damping that any stage moves grains with


class Scaled(NamedTuple):
    """Packed grains in units of their mean radius, the box around the origin."""

    unit: float  # m: the mean radius
    x: Array  # (n,)
    y: Array
    radius: Array
    box: Array  # (4,)
    middle: Array  # (2,) of the box, where the packing has it


def scaled(packing: Packing) -> Scaled:
    """The packed grains in units of their mean radius."""
    unit = float(packing.radius.mean())
    box = packing.box / unit
    middle = 0.5 * np.array([box[0] + box[1], box[2] + box[3]])
    return Scaled(
        unit,
        packing.x / unit - middle[0],
        packing.y / unit - middle[1],
        packing.radius / unit,
        box - np.repeat(middle, 2),
        middle,
    )


class Elasticity(NamedTuple):
    """How contacts respond: the law in units of k_n, and what these are."""

    law: Law
    normal_stiffness: float  # k_n, Pa
    bond_modulus: float  # of parallel bonds that have none of their own, over k_n


def elasticity(
    contact: Contact | None,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    pressure: float,
) -> Elasticity:
    """The law of contact of a scene.

    Of a linear contact k_n is given; of a Hertz-Mindlin one it is the tangent stiffness of two
    grains of mean radius under the force 2 r̄ p that a `pressure` p (Pa) puts on them, and
    `normal_stiffness` is the grains' Young's modulus.

    Parameters
    ----------
    contact : a law other than the linear one, or None
    normal_stiffness : k_n, N/m per metre of depth; Young’s modulus of Hertz-Mindlin grains, Pa
    stiffness_ratio : k_n / k_s
    friction : Coulomb coefficient of contacts
    pressure : p, Pa, under which a Hertz contact has its stiffness
    """
    if contact is None:
        law: Law = Linear(1.0, 1.0 / stiffness_ratio, friction)
    elif contact.law == "rolling":
        law = Rolling(1.0, 1.0 / stiffness_ratio, friction, contact.rolling_friction or 0.0)
    else:
        assert contact.law == "hertz", contact.law
        nu = contact.poissons_ratio or 0.0
        effective = normal_stiffness / (2.0 * (1.0 - nu**2))
        overlap = (3.0 * np.sqrt(2.0) * pressure / effective) ** (2.0 / 3.0)
        unit = effective * np.sqrt(0.5 * overlap)
        shear = 2.0 * (1.0 - nu) / (2.0 - nu)
        law = Hertz(1.0, float(effective / unit), shear, friction)
        return Elasticity(law, float(unit), float(normal_stiffness / unit))
    return Elasticity(law, normal_stiffness, 1.0)


def build_specimen(
    packing: Packing,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds | None,
    joints: tuple[JointLine, ...] = (),
    seed: int = 0,
    elastic: Elasticity | None = None,
) -> Specimen:
    """The packed grains in units of mean radius and k_n, centred, with bonds and joints.

    Contacts are linear unless `elastic` says otherwise, which then has `normal_stiffness` too.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    normal_stiffness : k_n of contacts, N/m per metre of depth
    stiffness_ratio : k_n / k_s
    friction : Coulomb coefficient of contacts
    bonds : cement on all contacts, or None
    joints : smooth joints along straight traces
    seed : of the bonds’ strengths
    elastic : law of contact with its scales; None: linear
    """
    if elastic is None:
        elastic = elasticity(None, normal_stiffness, stiffness_ratio, friction, 0.0)
    normal_stiffness = elastic.normal_stiffness
    unit, x, y, radius, box, middle = scaled(packing)
    a, b = packing.contact_a, packing.contact_b
    limit = friction * packing.normal_force
    shear = np.clip(packing.shear_force, -limit, limit) / unit
    cement = no_bonds()
    if bonds is not None:
        if bonds.installation_gap > 0.0:
            a, b, shear = _with_near(a, b, shear, x, y, radius, bonds.installation_gap)
        distance = np.hypot(x[b] - x[a], y[b] - y[a])
        cement = cemented(bonds, radius[a], radius[b], distance, elastic, stiffness_ratio, seed)
    contacts = Pairs(
        start=np.searchsorted(a, np.arange(len(x) + 1)),
        one=a.astype(np.int32),
        other=b.astype(np.int32),
        shear=shear,
        moment=np.zeros(len(a)),
        bond=np.arange(len(a), dtype=np.int32) if bonds else np.full(len(a), -1, np.int32),
        x=x,
        y=y,
    )
    traces = [_trace(line, unit, middle, normal_stiffness) for line in joints]
    law = elastic.law
    mass = scaled_mass(radius, _stiffest(law, cement, radius, traces), TIME_STEP)
    mass = np.maximum(
        mass, _least_mass(law, cement, np.bincount(np.append(a, b), minlength=len(x)))
    )
    return Specimen(
        at_rest(x, y, radius, mass),
        box,
        law,
        bonds=cement,
        known=contacts,
        traces=traces,
    )


def packed_pressure(packing: Packing, law: Law) -> float:
    """Pressure of the packed grains over k_n, by a law of contact; nothing moves."""
    if isinstance(law, Linear | Rolling):
        return float(packing.packing_pressure)
    unit, a, b = float(packing.radius.mean()), packing.contact_a, packing.contact_b
    overlap = packing.normal_force / unit
    forces = presses(law, overlap, relative_radius(packing.radius[a], packing.radius[b]) / unit)
    return float(packing.packing_pressure) * float(forces.sum() / max(overlap.sum(), 1e-300))


def cemented(
    bonds: Bonds,
    radius_a: Array,
    radius_b: Array,
    distance: Array,
    elastic: Elasticity,
    stiffness_ratio: float,
    seed: int,
) -> BondState:
    """Bonds between grains of radii (m,), a distance apart.

    Parameters
    ----------
    bonds : cement
    radius_a : radii of the first grains, (b,) m
    radius_b : of the second, (b,) m
    distance : of their centres, (b,) m
    elastic : law of contact with its scales
    stiffness_ratio : k_n / k_s
    seed : of the strengths
    """
    normal_stiffness = elastic.normal_stiffness
    random = np.random.Generator(np.random.PCG64([seed, len(distance)]))
    tensile, shear = (
        strengths(mean / normal_stiffness, deviation / normal_stiffness, len(distance), random)
        for mean, deviation in (
            (bonds.tensile_strength, bonds.tensile_deviation),
            (bonds.shear_strength, bonds.shear_deviation),
        )
    )
    return install(
        bonds.kind,
        tensile_strength=tensile,
        shear_strength=shear,
        friction=bonds.friction,
        radius_multiplier=bonds.radius_multiplier,
        modulus=(
            elastic.bond_modulus if bonds.modulus is None else bonds.modulus / normal_stiffness
        ),
        stiffness_ratio=bonds.stiffness_ratio or stiffness_ratio,
        radius_a=radius_a,
        radius_b=radius_b,
        distance=distance,
    )


def _with_near(
    a: Array,
    b: Array,
    shear: Array,
    x: Array,
    y: Array,
    radius: Array,
    gap: float,
) -> tuple[Array, Array, Array]:
    """Contacts (a, b) with their shear forces, and pairs up to a gap apart, sorted by (a, b)."""
    n = len(x)
    grains = at_rest(x, y, radius, np.ones(n))
    known = a * n + b
    near_a, near_b = listed(find_pairs(grains, gap, no_pairs(n)))
    every = np.union1d(known, near_a * n + near_b)
    held = np.zeros(len(every))
    held[np.searchsorted(every, known)] = shear
    return every // n, every % n, held


def _trace(line: JointLine, unit: float, middle: Array, normal_stiffness: float) -> Trace:
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


def _least_mass(law: Law, cement: BondState, contacts: Array) -> Array:
    """Mass (n,) at which grains with so many `contacts` (n,) are calm under local damping.

    Grains that move against all their neighbours have ω² = z (k_n + k_s) / m, those that turn with
    them 2 z k_s / m. Local damping α enlarges the force that stops them by 1 + α, so that leapfrog
    needs Δt ω √(1 + α) ≤ 2: in a regular lattice they do so all at once, and never come to rest.
    """
    if not isinstance(law, Linear | Rolling):
        return np.zeros(len(contacts))
    normal, shear = law.kn, law.ks
    if cement.kind == PARALLEL_BONDS:
        normal = normal + cement.kn.max(initial=0.0)
        shear = shear + cement.ks.max(initial=0.0)
    stiffness = max(normal + shear, 2.0 * shear)
    found: Array = 0.25 * (1.0 + MOST_DAMPING) * TIME_STEP**2 * stiffness * contacts
    return found


def _stiffest(law: Law, cement: BondState, radius: Array, traces: list[Trace]) -> float:
    """Stiffness of the stiffest contact, along its normal or across it.

    Bending adds nothing: k_r is at most k_n r² / 3, and grains that turn against each other
    bend a bond that they do not shear.
    """
    bonded = float(stiffest(law)) + (
        float(np.maximum(cement.kn, cement.ks).max(initial=0.0))
        if cement.kind == PARALLEL_BONDS
        else 0.0
    )
    joined = [
        2.0 * radius.max() * max(trace.normal_stiffness, trace.shear_stiffness) for trace in traces
    ]
    return max(bonded, *joined) if joined else bonded
