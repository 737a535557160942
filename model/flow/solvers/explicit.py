"""Forward Euler in time: the paper's scheme (Eqs 5 and 14), with its step put right.

Eq. 14 bounds the step by what one aperture per pore would allow (`paper_step`). Where
apertures differ within a pore, the bound that keeps pressures positive is C_i / Σ_j g_ij;
stability itself ends at 2 / λ_max.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from demflow.model.flow.equation.algebraic import Algebraic, algebraic
from demflow.model.flow.equation.problem import (
    Answer,
    Problem,
    empty_answer,
    fill_map,
    relative_residual,
)
from demflow.model.flow.equation.system import System
from demflow.model.flow.solvers.stencil import driven, march, stencil
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Network

# Pore updates that a run may take (about twenty minutes).
MOST_UPDATES = 5e11
SECONDS_PER_UPDATE = 2.5e-9

# Restarts that the fastest decay rate may take; some tens are usual.
MOST_RESTARTS = 1000


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
    """Largest eigenvalue λ of C⁻¹G on the pores, 1/s; forward Euler is stable up to 2/λ.

    Raises `ModelError` where it is not found in `MOST_RESTARTS` restarts.
    """
    pores = system.pores
    root = np.sqrt(system.storage[:pores])

    def apply(scaled: np.ndarray) -> np.ndarray:
        full = wells.lift(np.ravel(scaled) / root)
        found: np.ndarray = -_net_flow(system, np.zeros(system.n), full)[:pores] / root
        return found

    if pores < 30:
        matrix = np.column_stack([apply(unit) for unit in np.eye(pores)])
        return float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).max(initial=0.0))
    start = np.random.default_rng(0).standard_normal(pores)
    operator = LinearOperator((pores, pores), matvec=apply, dtype=float)
    try:
        found = eigsh(
            operator,
            k=1,
            which="LA",
            v0=start,
            maxiter=MOST_RESTARTS,
            return_eigenvectors=False,
        )
    except ArpackNoConvergence as none:
        raise ModelError(
            "explicit cannot tell whether its step is stable, since the fastest decay rate was not "
            "found; take a solver.safety_factor of 1 or less with solver.step corrected, which "
            "is, or use solver.method krylov"
        ) from none
    return float(found[0])


def paper_step(
    network: Network, apertures: Apertures, bulk_modulus: float, domains: np.ndarray
) -> float:
    """Step of Eq. 14 as printed, min 24 μ R̄ V_d / (N K_f w³) over some domains, in s.

    N is a domain's number of pipes, R̄ the mean radius of the grains around it and w the mean
    aperture of its pipes, by Eq. 1 from their conductances. Where all have one aperture this
    is C_i / Σ_j g_ij, but for R̄; elsewhere it is no bound.

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    bulk_modulus : of the fluid, Pa
    domains : which pores count, (k,) int
    """
    d = len(network.volume)
    ends = np.concatenate([network.pipe_from, network.pipe_to])
    cubed = apertures.conductance * network.pipe_length  # w³ / (12 μ)
    pipes = np.bincount(ends, minlength=d)
    root = np.bincount(ends, weights=np.tile(np.cbrt(cubed), 2), minlength=d)
    domains = domains[domains < d]
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
        moved = driven(rows, rhs, system)
        p = np.zeros(system.n)
        p[system.pores :] = wells.direct(rhs)
        q = p.copy()
        integral = np.zeros(system.n)
        field = np.zeros(system.n)
        for m, (interval, count) in enumerate(zip(intervals, steps, strict=True)):
            if count:
                dt = interval / count
                p, q = march(p, q, integral, int(count), dt, rows, moved, rhs[system.pores :])
            field[rows.order] = p
            _record(problem, k, m, field, integral, answer)
        rate = np.zeros(system.n)
        pores = slice(0, system.pores)
        rate[pores] = _net_flow(system, rhs, field)[pores] / system.storage[pores]
        residual = float(np.maximum(residual, relative_residual(system, rhs, rate, field)))
    return answer._replace(time_error=math.nan, residual=residual, work=int(steps.sum()))


def _in_words(seconds: float) -> str:
    """A duration that a person can judge."""
    units = (("years", 31_557_600.0), ("days", 86_400.0), ("hours", 3_600.0), ("minutes", 60.0))
    for unit, size in units:
        if seconds >= 2.0 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} seconds"


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
    found: np.ndarray = net + np.bincount(system.edge_j, weights=flow, minlength=system.n)
    return found


def _record(
    problem: Problem, source: int, m: int, p: np.ndarray, integral: np.ndarray, answer: Answer
) -> None:
    """Fill lag `m` of one source's part of the answer (in place)."""
    records, direct = problem.records, problem.records.direct[source]
    flows = slice(records.well_rows, records.well_rows + records.flow_rows)
    now, through = (records.rows @ np.column_stack([p, integral])).T
    answer.output[source, m] = now + direct
    answer.cumulative[source, m, :-1] = (through + problem.lag[m] * direct)[flows]
    answer.cumulative[source, m, -1] = problem.system.storage @ p
    if len(problem.domain):
        answer.pressure[source, m] = fill_map(problem, source, p[None])[0]
