"""How wide each pipe is and what it conducts (the *open* stage)."""

from __future__ import annotations

import numpy as np

from demflow.model.network.traces import Chain, chain_along, pipes_across
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Network, Permeability, StressState
from demflow.model.region import Region
from demflow.model.scene import Fracture, Line, Matrix, lines_of


def stressed_aperture(w0: np.ndarray, force: np.ndarray, half_force: float) -> np.ndarray:
    """Aperture of pipes under compression, w = w0 F0 / (F + F0).

    Eq. 2 with its sign put right: F0 (`half_force`, N per metre) is the force that halves
    the aperture w0 (m). `force` ≥ 0 is compressive.
    """
    return w0 * half_force / (force + half_force)


def parted_aperture(w0: np.ndarray, gap: np.ndarray, gap_factor: float) -> np.ndarray:
    """Aperture of pipes whose grains have parted, w = w0 + m g (Eq. 3); gap g ≥ 0 in m."""
    return w0 + gap_factor * gap


def pipe_conductance(aperture: np.ndarray, length: np.ndarray, viscosity: float) -> np.ndarray:
    """Conductance of a pipe between parallel plates, g = w³ / (12 μ L) (Eq. 1), m³/(s Pa)."""
    return aperture**3 / (12.0 * viscosity * length)


def transmissivity(aperture: float, viscosity: float) -> float:
    """Cubic law of a fracture of hydraulic aperture w, T = w³ / (12 μ), m³/(s Pa)."""
    return aperture**3 / (12.0 * viscosity)


def uniform(network: Network, aperture: float, viscosity: float) -> Apertures:
    """The network with one aperture everywhere and no fracture."""
    p = len(network.pipe_from)
    conductance = pipe_conductance(np.full(p, float(aperture)), network.pipe_length, viscosity)
    return Apertures(
        aperture=np.full(p, float(aperture)),
        conductance=conductance,
        volume=network.volume,
        on_fracture=np.full(p, -1, dtype=np.int64),
        cut_conductance=conductance[network.cut] / network.cut_fraction,
        trace_start=np.empty((0, 2)),
        trace_end=np.empty((0, 2)),
        trace_fracture=np.empty(0, dtype=np.int64),
        trace_transmissivity=np.empty(0),
        trace_pipes=np.empty(0, dtype=np.int64),
        trace_acts=np.empty(0, dtype=np.int64),
        pipe_trace_from=np.full(p, np.nan),
        pipe_trace_to=np.full(p, np.nan),
        matrix_aperture=np.asarray(float(aperture)),
    )


