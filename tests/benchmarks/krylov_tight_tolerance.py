"""Eight digits of the well's pressure cost krylov little more than four."""

from __future__ import annotations

from tests.benchmarks.result import Result, at_most
from tests.diffusion import cheapest, reference, well_problem

DOMAINS = 20_000
LADDER = tuple(m * 10.0**-k for k in range(2, 10) for m in (1.0, 0.3))


def run() -> Result:
    """Time to a true error of 1e-8 over time to 1e-4, 81 times over 8 decades."""
    problem = well_problem(DOMAINS)
    exact = reference(problem)
    loose = cheapest("krylov", problem, exact, 1e-4, LADDER, repeats=5)
    tight = cheapest("krylov", problem, exact, 1e-8, LADDER, repeats=5)
    return at_most(
        tight.seconds / loose.seconds,
        2.0,
        "time at 1e-8 over time at 1e-4",
        f"{problem.system.pores} domains\n{loose}\n{tight}",
    )
