"""Networks of lattices against solutions of the continuum that are not of this repository.

Equal discs have a permeability in closed form, so that nothing is fitted: what is left is the
size of a pore against that of the well, the fracture or the sample.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from demflow.model.analytic.fractures import (
    bilinear_flow,
    infinite_conductivity_fracture,
    uniform_flux_fracture,
)
from demflow.model.analytic.lattice import (
    HEXAGONAL_POROSITY,
    SQUARE_POROSITY,
    hexagonal_permeability,
    square_permeability,
)
from demflow.model.analytic.linear import linear_dimensionless_pressure
from demflow.model.analytic.radial import line_source, radial_dimensionless_pressure
from demflow.model.analytic.wells import closed_circle_pseudo_steady
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import BiWing, Probe, Trace, Well
from tests.reservoirs import reservoir
from tests.rocks import hexagonal_lattice, square_lattice

MU, K_F, W = 1e-3, 1e9, 1e-5
RADIUS = 1 / 120  # of a disc
SQUARE = square_lattice(1.1, RADIUS, (RADIUS, RADIUS))  # with a pore at the origin
BOX = Rectangle(2.0 - RADIUS, 2.0 - RADIUS)
K = square_permeability(W, RADIUS)
DIFFUSIVITY = K * K_F / (SQUARE_POROSITY * MU)
UNIT = MU / (2 * math.pi * K)  # Pa for 1 m³/s


def fall(seen, well=0):
    """p_D of a well that produces 1 m³/s from a pressure of 0."""
    return -seen["well_pressure"][well] / UNIT


def test_linear_flow_at_any_time():
    rock = reservoir(square_lattice(1.1, RADIUS), Rectangle(2.0, 0.2), W)
    t_D = np.geomspace(2e-3, 3.0, 25)
    places = np.linspace(-0.95, 0.95, 20)
    probes = tuple(Probe(f"{x}", (float(x), 0.01)) for x in places)
    seen = rock.observed(
        (),
        (("left", 0.0), ("right", -1.0)),
        0.0,
        tuple(t_D * 4 / DIFFUSIVITY),
        probes=probes,
        tolerance=1e-5,
    )
    expected = linear_dimensionless_pressure(0.5 * (places[:, None] + 1.0), t_D)
    np.testing.assert_allclose(-seen["probe_pressure"], expected, atol=4e-3)


@pytest.mark.parametrize("R_De", [6.0, 11.0])
def test_radial_flow_at_any_time(R_De):
    """Eq. 29 at the well, from the paper's first times to the steady state."""
    radius = 1 / 70
    k = hexagonal_permeability(W, radius)
    rock = reservoir(hexagonal_lattice(1.1, radius), Circle(1.0), W)
    well = Well(name="w", at=(0.0, 0.0), radius=1 / R_De, rate=1.0)
    t_D = np.geomspace(1.0, 1e3, 20)
    unit = HEXAGONAL_POROSITY * MU / (k * K_F * R_De**2)
    seen = rock.observed((well,), (("outer", 0.0),), 0.0, tuple(t_D * unit), tolerance=1e-5)
    steady = MU * math.log(R_De) / (2 * math.pi * k)
    found = -seen["well_pressure"][0] / steady
    np.testing.assert_allclose(found, radial_dimensionless_pressure(1.0, t_D, R_De), rtol=0.03)


def test_interference_follows_theis():
    """A narrow well seen from pores around it, until the rim is felt."""
    rock = reservoir(SQUARE, BOX, W)
    well = Well(name="w", at=(0.0, 0.0), radius=1e-4, rate=1.0)
    probes = (Probe("along", (0.3, 0.0)), Probe("across", (0.2, 0.2)), Probe("near", (0.1, 0.05)))
    times = np.geomspace(0.02, 0.2, 9) / DIFFUSIVITY
    seen = rock.observed((well,), (), 0.0, tuple(times), probes=probes, tolerance=1e-5)
    for k, probe in enumerate(probes):
        expected = line_source(math.hypot(*probe.at), DIFFUSIVITY * times)
        np.testing.assert_allclose(
            -seen["probe_pressure"][k] / UNIT, expected, rtol=0.03, atol=0.003
        )


