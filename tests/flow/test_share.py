"""How large the sums are from which errors of responses are told apart."""

import numpy as np
import pytest

from demflow.model.flow.equation.problem import Steps, fill_map, fill_maps
from demflow.model.flow.solvers.share import pulse, told
from tests.diffusion import well_problem
from tests.reservoirs import exact_response

RISES = {
    "closed rock": lambda t: t,
    "a side far away": lambda t: np.exp(-3.0 / np.maximum(t, 1e-9)),
    "what settles": lambda t: 1.0 - np.exp(-t),
    "what goes on": lambda t: np.log1p(t),
}


@pytest.mark.parametrize("rise", RISES)
@pytest.mark.parametrize("shortest", [1e-2, 0.3, 5.0, 1e3])
def test_a_pulse_is_told_no_larger_than_it_is_and_not_much_smaller(rise, shortest):
    """Against all pulses on a fine grid, for lags off it."""
    response = RISES[rise]
    lag = np.geomspace(1.7e-3, 1e4, 61)
    fine = np.geomspace(1e-4, 1e4, 4001)
    right = np.abs(response(fine) - response(np.maximum(fine - shortest, 0.0))).max()
    found = pulse(lag, response(lag)[:, None], 2, shortest)[0]
    assert 0.3 * right <= found <= right * (1.0 + 1e-9)


def test_a_source_of_one_step_moves_all_that_it_does():
    response = np.array([[0.0, 1.0], [-3.0, 1.5], [2.0, 2.0]])
    assert pulse(np.array([0.0, 1.0, 2.0]), response, 1, np.inf).tolist() == [3.0, 2.0]


@pytest.mark.parametrize("source", [0, 1])
def test_the_lags_that_are_told_hold_the_largest_pressure_of_a_single_step(source):
    """Of a fixed pressure and of a rate, against all lags by dense eigenvectors."""
    problem = well_problem(150, decades=6.0)
    moved = np.abs(exact_response(problem.system, source, problem.lag)).max(axis=1)
    at = told(problem, source)
    assert at.sum() == 1
    assert moved[at].max() == pytest.approx(moved.max(), rel=1e-9)
    twice = Steps(np.ones(2), np.full(2, 2.0), np.ones(2))
    assert np.array_equal(told(problem._replace(steps=twice), source), problem.lag > 0.0)


def test_maps_of_a_basis_are_those_of_its_fields():
    """Whether every mapped pore is an unknown or some have a fixed pressure of their own."""
    problem, rng = well_problem(150), np.random.default_rng(1)
    system = problem.system
    places = len(system.node_of_domain)
    vectors, coefficients = rng.normal(size=(system.n, 5)), rng.normal(size=(4, 5))
    direct = np.where(np.arange(system.n) < system.pores, 0.0, 2.0)
    for domain in (np.flatnonzero(system.node_of_domain >= 0), np.arange(places)):
        asked = problem._replace(domain=domain)
        maps = np.zeros((4, len(domain)))
        fill_maps(asked, 0, coefficients, vectors, direct, maps)
        right = fill_map(asked, 0, coefficients @ vectors.T + direct)
        np.testing.assert_allclose(maps, right, rtol=1e-12, atol=1e-12)
