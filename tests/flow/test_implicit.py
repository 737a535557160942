"""The implicit solver: its method's conditions, its observed order, its error and its balance."""

import numpy as np
import pytest

from demflow.model.flow.equation.algebraic import algebraic
from demflow.model.flow.solvers import implicit as implicit_module
from demflow.model.flow.solvers.implicit import (
    EMBEDDED,
    GAMMA,
    RUNGS_PER_OCTAVE,
    STAGES,
    WEIGHTS,
    Ladder,
    State,
    implicit,
    take_step,
    weights_at,
)
from demflow.model.outcome import ModelError
from tests.diffusion import reference, relative_error, well_pressure, well_problem
from tests.reservoirs import dense_matrices, exact_response

PROBLEM = well_problem(250, decades=5.0, times=31)
SYSTEM = PROBLEM.system
EXACT = exact_response(SYSTEM, 1, PROBLEM.lag)
WELL = SYSTEM.pores


def test_the_method_meets_the_conditions_of_its_order():
    """All eight of order four; the embedded weights those of order three only."""
    node = STAGES.sum(axis=1)
    third = [
        (np.ones(6), 1),
        (node, 1 / 2),
        (node**2, 1 / 3),
        (STAGES @ node, 1 / 6),
    ]
    fourth = [
        (node**3, 1 / 4),
        (node * (STAGES @ node), 1 / 8),
        (STAGES @ node**2, 1 / 12),
        (STAGES @ STAGES @ node, 1 / 24),
    ]
    for vector, value in third + fourth:
        assert WEIGHTS @ vector == pytest.approx(value, abs=1e-14)
    for vector, value in third:
        assert EMBEDDED @ vector == pytest.approx(value, abs=1e-14)
    assert any(abs(EMBEDDED @ vector - value) > 1e-4 for vector, value in fourth)
    np.testing.assert_allclose(np.diag(STAGES)[1:], GAMMA)
    # every stage is itself of second order
    np.testing.assert_allclose(STAGES @ node, node**2 / 2, atol=1e-14)


def test_the_method_is_stable_for_any_decay_and_forgets_fast_ones():
    """|R(z)| ≤ 1 on the left half-plane, R → 0 at −∞, and the estimate stays finite."""

    def growth(z, weights):
        return 1 + z * weights @ np.linalg.solve(np.eye(6) - z * STAGES, np.ones(6))

    imaginary = [abs(growth(1j * y, WEIGHTS)) for y in np.logspace(-3, 6, 200)]
    assert max(imaginary) <= 1 + 1e-12
    assert abs(growth(-1e9, WEIGHTS)) < 1e-7
    assert abs(growth(-1e9, EMBEDDED)) < 1


def test_the_observed_order_is_four():
    """Halving the step divides the error by 16, from a state that forgot its first moments."""
    wells = algebraic(SYSTEM)
    rhs = SYSTEM.source(1)
    ladder = Ladder(SYSTEM)
    rung = ladder.rung(PROBLEM.lag[10])
    size = ladder.step(rung)
    start, end = exact_response(SYSTEM, 1, np.array([size, 2 * size]))
    matrix, storage = dense_matrices(SYSTEM)
    rate = wells.lift((rhs - matrix @ start)[: SYSTEM.pores] / storage)
    errors = []
    for halvings in range(2, 5):
        state = State(0.0, start, rate, np.zeros(1))
        step_rung = rung - RUNGS_PER_OCTAVE * halvings
        for _ in range(2**halvings):
            step = take_step(SYSTEM, ladder.factor(step_rung), rhs, state, ladder.step(step_rung))
            state = State(0.0, step.value[-1], step.increment[-1] / step.size, np.zeros(1))
        errors.append(np.abs(state.pressure - end).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.1)


def test_pressure_within_a_step_is_of_third_order_and_meets_its_end():
    node = STAGES.sum(axis=1)
    np.testing.assert_array_equal(weights_at(1.0)[1], WEIGHTS)
    for part in (1e-3, 0.2, 0.5, 0.9, 1.0):
        values, increments = weights_at(part)
        assert values[:-1].sum() == pytest.approx(1.0, abs=1e-12)
        for power in (1, 2, 3):
            moment = increments @ node ** (power - 1)
            assert moment == pytest.approx(part**power / power, abs=1e-12)


def test_what_the_step_sees_of_its_error_covers_what_lies_within():
    """For decays of any rate, those far faster than the step too."""
    decay = np.logspace(-1, 9, 400)
    stages = np.linalg.solve(np.eye(6) + decay[:, None, None] * STAGES, np.ones((6, 1)))[..., 0]
    seen = decay * np.abs(stages @ (WEIGHTS - EMBEDDED))
    known = np.column_stack([stages, -decay * stages[:, -1]])
    for part in np.linspace(0.002, 1.0, 60):
        values, _ = weights_at(float(part))
        error = np.abs(known @ values - np.exp(-decay * part))
        assert np.max(error / seen) <= 5.5


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4, 1e-6, 1e-8])
def test_tolerance_means_error(tolerance):
    answer = implicit(PROBLEM._replace(tolerance=tolerance))
    ratio = relative_error(well_pressure(answer), EXACT[:, WELL]) / tolerance
    assert 0.01 <= ratio <= 1.0
    assert answer.time_error <= tolerance


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-7])
def test_fluid_let_in_and_stored_balances_at_every_lag(tolerance):
    """Stored = let in − produced, whatever the error of the pressure."""
    answer = implicit(PROBLEM._replace(tolerance=tolerance))
    let_in, stored = answer.cumulative[1].T
    produced = PROBLEM.lag
    np.testing.assert_allclose(stored, let_in - produced, atol=0, rtol=1e-10)


def test_agrees_with_krylov_where_conductances_lie_nine_decades_apart():
    """Dense eigenvectors lose the slow modes there; the two solvers share only the factor."""
    problem = well_problem(400, contrast=1e9, seed=4, decades=6.0, times=25)
    found = well_pressure(implicit(problem._replace(tolerance=1e-8)))
    assert relative_error(found, reference(problem)) <= 1e-8


def test_factors_are_reused():
    """Far fewer factors than steps, and none anew for a second source of the same steps."""
    answer = implicit(PROBLEM._replace(tolerance=1e-8))
    ladder = Ladder(SYSTEM)
    rungs = ladder.rung(PROBLEM.lag[-1]) - ladder.rung(1e-6 * PROBLEM.lag[0])
    assert answer.work > 5 * rungs
    assert ladder.factor(3) is ladder.factor(3)
    assert ladder.made == 1


def test_few_factors_are_kept_where_memory_is_short(monkeypatch):
    monkeypatch.setattr(implicit_module, "CACHE_BYTES", 1)
    frugal = implicit(PROBLEM._replace(tolerance=1e-3))
    monkeypatch.undo()
    plain = implicit(PROBLEM._replace(tolerance=1e-3))
    np.testing.assert_array_equal(frugal.output, plain.output)


def test_the_ladder_has_a_fixed_ratio():
    for rung in (-70, -1, 0, 5, 41):
        assert Ladder.rung(Ladder.step(rung)) == rung
        assert Ladder.rung(1.2 * Ladder.step(rung)) == rung
        assert Ladder.step(rung + 1) / Ladder.step(rung) == pytest.approx(
            2.0 ** (1 / RUNGS_PER_OCTAVE)
        )


def test_too_many_steps_are_an_outcome(monkeypatch):
    monkeypatch.setattr(implicit_module, "MOST_STEPS", 3)
    with pytest.raises(ModelError, match="krylov"):
        implicit(PROBLEM)
