"""Wells beside traces and rims against closed forms, on random packings and off lucky places."""

import cmath
import math

import numpy as np
import pytest

from demflow.model.flow.equation.grounded_field import grounded_field
from demflow.model.flow.equation.well_field import well_field
from demflow.model.mechanics.packing.packing import pack
from demflow.model.network.fractures.subdivide import Cuts, subdivide
from demflow.model.permeability import permeability
from demflow.model.region import Circle
from demflow.model.scene import Trace, Well
from tests.reservoirs import reservoir

DISC = Circle(1.0)
ACROSS = Trace(name="across", aperture=3e-3, start=(-1.5, 0.0), end=(1.5, 0.0))
HALF = Trace(name="half", aperture=3e-3, start=(0.0, 0.0), end=(1.5, 0.0))


@pytest.fixture(scope="module", params=[1, 2])
def packing(request):
    return pack(
        region=DISC,
        count=900,
        mean_radius=None,
        packing="random",
        radius_ratio=1.66,
        porosity=0.16,
        seed=request.param,
    )


def falls(rock, plain, places, radii):
    """Drawdowns over μ / 2πk at a unit rate, the rim at zero."""
    tensor = permeability(plain.network, plain.apertures, viscosity=1e-3) / 1e-3
    unit = 2 * math.pi * math.sqrt(np.linalg.det(tensor))
    found = []
    for at, radius in zip(places, radii, strict=True):
        well = Well(name="w", at=(at.real, at.imag), radius=radius, rate=1.0)
        seen = rock.observed((well,), (("outer", 0.0),), method="steady", record_map=False)
        found.append(-float(seen["well_pressure"][0]) * unit)
    return np.array(found)


def places_around(rock, seed, low, high, sector):
    """Places within some spacings of the middle, in a sector, and radii."""
    rng = np.random.default_rng(seed)
    h = math.sqrt(rock.network.area[rock.network.inside].mean())
    away = h * rng.uniform(low, high, 12)
    angle = rng.uniform(*sector, 12)
    return away * np.exp(1j * angle), h * np.resize([0.01, 0.1, 0.2], 12), h


@pytest.mark.slow
def test_a_well_beside_a_trace_that_keeps_its_pressure(packing):
    """ln((1 − |z|²) / |1 − z²|) + arcosh(|Im z| / r_w), the trace a diameter."""
    plain = reservoir(packing, DISC)
    z, radii, h = places_around(plain, 1, 0.4, 2.0, (0.2 * math.pi, 0.8 * math.pi))
    z = z.real * 5 + 1j * np.maximum(z.imag, 0.3 * h)
    expected = [
        math.log((1 - abs(at) ** 2) / abs(1 - at**2)) + math.acosh(at.imag / r)
        for at, r in zip(z, radii, strict=True)
    ]
    off = falls(reservoir(packing, DISC, fractures=(ACROSS,)), plain, z, radii) / expected - 1
    assert abs(off.mean()) < 0.015
    assert np.abs(off).max() < 0.04


@pytest.mark.slow
def test_a_well_around_the_tip_of_a_trace(packing):
    """A disc slit along a radius: half a disc in √z, where the well's radius is r_w / |2 √z|."""
    plain = reservoir(packing, DISC)
    z, radii, _ = places_around(plain, 2, 0.4, 1.5, (0.3 * math.pi, 1.7 * math.pi))
    w = np.array([cmath.sqrt(at) for at in z])
    w = np.where(w.imag < 0, -w, w)
    expected = np.log(2 * w.imag * (1 - abs(w) ** 2) / abs(1 - w * w) * 2 * abs(w) / radii)
    off = falls(reservoir(packing, DISC, fractures=(HALF,)), plain, z, radii) / expected - 1
    assert abs(off.mean()) < 0.02
    assert np.abs(off).max() < 0.05


def test_a_wide_well_beside_a_rim(packing):
    """arcosh((1 + r_w² − ρ²) / 2 r_w), with the well's wall near the rim itself."""
    plain = reservoir(packing, DISC)
    rng = np.random.default_rng(3)
    h = math.sqrt(plain.network.area[plain.network.inside].mean())
    z = (1 - h * rng.uniform(0.4, 1.0, 12)) * np.exp(2j * math.pi * rng.uniform(size=12))
    expected = [math.acosh((1 + (0.3 * h) ** 2 - abs(at) ** 2) / (0.6 * h)) for at in z]
    off = falls(plain, plain, z, np.full(12, 0.3 * h)) / expected - 1
    assert abs(off.mean()) < 0.03
    assert np.abs(off).max() < 0.06


