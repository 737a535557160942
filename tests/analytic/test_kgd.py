"""Closed forms of a KGD fracture: their published numbers, and the laws that they come from."""

import math

import numpy as np
import pytest

from demflow.model.analytic import kgd

E, NU, K, RATE = 30e9, 0.25, 1e6, 1e-4
PLANE = E / (1.0 - NU**2)


def test_a_fracture_that_toughness_resists_at_ten_seconds():
    found = kgd.toughness_dominated(np.array([10.0]), plane_modulus=PLANE, toughness=K, rate=RATE)
    assert found.half_length[0] == pytest.approx(4.335, rel=2e-4)
    assert found.width[0] == pytest.approx(0.1468e-3, rel=5e-4)
    assert found.pressure[0] == pytest.approx(0.271e6, rel=1e-3)


def test_a_fracture_that_friction_resists_at_ten_seconds():
    found = kgd.viscosity_dominated(
        np.array([10.0]), plane_modulus=PLANE, viscosity=1e-3, rate=RATE
    )
    assert found.half_length[0] == pytest.approx(3.363, rel=1e-3)
    assert found.width[0] == pytest.approx(0.2079e-3, rel=4e-3)
    assert found.pressure[0] == pytest.approx(0.584e6, rel=4e-3)


def test_both_hold_the_volume_that_was_injected():
    times = np.array([0.3, 10.0, 400.0])
    found = kgd.toughness_dominated(times, plane_modulus=PLANE, toughness=K, rate=RATE)
    ellipse = 0.5 * math.pi * found.half_length * found.width
    np.testing.assert_allclose(ellipse, RATE * times, rtol=1e-12)
    for time in times:
        half = kgd.viscosity_dominated(
            np.array([time]), plane_modulus=PLANE, viscosity=1e-3, rate=RATE
        ).half_length[0]
        xi = np.cos(np.linspace(0.5 * np.pi, 0.0, 4001))[:-1]  # closer towards the tip
        opening, _ = kgd.opening_and_pressure(
            xi, time, plane_modulus=PLANE, viscosity=1e-3, rate=RATE
        )
        held = 2.0 * half * np.trapezoid(np.append(opening, 0.0), np.append(xi, 1.0))
        assert held == pytest.approx(RATE * time, rel=8e-3)


def test_pressure_falls_as_friction_in_the_fluid_says():
    """Poiseuille's law: −w³/(12 μ) dp/dx carries what fills the fracture beyond x."""
    time, mu = 10.0, 1e-3
    now = {"plane_modulus": PLANE, "viscosity": mu, "rate": RATE}
    half = kgd.viscosity_dominated(np.array([time]), **now).half_length[0]
    xi = np.linspace(0.0, 1.0, 20001)[:-1]
    opening, pressure = kgd.opening_and_pressure(xi, time, **now)
    middle = 0.5 * (xi[1:] + xi[:-1])
    wide = 0.5 * (opening[1:] + opening[:-1])
    flow = -(wide**3) / (12.0 * mu) * np.diff(pressure) / (half * np.diff(xi))
    # w ~ t^⅓ at ξ, ℓ ~ t^⅔: what goes by ξ is ⅔ ξ w ℓ/t + ∫ w dξ ℓ/t
    beyond = np.cumsum(wide[::-1] * np.diff(xi)[::-1])[::-1]
    passes = half / time * (2.0 / 3.0 * middle * wide + beyond)
    well_within = (middle > 0.1) & (middle < 0.9)
    off = np.abs(flow - passes)[well_within]
    assert off.max() < 0.025 * 0.5 * RATE  # what the first terms leave


def test_pressure_opens_the_fracture_as_elasticity_says():
    """Opening of a straight crack under any pressure (Sneddon & Lowengrub 1969)."""
    time = 10.0
    now = {"plane_modulus": PLANE, "viscosity": 1e-3, "rate": RATE}
    half = kgd.viscosity_dominated(np.array([time]), **now).half_length[0]
    angle = (np.arange(4000) + 0.5) * 0.5 * np.pi / 4000
    s = np.sin(angle)
    _, pressure = kgd.opening_and_pressure(s, time, **now)
    for x in (0.0, 0.3, 0.7):
        own, there = kgd.opening_and_pressure(np.array([x]), time, **now)
        root = math.sqrt(1.0 - x * x)
        kernel = np.log(np.abs((root + np.cos(angle)) / (root - np.cos(angle))))
        more = np.sum((pressure - there) * kernel * np.cos(angle)) * 0.5 * np.pi / 4000
        opened = 4.0 * half / PLANE * (there[0] * root + more / math.pi)
        assert opened == pytest.approx(own[0], rel=0.01)


def test_which_of_the_two_holds():
    stiff = {"plane_modulus": PLANE, "toughness": K, "rate": RATE}
    assert kgd.dimensionless_toughness(**stiff, viscosity=1e-6) > kgd.TOUGHNESS_ABOVE
    assert kgd.dimensionless_toughness(**stiff, viscosity=1e-3) == pytest.approx(
        4 * math.sqrt(2 / math.pi) * K / (PLANE**3 * 12e-3 * RATE) ** 0.25
    )
