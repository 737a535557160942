"""Forward Euler in time: the paper's scheme (Eqs 5 and 14), with its step put right.

Eq. 14 bounds the step by what one aperture per pore would allow. Where apertures differ
within a pore, the bound that keeps pressures positive is C_i / Σ_j g_ij; stability itself
ends at 2 / λ_max.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from model.compile import kernel
from model.flow.algebraic import Algebraic, algebraic
from model.flow.problem import Answer, Problem, empty_answer, fill_map, relative_residual
from model.flow.system import System
from model.outcome import ModelError

# Pore updates that a run may take (about half an hour at 3 ns each).
MOST_UPDATES = 5e11


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


def explicit(problem: Problem) -> Answer:
    """March every active source through the lags with one step per interval.

    Between two lags the step is the largest that divides the interval and does not exceed
    `safety_factor` times `step_limit`. Raises `ModelError` before it starts where that
    takes more than `MOST_UPDATES` pore updates, or where the step is beyond stability.
    """
    system, lags = problem.system, problem.lag
    wells = algebraic(system)
    limit = problem.safety_factor * step_limit(system)
    if problem.safety_factor > 1.0 and limit * fastest_decay(system, wells) > 2.0:
        raise ModelError(
            f"explicit blows up with a step of {limit:.3g} s: it is stable up to "
            f"{2.0 / fastest_decay(system, wells):.3g} s; set solver.safety_factor to 1 or less, "
            "or use solver.method krylov"
        )
    intervals = np.diff(np.concatenate([[0.0], lags]))
    needed = np.ceil(intervals / limit * (1.0 - 1e-12))
    updates = float(needed.sum()) * system.n * len(problem.active_sources)
    if updates > MOST_UPDATES:
        raise ModelError(
            f"explicit would take {needed.sum():.3g} steps of {limit:.3g} s over {system.n} pores, "
            f"about {updates * 3e-9 / 3600:.3g} h; use solver.method krylov"
        )
    steps = np.maximum(needed, intervals > 0.0).astype(np.int64)
    start, neighbour, conductance = _adjacency(system)
    with np.errstate(divide="ignore"):
        step_over_storage = 1.0 / system.storage
    answer = empty_answer(problem)
    residual = 0.0
    for k in problem.active_sources:
        rhs = system.source(k)
        p = np.zeros(system.n)
        p[system.pores :] = wells.direct(rhs)
        integral = np.zeros(system.n)
        maps = np.zeros((len(lags), system.n))
        for m, (interval, count) in enumerate(zip(intervals, steps, strict=True)):
            if count:
                dt = interval / count
                _march(
                    p,
                    integral,
                    int(count),
                    dt,
                    start,
                    neighbour,
                    conductance,
                    system.excess,
                    rhs,
                    step_over_storage,
                    system.pores,
                )
            maps[m] = p
            answer.cumulative[k, m] = _volumes(problem, k, p, integral, lags[m])
        answer.output[k] = (problem.records.rows @ maps.T).T + problem.records.direct[k]
        answer.pressure[k] = fill_map(problem, k, maps)
        rate = np.zeros(system.n)
        pores = slice(0, system.pores)
        rate[pores] = _net_flow(system, rhs, p)[pores] / system.storage[pores]
        residual = max(residual, relative_residual(system, rhs, rate, p))
    return answer._replace(time_error=math.nan, residual=residual, work=int(steps.sum()))


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


def _adjacency(system: System) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Neighbours of each unknown and conductances to them, in compressed rows."""
    i = np.concatenate([system.edge_i, system.edge_j])
    j = np.concatenate([system.edge_j, system.edge_i])
    g = np.concatenate([system.edge_g, system.edge_g])
    order = np.lexsort((j, i))
    start = np.searchsorted(i[order], np.arange(system.n + 1))
    return start, j[order], g[order]


@kernel
def _march(p, integral, count, dt, start, neighbour, g, excess, rhs, inverse_storage, pores):
    """Advance p (n,) by `count` steps in place; `integral` gathers ∫ p dt as Euler sees it."""
    n = p.size
    rate = np.empty(pores)
    for _ in range(count):
        for i in range(pores):
            flow = rhs[i] - excess[i] * p[i]
            for k in range(start[i], start[i + 1]):
                flow += g[k] * (p[neighbour[k]] - p[i])
            rate[i] = flow
        for i in range(n):
            integral[i] += dt * p[i]
        for i in range(pores):
            p[i] += dt * inverse_storage[i] * rate[i]
        # wells have no storage: they balance at once (a few sweeps where wells touch)
        for _ in range(1 if n - pores < 2 else 20):
            for w in range(pores, n):
                total, flow = excess[w], rhs[w]
                for k in range(start[w], start[w + 1]):
                    total += g[k]
                    flow += g[k] * p[neighbour[k]]
                p[w] = flow / total
