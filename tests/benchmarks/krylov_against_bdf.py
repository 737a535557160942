"""Krylov against SciPy's BDF at the same true error of the well's pressure."""

from __future__ import annotations

import time

import numpy as np
from scipy.integrate import solve_ivp
from scipy.sparse import coo_array, csc_matrix, csr_array, diags_array

from demflow.model.flow.equation.algebraic import algebraic
from demflow.model.flow.equation.problem import Problem
from tests.benchmarks.result import Result
from tests.diffusion import Timed, cheapest, reference, relative_error, well_problem

DOMAINS = 20_000
ERROR = 1e-4
FASTER = 40.0
LADDER = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)


def bdf(problem: Problem, tolerance: float) -> np.ndarray:
    """The well's pressure for unit rate by BDF on the pores, its sparse Jacobian given."""
    system, pores = problem.system, problem.system.pores
    i, j, g = system.edge_i, system.edge_j, system.edge_g
    n = system.n
    offs = coo_array((np.concatenate([g, g]), (np.concatenate([i, j]), np.concatenate([j, i]))))
    total = system.excess + np.bincount(i, g, n) + np.bincount(j, g, n)
    inner = (diags_array(total) - offs).tocsr()[:pores, :pores]
    wells = algebraic(system)
    reduced = inner - wells.coupling.T @ (csr_array(wells.inverse) @ wells.coupling)
    storage = system.storage[:pores]
    jacobian = csc_matrix(-diags_array(1.0 / storage) @ reduced)
    rhs = system.source(1)
    load = wells.reduce_source(rhs) / storage
    direct = wells.direct(rhs)[0]
    solution = solve_ivp(
        lambda _, p: jacobian @ p + load,
        (0.0, problem.lag[-1]),
        np.zeros(pores),
        method="BDF",
        t_eval=problem.lag,
        rtol=tolerance,
        atol=tolerance * abs(direct),
        jac=jacobian,
    )
    return wells.lift(solution.y)[pores] + direct


def run() -> Result:
    """Times of the loosest tolerances that deliver the error, 81 times over 8 decades."""
    problem = well_problem(DOMAINS)
    exact = reference(problem)
    krylov = cheapest("krylov", problem, exact, ERROR, LADDER, repeats=5)
    for tolerance in (1e-4, 3e-5, 1e-5, 3e-6):
        start = time.perf_counter()
        pressure = bdf(problem, tolerance)
        took = time.perf_counter() - start
        peer = Timed(tolerance, took, relative_error(pressure, exact))
        if peer.error <= ERROR:
            break
    ratio = peer.seconds / krylov.seconds
    return Result(
        f"{ratio:.0f} times faster",
        f"≥ {FASTER:g}",
        bool(ratio >= FASTER and peer.error <= ERROR),
        f"{problem.system.pores} domains\nkrylov {krylov}\nBDF {peer}",
    )
