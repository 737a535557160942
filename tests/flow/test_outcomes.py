"""What a solver cannot give is an outcome that says so: never a number that is none."""

import tracemalloc

import numpy as np
import pytest
from scipy.sparse.linalg import ArpackNoConvergence

from demflow.model import memory
from demflow.model.flow.equation.algebraic import algebraic
from demflow.model.flow.linear.factor import analyse, factorise
from demflow.model.flow.solvers import explicit as explicit_module
from demflow.model.flow.solvers import subspace as subspace_module
from demflow.model.flow.solvers.explicit import _in_words, fastest_decay, step_limit
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.outcome import ModelError, OutOfMemory
from demflow.model.region import Rectangle
from demflow.model.scene import LEAST_TOLERANCE, Well
from tests.diffusion import reference, relative_error, well_pressure, well_problem
from tests.reservoirs import reservoir
from tests.rocks import random_graph

PROBLEM = well_problem(300, decades=5.0, times=21)
STEADY = PROBLEM._replace(lag=np.array([np.inf]))
GRAPH = random_graph(1.2, 400, 3)
ROCK = reservoir(GRAPH._replace(radius=0.5 * GRAPH.radius), Rectangle(2.0, 1.4), 2e-5)
WELL = Well(name="w", at=(0.3, 0.2), radius=0.1, rate=1.0)
TIMES = tuple(step_limit(ROCK.assembled((), ("left",))) * np.geomspace(10.0, 300.0, 7))
every = pytest.mark.parametrize("method", SOLVERS)


def posed(method):
    """The problem with so short a window that explicit answers it too."""
    if not SOLVERS[method].transient:
        return STEADY
    lag = step_limit(PROBLEM.system) * np.geomspace(100.0, 3000.0, 9)
    return PROBLEM._replace(lag=lag) if method == "explicit" else PROBLEM


def answered(method, problem):
    """The answer, or the words of the error in its place."""
    try:
        return SOLVERS[method].run(problem)
    except ModelError as error:
        return str(error)


@pytest.mark.slow
@every
def test_a_tolerance_below_round_off_gives_numbers_or_an_error(method):
    found = answered(method, posed(method)._replace(tolerance=1e-16))
    if isinstance(found, str):
        assert "solver.tolerance" in found
        return
    for what in ("output", "cumulative", "pressure", "residual"):
        assert np.isfinite(getattr(found, what)).all()
    if SOLVERS[method].controls_error and SOLVERS[method].transient:
        assert found.time_error >= 1e-16


@pytest.mark.slow
@every
def test_the_least_tolerance_is_kept_or_told(method):
    problem = posed(method)._replace(tolerance=LEAST_TOLERANCE)
    if not (SOLVERS[method].controls_error and SOLVERS[method].transient):
        return
    found = answered(method, problem)
    if isinstance(found, str):
        assert "solver.tolerance" in found
        return
    assert relative_error(well_pressure(found), reference(problem)) <= 1e-9


@pytest.mark.slow
@every
def test_the_registry_says_who_estimates_the_error(method):
    solver = SOLVERS[method]
    found = ROCK.respond((WELL,), ("left",), TIMES if solver.transient else (), method)
    assert np.isfinite(found.time_error) == solver.controls_error
    if solver.controls_error:
        assert found.time_error <= 1e-9
        assert found.tolerance_met == 1.0
    else:
        assert np.isnan(found.tolerance_met)


def test_a_tolerance_that_is_not_met_is_told(monkeypatch):
    """Where round-off ends the way, the answer comes with a word."""
    solver = SOLVERS["krylov"]
    monkeypatch.setitem(
        SOLVERS,
        "krylov",
        solver._replace(run=lambda problem: solver.run(problem)._replace(time_error=2e-9)),
    )
    assert ROCK.respond((WELL,), ("left",), TIMES).tolerance_met == 0.0
    assert ROCK.observed((WELL,), (("left", 0.0),), 0.0, TIMES)["tolerance_met"] == 0.0


@pytest.mark.slow
@every
@pytest.mark.parametrize("what", ["output", "cumulative", "pressure", "residual"])
def test_what_is_no_number_is_no_answer(method, what, monkeypatch):
    solver = SOLVERS[method]

    def broken(problem):
        answer = solver.run(problem)
        wrong = np.array(getattr(answer, what), dtype=float)
        wrong.flat[-1] = np.nan
        return answer._replace(**{what: wrong})

    monkeypatch.setitem(SOLVERS, method, solver._replace(run=broken))
    with pytest.raises(ModelError, match=f"{method} gave a {what}"):
        ROCK.respond((WELL,), ("left",), TIMES if solver.transient else (), method)


@every
def test_an_answer_that_would_not_fit_is_not_begun(method, monkeypatch):
    monkeypatch.setattr(memory, "SMALL", 0)
    monkeypatch.setattr(memory, "available", lambda: 1e3)
    solver = SOLVERS[method]
    monkeypatch.setitem(SOLVERS, method, solver._replace(run=None))
    with pytest.raises(OutOfMemory, match=r"responses of 2 sources at \d+ lags.*fewer times"):
        ROCK.respond((), ("left", "right"), TIMES if solver.transient else (), method)


def test_a_space_that_would_not_fit_is_not_grown(monkeypatch):
    asked = []
    monkeypatch.setattr(subspace_module, "foresee", lambda what, size: asked.append((what, size)))
    monkeypatch.setattr(subspace_module, "FIRST_ROOM", 4)
    monkeypatch.setattr(subspace_module, "MOST_VECTORS", 14)
    SOLVERS["krylov"].run(PROBLEM)
    rooms = [int(size / PROBLEM.system.n / 8) for _, size in asked]
    assert rooms[:2] == [8, 16]
    assert np.all(np.diff(rooms[1:]) == 1)


@pytest.mark.slow
def test_explicit_holds_no_field_for_each_lag():
    """A schedule has thousands of lags; without maps only the outputs are kept."""
    lag = step_limit(PROBLEM.system) * np.linspace(1.0, 500.0, 5000)
    problem = PROBLEM._replace(lag=lag)
    fields = lag.nbytes * problem.system.n
    tracemalloc.start()
    SOLVERS["explicit"].run(problem)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 0.3 * fields


def test_a_singular_matrix_is_told():
    i, j = np.array([0, 2]), np.array([1, 3])  # two pairs, one of which nothing holds
    symbolic = analyse(5, i, j)
    with pytest.raises(ModelError, match="singular"):
        factorise(symbolic, np.ones(2), np.array([1.0, 0.0, 0.0, 0.0, 1.0]))
    with pytest.raises(ModelError, match="singular"):
        factorise(symbolic, np.ones(2), np.array([1.0, 0.0, 1.0, 0.0, 0.0]))


def test_a_decay_rate_that_is_not_found_is_told(monkeypatch):
    def lost(*_, **__):
        raise ArpackNoConvergence("no convergence", np.empty(0), np.empty((0, 0)))

    monkeypatch.setattr(explicit_module, "eigsh", lost)
    with pytest.raises(ModelError, match=r"solver\.safety_factor"):
        fastest_decay(PROBLEM.system, algebraic(PROBLEM.system))


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0.4 seconds"), (150.0, "2.5 minutes"), (9e3, "2.5 hours"), (4e8, "13 years")],
)
def test_durations_in_words(seconds, words):
    assert _in_words(seconds) == words
