"""Storage, skin, fractures, tunnels and drainage against the laws that they obey."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from demflow.model.analytic.fractures import (
    bilinear_flow,
    infinite_conductivity_fracture,
    uniform_flux_fracture,
)
from demflow.model.analytic.radial import (
    finite_radius_well,
    line_source,
    radial_dimensionless_pressure,
)
from demflow.model.analytic.terzaghi import consolidation_degree, drainage_rate
from demflow.model.analytic.wellbore import horner_time, well_with_storage_and_skin
from demflow.model.analytic.wells import doublet_pressure_fall, tunnel_inflow


@pytest.mark.parametrize("R_De", [3.0, 14.26, 500.0])
def test_without_storage_and_skin_it_is_equation_29(R_De):
    t = np.geomspace(1e-3, 1e7, 40)
    plain = well_with_storage_and_skin(t, 0.0, 0.0, R_De)
    expected = math.log(R_De) * radial_dimensionless_pressure(1.0, t, R_De)
    np.testing.assert_allclose(plain, expected, atol=1e-11 * R_De)


@pytest.mark.parametrize("skin", [0.0, 2.0, 20.0])
@pytest.mark.parametrize("C_D", [0.5, 100.0, 1e4])
def test_early_the_wellbore_empties_and_late_only_the_skin_is_left(C_D, skin):
    early, late = C_D * np.geomspace(1e-9, 1e-5, 5), C_D * np.geomspace(1e5, 1e8, 5)
    np.testing.assert_allclose(
        well_with_storage_and_skin(early, C_D, skin), early / C_D, rtol=1e-2, atol=1e-12
    )
    expected = finite_radius_well(1.0, late) + skin
    np.testing.assert_allclose(well_with_storage_and_skin(late, C_D, skin), expected, rtol=1e-3)


def test_the_wellbore_s_balance_closes():
    """C_D dp_wD/dt_D + q_sandface = 1 in Duhamel's form: p_w = ∫ q_s p_D' + S q_s."""
    C_D, skin = 30.0, 3.0
    t = np.linspace(0.0, 60.0, 1201)[1:]
    p = well_with_storage_and_skin(t, C_D, skin)
    sandface = 1.0 - C_D * np.gradient(p, t, edge_order=2)
    inner = finite_radius_well(1.0, t)
    steps = np.diff(sandface, prepend=0.0)
    # each step of the flow adds its own response, half a step late
    half = finite_radius_well(1.0, t - 0.5 * t[0])
    rebuilt = np.array([steps[: k + 1] @ half[k::-1] for k in range(len(t))]) + skin * sandface
    assert inner[-1] > 2.0
    np.testing.assert_allclose(rebuilt[40:], p[40:], rtol=2e-3)


@given(t=st.floats(1e-3, 1e8), C_D=st.floats(0.1, 1e5), skin=st.floats(0, 30))
def test_storage_delays_and_skin_adds(t, C_D, skin):
    fall = float(well_with_storage_and_skin(t, C_D, skin))
    assert fall <= t / C_D * (1 + 1e-9)
    assert fall <= float(finite_radius_well(1.0, t)) + skin + 1e-9
    assert fall <= float(well_with_storage_and_skin(1.1 * t, C_D, skin)) + 1e-9
    assert fall <= float(well_with_storage_and_skin(t, C_D, skin + 1.0)) + 1e-9


@pytest.mark.parametrize(
    ("C_D", "skin", "R_De"), [(-1.0, 0.0, 10.0), (1.0, -1.0, 10.0), (1.0, 1.0, 1.0)]
)
def test_refuses_what_no_well_has(C_D, skin, R_De):
    with pytest.raises(ValueError, match="must"):
        well_with_storage_and_skin(1.0, C_D, skin, R_De)


def test_horner_s_line_is_what_is_left_of_two_line_sources():
    """p_i − p_ws = q μ / (4πk) ln of Horner's time, once both are logarithmic."""
    production, shut_in = 1e9, np.geomspace(1e6, 1e9, 7)
    fall = line_source(1.0, production + shut_in) - line_source(1.0, shut_in)
    np.testing.assert_allclose(fall, 0.5 * np.log(horner_time(shut_in, production)), rtol=1e-6)


