"""`auto`: a solver that can answer, the tolerance kept, and the reason told."""

import functools

import numpy as np
import pytest

from demflow.model.controls import sites
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.forecast import course, euler_error
from demflow.model.flow.solvers.registry import SOLVERS, choose, solve
from demflow.model.outcome import ModelError
from demflow.model.region import Rectangle
from demflow.model.scene import Probe, Well
from tests.diffusion import reference, relative_error, step_error, well_pressure, well_problem
from tests.reservoirs import reservoir
from tests.rocks import random_graph

pytestmark = pytest.mark.slow

PROBLEM = well_problem(300, decades=5.0, times=21)
LIMIT = step_limit(PROBLEM.system)
STEADY = PROBLEM._replace(lag=np.array([np.inf]))


def error_of(lag, found, exact):
    """The largest error of all that two answers of one side and one well record."""
    return step_error(found, exact, lag, fixed=1, wells=1, flows=True)


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


WELLS = (Well(name="w", at=(0.1, 0.05), radius=0.05, rate=1.0),)
RECORDED = {
    "map": {"record_map": True},
    "probes": {
        "record_map": False,
        "probes": (
            Probe("near", (0.2, 0.05)),
            Probe("side", (-0.9, 0.3)),
            Probe("far", (0.8, -0.8)),
        ),
    },
}


@pytest.mark.parametrize("recorded", RECORDED.values(), ids=RECORDED)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("wells", "sides"), [(WELLS, ()), ((), ("left",)), (WELLS, ("left",))])
def test_the_choice_keeps_the_tolerance_far_from_the_source(wells, sides, seed, recorded):
    """Short windows, where explicit tempts: the field's error is not that of the source."""
    packing = random_graph(1.1, 700, seed)
    rock = reservoir(packing._replace(radius=0.5 * packing.radius), Rectangle(2.0, 2.0))
    limit = step_limit(rock.assembled(sites(wells), sides))
    for first in (3.0, 30.0):
        asked = (wells, sides, tuple(limit * np.geomspace(first, 10.0 * first, 5)))
        exact = rock.respond(*asked, tolerance=1e-11, **recorded)
        for tolerance in (1e-4, 1e-6):
            found = rock.respond(*asked, method="auto", tolerance=tolerance, **recorded)
            error = step_error(
                found, exact, exact.lag, fixed=len(sides), wells=len(wells), flows=True
            )
            allowed = tolerance if found.solver == "explicit" else 3 * tolerance
            assert error <= allowed, found.solver_reason


def recorded_of_one_source(seed, source):
    """Maps and probes of a problem in two windows, where one source acts."""
    plain = well_problem(300, seed=seed, at=(0.1 * seed, -0.2))
    limit, pores = step_limit(plain.system), plain.system.domain
    plain = plain._replace(active=np.arange(2) == source, check_flows=True)
    mapped = plain._replace(domain=pores)
    probed = plain._replace(records=outputs(plain.system, pores[::20]))
    for problem in (mapped, probed):
        for first in (3.0, 30.0):
            yield problem._replace(lag=limit * np.geomspace(first, 10.0 * first, 7))


@functools.cache
def with_their_answers(seed, source):
    """The same, and what krylov answers: one serves all tolerances."""
    asked = tuple(recorded_of_one_source(seed, source))
    return [(one, SOLVERS["krylov"].run(one._replace(tolerance=1e-10))) for one in asked]


@pytest.mark.parametrize("source", [0, 1], ids=["side", "well"])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_the_bound_on_the_explicit_step_holds_for_maps_probes_and_flows(tolerance, seed, source):
    for asked, exact in with_their_answers(seed, source):
        problem = asked._replace(tolerance=tolerance)
        safety = SOLVERS["explicit"].forecast(problem, course(problem)).safety_factor
        found = SOLVERS["explicit"].run(problem._replace(safety_factor=safety))
        assert error_of(asked.lag, found, exact) <= tolerance


def keeps_the_tolerance_or_tells(asked):
    """Whether explicit, at the step forecast, is right or finds in its answer that it is not."""
    exact = SOLVERS["krylov"].run(asked._replace(tolerance=1e-11))
    for tolerance in (1e-2, 1e-4):
        problem = asked._replace(tolerance=tolerance)
        forecast = SOLVERS["explicit"].forecast(problem, course(problem))
        put = problem._replace(safety_factor=forecast.safety_factor)
        answer = SOLVERS["explicit"].run(put)
        told = tolerance if forecast.proven else euler_error(put, answer)
        if error_of(asked.lag, answer, exact) > max(told, tolerance):
            return False
    return True


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("at", [(0.1, 0.05), (-0.9, 0.1)], ids=["far", "near"])
def test_an_answer_that_is_looked_at_keeps_the_tolerance(at, seed):
    """A well and a side: far apart explicit will do; near each other it is told by its answer."""
    plain = well_problem(600, seed=seed, at=at)._replace(check_flows=True)
    limit = step_limit(plain.system)
    for source in (0, 1):
        for first in (3.0, 10.0, 30.0):
            lag = limit * np.geomspace(first, 10.0 * first, 21)
            asked = plain._replace(active=np.arange(2) == source, lag=lag)
            assert keeps_the_tolerance_or_tells(asked)


@pytest.mark.parametrize("seed", range(3))
def test_maps_and_probes_that_are_looked_at_keep_the_tolerance(seed):
    plain = well_problem(600, seed=seed, at=(0.1, 0.05))
    limit, pores = step_limit(plain.system), plain.system.domain
    for recorded in ({"domain": pores}, {"records": outputs(plain.system, pores[::20])}):
        for first in (3.0, 30.0):
            lag = limit * np.geomspace(first, 10.0 * first, 21)
            assert keeps_the_tolerance_or_tells(plain._replace(lag=lag, **recorded))


def test_where_the_choice_fails_the_next_one_answers(monkeypatch):
    from demflow.model.flow.solvers import krylov as krylov_module

    plain, _ = solve("auto", PROBLEM)
    assert plain.method == "krylov"
    monkeypatch.setattr(krylov_module, "MOST_VECTORS", 4)
    choice, answer = solve("auto", PROBLEM)
    assert choice.method == "implicit"
    assert "krylov failed: krylov reached a relative error" in choice.reason
    monkeypatch.undo()
    assert relative_error(well_pressure(answer), reference(PROBLEM)) <= 3 * PROBLEM.tolerance


def test_where_no_choice_answers_the_first_one_is_heard(monkeypatch):
    from demflow.model.flow.solvers import explicit as explicit_module
    from demflow.model.flow.solvers import implicit as implicit_module
    from demflow.model.flow.solvers import krylov as krylov_module

    monkeypatch.setattr(krylov_module, "MOST_VECTORS", 4)
    monkeypatch.setattr(implicit_module, "MOST_STEPS", 3)
    monkeypatch.setattr(explicit_module, "MOST_UPDATES", 1.0)
    with pytest.raises(ModelError, match="krylov reached"):
        solve("auto", PROBLEM)


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
