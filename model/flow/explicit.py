"""Forward Euler in time: the paper's scheme (Eqs 5 and 14), with its step put right.

Eq. 14 bounds the step by what one aperture per pore would allow (`paper_step`). Where
apertures differ within a pore, the bound that keeps pressures positive is C_i / Σ_j g_ij;
stability itself ends at 2 / λ_max.

A step reads every pore, its first four neighbours and their conductances in the order of
memory: pores are numbered by reverse Cuthill–McKee, rows have one width and no branch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import LinearOperator, eigsh

from model.compile import kernel
from model.flow.algebraic import Algebraic, algebraic
from model.flow.problem import Answer, Problem, empty_answer, fill_map, relative_residual
from model.flow.system import System
from model.outcome import ModelError
from model.products import Apertures, Network

# Pore updates that a run may take (about twenty minutes).
MOST_UPDATES = 5e11
SECONDS_PER_UPDATE = 2.5e-9

WIDTH = 4  # neighbours of a pore that its row holds; most pores of a packing have no more


def step_limit(system: System) -> float:
    """Largest step that keeps the discrete maximum principle, min C_i / Σ_j g_ij, in s."""
    total = system.excess
    total = total + np.bincount(system.edge_i, weights=system.edge_g, minlength=system.n)
    total = total + np.bincount(system.edge_j, weights=system.edge_g, minlength=system.n)
    pores = slice(0, system.pores)
    flowing = total[pores] > 0.0
    if not flowing.any():
        return math.inf
    return float(np.min(system.storage[pores][flowing] / total[pores][flowing]))


def fastest_decay(system: System, wells: Algebraic) -> float:
    """Largest eigenvalue λ of C⁻¹G on the pores, 1/s; forward Euler is stable up to 2/λ."""
    pores = system.pores
    root = np.sqrt(system.storage[:pores])

    def apply(scaled: np.ndarray) -> np.ndarray:
        full = wells.lift(np.ravel(scaled) / root)
        return -_net_flow(system, np.zeros(system.n), full)[:pores] / root

    if pores < 30:
        matrix = np.column_stack([apply(unit) for unit in np.eye(pores)])
        return float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).max(initial=0.0))
    start = np.random.default_rng(0).standard_normal(pores)
    operator = LinearOperator((pores, pores), matvec=apply, dtype=float)
    return float(eigsh(operator, k=1, which="LA", v0=start, return_eigenvectors=False)[0])


def paper_step(
    network: Network, apertures: Apertures, bulk_modulus: float, domains: np.ndarray
) -> float:
    """Step of Eq. 14 as printed, min 24 μ R̄ V_d / (N K_f w³) over some domains, in s.

    N is a domain's number of pipes, R̄ the mean radius of the grains around it and w the mean
    aperture of its pipes, by Eq. 1 from their conductances. Where all have one aperture this
    is C_i / Σ_j g_ij, but for R̄; elsewhere it is no bound.
    """
    d = len(network.volume)
    ends = np.concatenate([network.pipe_from, network.pipe_to])
    cubed = apertures.conductance * network.pipe_length  # w³ / (12 μ)
    pipes = np.bincount(ends, minlength=d)
    root = np.bincount(ends, weights=np.tile(np.cbrt(cubed), 2), minlength=d)
    corners = np.diff(network.corner_start)
    around = np.repeat(np.arange(d), corners)
    radius = np.bincount(around, weights=network.grain_radius[network.corner_grain], minlength=d)
    open_ones = domains[root[domains] > 0.0]
    N, w = pipes[open_ones], root[open_ones] / pipes[open_ones]
    R, C = (radius / corners)[open_ones], apertures.volume[open_ones] / bulk_modulus
    return float(np.min(2.0 * R * C / (N * w**3), initial=math.inf))


def explicit(problem: Problem) -> Answer:
    """March every active source through the lags with one step per interval.

    Between two lags the step is the largest that divides the interval and does not exceed
    `safety_factor` times `step_limit`, or times the paper's step where the problem gives it.
    Raises `ModelError` before it starts where that takes more than `MOST_UPDATES` pore
    updates, or where the step is beyond stability.
    """
    system, lags = problem.system, problem.lag
    wells = algebraic(system)
    positive = step_limit(system)
    limit = problem.safety_factor * (positive if problem.step is None else problem.step)
    if limit > positive:
        _check_stable(limit, fastest_decay(system, wells))
    intervals = np.diff(np.concatenate([[0.0], lags]))
    needed = np.ceil(intervals / limit * (1.0 - 1e-12))
    updates = float(needed.sum()) * system.n * len(problem.active_sources)
    if updates > MOST_UPDATES:
        raise ModelError(
            f"explicit would take {needed.sum():.3g} steps of {limit:.3g} s over {system.n} pores, "
            f"about {_in_words(updates * SECONDS_PER_UPDATE)}; use solver.method krylov"
        )
    steps = np.maximum(needed, intervals > 0.0).astype(np.int64)
    rows = stencil(system, wells)
    answer = empty_answer(problem)
    residual = 0.0
    for k in problem.active_sources:
        rhs = system.source(k)
        driven = _driven(rows, rhs, system)
        p = np.zeros(system.n)
        p[system.pores :] = wells.direct(rhs)
        q = p.copy()
        integral = np.zeros(system.n)
        maps = np.zeros((len(lags), system.n))
        for m, (interval, count) in enumerate(zip(intervals, steps, strict=True)):
            if count:
                dt = interval / count
                p, q = _march(p, q, integral, int(count), dt, rows, driven, rhs[system.pores :])
            maps[m, rows.order] = p
            answer.cumulative[k, m] = _volumes(problem, k, maps[m], integral, lags[m])
        answer.output[k] = (problem.records.rows @ maps.T).T + problem.records.direct[k]
        answer.pressure[k] = fill_map(problem, k, maps)
        rate = np.zeros(system.n)
        pores = slice(0, system.pores)
        rate[pores] = _net_flow(system, rhs, maps[-1])[pores] / system.storage[pores]
        residual = max(residual, relative_residual(system, rhs, rate, maps[-1]))
    return answer._replace(time_error=math.nan, residual=residual, work=int(steps.sum()))


def _in_words(seconds: float) -> str:
    """A duration that a person can judge."""
    for unit, size in (("years", 31_557_600.0), ("days", 86_400.0), ("hours", 3_600.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 60.0:.2g} minutes"


def _check_stable(step: float, decay: float) -> None:
    """Raise where forward Euler grows: its slowest-damped mode changes by 1 − Δt λ a step."""
    growth = step * decay - 1.0
    if growth > 1.0:
        raise ModelError(
            f"explicit blows up with a step of {step:.3g} s: errors grow {growth:.3g}-fold a step. "
            f"It is stable up to {2.0 / decay:.3g} s; lower solver.safety_factor (1 or less of "
            "the corrected step never grows), or use solver.method krylov"
        )


def _net_flow(system: System, rhs: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Flow f − G p into each unknown at pressure p, m³/s."""
    flow = system.edge_g * (p[system.edge_i] - p[system.edge_j])
    net = rhs - system.excess * p
    net = net - np.bincount(system.edge_i, weights=flow, minlength=system.n)
    return net + np.bincount(system.edge_j, weights=flow, minlength=system.n)


