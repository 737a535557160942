"""Krylov against the paper's explicit scheme on its linear scene of 5,000 grains."""

from __future__ import annotations

import numpy as np

from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.problem import Problem
from demflow.model.flow.equation.system import assemble
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.stages import run_stages
from demflow.sweep import load_study
from demflow.sweep.study.cases import case_at
from tests.benchmarks.ran import STUDIES
from tests.benchmarks.result import Result
from tests.diffusion import seconds


def linear_problem() -> Problem:
    """The first packing of studies/paper_linear.yaml: pressure of every domain at its times."""
    study = load_study(STUDIES / "paper_linear.yaml")
    scene = case_at(study, [0] * len(study.axes)).scene
    products = run_stages(scene)
    system = assemble(
        products["network"],
        products["open"],
        region=scene.region,
        bulk_modulus=scene.fluid.bulk_modulus,
        wells=(),
        sides=tuple(name for name, _ in scene.boundaries),
    )
    return Problem(
        system=system,
        records=outputs(system, np.empty(0, dtype=np.int64)),
        lag=np.array(scene.times[:-1]),  # the last is the steady state
        active=np.array([False, True]),
        domain=system.domain,
        tolerance=1e-4,
        safety_factor=0.9,
    )


def run() -> Result:
    """Ratio of the times, krylov held to the largest error of the maps that explicit makes."""
    problem = linear_problem()
    exact = SOLVERS["krylov"].run(problem._replace(tolerance=1e-10)).pressure[1]

    def error(method: str, tolerance: float) -> float:
        answer = SOLVERS[method].run(problem._replace(tolerance=tolerance))
        return float(np.abs(answer.pressure[1] - exact).max() / np.abs(exact).max())

    by_explicit = error("explicit", 1e-4)
    for tolerance in (m * 10.0**-k for k in range(1, 9) for m in (3.0, 1.0)):
        by_krylov = error("krylov", tolerance)
        if by_krylov <= by_explicit:
            break
    asked = problem._replace(tolerance=tolerance)
    slow = seconds(lambda: SOLVERS["explicit"].run(asked), 1)
    fast = seconds(lambda: SOLVERS["krylov"].run(asked), 5)
    return Result(
        f"{slow / fast:.0f} times faster",
        "≥ 1, krylov's error not larger",
        bool(slow >= fast and by_krylov <= by_explicit),
        f"{problem.system.pores} domains, {len(problem.lag)} times, error of the maps over the "
        f"boundary's step\nexplicit at 0.9 of its step: {slow:.3f} s, error {by_explicit:.1e}\n"
        f"krylov at tolerance {tolerance:.0e}: {fast:.3f} s, error {by_krylov:.1e}",
    )
