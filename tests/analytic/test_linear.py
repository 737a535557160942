"""Eq. 24 and Terzaghi's consolidation against the plain series, the paper's figures and laws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demflow.model.analytic.linear import linear_dimensionless_pressure, linear_pressure
from demflow.model.analytic.terzaghi import consolidation_degree, excess_pressure

PAPER_TIMES = [0.00484, 0.01931, 0.04823, 0.10608, 0.22178, 1.08951]
unit = st.floats(0, 1)


def plain_series(x_D, t_D, terms=4000):
    """Eq. 24 term by term."""
    return x_D + 2 / np.pi * sum(
        (-1) ** n / n * np.exp(-((n * np.pi) ** 2) * t_D) * np.sin(n * np.pi * x_D)
        for n in range(1, terms)
    )


@pytest.mark.parametrize(
    ("x_D", "expected"),
    [
        (0.5, [0.0000, 0.0110, 0.1074, 0.2766, 0.4287, 0.5000]),
        (0.75, [0.0111, 0.2033, 0.4209, 0.5872, 0.6995, 0.7500]),
    ],
)
def test_gives_the_papers_figures(x_D, expected):
    np.testing.assert_allclose(
        linear_dimensionless_pressure(x_D, PAPER_TIMES), expected, atol=5.1e-5
    )


def test_equals_the_plain_series_on_both_sides_of_the_switch():
    x = np.linspace(0, 1, 41)
    t = np.concatenate([np.geomspace(1e-5, 10, 40), [0.2 - 1e-15, 0.2, 0.2 + 1e-15]])[:, None]
    np.testing.assert_allclose(
        linear_dimensionless_pressure(x, t), plain_series(x, t), rtol=0, atol=2e-14
    )


def test_keeps_relative_precision_where_little_has_arrived():
    """Far ahead of the front P_D ≈ erfc((1 − x_D) / 2√t_D), here 2e-45."""
    from scipy.special import erfc

    np.testing.assert_allclose(linear_dimensionless_pressure(0.9, 2.5e-5), erfc(10.0), rtol=1e-12)


def test_starts_from_the_initial_pressure():
    np.testing.assert_array_equal(
        linear_dimensionless_pressure([0.0, 0.3, 1 - 1e-12, 1.0], 0.0), [0, 0, 0, 1]
    )


@pytest.mark.slow
@given(x_D=unit, t_D=st.floats(0, 1e6))
def test_obeys_the_maximum_principle_and_rises_to_the_steady_state(x_D, t_D):
    value = linear_dimensionless_pressure(x_D, t_D)
    assert -1e-14 <= value <= x_D + 1e-14
    assert value <= linear_dimensionless_pressure(x_D, 1.1 * t_D) + 1e-14


def test_satisfies_the_diffusion_equation():
    h, k = 1e-3, 1e-5
    x, t = np.meshgrid(np.linspace(0.1, 0.9, 9), [0.05, 0.15, 0.3], indexing="ij")
    p = linear_dimensionless_pressure
    rate = (p(x, t + k) - p(x, t - k)) / (2 * k)
    curvature = (p(x + h, t) - 2 * p(x, t) + p(x - h, t)) / h**2
    np.testing.assert_allclose(rate, curvature, atol=2e-4)


def test_general_pressure_equals_equation_74():
    length, diffusivity, initial, first, second = 13.5, 0.0132, 6e6, 5e6, 1e6
    x, t = np.linspace(0, length, 15), np.array([[50.0], [700.0], [9000.0]])
    n = np.arange(1, 3000)[:, None, None]
    sign = (-1.0) ** n
    coefficient = 2 * (initial - first) * (1 - sign) / (n * np.pi)
    coefficient = coefficient + 2 * (second - first) * sign / (n * np.pi)
    modes = np.exp(-diffusivity * (n * np.pi / length) ** 2 * t) * np.sin(n * np.pi * x / length)
    expected = first + (second - first) * x / length + np.sum(coefficient * modes, axis=0)
    result = linear_pressure(
        x, t, length=length, diffusivity=diffusivity, initial=initial, first=first, second=second
    )
    np.testing.assert_allclose(result[:, 1:-1], expected[:, 1:-1], rtol=1e-12)
    np.testing.assert_allclose(result[:, [0, -1]], [[first, second]] * 3, rtol=1e-12)


@pytest.mark.parametrize(("x_D", "t_D"), [(-0.1, 1.0), (1.1, 1.0), (0.5, -1.0), (np.nan, 1.0)])
def test_refuses_what_lies_outside_the_sample(x_D, t_D):
    with pytest.raises(ValueError, match=r"Eq\. 24"):
        linear_dimensionless_pressure(x_D, t_D)


def test_consolidation_equals_its_series():
    z, T = np.linspace(0.05, 1, 20), np.geomspace(1e-3, 5, 12)[:, None]
    M = ((2 * np.arange(200) + 1) * np.pi / 2)[:, None, None]
    expected = np.sum(2 / M * np.sin(M * z) * np.exp(-(M**2) * T), axis=0)
    np.testing.assert_allclose(excess_pressure(z, T), expected, atol=1e-13)
    assert np.all(excess_pressure(z, 0.0) == 1.0)


def test_settlement_is_what_the_pressure_gave_up():
    nodes, weights = np.polynomial.legendre.leggauss(200)
    for T in (1e-3, 0.0199, 0.0201, 0.197, 1.0, 3.0):
        mean = np.sum(weights / 2 * excess_pressure((nodes + 1) / 2, T))
        np.testing.assert_allclose(consolidation_degree(T), 1 - mean, atol=1e-12)
    np.testing.assert_allclose(consolidation_degree(0.197), 0.5, atol=5e-4)  # the textbook's
    assert consolidation_degree(0.0) == 0.0