def _volumes(
    problem: Problem, source: int, p: np.ndarray, integral: np.ndarray, time: float
) -> np.ndarray:
    """Volumes let in by each fixed pressure since the step, and the volume stored, (fixed + 1,)."""
    records = problem.records
    flows = slice(records.well_rows, records.well_rows + records.flow_rows)
    let_in = (records.rows @ integral + time * records.direct[source])[flows]
    return np.append(let_in, problem.system.storage @ p)


class Stencil(NamedTuple):
    """The flow equation as a step reads it, with pores renumbered; wells follow the pores.

    Weights are g_ij / C_i in 1/s.
    """

    order: np.ndarray  # (n,) the unknown that stands at each place
    near: np.ndarray  # (pores, WIDTH) int32: places of the first neighbours, itself where none
    near_weight: np.ndarray  # (pores, WIDTH)
    row: np.ndarray  # (m,) int32: further neighbours and wells, one entry each
    column: np.ndarray  # (m,) int32
    weight: np.ndarray  # (m,)
    rim_unknown: np.ndarray  # (u,) unknowns beside a fixed pressure, wells included
    rim_place: np.ndarray  # (u,) their places
    well: np.ndarray  # (e,) well of each of the wells' pipes
    well_pore: np.ndarray  # (e,) place of the pore at its other end
    well_g: np.ndarray  # (e,) m³/(s Pa)
    inverse: np.ndarray  # (w, w) K_ww⁻¹


