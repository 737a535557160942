"""Deconvolution: its Jacobian, exact data, noise, and what it refuses."""

import numpy as np
import pytest

from demflow.sweep.analysis.deconvolution import _Problem, deconvolve
from demflow.sweep.analysis.reservoirs import MODELS, Superposed, unit_response
from demflow.sweep.study.reservoir import PARAMETERS, Rock, parameters_of

ROCK = Rock(porosity=0.2, viscosity=1e-3, compressibility=1e-9, well_radius=0.1, thickness=10.0)
VALUES = {n: PARAMETERS[n].default for n in parameters_of("fault")} | {
    "permeability": 5e-14,
    "initial_pressure": 3e7,
    "skin_factor": 3.0,
    "wellbore_storage": 1e-9,
    "distance": 80.0,
}
RATES = ((0.0, 5e-4), (1e5, 0.0), (2e5, 1e-3), (4e5, 3e-4), (6e5, 0.0))
TIMES = np.concatenate([start + np.geomspace(3.0, 2e5 if start else 1e5, 50) for start, _ in RATES])
TIMES = np.unique(TIMES)
EXACT = Superposed(TIMES, RATES).pressure(MODELS["fault"], ROCK, VALUES)


def known(times):
    step = 1e-3
    up, down = (
        unit_response(MODELS["fault"], ROCK, VALUES, times * np.exp(way * step)) for way in (1, -1)
    )
    return (up - down) / (2 * step)


def test_the_jacobian_is_that_of_differences():
    problem = _Problem(TIMES, EXACT, np.array(RATES), 1e3, 0.01, 3e7, 1e3)
    rng = np.random.default_rng(0)
    u = problem.start()
    u[: len(problem.nodes)] += rng.normal(0.0, 0.5, len(problem.nodes))
    jacobian = problem.residual(u, 0.1)[1]
    for k in range(len(u)):
        step = np.zeros(len(u))
        step[k] = 1e-6
        up, down = (problem.residual(u + way * step, 0.1)[0] for way in (1, -1))
        numeric = (up - down) / 2e-6
        np.testing.assert_allclose(
            jacobian[:, k], numeric, atol=1e-5 * np.abs(numeric).max() + 1e-6
        )


def test_exact_data_give_the_derivative_of_one_rate_and_know_the_start():
    found = deconvolve(TIMES, EXACT, RATES, pressure_error=100.0, rate_error=1e-3)
    inner = slice(3, -2)
    np.testing.assert_allclose(found.derivative[inner], known(found.time)[inner], rtol=0.03)
    response = unit_response(MODELS["fault"], ROCK, VALUES, found.time)
    np.testing.assert_allclose(found.change[3:], response[3:], rtol=0.01)
    assert found.initial_pressure == pytest.approx(3e7, abs=2e3)
    assert found.misfit < 200.0


def test_noise_in_rates_and_pressures_is_borne_and_told():
    rng = np.random.default_rng(1)
    error = 1e-3 * np.ptp(EXACT)
    noisy = EXACT + rng.normal(0.0, error, len(TIMES))
    told = [(start, rate * (1 + 0.01 * rng.normal())) for start, rate in RATES]
    found = deconvolve(
        TIMES, noisy, told, pressure_error=error, initial_pressure=3e7, initial_error=error
    )
    off = np.abs(found.derivative / known(found.time) - 1.0)
    assert np.median(off) < 0.02
    assert np.sum(off < 0.05) > 0.8 * len(off)
    assert found.misfit == pytest.approx(error, rel=0.15)
    true = np.array([rate for _, rate in RATES])
    corrected = np.abs(found.rates - true).sum()
    assert corrected < np.abs(np.array([rate for _, rate in told]) - true).sum()
    np.testing.assert_array_equal(found.rates[true == 0.0], 0.0)
    stiff = deconvolve(
        TIMES, noisy, told, pressure_error=error, initial_pressure=3e7, curvature=0.002
    )
    loose = deconvolve(
        TIMES, noisy, told, pressure_error=error, initial_pressure=3e7, curvature=1.0
    )
    assert stiff.curvature == 0.002
    assert stiff.misfit > found.misfit
    assert np.mean(loose.spread) > np.mean(found.spread)


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="errors of pressures and rates"):
        deconvolve(TIMES, EXACT, RATES, pressure_error=0.0)
    with pytest.raises(ValueError, match="no point lies after"):
        deconvolve(TIMES, EXACT, ((1e9, 1.0),), pressure_error=1.0)
