"""Wells in the network: which pores they cover, and what the pipes that leave them conduct."""

from __future__ import annotations

import numpy as np

from demflow.model.flow.equation.sites import WellSite
from demflow.model.flow.linear.factor import analyse, factorise, solve
from demflow.model.network.connectivity import reached
from demflow.model.network.domains import domains_at
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Network
from demflow.model.region import Region, distance_to_rim

# Peaceman (1978): on a regular grid the pressure of a well block is that at 0.2 of the
# distance between its neighbours; a pore near the well's centre is taken to stand there.
EQUIVALENT_RADIUS = 0.2

# A pore may touch the wellbore; its logarithmic distance keeps this part of the pipe's.
WELL_FLOOR = 0.02


# Pores between the circles between which the rock around a well is measured, and the least
# that the inner one spans.
MEASURED_PORES = 15.0
FEWEST_PORES = 3.0


def wells_of_domains(network: Network, wells: tuple[WellSite, ...]) -> np.ndarray:
    """The well in which each domain lies, −1 outside of all."""
    well_of = np.full(len(network.x), -1)
    for k, well in enumerate(wells):
        distance = np.hypot(network.x - well.at[0], network.y - well.at[1])
        within = (distance < well.radius) & network.inside
        if not within.any():
            within = np.zeros(len(network.x), dtype=bool)
            within[domains_at(network, np.array([well.at]))] = True
        shared = well_of[within & (well_of >= 0)]
        if len(shared):
            raise ModelError(
                f"wells {wells[shared[0]].name} and {well.name} lie in one pore; move them apart, "
                "or raise grains.count"
            )
        well_of[within] = k
    return well_of


