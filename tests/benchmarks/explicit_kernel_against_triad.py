"""The explicit step streams its network at the pace of a triad, at a million domains too."""

from __future__ import annotations

import numba
import numpy as np

from demflow.model.flow.equation.algebraic import algebraic
from demflow.model.flow.equation.problem import Problem
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.flow.solvers.stencil import stencil
from tests.benchmarks.result import Result
from tests.diffusion import seconds, well_problem

SMALL, LARGE = 10_000, 1_000_000
UPDATES = 1e9  # pore updates that are timed
ROUNDS = 3  # in which step and triad are timed in turn: the host shares its memory


@numba.njit
def triad(a, b, c, s, count):
    """Stream three arrays `count` times."""
    for _ in range(count):
        for i in range(a.size):
            a[i] = b[i] + s * c[i]


def step_seconds(problem: Problem) -> float:
    """Time of one step: what further steps add to a run, so that its preparation drops out."""
    limit = step_limit(problem.system)
    few = 10
    many = few + max(20, int(UPDATES / problem.system.pores))

    def run(steps: int) -> float:
        asked = problem._replace(lag=np.array([steps * limit]), safety_factor=1.0)
        return seconds(lambda: SOLVERS["explicit"].run(asked), 1)

    return (run(many) - run(few)) / (many - few)


def bytes_of_a_step(problem: Problem) -> int:
    """What a step reads and writes: two pressures a pore, and the stencil."""
    rows = stencil(problem.system, algebraic(problem.system))
    parts = (rows.near, rows.near_weight, rows.row, rows.column, rows.weight)
    return 16 * problem.system.pores + sum(part.nbytes for part in parts)


def triad_seconds(size: int) -> float:
    """Time in which a triad streams so many bytes."""
    a, b, c = (np.ones(size // 24) for _ in range(3))
    count = max(10, int(2e10 / size))
    triad(a, b, c, 0.5, 1)
    return seconds(lambda: triad(a, b, c, 0.5, count), 1) / count


def run() -> Result:
    """Part of the triad's bandwidth at 1e6 domains, and its cost a domain against that at 1e4."""
    lines, cost = [], {}
    for domains in (SMALL, LARGE):
        problem = well_problem(domains, times=2)
        pores, size = problem.system.pores, bytes_of_a_step(problem)
        timed = [(step_seconds(problem), triad_seconds(size)) for _ in range(ROUNDS)]
        step, stream = np.median(timed, axis=0)
        cost[domains], part = step / pores, stream / step
        lines.append(
            f"{pores} domains: {1e9 * step / pores:.2f} ns a domain-step, {size / pores:.0f} B; "
            f"{size / step / 1e9:.1f} GB/s of the triad's {size / stream / 1e9:.1f}"
        )
    growth = cost[LARGE] / cost[SMALL]
    return Result(
        f"{part:.0%} of the triad's bandwidth, {growth:.2f} times the cost at 1e4",
        "≥ 60 %, ≤ 2.5",
        bool(part >= 0.6 and growth <= 2.5),
        "\n".join(lines),
    )
