"""Wells near straight boundaries, in double porosity and on fractures, in Laplace space."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import exp1, kv

from demflow.model.analytic.boundaries import (
    CONSTANT,
    NO_SIDE,
    SEALED,
    Side,
    images_of_sides,
    with_double_porosity,
    with_sides,
)
from demflow.model.analytic.fractures import (
    bilinear_flow,
    finite_conductivity_transform,
    infinite_conductivity_fracture,
    integral_of_K0,
    uniform_flux_fracture,
    uniform_flux_transform,
)
from demflow.model.analytic.laplace import invert
from demflow.model.analytic.radial import bounded_transform, closed_transform, unbounded_transform
from demflow.model.analytic.wells import closed_circle_pseudo_steady, thiem_pressure_fall

TIMES = np.geomspace(1e2, 3e6, 12)
SIDES = (Side(300.0), Side(900.0), Side(500.0), Side(400.0))


def row(first, second, most=25):
    """Places and signs of a well's images in two parallel sides, each reflection by itself."""
    found = [(0.0, 1.0)]
    for side, other, way in ((first, second, -1.0), (second, first, 1.0)):
        place, sign, mirror, next_mirror = 0.0, 1.0, side, other
        for _ in range(most):
            if mirror.reflection == 0.0:
                break
            wall = way * mirror.distance if mirror is side else -way * mirror.distance
            place, sign = 2.0 * wall - place, sign * mirror.reflection
            found.append((place, sign))
            mirror, next_mirror = next_mirror, mirror
    return found


@pytest.mark.parametrize(
    "reflections",
    [
        *((1, 0, 0, 0), (1, 0, -1, 0), (1, 1, 0, 0), (-1, 1, 0, 0), (0, 0, 1, -1)),
        *((0, 1, 1, 1), (1, -1, 1, 1), (1, 1, 1, 1), (-1, -1, -1, -1)),
    ],
)
def test_sides_are_the_sum_over_every_image(reflections):
    sides = [
        Side(side.distance, float(r)) if r else NO_SIDE
        for side, r in zip(SIDES, reflections, strict=True)
    ]
    slow = np.zeros_like(TIMES)
    for (x, a), (y, b) in itertools.product(row(*sides[:2]), row(*sides[2:])):
        if x or y:
            slow += 0.5 * a * b * exp1((x * x + y * y) / (4.0 * TIMES))
    fast = invert(lambda s: images_of_sides(s, *sides) / s, TIMES)
    np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-9)


def test_a_rectangle_does_not_mind_being_turned_or_mirrored():
    w, e, s, n = (Side(d, r) for d, r in ((40, SEALED), (900, CONSTANT), (70, SEALED), (300, 1.0)))
    z = np.array([1e-6 + 2e-6j, 1e-4 - 3e-5j, 2e-3 + 0j])
    expected = images_of_sides(z, w, e, s, n)
    for turned in ((e, w, s, n), (s, n, w, e), (n, s, e, w)):
        np.testing.assert_allclose(images_of_sides(z, *turned), expected, rtol=1e-9)


def test_a_closed_square_ends_as_dietz_found():
    """p_D = 2π t_DA + ½ ln(4 A / (e^γ C_A r_w²)), C_A = 30.8828 for a well in the middle."""
    half = Side(1000.0)
    late = np.array([1e7, 1e8, 1e9])
    area = 4e6
    p_D = invert(with_sides(unbounded_transform(1.0), half, half, half, half), late)
    shape = 0.5 * math.log(4.0 * area / (math.exp(np.euler_gamma) * 30.8828))
    np.testing.assert_allclose(p_D - 2.0 * math.pi * late / area, shape, rtol=1e-4)


def test_a_well_beyond_a_side_is_refused():
    with pytest.raises(ValueError, match="outside the well"):
        images_of_sides(np.array([1.0 + 0j]), Side(0.5))