def open_pipes(
    network: Network,
    stress: StressState | None,
    unit_permeability: Permeability | None,
    *,
    region: Region,
    matrix: Matrix,
    fractures: tuple[Fracture, ...],
    viscosity: float,
) -> Apertures:
    """Open every pipe: matrix, stress, then fractures and barriers.

    Parameters
    ----------
    network : pores and pipes.
    stress : contact forces and moved grains; None where no stress is modelled.
    unit_permeability : permeability of the network at an aperture of 1 m everywhere
        (permeability is proportional to w³); needed where a permeability is given.
    region, matrix, fractures, viscosity : parts of the scene.

    A fracture given by its permeability has w_f = (k_f / k_1)^(1/3) in the unstressed
    state, and follows stress as the matrix does. One given by a hydraulic aperture has
    that aperture in place, and its pipes are calibrated so that the trace carries
    w³ / (12 μ). Where traces share a pipe the more conductive one has it; barriers come
    last and multiply whatever crosses them.
    """
    if matrix.aperture is not None:
        w0 = matrix.aperture
    else:
        w0 = _aperture_for(matrix.permeability, unit_permeability)
    result = uniform(network, w0, viscosity)
    unstressed = result.aperture.copy()
    lines = [
        line
        for line in lines_of(fractures, region)
        if line.length > 0.0 and fractures[line.fracture].acts_on_flow
    ]
    chains = [chain_along(network, line) for line in lines]
    acts = np.zeros(len(lines), dtype=np.int64)

    for index, (line, chain) in enumerate(zip(lines, chains, strict=True)):
        fracture = fractures[line.fracture]
        if fracture.permeability is not None:
            wide = _aperture_for(fracture.permeability, unit_permeability)
            pipes = np.concatenate([chain.pipe, [p for p in chain.rim_pipe if p >= 0]]).astype(int)
            wider = unstressed[pipes] <= wide
            unstressed[pipes[wider]] = wide
            acts[index] = np.count_nonzero(wider)
            _claim(result, pipes, wider, index)

    aperture = _stressed(network, stress, unstressed, matrix)
    conductance = pipe_conductance(aperture, network.pipe_length, viscosity)
    result = result._replace(
        aperture=aperture,
        conductance=conductance,
        cut_conductance=conductance[network.cut] / network.cut_fraction,
        volume=_volumes(network, fractures, lines, chains, aperture),
    )
    for index, (line, chain) in enumerate(zip(lines, chains, strict=True)):
        if line.aperture is not None:
            acts[index] = _calibrate(network, result, index, chain, line.aperture, viscosity)
    for index, line in enumerate(lines):
        multiplier = fractures[line.fracture].transmissibility_multiplier
        if multiplier is not None:
            across = pipes_across(network, line)
            result.conductance[across] *= multiplier
            result.cut_conductance[across[network.cut]] *= multiplier
            acts[index] = np.count_nonzero(across)
    return result._replace(
        trace_start=np.array([line.start for line in lines]).reshape(-1, 2),
        trace_end=np.array([line.end for line in lines]).reshape(-1, 2),
        trace_fracture=np.array([line.fracture for line in lines], dtype=np.int64),
        trace_transmissivity=np.array(
            [transmissivity(line.aperture or 0.0, viscosity) for line in lines]
        ),
        trace_pipes=np.array([len(chain.pipe) for chain in chains], dtype=np.int64),
        trace_acts=acts,
    )


def _aperture_for(permeability: float | None, unit_permeability: Permeability | None) -> float:
    """Aperture at which a uniform network has the permeability: a cube root, k ∝ w³."""
    if permeability is None or unit_permeability is None:
        raise ModelError("a permeability is asked for, but the network's own was not computed")
    return float(np.cbrt(permeability / (0.5 * np.trace(unit_permeability.tensor))))


def _stressed(
    network: Network, stress: StressState | None, unstressed: np.ndarray, matrix: Matrix
) -> np.ndarray:
    """Apertures under the contact forces; unchanged where no force law is given."""
    if stress is None or matrix.half_force is None:
        return unstressed
    contact = pipe_contacts(network, stress)
    force = np.where(contact >= 0, stress.normal_force[contact], 0.0)
    gap = np.maximum(pipe_gaps(network, stress), 0.0)
    return np.where(
        force > 0.0,
        stressed_aperture(unstressed, np.maximum(force, 0.0), matrix.half_force),
        parted_aperture(unstressed, gap, matrix.gap_factor),
    )


def pipe_contacts(network: Network, stress: StressState) -> np.ndarray:
    """The contact of the loaded grains at each pipe, (p,), −1 where they carry nothing."""
    n = np.int64(len(stress.x))
    key = network.pipe_grain_a * n + network.pipe_grain_b
    known = stress.contact_a * n + stress.contact_b
    if len(known) == 0:
        return np.full(len(key), -1)
    found = np.minimum(np.searchsorted(known, key), len(known) - 1)
    return np.where(known[found] == key, found, -1)


def pipe_gaps(network: Network, stress: StressState) -> np.ndarray:
    """Gap between the grains at each pipe, (p,) in m, negative where they overlap.

    Across a smooth joint it is the joint's own: grains that slide past each other along it
    part without opening it.
    """
    a, b = network.pipe_grain_a, network.pipe_grain_b
    distance = np.hypot(stress.x[a] - stress.x[b], stress.y[a] - stress.y[b])
    contact = pipe_contacts(network, stress)
    opening = np.where(contact >= 0, stress.joint_gap[contact], np.nan)
    touching = (
        network.grain_radius[network.pipe_grain_a] + network.grain_radius[network.pipe_grain_b]
    )
    return np.where(np.isnan(opening), distance - touching, opening)


