"""Permeability tensor of a network, from two steady solves."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from model.flow.factor import analyse, factorise, solve
from model.network.apertures import uniform
from model.outcome import ModelError
from model.products import Apertures, Network
from model.region import Region, bounding_box, contains

# The rim holds the pressure on a straight line, which stiffens the pores beside it; the
# tensor is measured in the core, the region shrunk to this part about its centre.
CORE = 0.8


def permeability(
    network: Network, apertures: Apertures, *, region: Region, viscosity: float
) -> np.ndarray:
    """Permeability tensor (2, 2) in m² of the core of the region.

    Pressure p = −x, then p = −y, is imposed along the whole rim. With the dissipation
    E_ab = Σ g Δp_a Δp_b / A over the pipes of the core (a pipe between core and outside
    counts half) and the mean gradient H of the core, least squares weighted by area, the
    tensor is k = μ H⁻ᵀ E H⁻¹: symmetric, and exact wherever the pressure is linear.

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

    held = _held(len(nodes), i, j, rim[rim_g > 0.0])
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

    core = _core(network, region)[nodes]
    if np.count_nonzero(core & held) < 3:
        core = np.ones(len(nodes), dtype=bool)
    drop = p[i] - p[j]
    weight = 0.5 * (core[i].astype(float) + core[j]) * g
    rim_drop = p[rim] + np.column_stack([rim_x, rim_y])
    # of a cut pipe, the half that belongs to the pore inside is 1/(2t) of the part to the rim
    rim_weight = np.where(core[rim], np.minimum(0.5 / t, 1.0) * rim_g, 0.0)
    dissipation = drop.T @ (weight[:, None] * drop)
    dissipation += rim_drop.T @ (rim_weight[:, None] * rim_drop)
    dissipation /= network.area[nodes][core].sum()
    gradient = _mean_gradient(network, nodes[core & held], p[core & held])
    back = np.linalg.inv(gradient)
    tensor = viscosity * back.T @ dissipation @ back
    return 0.5 * (tensor + tensor.T)


def unit_permeability(network: Network, *, region: Region) -> np.ndarray:
    """Permeability of the network for an aperture of 1 m everywhere, (2, 2), m² per m³.

    Since k ∝ w³, the permeability at any uniform aperture w is w³ times this.
    """
    return permeability(network, uniform(network, 1.0, 1.0), region=region, viscosity=1.0)


def _core(network: Network, region: Region) -> np.ndarray:
    """Domains whose centroid, moved outward from the region's centre by 1/CORE, stays inside."""
    xmin, xmax, ymin, ymax = bounding_box(region)
    middle = np.array([0.5 * (xmin + xmax), 0.5 * (ymin + ymax)])
    points = np.column_stack([network.x, network.y])
    return network.inside & contains(region, middle + (points - middle) / CORE)


def _mean_gradient(network: Network, domains: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Least-squares gradient of each pressure field, as columns (2, fields), by area."""
    weight = np.sqrt(network.area[domains])[:, None]
    columns = np.column_stack([np.ones(len(domains)), network.x[domains], network.y[domains]])
    fit, *_ = np.linalg.lstsq(weight * columns, weight * p, rcond=None)
    return fit[1:]


def _held(n: int, i: np.ndarray, j: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Pores that conducting pipes connect to the rim."""
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    reached = np.zeros(label.max() + 1, dtype=bool)
    reached[label[rim]] = True
    return reached[label]