def test_a_closed_circle_ends_in_pseudo_steady_flow():
    late = np.array([1e5, 1e6])
    p_D = invert(closed_transform(1.0, 200.0), late)
    np.testing.assert_allclose(p_D, closed_circle_pseudo_steady(1.0, late, 200.0), rtol=1e-8)


def test_circles_are_unbounded_before_they_are_felt_and_then_thiem():
    early = np.geomspace(1.0, 100.0, 5)
    alone = invert(unbounded_transform(1.0), early)
    for bounded in (closed_transform, bounded_transform):
        np.testing.assert_allclose(invert(bounded(1.0, 500.0), early), alone, rtol=1e-9)
    steady = thiem_pressure_fall(2 * math.pi, 1.0, 1.0, 1.0, 50.0)
    np.testing.assert_allclose(invert(bounded_transform(1.0, 50.0), 1e6), steady, rtol=1e-9)


@pytest.mark.parametrize("slabs", [False, True])
def test_double_porosity_goes_from_fractures_alone_to_the_whole(slabs):
    storativity, interporosity = 0.05, 1e-7
    double = with_double_porosity(unbounded_transform(1.0), storativity, interporosity, slabs=slabs)
    late = np.geomspace(1e11, 1e13, 4)
    whole = invert(unbounded_transform(1.0), late)
    np.testing.assert_allclose(invert(double, late), whole, rtol=1e-3)
    early = np.geomspace(1e1, 1e2, 4)
    fractures = invert(unbounded_transform(1.0), early / storativity)
    np.testing.assert_allclose(invert(double, early), fractures, rtol=0.02 if slabs else 1e-3)
    one = with_double_porosity(unbounded_transform(1.0), 1.0 - 1e-12, 1e-7)
    np.testing.assert_allclose(invert(one, late), whole, rtol=1e-8)


@pytest.mark.parametrize("z", [0.0, 1e-6, 0.3, 3 + 8j, 0.5 + 12j, 17.9, 18.1, 2 + 18j, 40.0])
def test_the_integral_of_K0_is_its_quadrature(z):
    def wave(u):
        return kv(0, z * u**3) * z * 3 * u**2 if z else 0.0

    real = quad(lambda u: np.real(wave(u)), 0, 1, limit=400)[0]
    imaginary = quad(lambda u: np.imag(wave(u)), 0, 1, limit=400)[0]
    assert abs(complex(integral_of_K0(z)) - (real + 1j * imaginary)) < 3e-8


@pytest.mark.parametrize("x_D", [0.0, 0.732, 0.95])
def test_an_even_inflow_is_that_of_gringarten(x_D):
    t = np.geomspace(1e-5, 1e5, 15)
    found = invert(uniform_flux_transform(x_D), t)
    np.testing.assert_allclose(found, uniform_flux_fracture(t, x_D), rtol=1e-6)


def test_a_resisting_fracture_begins_bilinear_and_ends_without_resistance():
    early = np.geomspace(1e-6, 1e-4, 5)
    found = invert(finite_conductivity_transform(3.0), early, 12)
    np.testing.assert_allclose(found, bilinear_flow(early, 3.0), rtol=0.015)
    t = np.geomspace(1e-3, 1e3, 7)
    open_one = invert(finite_conductivity_transform(1e6), t, 12)
    np.testing.assert_allclose(open_one, infinite_conductivity_fracture(t), rtol=0.04)
    resistance = [invert(finite_conductivity_transform(F), t, 12) for F in (1.0, 10.0, 100.0)]
    assert np.all(np.diff(resistance, axis=0) < 0.0)


def test_a_fracture_without_resistance_is_a_well_of_half_its_half_length():
    """Late p_wD = ½ (ln t_Dxf + 0.80907) + ln 2: the plate's capacity (Prats 1961)."""
    t = np.array([1e4, 1e5])
    far = invert(finite_conductivity_transform(1e5), t, 12)
    np.testing.assert_allclose(far - 0.5 * (np.log(t) + 0.80907), math.log(2.0), atol=2e-3)