def test_a_closed_circle_comes_to_pseudo_steady_flow():
    """Slope 1 of the mean, and the well's own level, van Everdingen & Hurst's."""
    radius, R_De = 0.02, 8.0
    k = hexagonal_permeability(W, radius)
    rock = reservoir(hexagonal_lattice(1.1, radius), Circle(1.0), W)
    well = (Well(name="w", at=(0.0, 0.0), radius=1 / R_De, rate=1.0),)
    t_D = np.array([1.0, 2.0, 4.0]) * R_De**2
    unit = HEXAGONAL_POROSITY * MU / (k * K_F * R_De**2)
    seen = rock.observed(well, (), 0.0, tuple(t_D * unit), tolerance=1e-5)
    found = -seen["well_pressure"][0] * 2 * math.pi * k / MU
    np.testing.assert_allclose(found, closed_circle_pseudo_steady(1.0, t_D, R_De), rtol=0.02)
    slope = np.diff(found) / np.diff(t_D)
    np.testing.assert_allclose(slope, 2 / (R_De**2 - 1), rtol=0.01)


def test_a_fracture_of_infinite_conductivity_follows_gringarten():
    """x_f = 42 discs; from t_Dxf = 0.1: before, the pores beside the tips show (4 % at 0.05)."""
    half_length = 0.35
    fracture = BiWing(name="f", at=(0.0, 0.0), angle=0.0, half_length=half_length, aperture=30 * W)
    rock = reservoir(SQUARE, BOX, W, (fracture,))
    well = Well(name="w", at=(0.0, 0.0), radius=1e-3, rate=1.0)
    t_Dxf = np.geomspace(0.1, 1.0, 12)
    seen = rock.observed(
        (well,), (), 0.0, tuple(t_Dxf * half_length**2 / DIFFUSIVITY), tolerance=1e-5
    )
    np.testing.assert_allclose(fall(seen), infinite_conductivity_fracture(t_Dxf), rtol=0.03)


@pytest.mark.slow
def test_a_fracture_of_uniform_flux_follows_gringarten():
    """A row of wells of one rate, each in a pore that it leaves its storage and its pressure."""
    spacing, arm = 2 * RADIUS, 20
    places = spacing * np.arange(-arm, arm + 1)
    row = tuple(
        Well(
            name=f"w{k}",
            at=(float(x), 0.0),
            radius=math.exp(-math.pi / 2) * spacing,  # Peaceman's
            rate=1.0 / len(places),
            wellbore_storage=SQUARE_POROSITY * spacing**2 / K_F,
        )
        for k, x in enumerate(places)
    )
    half_length = 0.5 * spacing * len(places)
    assert half_length >= 40 * RADIUS
    t_Dxf = np.geomspace(0.05, 1.0, 12)
    times = tuple(t_Dxf * half_length**2 / DIFFUSIVITY)
    seen = reservoir(SQUARE, BOX, W).observed(row, (), 0.0, times, tolerance=1e-4, record_map=False)
    expected = uniform_flux_fracture(t_Dxf, places[:, None] / half_length)
    found = -seen["well_pressure"] / UNIT
    np.testing.assert_allclose(found, expected, rtol=0.03)
    from_the_middle = expected[arm] / expected
    np.testing.assert_allclose(found[arm] / found, from_the_middle, rtol=0.01)


def test_a_fracture_of_finite_conductivity_flows_bilinearly():
    """Level and slope 1/4 of Cinco-Ley & Samaniego, before its tips are felt."""
    transmissivity = 2.0 * K / MU  # T μ / k = 2 m
    aperture = (12 * MU * transmissivity) ** (1 / 3)
    fracture = Trace(name="f", start=(-1.0, 0.0), end=(1.0, 0.0), aperture=aperture)
    rock = reservoir(SQUARE, BOX, W, (fracture,))
    well = Well(name="w", at=(0.0, 0.0), radius=1e-3, rate=1.0)
    spread = np.geomspace(0.002, 0.012, 9)  # η t, m²
    seen = rock.observed((well,), (), 0.0, tuple(spread / DIFFUSIVITY), tolerance=1e-5)
    found = fall(seen)
    # lengths in metres: x_f = 1 m, F_CD = T μ / (k x_f)
    np.testing.assert_allclose(found, bilinear_flow(spread, 2.0), rtol=0.03)
    slope = np.polyfit(np.log(spread), np.log(found), 1)[0]
    assert slope == pytest.approx(0.25, abs=0.025)
