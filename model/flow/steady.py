"""Steady pressure: one sparse factor, one solve for each source."""

from __future__ import annotations

import numpy as np

from model.flow.factor import analyse, factorise, solve
from model.flow.problem import Answer, Problem, empty_answer, fill_map, relative_residual
from model.flow.system import without_outlet
from model.outcome import ModelError


def steady(problem: Problem) -> Answer:
    """Solve G p = f for a unit of each active source; the one lag is infinity.

    Raises `ModelError` where some pore is connected to no fixed pressure.
    """
    system = problem.system
    if without_outlet(system):
        raise ModelError(
            "no steady state: a well feeds pores that reach no fixed pressure; give a boundary "
            "pressure, or times for a transient"
        )
    symbolic = analyse(system.n, system.edge_i, system.edge_j)
    factor = factorise(symbolic, system.edge_g, system.excess)
    answer = empty_answer(problem)
    residual = 0.0
    for k in problem.active_sources:
        rhs = system.source(k)
        p = solve(factor, rhs)
        answer.output[k, 0] = problem.records.rows @ p + problem.records.direct[k]
        answer.pressure[k] = fill_map(problem, k, p[None])
        residual = max(residual, relative_residual(system, rhs, np.zeros(system.n), p))
    return answer._replace(residual=residual, work=int(problem.active.sum()))
