"""Permeability tensor of a network, from two steady solves."""

from __future__ import annotations

import numpy as np

from demflow.model.flow.linear.factor import analyse, factorise, solve
from demflow.model.network.apertures import uniform
from demflow.model.network.connectivity import reached
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Network, Permeability


def permeability(network: Network, apertures: Apertures, *, viscosity: float) -> np.ndarray:
    """Permeability tensor (2, 2) in m² of the region.

    Pressure p = −x, then p = −y, is imposed along the whole rim, so that the mean gradient
    is exactly −1 along either axis and k_ab = μ Σ g Δp_a Δp_b / A (Hill's lemma): the
    dissipation of the pipes inside, and of the half of each cut pipe that belongs to the
    pore inside, over the area of the polygons. Symmetric to round-off, and exact wherever
    the pressure is linear. Wells are left out.

    Raises `ModelError` where no pipe conducts.
    """
    nodes = np.flatnonzero(network.inside)
    number = np.full(len(network.x), -1)
    number[nodes] = np.arange(len(nodes))
    within = (
        network.inside[network.pipe_from]
        & network.inside[network.pipe_to]
        & (apertures.conductance > 0.0)
    )
    i, j = number[network.pipe_from[within]], number[network.pipe_to[within]]
    g = apertures.conductance[within]
    rim = number[network.cut_inside]
    rim_g = apertures.cut_conductance

    held = reached(len(nodes), i, j, rim[rim_g > 0.0])
    if not held.any():
        raise ModelError(
            "no conducting pipe reaches the rim, so there is no permeability to measure; give the "
            "matrix an aperture"
        )
    # pores that the rim does not reach carry nothing; any finite pressure serves them
    excess = np.bincount(rim, weights=rim_g, minlength=len(nodes)) + ~held
    t = network.cut_fraction
    inner, outer = network.cut_inside, network.cut_outside
    rim_x = network.x[inner] + t * (network.x[outer] - network.x[inner])
    rim_y = network.y[inner] + t * (network.y[outer] - network.y[inner])
    rhs = np.column_stack(
        [
            np.bincount(rim, weights=-rim_g * rim_x, minlength=len(nodes)),
            np.bincount(rim, weights=-rim_g * rim_y, minlength=len(nodes)),
        ]
    )
    p = solve(factorise(analyse(len(nodes), i, j), g, excess), rhs)

    drop = p[i] - p[j]
    rim_drop = p[rim] + np.column_stack([rim_x, rim_y])
    # the half that belongs to the pore inside is 1 / (2t) of the part up to the rim; along a
    # fracture that part is measured on the trace and taken as it is
    half = np.where(apertures.on_fracture[network.cut] >= 0, 1.0, 0.5 / t)
    dissipation = drop.T @ (g[:, None] * drop)
    dissipation += rim_drop.T @ ((half * rim_g)[:, None] * rim_drop)
    tensor = viscosity * dissipation / network.area[nodes].sum()
    return 0.5 * (tensor + tensor.T)


def unit_permeability(network: Network) -> np.ndarray:
    """Permeability of the network for an aperture of 1 m everywhere, (2, 2), m² per m³.

    Since k ∝ w³, the permeability at any uniform aperture w is w³ times this.
    """
    return permeability(network, uniform(network, 1.0, 1.0), viscosity=1.0)


def calibrate(network: Network) -> Permeability:
    """Permeability of the network at an aperture of 1 m (the *calibrate* stage)."""
    return Permeability(unit_permeability(network))


def measure(network: Network, apertures: Apertures, *, viscosity: float) -> Permeability:
    """Permeability of the open network (the *measure* stage)."""
    return Permeability(permeability(network, apertures, viscosity=viscosity))
