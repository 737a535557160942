"""Wells in the network: which pores they cover, and what the pipes that leave them conduct."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.network.domains import domains_at
from model.outcome import ModelError
from model.products import Apertures, Network

# Peaceman (1978): on a regular grid the pressure of a well block is that at 0.2 of the
# distance between its neighbours; a pore near the well's centre is taken to stand there.
EQUIVALENT_RADIUS = 0.2

# A pore may touch the wellbore; its logarithmic distance keeps this part of the pipe's.
WELL_FLOOR = 0.02


class WellSite(NamedTuple):
    """What the flow stage knows of a well: not its rate."""

    name: str
    at: tuple[float, float]  # m
    radius: float  # m
    fixed_pressure: bool
    change_times: tuple[float, ...]  # s, when its rate changes
    skin: float = 0.0  # ≥ 0; a negative one is in the radius
    storage: float = 0.0  # m³/Pa for unit depth


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
    """Conducting pipes between domains inside the region, placed at the wells' walls.

    Raises `ModelError` where a well has a skin, but no pipe of rock that it could throttle.
    """
    i, j = network.pipe_from, network.pipe_to
    conducts = network.inside[i] & network.inside[j] & (apertures.conductance > 0.0)
    pipe = np.flatnonzero(conducts)
    i, j, g = i[pipe], j[pipe], apertures.conductance[pipe].copy()
    for k, well in enumerate(wells):
        throttled = 0
        for inner, outer, place_outer in (
            (i, j, apertures.pipe_trace_to[pipe]),
            (j, i, apertures.pipe_trace_from[pipe]),
        ):
            leaves = np.flatnonzero((well_of[inner] == k) & (well_of[outer] < 0))
            on_trace = ~np.isnan(place_outer[leaves])
            ours = leaves[~on_trace]
            g[ours] *= _well_factor(network, well, inner[ours], outer[ours])
            throttled += len(ours)
            ours = leaves[on_trace]
            g[ours] = _trace_at_well(apertures, well, pipe[ours], place_outer[ours], g[ours])
        if well.skin > 0.0 and not throttled:
            raise ModelError(
                f"well {well.name} has a skin_factor, but takes fluid through no pipe of the rock, "
                "only along fractures of a given aperture, which a skin leaves alone"
            )
    return i, j, g


def _well_factor(
    network: Network, well: WellSite, inner: np.ndarray, outer: np.ndarray
) -> np.ndarray:
    """Correction ln(r_j / r_i) / (ln(r_j / r_w) + S) of pipes that leave a well.

    Where the flow around the well is radial, p_j − p_w = q μ (ln(r_j / r_w) + S) / (2π k): the
    skin S adds q μ S / (2π k) with the permeability that the pipes around the well have, and
    does so pipe by pipe, as p_w = p − S ∂p/∂ln r does at the wall (van Everdingen 1953, Trans.
    AIME 198; Agarwal, Al-Hussainy & Ramey 1970, SPE J. 10, Eq. 5).
    """
    x0, y0 = well.at
    r_in = np.hypot(network.x[inner] - x0, network.y[inner] - y0)
    r_out = np.hypot(network.x[outer] - x0, network.y[outer] - y0)
    between = np.hypot(network.x[inner] - network.x[outer], network.y[inner] - network.y[outer])
    r_in = np.maximum(r_in, EQUIVALENT_RADIUS * between)
    whole = np.log(np.maximum(r_out, 1.001 * r_in) / r_in)
    return whole / (np.maximum(np.log(r_out / well.radius), WELL_FLOOR * whole) + well.skin)


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