@pytest.mark.parametrize("x", [0.0, 0.3, 0.732, 0.999, 1.0])
@pytest.mark.parametrize("t", [1e-3, 0.3, 5.0, 1e3])
def test_uniform_flux_is_the_integral_of_instantaneous_sources(x, t):
    """½ ∫ √π/2 [erf((1−x)/2√τ) + erf((1+x)/2√τ)] dτ/√τ, with u = √τ."""

    def source(u):
        return 0.5 * math.sqrt(math.pi) * sum(math.erf((1 + s * x) / (2 * u)) for s in (-1, 1))

    expected, _ = quad(source, 0.0, math.sqrt(t), epsabs=1e-13, epsrel=1e-12, limit=200)
    assert float(uniform_flux_fracture(t, x)) == pytest.approx(expected, rel=1e-10)


def test_fractures_are_linear_early_and_radial_late():
    early, late = np.geomspace(1e-6, 1e-3, 4), np.geomspace(1e4, 1e7, 4)
    for solution in (uniform_flux_fracture, infinite_conductivity_fracture):
        np.testing.assert_allclose(solution(early), np.sqrt(np.pi * early), rtol=1e-3)
    # late: ½ (ln t + 2.80907) at uniform flux, ½ (ln t + 2.2000) at infinite conductivity
    np.testing.assert_allclose(
        uniform_flux_fracture(late), 0.5 * (np.log(late) + 2.80907), atol=1e-4
    )
    np.testing.assert_allclose(
        infinite_conductivity_fracture(late), 0.5 * (np.log(late) + 2.2000), atol=6e-3
    )


def test_fractures_are_given_on_themselves_alone():
    for t, x in ((0.0, 0.0), (1.0, 1.1), (-1.0, 0.0)):
        with pytest.raises(ValueError, match="fracture"):
            uniform_flux_fracture(t, x)


def test_bilinear_flow_solves_its_own_equation():
    """F_CD d²p/dx² = −(fluid from the rock); in Laplace space p̄ = π/(F_CD s √(2√s/F_CD))."""
    from demflow.model.analytic.laplace import invert

    F_CD, t = 3.0, np.geomspace(1e-6, 1e-2, 5)
    fall = invert(lambda s: math.pi / (F_CD * s * np.sqrt(2 * np.sqrt(s) / F_CD)), t)
    np.testing.assert_allclose(bilinear_flow(t, F_CD), fall, rtol=1e-10)


def test_a_tunnel_s_inflow_is_that_of_a_well_and_its_image():
    """Potential between wells of opposite rate at ±h, on the wall at depth h − r."""
    h, r = 50.0, 1.0
    inflow = tunnel_inflow(1e5, 1e-3, 1e-13, h, r)
    fall = inflow * 1e-3 / (2 * math.pi * 1e-13) * math.log((2 * h - r) / r)
    assert fall == pytest.approx(1e5, rel=3e-3)


def test_a_doublet_is_two_wells_with_their_images():
    a, r, R = 4.0, 0.1, 14.0
    image = R * R / a

    def potential(x):  # producer at +a, injector at −a; on the rim it is zero
        return (-math.log(abs(x - a)) + math.log(abs(x - image)) + math.log(abs(x + a))) - math.log(
            abs(x + image)
        )

    assert potential(R) == pytest.approx(potential(-R), abs=1e-12)
    fall = doublet_pressure_fall(1.0, 2 * math.pi, 1.0, offset=a, radius=r, outer_radius=R)
    assert fall == pytest.approx(potential(a - r), rel=0.01)
    wide = doublet_pressure_fall(1.0, 2 * math.pi, 1.0, offset=a, radius=r, outer_radius=1e6)
    assert wide == pytest.approx(math.log(2 * a / r), rel=1e-6)


def test_drainage_is_the_rate_at_which_the_layer_settles():
    t = np.array([1e-3, 0.0199, 0.0201, 0.3, 2.0])
    h = 1e-5 * t
    slope = (consolidation_degree(t + h) - consolidation_degree(t - h)) / (2 * h)
    np.testing.assert_allclose(drainage_rate(t), slope, rtol=1e-6)


@pytest.mark.slow
def test_drainage_agrees_with_a_chain_of_cells():
    """The layer cut into cells, integrated by scipy to 1e-9."""
    n = 200
    depth = (np.arange(n) + 0.5) / n

    def rate(_t, u):
        flow = np.diff(u, prepend=-u[0], append=u[-1]) * n
        return np.diff(flow) * n

    found = solve_ivp(rate, (0, 0.5), np.ones(n), method="BDF", rtol=1e-8, atol=1e-10)
    flux = 2 * n * found.y[0, -1]
    assert flux == pytest.approx(float(drainage_rate(0.5)), rel=1e-4)
    assert depth[0] < 1 / n