@pytest.mark.slow
def test_a_trace_that_conducts_nothing_changes_nothing(packing):
    """Whatever stands between a well and a trace, the whole of each pipe stays what it is."""
    tight = Trace(name="tight", aperture=1e-12, start=(-1.5, 0.0), end=(1.5, 0.0))
    plain = reservoir(packing, DISC)
    z, radii, _ = places_around(plain, 4, 1.0, 2.0, (0.3 * math.pi, 0.7 * math.pi))
    off = falls(reservoir(packing, DISC, fractures=(tight,)), plain, z, radii)
    off = off / falls(plain, plain, z, radii) - 1
    assert np.median(np.abs(off)) < 1e-6
    assert np.abs(off).max() < 0.03  # where a link was needed


@pytest.mark.parametrize(("radius", "away"), [(0.01, 0.5), (0.3, 0.5), (0.3, 0.35), (0.1, 2.0)])
def test_the_field_is_that_of_a_circle_and_a_line(radius, away):
    """Charges at ± √(d² − r²) from the line, whose circle is the well's wall."""
    far, held = Circle(1e3), np.array([True])
    free = well_field((0.0, 0.0), radius, np.eye(2), far, held, 100.0)
    ends = np.array([[-500.0, -away]]), np.array([[500.0, -away]])
    field = grounded_field(free, *ends, far, held)
    assert -field.at_wall == pytest.approx(math.acosh(away / radius), abs=0.004)
    points = np.array([[3.0, 4.0], [1.0, 0.2], [0.0, 1.0], [0.0, -2 * away], [2.0, -away]])
    z = points @ [1, 1j] + 1j * away
    pole = 1j * math.sqrt(away**2 - radius**2)
    expected = np.where(points[:, 1] < -away, 0.0, np.log(np.abs((z - pole) / (z + pole))))
    np.testing.assert_allclose(field.at_points(points), expected, atol=0.03)


def test_the_field_leaves_a_sealed_side_alone():
    """Charges on a trace have images in a sealed side as the well's: nothing flows across it."""
    side = Circle(1.0)
    sealed = np.array([False])
    free = well_field((0.9, 0.0), 0.01, np.eye(2), side, sealed, 0.6)
    field = grounded_field(free, np.array([[0.8, -0.5]]), np.array([[0.8, 0.5]]), side, sealed)
    angle = np.linspace(-0.4, 0.4, 9)
    on = np.column_stack([np.cos(angle), np.sin(angle)])
    across = field.at_points(on * 1.0001) - field.at_points(on * 0.9999)
    around = field.at_points(on * 0.9) - field.at_points(on)
    assert np.abs(across).max() / 2e-4 < 0.1 * np.abs(around).max() / 0.1


def test_a_spur_is_a_star_of_three_resistances():
    """Pressures between the terminals as with the middle of the star written out."""
    g, t, s = 2.0, 0.3, 0.7
    one = np.zeros(1)
    cut = Cuts(np.array([0]), np.array([t]), np.array([0]), one, np.array([s]))
    a, b, c = subdivide(np.array([0]), np.array([1]), np.array([g]), cut, 2)
    found = np.zeros((3, 3))
    for p, q, h in zip(a, b, c, strict=True):
        found[[p, q], [p, q]] += h
        found[[p, q], [q, p]] -= h
    star = g / np.array([t, 1 - t, s])
    expected = np.diag(star) - np.outer(star, star) / star.sum()
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_a_trace_that_points_at_a_well_is_felt_the_more_the_nearer_it_ends(packing):
    """From a pore away to the wall; within 1e-9 of the radius it meets the well."""
    radius, falls_ = 0.01, []
    for gap in (-0.005, 1e-12, 1e-6, 1e-4, 1e-3, 1e-2, 5e-2):
        trace = Trace(name="t", aperture=3e-4, start=(radius + gap, 0.0), end=(1.5, 0.0))
        well = Well(name="w", at=(0.0, 0.0), radius=radius, rate=1.0)
        rock = reservoir(packing, DISC, fractures=(trace,))
        seen = rock.observed((well,), (("outer", 0.0),), method="steady", record_map=False)
        falls_.append(-float(seen["well_pressure"][0]))
    assert falls_[1] == pytest.approx(falls_[0], rel=1e-9)
    assert np.all(np.diff(falls_[1:]) > 0)
