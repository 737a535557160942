"""Elastic moduli of bonded grains, free of walls: the rim follows a strain, the rest is solved."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.mechanics.static.load_carrying import contacts_of
from demflow.model.mechanics.static.stiffness import (
    ANCHOR,
    Contacts,
    factorise,
    matrix,
    solve,
    springs,
)
from demflow.model.outcome import ModelError
from demflow.model.products import Moduli, Packing
from demflow.model.scene import Bonds

RIM = 4.0  # mean radii from the walls in which grains follow the strain
REFINEMENTS = 4
STRAINS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # xx, yy, γ


def elastic_moduli(
    packing: Packing,
    *,
    normal_stiffness: float,
    stiffness_ratio: float,
    friction: float,
    bonds: Bonds,
) -> Moduli:
    """Moduli of a packing that is bonded as `stress.load` does, for small strains.

    Contacts are those of the packed state, with the stiffness that they have there (`springs`).

    Grains within RIM of the walls follow the strain without rotation, the others find
    equilibrium. Stress is the mean over these, Σ f ⊗ l / 2 over their areas π r² / (1 − φ).

    Parameters
    ----------
    packing : the packed state.
    normal_stiffness : k_n of contacts, N/m per metre of depth.
    stiffness_ratio : k_n / k_s.
    friction : Coulomb coefficient; without effect before anything slips.
    bonds : cement on all contacts of the packed state; its strengths do not matter.

    Raises ModelError where no grain lies far enough from the walls.
    """
    specimen = build_specimen(packing, normal_stiffness, stiffness_ratio, friction, bonds)
    grains, box, n = specimen.grains, specimen.box, len(specimen.grains.x)
    none = np.empty(0, np.int64)
    contacts = contacts_of(specimen)._replace(walls=(none, none, none, none))
    a, b = contacts.a, contacts.b
    stiffness = matrix(grains, contacts, specimen.bonds, specimen.law)[: 3 * n, : 3 * n]
    inside = (
        (grains.x > box[0] + RIM)
        & (grains.x < box[1] - RIM)
        & (grains.y > box[2] + RIM)
        & (grains.y < box[3] - RIM)
    )
    if not np.any(inside):
        raise ModelError("too few grains for elastic_moduli; raise grains.count")
    free, fixed = np.flatnonzero(np.repeat(inside, 3)), np.flatnonzero(np.repeat(~inside, 3))
    inner = csc_array(stiffness[free][:, free])
    factor = factorise(inner)
    anchor = ANCHOR * specimen.law.kn
    dx, dy = grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]
    weight = 0.5 * (inside[a].astype(float) + inside[b])
    solid = np.pi * np.sum(grains.radius[inside] ** 2)
    area = solid / (1.0 - float(packing.porosity))
    columns = []
    for xx, yy, shear in STRAINS:
        u = np.zeros((n, 3))
        u[:, 0] = xx * grains.x + 0.5 * shear * grains.y
        u[:, 1] = yy * grains.y + 0.5 * shear * grains.x
        flat = u.ravel()
        load = -(stiffness[free][:, fixed] @ flat[fixed])
        found = solve(factor, load)
        for _ in range(REFINEMENTS):  # without the anchors
            found += solve(factor, load - inner @ found + anchor * found)
        flat[free] = found
        fx, fy = _forces(flat.reshape(n, 3), contacts, specimen)
        columns.append(
            [
                np.sum(weight * fx * dx) / area,
                np.sum(weight * fy * dy) / area,
                0.5 * np.sum(weight * (fx * dy + fy * dx)) / area,
            ]
        )
    tensor = normal_stiffness * np.array(columns).T
    compliance = np.linalg.inv(tensor)
    modulus = 0.5 * (1.0 / compliance[0, 0] + 1.0 / compliance[1, 1])
    ratio = -0.5 * (compliance[0, 1] + compliance[1, 0]) * modulus
    return Moduli(tensor, np.asarray(modulus), np.asarray(ratio))


def in_plane_strain(modulus: float, ratio: float) -> tuple[float, float]:
    """Young's modulus and Poisson's ratio of a rock whose slice in plane strain shows these.

    ν = ν₂ / (1 + ν₂), E = E₂ (1 − ν²): a slice that cannot strain out of its plane shows
    ν₂ = ν / (1 − ν) and E₂ = E / (1 − ν²); one without stress out of it shows E and ν themselves.
    """
    true = ratio / (1.0 + ratio)
    return modulus * (1.0 - true**2), true


def _forces(u: Array, contacts: Contacts, specimen: Specimen) -> tuple[Array, Array]:
    """Linear forces on b of each contact, tension positive as strains are."""
    grains, a, b = specimen.grains, contacts.a, contacts.b
    dx, dy = grains.x[b] - grains.x[a], grains.y[b] - grains.y[a]
    distance = np.hypot(dx, dy)
    nx, ny = dx / distance, dy / distance
    overlap = grains.radius[a] + grains.radius[b] - distance
    kn, ks, _ = springs(overlap, contacts, grains, specimen.bonds, specimen.law)
    ux, uy = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1]
    normal = kn * (ux * nx + uy * ny)
    turn = u[a, 2] * (grains.radius[a] - 0.5 * overlap)
    turn += u[b, 2] * (grains.radius[b] - 0.5 * overlap)
    shear = ks * (uy * nx - ux * ny - turn)
    return normal * nx - shear * ny, normal * ny + shear * nx
