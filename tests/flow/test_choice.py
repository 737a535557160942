"""`auto`: a solver that can answer, the tolerance kept, and the reason told."""

import numpy as np
import pytest

from model.flow.choice import course
from model.flow.explicit import step_limit
from model.flow.solvers import SOLVERS, choose
from tests.diffusion import reference, relative_error, well_pressure, well_problem

PROBLEM = well_problem(300, decades=5.0, times=21)
LIMIT = step_limit(PROBLEM.system)
STEADY = PROBLEM._replace(lag=np.array([np.inf]))


def test_a_solver_asked_for_runs_as_it_is():
    for method in SOLVERS:
        choice = choose(method, PROBLEM)
        assert (choice.method, choice.reason) == (method, "asked for")
        assert choice.problem is PROBLEM


def test_every_solver_that_can_answer_is_weighed():
    choice = choose("auto", PROBLEM)
    assert SOLVERS[choice.method].transient
    for method, solver in SOLVERS.items():
        assert (f"{method} " in choice.reason) == solver.transient
        assert solver.forecast(PROBLEM, course(PROBLEM)).seconds > 0
    assert choose("auto", STEADY).method == "steady"


@pytest.mark.parametrize("steps", [(3, 30), (30, 300), (1e3, 1e5), (1e4, 1e9)])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-5])
def test_the_choice_keeps_the_tolerance(steps, tolerance):
    lag = LIMIT * np.geomspace(*steps, 15)
    problem = PROBLEM._replace(lag=lag, tolerance=tolerance)
    choice = choose("auto", problem)
    answer = SOLVERS[choice.method].run(choice.problem)
    assert relative_error(well_pressure(answer), reference(problem)) <= 3 * tolerance


@pytest.mark.parametrize("steps", [(3, 30), (100, 1000)])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_the_bound_on_the_explicit_step_holds(steps, tolerance):
    problem = PROBLEM._replace(lag=LIMIT * np.geomspace(*steps, 9), tolerance=tolerance)
    safety = SOLVERS["explicit"].forecast(problem, course(problem)).safety_factor
    answer = SOLVERS["explicit"].run(problem._replace(safety_factor=safety))
    assert relative_error(well_pressure(answer), reference(problem)) <= tolerance


def test_long_windows_are_not_marched_through():
    """What explicit would take grows with the last time; krylov's forecast hardly does."""
    near, far = (PROBLEM._replace(lag=LIMIT * np.geomspace(10.0, t, 9)) for t in (1e2, 1e8))
    explicit, krylov = (
        [SOLVERS[method].forecast(window, course(window)).seconds for window in (near, far)]
        for method in ("explicit", "krylov")
    )
    assert explicit[1] > 1e4 * explicit[0]
    assert krylov[1] < 4 * krylov[0]
    assert choose("auto", far).method == "krylov"
