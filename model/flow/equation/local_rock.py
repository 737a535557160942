"""What the rock conducts around a place: its mobility k/μ, measured on the pores there."""

from __future__ import annotations

import numpy as np

from demflow.model.flow.linear.factor import analyse, factorise, solve
from demflow.model.network.connectivity import reached
from demflow.model.products import Apertures, Network
from demflow.model.region import Region, distance_to_rim

# Pores between the well's wall and the end of the rock that is measured, and those beyond it
# up to where the gradient is imposed.
MEASURED_PORES = 20.0
MARGIN_PORES = 3.0

NEAREST = 40  # pores at the wall of a well whose mean area says how far apart pores are there

# Measured pores lie this many pores from the rim, unless the region has none that far.
RIM_PORES = 1.5


def spacing_around(network: Network, at: tuple[float, float], radius: float) -> float:
    """Root of the mean area of the pores at a well's wall and the nearest ones beyond it, m.

    Parameters
    ----------
    network : pores and pipes of the matrix
    at : centre of the well, m
    radius : of the well, m
    """
    distance = np.hypot(network.x - at[0], network.y - at[1])
    distance = np.where(network.inside, np.abs(distance - radius), np.inf)
    near = np.argpartition(distance, min(NEAREST, len(distance)) - 1)[:NEAREST]
    near = near[np.argsort(distance[near], kind="stable")]
    return float(np.sqrt(network.area[near[network.inside[near]]].mean()))


def mobility_around(
    network: Network,
    apertures: Apertures,
    region: Region,
    at: tuple[float, float],
    radius: float,
    spacing: float,
) -> np.ndarray:
    """Mobility k/μ (2, 2), m²/(Pa s), of the rock around a well of a radius (m), symmetric.

    By the mean flux Q and dissipation D of the pores up to twenty pores from the well's wall, where
    p = −x and p = −y are imposed a few pores further out and on the rim: Q D⁻¹ Qᵀ, whatever mean
    gradient that makes of them. Pipes along fractures are left out; zero where nothing else
    conducts.

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    region : where the case lies, m
    at : centre of the well, m
    radius : of the well, m
    spacing : of the pores there, m
    """
    distance = np.hypot(network.x - at[0], network.y - at[1])
    end = radius + MEASURED_PORES * spacing
    node = np.full(len(network.x), -1)
    near = np.flatnonzero(network.inside & (distance < end + MARGIN_PORES * spacing))
    node[near] = np.arange(len(near))
    measured = distance[near] < end
    place = np.column_stack([network.x, network.y])
    off_rim = distance_to_rim(region, place[near]) > RIM_PORES * spacing
    whole = not np.any(measured & off_rim)
    if not whole:
        measured &= off_rim

    pipe = np.flatnonzero((node[network.pipe_from] >= 0) | (node[network.pipe_to] >= 0))
    i, j, g = network.pipe_from[pipe], network.pipe_to[pipe], apertures.conductance[pipe]
    rock = (apertures.on_fracture[pipe] < 0) & (g > 0.0) & network.inside[i] & network.inside[j]
    i, j, g = i[rock], j[rock], g[rock]
    i, j = np.where(node[i] >= 0, i, j), np.where(node[i] >= 0, j, i)
    within = node[j] >= 0
    cut = (node[network.cut_inside] >= 0) & (apertures.on_fracture[network.cut] < 0)
    inner, outer = network.cut_inside[cut], network.cut_outside[cut]
    t = network.cut_fraction[cut, None]
    ends = np.concatenate([node[i[~within]], node[inner]])
    end_g = np.concatenate([g[~within], apertures.cut_conductance[cut]])
    end_place = np.concatenate(
        [place[j[~within]], place[inner] + t * (place[outer] - place[inner])]
    )
    i, j, g = node[i[within]], node[j[within]], g[within]
    held = reached(len(near), i, j, ends[end_g > 0.0])
    if not held.any():
        return np.zeros((2, 2))
    excess = np.bincount(ends, weights=end_g, minlength=len(near)) + ~held
    rhs = -np.column_stack(
        [np.bincount(ends, weights=end_g * x, minlength=len(near)) for x in end_place.T]
    )
    p = solve(factorise(analyse(len(near), i, j), g, excess), rhs)

    drop, end_drop = p[i] - p[j], p[ends] + end_place
    step, end_step = place[near[j]] - place[near[i]], end_place - place[near[ends]]
    if whole:  # a region of a few pores is measured up to its rim
        share, end_share, area = np.ones(len(i)), np.ones(len(ends)), region.area
    else:
        share = 0.5 * (measured[i].astype(float) + measured[j])
        end_share, area = 0.5 * measured[ends], float(network.area[near[measured]].sum())
    flow, end_flow = (share * g)[:, None] * drop, (end_share * end_g)[:, None] * end_drop
    dissipation = (drop.T @ flow + end_drop.T @ end_flow) / area
    flux = (step.T @ flow + end_step.T @ end_flow) / area
    mobility = flux @ np.linalg.pinv(dissipation, hermitian=True) @ flux.T
    found: np.ndarray = 0.5 * (mobility + mobility.T)
    return found
