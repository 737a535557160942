"""Slip of a plane by Mohr and Coulomb, against what else says the same."""

import numpy as np
import pytest

from demflow.model.analytic.jaeger import jaeger_strength
from demflow.model.analytic.mohr_coulomb import slip_pressure, tractions


def test_tractions_are_those_of_the_stress_tensor():
    rng = np.random.default_rng(1)
    for xx, yy, angle in rng.uniform([1, 1, -3], [9, 9, 3], (50, 3)):
        along = np.array([np.cos(angle), np.sin(angle)])
        normal = np.array([-along[1], along[0]])
        traction = np.diag([xx, yy]) @ normal
        found = tractions(xx, yy, angle)
        assert found[0] == pytest.approx(normal @ traction)
        assert abs(found[1]) == pytest.approx(abs(along @ traction))


def test_at_that_pressure_the_strength_is_the_stress_that_there_is():
    """Jaeger's strength under the effective confining stress is the effective axial stress."""
    angle, friction, cohesion = np.radians(60.0), 0.5, 1e6
    pressure = slip_pressure(10e6, 25e6, angle, friction, cohesion)
    assert jaeger_strength(10e6 - pressure, angle, friction, cohesion) == pytest.approx(
        25e6 - pressure
    )


def test_a_plane_along_a_principal_stress_opens_and_does_not_slide():
    assert slip_pressure(10e6, 20e6, 0.0, 0.6) == pytest.approx(20e6)
    assert slip_pressure(10e6, 20e6, 0.5 * np.pi, 0.6) == pytest.approx(10e6)
    assert slip_pressure(10e6, 11e6, 1.0, 0.6, 1e7) == pytest.approx(tractions(10e6, 11e6, 1.0)[0])
