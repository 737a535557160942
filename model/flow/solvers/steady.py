"""Steady pressure: one sparse factor, one solve for each source."""

from __future__ import annotations

from demflow.model.flow.equation.balance import steady_flow
from demflow.model.flow.equation.problem import Answer, Problem, empty_answer, fill_map
from demflow.model.flow.equation.system import without_outlet
from demflow.model.flow.linear.factor import analyse, factorise
from demflow.model.outcome import ModelError


def steady(problem: Problem) -> Answer:
    """Solve G p = f for a unit of each active source; the one lag is infinity.

    The residual is the largest imbalance of a pore over the flow through it, before anything
    was drained, or the largest share of a flow that was (`SteadyFlow.misfit`).

    Raises `ModelError` where some pore is connected to no fixed pressure.
    """
    system, records = problem.system, problem.records
    if without_outlet(system):
        raise ModelError(
            "no steady state: a well, or a side with an inflow, feeds pores that reach no fixed "
            "pressure; give a boundary pressure, or times for a transient"
        )
    symbolic = analyse(system.n, system.edge_i, system.edge_j)
    factor = factorise(symbolic, system.edge_g, system.excess)
    answer = empty_answer(problem)
    flows = slice(records.well_rows, records.well_rows + records.flow_rows)
    residual, work = 0.0, 0
    for k in problem.active_sources:
        found = steady_flow(system, factor, k)
        answer.output[k, 0] = records.rows @ found.pressure + records.direct[k]
        answer.output[k, 0, flows] = found.inflow(system, k)
        answer.missing[k] = found.missing
        answer.pressure[k] = fill_map(problem, k, found.pressure[None])
        residual = max(residual, found.imbalance, found.misfit)
        work += 1 + found.refinements
    return answer._replace(residual=residual, work=work)
