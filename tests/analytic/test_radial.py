"""Eqs 29 and 30 and their companions against the paper, each other and the laws they obey."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_bvp
from scipy.special import j0, j1, y0, y1

from demflow.model.analytic.laplace import invert
from demflow.model.analytic.radial import (
    finite_radius_well,
    line_source,
    radial_dimensionless_pressure,
    radial_roots,
)
from demflow.model.analytic.wells import closed_circle_pseudo_steady, thiem_pressure_fall

R_DE = 14.26
TABLE_5 = """
0.170 0.395 0.624 0.855 1.088 1.322 1.557 1.792 2.027 2.263 2.499 2.735 2.971 3.207 3.444 3.680
3.916 4.153 4.390 4.626 4.863 5.099 5.336 5.573 5.810 6.046 6.283 6.520 6.757 6.993 7.230 7.467
7.704 7.941 8.177 8.414 8.651 8.888 9.125 9.362 9.598 9.835 10.072 10.309 10.546 10.783 11.020
11.256 11.493 11.730"""


def test_roots_reproduce_table_5():
    roots = radial_roots(R_DE, 50)
    np.testing.assert_allclose(roots, np.array(TABLE_5.split(), float), atol=5.01e-4)
    np.testing.assert_allclose(roots[[0, 1, 2, 49]], [0.1701, 0.3946, 0.6236, 11.730], atol=5e-4)


@pytest.mark.parametrize("R_De", [1.001, 1.5, 3.0, R_DE, 1e3, 1e6])
def test_every_root_is_one_and_none_is_missed(R_De):
    roots = radial_roots(R_De, 300)

    def value(x):
        return y1(x) * j0(x * R_De) - j1(x) * y0(x * R_De)

    gaps = np.diff(roots)
    assert np.all(gaps > 0)
    left, right = value(roots - 1e-7 * gaps[0]), value(roots + 1e-7 * gaps[0])
    assert np.all(left * right < 0)
    # a fine scan sees as many changes of sign up to the last root
    scan = value(np.linspace(0.05 * roots[0], roots[-1] + 0.4 * gaps[-1], 20_000))
    assert np.count_nonzero(scan[1:] * scan[:-1] < 0) == 300


def test_gives_the_papers_figures():
    result = radial_dimensionless_pressure(1.0, [1.67, 5.84, 19.75, 38.29, 334.97], R_DE)
    np.testing.assert_allclose(result, [0.3619, 0.5362, 0.7352, 0.8494, 1.0000], atol=5.1e-5)


@pytest.mark.parametrize("R_De", [1.05, 3.0, R_DE, 500.0])
def test_series_of_many_terms_agrees_at_early_times(R_De):
    """Eq. 29 as printed with 2,000 terms, where the function inverts a transform instead."""
    roots = radial_roots(R_De, 2000)
    coefficient = np.pi * j0(roots * R_De) ** 2 / (roots * (j1(roots) ** 2 - j0(roots * R_De) ** 2))
    R = np.array([1.0, 1.0 + 0.1 * (R_De - 1), 0.5 * (1 + R_De), R_De])[:, None]
    t = (R_De - 1.0) ** 2 * np.array([2e-5, 9.9e-4, 1.1e-3, 5e-3, 9.99e-3, 1.01e-2, 1.0])
    mode = y1(roots) * j0(roots * R[..., None]) - j1(roots) * y0(roots * R[..., None])
    decay = np.exp(-(roots**2) * t[:, None])
    expected = 1 + (np.sum(coefficient * mode * decay, axis=-1) - np.log(R)) / np.log(R_De)
    np.testing.assert_allclose(
        radial_dimensionless_pressure(R, t, R_De), expected, rtol=0, atol=3e-11
    )


@given(
    R_De=st.floats(1.01, 1e4),
    place=st.floats(0, 1),
    t_D=st.one_of(st.just(0.0), st.floats(1e-12, 1e12)),
)
def test_stays_between_the_initial_and_the_steady_state(R_De, place, t_D):
    R = R_De**place if 0 < place < 1 else (1.0, R_De)[int(place)]
    value = radial_dimensionless_pressure(R, t_D, R_De)
    assert -1e-12 <= value <= 1 - np.log(R) / np.log(R_De) + 1e-12


def test_flux_at_the_well_is_the_rate_at_all_times():
    """(1/R) dP/dR at the well is −1 / ln R_De (Eq. 83), here by a one-sided difference."""
    h = 1e-4
    t = np.geomspace(1e-3, 1e4, 30)
    p = [radial_dimensionless_pressure(1 + k * h, t, R_DE) for k in range(3)]
    slope = (-3 * p[0] + 4 * p[1] - p[2]) / (2 * h)
    np.testing.assert_allclose(slope * np.log(R_DE), -1.0, atol=2e-4)


def test_outer_boundary_keeps_its_pressure_and_time_zero_is_undisturbed():
    t = np.geomspace(1e-6, 1e6, 40)
    np.testing.assert_allclose(radial_dimensionless_pressure(R_DE, t, R_DE), 0.0, atol=1e-13)
    assert np.all(radial_dimensionless_pressure(np.linspace(1, R_DE, 9), 0.0, R_DE) == 0)


@pytest.mark.parametrize(
    ("R_D", "t_D", "R_De"), [(1, 1, 1), (1, 1, 0.5), (0.9, 1, 2), (3, 1, 2), (1, -1, 2)]
)
def test_refuses_impossible_reservoirs(R_D, t_D, R_De):
    with pytest.raises(ValueError, match="R_D"):
        radial_dimensionless_pressure(R_D, t_D, R_De)


def test_unbounded_well_between_its_asymptotes():
    early, late = np.geomspace(1e-20, 1e-8, 5), np.geomspace(1e6, 1e20, 5)
    np.testing.assert_allclose(
        finite_radius_well(1.0, early), 2 * np.sqrt(early / np.pi), rtol=1e-4
    )
    expected = 0.5 * (np.log(4 * late) - np.euler_gamma)
    np.testing.assert_allclose(finite_radius_well(1.0, late), expected, rtol=1e-5)
    # van Everdingen & Hurst (1949), Table I: p_D(1) = 0.802, p_D(10) = 1.651, p_D(100) = 2.723
    np.testing.assert_allclose(
        finite_radius_well(1.0, [1, 10, 100]), [0.802, 1.651, 2.723], atol=6e-4
    )


def test_line_source_is_the_far_field_of_the_well():
    t = np.geomspace(1e6, 1e9, 6)
    np.testing.assert_allclose(finite_radius_well(1000.0, t), line_source(1000.0, t), rtol=5e-6)


@pytest.mark.parametrize(
    ("transform", "function"),
    [
        (lambda s: 1 / s, np.ones_like),
        (lambda s: 1 / (s + 1), lambda t: np.exp(-t)),
        (lambda s: 1 / np.sqrt(s), lambda t: 1 / np.sqrt(np.pi * t)),
        (lambda s: 1 / s**2, lambda t: t),
    ],
)
def test_laplace_inversion_of_known_pairs(transform, function):
    t = np.geomspace(1e-6, 10, 30)
    np.testing.assert_allclose(invert(transform, t), function(t), rtol=5e-12, atol=5e-13)


def test_laplace_inversion_refuses_time_zero():
    with pytest.raises(ValueError, match="above zero"):
        invert(lambda s: 1 / s, [0.0, 1.0])


def test_steady_state_of_the_papers_well():
    """2e-5 m³/s through 2442 mD from 13.8 m to 0.964 m lowers the well by 7 − 3.49 MPa."""
    fall = thiem_pressure_fall(2e-5, 1.0, 2442 * 9.869233e-16, [0.964, 13.8], 13.8)
    np.testing.assert_allclose(fall, [7e6 - 3.49e6, 0.0], rtol=2e-3)


def test_pseudo_steady_state_obeys_its_equation():
    """R p'' + p' = 2R/(E² − 1), p'(1) = −1, p'(E) = 0, and the mean is 2 t_D/(E² − 1)."""
    E, t = 7.0, 40.0
    source = 2 / (E**2 - 1)
    solution = solve_bvp(
        lambda R, y: [y[1], source - y[1] / R],
        lambda a, b: [a[1] + 1, a[0] - closed_circle_pseudo_steady(1.0, t, E)],
        np.linspace(1, E, 50),
        np.ones((2, 50)),
        tol=1e-8,
    )
    R = np.linspace(1, E, 20)
    np.testing.assert_allclose(solution.sol(R)[0], closed_circle_pseudo_steady(R, t, E), rtol=1e-6)
    assert abs(solution.sol(E)[1]) < 1e-6
    nodes, weights = np.polynomial.legendre.leggauss(60)
    R = 1 + (E - 1) * (nodes + 1) / 2
    stored = np.sum(weights * (E - 1) / 2 * R * closed_circle_pseudo_steady(R, t, E))
    np.testing.assert_allclose(stored, t, rtol=1e-10)  # one unit of rate, 2π taken out