def _calibrate(
    network: Network,
    result: Apertures,
    index: int,
    chain: Chain,
    aperture: float,
    viscosity: float,
) -> int:
    """Give the pipes along a trace T / Δs, which telescopes to T / length (in place).

    Returns the number of pipes that it widened.
    """
    carried = transmissivity(aperture, viscosity)
    conductance = carried / np.diff(chain.place)
    wins = conductance > result.conductance[chain.pipe]
    pipes = chain.pipe[wins]
    result.conductance[pipes] = conductance[wins]
    result.aperture[pipes] = aperture
    _claim(result, chain.pipe, wins, index)
    forward = network.pipe_from[pipes] == chain.domain[:-1][wins]
    near, far = chain.place[:-1][wins], chain.place[1:][wins]
    result.pipe_trace_from[pipes] = np.where(forward, near, far)
    result.pipe_trace_to[pipes] = np.where(forward, far, near)
    widened = np.count_nonzero(wins)
    for pipe, distance in zip(
        chain.rim_pipe,
        (chain.place[:1], chain.length - chain.place[-1:]),
        strict=True,
    ):
        if pipe < 0:
            continue
        crossing = np.searchsorted(network.cut, pipe)
        wins_rim = carried / distance[0] > result.cut_conductance[crossing]
        if wins_rim:
            result.cut_conductance[crossing] = carried / distance[0]
            result.aperture[pipe] = aperture
            widened += 1
        _claim(result, np.array([pipe]), np.array([wins_rim]), index)
    return int(widened)


def _claim(result: Apertures, pipes: np.ndarray, wins: np.ndarray, index: int) -> None:
    """Mark pipes as lying on a trace: those that it widened, and any that no other has."""
    ours = pipes[wins | (result.on_fracture[pipes] < 0)]
    result.on_fracture[ours] = index


def _volumes(
    network: Network,
    fractures: tuple[Fracture, ...],
    lines: list[Line],
    chains: list[Chain],
    aperture: np.ndarray,
) -> np.ndarray:
    """Pore volumes after the pores along a trace gave theirs to the matrix beside them.

    The pores along a trace belong to the matrix; left in the fracture they would delay its
    response. A pore keeps the volume of its stretch of fracture, the rest goes in equal
    parts to those of its neighbours that lie on no such trace; without any it keeps its own.
    """
    own = np.full(len(network.volume), np.nan)
    for line, chain in zip(lines, chains, strict=True):
        fracture = fractures[line.fracture]
        owner = fracture.pore_storage or ("matrix" if line.aperture else "fracture")
        if fracture.transmissibility_multiplier is not None or owner != "matrix":
            continue
        if len(chain.pipe) == 0:
            continue
        width = line.aperture or float(aperture[chain.pipe].mean())
        kept = np.fmax(own[chain.domain], 0.0) + width * chain.storage_length
        own[chain.domain] = np.minimum(kept, network.volume[chain.domain])
    on_trace = ~np.isnan(own)
    volume = network.volume.copy()
    if not on_trace.any():
        return volume
    i = np.concatenate([network.pipe_from, network.pipe_to])
    j = np.concatenate([network.pipe_to, network.pipe_from])
    gives = on_trace[i] & ~on_trace[j] & network.inside[j]
    receivers = np.bincount(i[gives], minlength=len(volume))
    parts = np.divide(
        network.volume - own, receivers, where=receivers > 0, out=np.zeros(len(volume))
    )
    giving = on_trace & (receivers > 0)
    volume[giving] = own[giving]
    np.add.at(volume, j[gives], parts[i[gives]])
    # a stretch of zero length would leave a pore without storage
    return np.maximum(volume, 1e-6 * network.volume.mean())
