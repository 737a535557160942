"""Jaeger's plane of weakness against the stresses on the plane itself."""

import numpy as np
import pytest

from demflow.model.analytic.jaeger import jaeger_strength, mobilised_friction

FRICTION, COHESION, CONFINING = np.tan(np.radians(25.0)), 2e6, 5e6


def test_the_plane_is_about_to_slip_at_the_strength() -> None:
    beta = np.radians(np.arange(30.0, 88.0, 2.0))
    strength = jaeger_strength(CONFINING, beta, FRICTION, COHESION)
    for angle, axial in zip(beta, strength, strict=True):
        normal = np.array([-np.sin(angle), np.cos(angle)])  # of a plane at an angle from x
        along = np.array([np.cos(angle), np.sin(angle)])
        traction = np.diag([CONFINING, axial]) @ normal
        assert abs(traction @ along) == pytest.approx(COHESION + FRICTION * (traction @ normal))


def test_it_is_least_at_45_degrees_and_half_the_friction_angle() -> None:
    beta = np.radians(np.linspace(26.0, 89.0, 631))
    least = beta[np.argmin(jaeger_strength(CONFINING, beta, FRICTION, COHESION))]
    assert np.degrees(least) == pytest.approx(57.5, abs=0.1)


@pytest.mark.parametrize("degrees", [0.0, 10.0, 25.0, 90.0])
def test_a_plane_flatter_than_its_friction_or_along_the_load_never_slips(degrees: float) -> None:
    assert np.isinf(jaeger_strength(CONFINING, np.radians(degrees), FRICTION, COHESION))


def test_a_plane_without_cohesion_mobilises_its_friction_at_the_strength() -> None:
    for angle in np.radians([30.0, 45.0, 60.0, 80.0]):
        axial = jaeger_strength(CONFINING, angle, FRICTION)
        assert mobilised_friction(axial, CONFINING, angle) == pytest.approx(np.radians(25.0))