def stencil(system: System, wells: Algebraic) -> Stencil:
    """Renumber the pores so that neighbours lie close together, and split their rows."""
    n, pores = system.n, system.pores
    i = np.concatenate([system.edge_i, system.edge_j])
    j = np.concatenate([system.edge_j, system.edge_i])
    g = np.concatenate([system.edge_g, system.edge_g])
    within = (i < pores) & (j < pores)
    graph = csr_array((g[within], (i[within], j[within])), shape=(pores, pores))
    banded = reverse_cuthill_mckee(graph, symmetric_mode=True) if pores else []
    order = np.concatenate([banded, np.arange(pores, n)]).astype(np.int64)
    place = np.empty(n, dtype=np.int64)
    place[order] = np.arange(n)
    leaves = i < pores
    i, j, g = place[i[leaves]], place[j[leaves]], g[leaves]
    by_row = np.lexsort((j, i))
    i, j, g = i[by_row], j[by_row], g[by_row]
    storage = system.storage[order[:pores]]
    weight = g / storage[i]
    position = np.arange(len(i)) - np.searchsorted(i, i)
    first = (position < WIDTH) & (j < pores)
    near = np.repeat(np.arange(pores, dtype=np.int32)[:, None], WIDTH, axis=1)
    near_weight = np.zeros((pores, WIDTH))
    near[i[first], position[first]] = j[first]
    near_weight[i[first], position[first]] = weight[first]
    at_well = j >= pores
    excess = system.excess
    return Stencil(
        order=order,
        near=near,
        near_weight=near_weight,
        row=i[~first].astype(np.int32),
        column=j[~first].astype(np.int32),
        weight=weight[~first],
        rim_unknown=np.flatnonzero(excess > 0.0),
        rim_place=place[excess > 0.0],
        well=j[at_well] - pores,
        well_pore=i[at_well],
        well_g=g[at_well],
        inverse=np.ascontiguousarray(wells.inverse),
    )


class Driven(NamedTuple):
    """The pores that a source or a fixed pressure acts on; no other has a term of its own."""

    place: np.ndarray  # (f,)
    weight: np.ndarray  # (f,) excess of the row over C_i, 1/s
    source: np.ndarray  # (f,) Pa/s


def _driven(rows: Stencil, rhs: np.ndarray, system: System) -> Driven:
    """Pick the pores beside a fixed pressure and, for an initial field, all that it moves."""
    order = rows.order[: system.pores]
    place = np.flatnonzero((system.excess[order] > 0.0) | (rhs[order] != 0.0))
    unknown = order[place]
    storage = system.storage[unknown]
    return Driven(place, system.excess[unknown] / storage, rhs[unknown] / storage)


@kernel
def _march(p, q, integral, count, dt, s, driven, well_source):
    """Advance p (n,) by `count` steps, with q (n,) as scratch; returns both, p first.

    `integral` gathers ∫ p dt of the unknowns of the rim, as Euler sees it.
    """
    pores = s.near.shape[0]
    for _ in range(count):
        for k in range(s.rim_place.size):
            integral[s.rim_unknown[k]] += dt * p[s.rim_place[k]]
        for i in range(pores):
            x = p[i]
            left = s.near_weight[i, 0] * (p[s.near[i, 0]] - x)
            left += s.near_weight[i, 1] * (p[s.near[i, 1]] - x)
            right = s.near_weight[i, 2] * (p[s.near[i, 2]] - x)
            right += s.near_weight[i, 3] * (p[s.near[i, 3]] - x)
            q[i] = x + dt * (left + right)
        for k in range(s.row.size):
            i = s.row[k]
            q[i] += dt * s.weight[k] * (p[s.column[k]] - p[i])
        for k in range(driven.place.size):
            i = driven.place[k]
            q[i] += dt * (driven.source[k] - driven.weight[k] * p[i])
        # wells have no storage: they balance at once
        q[pores:] = 0.0
        for w in range(well_source.size):
            for v in range(well_source.size):
                q[pores + w] += s.inverse[w, v] * well_source[v]
        for k in range(s.well.size):
            flow = s.well_g[k] * q[s.well_pore[k]]
            for w in range(well_source.size):
                q[pores + w] += s.inverse[w, s.well[k]] * flow
        p, q = q, p
    return p, q