def conducting_pipes(
    network: Network, apertures: Apertures, wells: tuple[WellSite, ...], well_of: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Conducting pipes between domains inside the region, placed at the wells' walls."""
    pipe = _conducting(network, apertures)
    i, j = network.pipe_from[pipe], network.pipe_to[pipe]
    g = apertures.conductance[pipe].copy()
    for k, well in enumerate(wells):
        for inner, outer, place_outer in (
            (i, j, apertures.pipe_trace_to[pipe]),
            (j, i, apertures.pipe_trace_from[pipe]),
        ):
            leaves = np.flatnonzero((well_of[inner] == k) & (well_of[outer] < 0))
            on_trace = ~np.isnan(place_outer[leaves])
            ours = leaves[~on_trace]
            g[ours] *= _well_factor(network, well, inner[ours], outer[ours])
            ours = leaves[on_trace]
            g[ours] = _trace_at_well(apertures, well, pipe[ours], place_outer[ours], g[ours])
    return i, j, g


def _conducting(network: Network, apertures: Apertures) -> np.ndarray:
    """Pipes that conduct between domains inside the region."""
    within = network.inside[network.pipe_from] & network.inside[network.pipe_to]
    return np.flatnonzero(within & (apertures.conductance > 0.0))


def _well_factor(
    network: Network, well: WellSite, inner: np.ndarray, outer: np.ndarray
) -> np.ndarray:
    """Logarithmic correction ln(r_j / r_i) / ln(r_j / r_w) of pipes that leave a well."""
    x0, y0 = well.at
    r_in = np.hypot(network.x[inner] - x0, network.y[inner] - y0)
    r_out = np.hypot(network.x[outer] - x0, network.y[outer] - y0)
    between = np.hypot(network.x[inner] - network.x[outer], network.y[inner] - network.y[outer])
    r_in = np.maximum(r_in, EQUIVALENT_RADIUS * between)
    whole = np.log(np.maximum(r_out, 1.001 * r_in) / r_in)
    return whole / np.maximum(np.log(r_out / well.radius), WELL_FLOOR * whole)


def _trace_at_well(
    apertures: Apertures,
    well: WellSite,
    pipe: np.ndarray,
    place: np.ndarray,
    conductance: np.ndarray,
) -> np.ndarray:
    """Conductance T / (distance along the trace from the well's wall) of calibrated pipes."""
    result = conductance.copy()
    for k, p in enumerate(pipe):
        trace = apertures.on_fracture[p]
        start, end = apertures.trace_start[trace], apertures.trace_end[trace]
        along = (end - start) / np.hypot(*(end - start))
        offset = start - np.asarray(well.at)
        half = offset @ along
        square = half * half - offset @ offset + well.radius**2
        if square <= 0.0:
            continue
        whole = abs(apertures.pipe_trace_to[p] - apertures.pipe_trace_from[p])
        distance = max(abs(place[k] + half) - np.sqrt(square), WELL_FLOOR * whole)
        result[k] = apertures.trace_transmissivity[trace] / distance
    return result


def radial_conductance(
    network: Network, apertures: Apertures, region: Region, well: WellSite
) -> float:
    """2π k / μ of the rock around a well, m³/(s Pa) for unit depth.

    From radial flow through the pipes between two circles around it, of which the inner is
    its wall or a few pores wide, and the outer some pores wider or at the rim. Pipes along
    fractures are left out; 0 where nothing else conducts.
    """
    spacing = float(np.sqrt(network.area[network.inside].mean()))
    room = float(distance_to_rim(region, np.array([well.at]))[0]) - spacing
    inner = max(well.radius, min(FEWEST_PORES * spacing, 0.5 * room))
    outer = min(inner + MEASURED_PORES * spacing, room)
    wide = well._replace(radius=inner)
    well_of = wells_of_domains(network, (wide,))
    distance = np.hypot(network.x - well.at[0], network.y - well.at[1])
    near = np.flatnonzero((distance < outer) & network.inside & (well_of < 0))
    if len(near) == 0:
        return 0.0
    node = np.full(len(network.x), -1)
    node[near] = np.arange(len(near))
    i, j, g = conducting_pipes(network, apertures, (wide,), well_of)
    rock = apertures.on_fracture[_conducting(network, apertures)] < 0
    i, j, g = i[rock], j[rock], g[rock]
    at_wall, at_rim = np.zeros(len(near)), np.zeros(len(near))
    for one, other in ((i, j), (j, i)):
        leaves = (node[one] >= 0) & (node[other] < 0)
        inward = leaves & (well_of[other] == 0)
        np.add.at(at_wall, node[one[inward]], g[inward])
        outward = leaves & (well_of[other] < 0)
        r_in, r_out = distance[one[outward]], distance[other[outward]]
        part = np.log(r_out / r_in) / np.log(outer / r_in)
        np.add.at(at_rim, node[one[outward]], g[outward] * part)
    within = (node[i] >= 0) & (node[j] >= 0)
    i, j, g = node[i[within]], node[j[within]], g[within]
    held = reached(len(near), i, j, np.flatnonzero(at_rim > 0.0))
    factor = factorise(analyse(len(near), i, j), g, at_wall + at_rim + ~held)
    through = float(at_wall @ solve(factor, at_rim))
    return through * float(np.log(outer / inner)) if through > 0.0 else 0.0


def with_skin(
    a: np.ndarray, b: np.ndarray, g: np.ndarray, well: int, skin_conductance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Connections between terminals with a resistance in series with all that a well takes.

    What takes fluid is then the wall, whose pressure is eliminated: with Σ the sum of the
    conductances g_j that meet there and of the skin's, g_i g_j / Σ joins each two neighbours
    and g_j g_skin / Σ each of them and the well.
    """
    ours = (a == well) | (b == well)
    neighbour, which = np.unique(np.where(a == well, b, a)[ours], return_inverse=True)
    meets = np.bincount(which, weights=g[ours])
    total = meets.sum() + skin_conductance
    first, second = np.triu_indices(len(neighbour), k=1)
    return (
        np.concatenate([a[~ours], neighbour[first], neighbour]),
        np.concatenate([b[~ours], neighbour[second], np.full(len(neighbour), well)]),
        np.concatenate(
            [g[~ours], meets[first] * meets[second] / total, meets * skin_conductance / total]
        ),
    )
