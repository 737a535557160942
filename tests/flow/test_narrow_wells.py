"""Wells of any width anywhere, several in a pore, beside a rim, against the continuum's forms."""

import math

import numpy as np
import pytest

from demflow.model.flow.equation.local_rock import mobility_around, spacing_around
from demflow.model.outcome import ModelError
from demflow.model.permeability import permeability
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import Well
from tests.reservoirs import reservoir
from tests.rocks import hexagonal_lattice, packing_of, random_graph, square_lattice

DISC = Circle(1.0)
VISCOSITY = 1e-3
ROCKS = {
    "hexagonal": reservoir(hexagonal_lattice(1.1, 1 / 40, (0.003, 0.002)), DISC),
    "square": reservoir(square_lattice(1.1, 1 / 40, (0.003, 0.002)), DISC),
    "random": reservoir(random_graph(1.1, 3000, 1), DISC),
    "another": reservoir(random_graph(1.1, 3000, 2), DISC),
}


def spacing(rock):
    return math.sqrt(rock.network.area[rock.network.inside].mean())


def transmits(rock):
    """2π k/μ."""
    tensor = permeability(rock.network, rock.apertures, viscosity=VISCOSITY) / VISCOSITY
    return 2 * math.pi * math.sqrt(np.linalg.det(tensor))


def drawdown(rock, *wells):
    """Dimensionless fall of each well's pressure, 2π k/μ Δp, the rim at 0."""
    seen = rock.observed(wells, (("outer", 0.0),), method="steady")
    return -seen["well_pressure"] * transmits(rock)


@pytest.mark.slow
def test_wells_are_no_tighter_than_their_rock_in_the_mean():
    """Mean over 40 random rocks; one well is within 1.1 % of Thiem's fall (standard deviation)."""
    well, off = Well(name="w", at=(0.0, 0.0), radius=0.12, rate=1.0), []
    for seed in range(40):
        graph = random_graph(1.15, 1000, seed)
        rock = reservoir(graph._replace(radius=0.5 * graph.radius), DISC)
        off.append(drawdown(rock, well)[0] / math.log(1 / 0.12) - 1)
    assert abs(np.mean(off)) <= 0.009


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "within"), [("hexagonal", 0.01), ("square", 0.01), ("random", 0.08)]
)
def test_a_well_of_any_width_anywhere_has_its_own_logarithm(name, within):
    """ln((R² − ρ²) / (R r_w)) from a hundredth of a pore to three, off any lucky place."""
    rock, rng = ROCKS[name], np.random.default_rng(3)
    off = []
    for ratio in (0.01, 0.1, 0.3, 0.6, 1.0, 1.7, 3.0):
        for _ in range(4):
            angle, rho = rng.uniform(0, 2 * math.pi), 0.6 * math.sqrt(rng.uniform())
            at, radius = (rho * math.cos(angle), rho * math.sin(angle)), ratio * spacing(rock)
            seen = drawdown(rock, Well(name="w", at=at, radius=radius, rate=1.0))[0]
            off.append(seen / math.log((1 - rho**2) / radius) - 1)
    assert np.abs(off).max() <= within
    assert abs(np.mean(off)) <= 0.02 * (within > 0.01) + 0.005
    assert np.std(off) <= 0.03


@pytest.mark.parametrize("seed", [1, 2])
def test_a_well_in_a_cavity_stands_in_rock_all_the_same(seed):
    """In a pore 4 spacings across, of which it is a part or the whole: ln((R² − ρ²) / (R r_w))."""
    graph, middle = random_graph(1.1, 1500, seed), np.array([0.2, 0.1])
    left = np.hypot(graph.x - middle[0], graph.y - middle[1]) > 0.15
    number = np.cumsum(left) - 1
    a, b = graph.contact_a, graph.contact_b
    pairs = np.column_stack([number[a], number[b]])[left[a] & left[b]]
    rock = reservoir(packing_of(graph.x[left], graph.y[left], graph.radius[left], pairs), DISC)
    step = spacing(rock)
    assert rock.network.area[rock.network.inside].max() > 10.0 * step**2
    at = middle + 0.3 * step
    for radius in (0.1 * step, step, 3.0 * step):
        well = Well(name="w", at=tuple(at), radius=radius, rate=1.0)
        expected = math.log((1 - at @ at) / radius)
        assert drawdown(rock, well)[0] == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("name", ROCKS)
def test_drawdown_does_not_jump_where_a_pore_joins_the_well(name):
    """Just below and above a radius that takes in another pore the answers agree."""
    rock = ROCKS[name]
    at = (0.21, -0.13)
    distance = np.sort(np.hypot(rock.network.x - at[0], rock.network.y - at[1]))
    for reach in distance[[1, 3, 6]]:
        pair = [
            drawdown(rock, Well(name="w", at=at, radius=float(reach * f), rate=1.0))[0]
            for f in (1 - 1e-3, 1 + 1e-3)
        ]
        assert pair[0] == pytest.approx(pair[1], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROCKS)
@pytest.mark.parametrize("pores", [0.6, 1.0, 1.5])
def test_a_well_beside_a_rim_sees_its_image(name, pores):
    """A hole of radius r_w at ρ in a disc: arcosh((R² + r_w² − ρ²) / (2 R r_w)), skin added."""
    rock = ROCKS[name]
    radius, rho = 0.1 * spacing(rock), 1 - pores * spacing(rock)
    expected = math.acosh((1 + radius**2 - rho**2) / (2 * radius))
    for angle in (0.3, 2.0, 4.4):
        at = (rho * math.cos(angle), rho * math.sin(angle))
        plain, skin = (
            drawdown(rock, Well(name="w", at=at, radius=radius, rate=1.0, skin_factor=s))[0]
            for s in (0.0, 2.0)
        )
        assert plain == pytest.approx(expected, rel=0.1)
        assert skin - plain == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROCKS)
@pytest.mark.parametrize("apart", [0.03, 0.2, 0.7, 1.3])
def test_two_wells_near_each_other_superpose(name, apart):
    """Each falls by its own logarithm and by that of the distance to the other."""
    rock = ROCKS[name]
    h = spacing(rock)
    radius, offset, rate = 0.01 * h, apart * h, (1.0, -0.4)
    for x, y in ((0.1, 0.2), (-0.34, 0.05), (0.021, -0.4)):
        places = np.array([(x, y), (x + 0.6 * offset, y + 0.8 * offset)])
        wells = [
            Well(name=f"{k}", at=tuple(map(float, at)), radius=radius, rate=q)
            for k, (at, q) in enumerate(zip(places, rate, strict=True))
        ]
        rho = np.hypot(*places.T)
        own = np.log((1 - rho**2) / radius)
        z = places @ [1, 1j]
        other = np.log(abs(1 - z[0].conjugate() * z[1]) / abs(z[0] - z[1]))
        expected = np.array(rate) * own + np.array(rate)[::-1] * other
        np.testing.assert_allclose(drawdown(rock, *wells), expected, atol=0.03 * own.max())


def test_a_row_of_wells_in_one_pore_and_the_next_keeps_positive_conductances():
    rock = ROCKS["random"]
    wells = tuple(
        Well(name=f"{k}", at=(0.1 + 0.007 * k, 0.1), radius=1e-3, rate=1.0) for k in range(7)
    )
    seen = drawdown(rock, *wells)
    places = 0.1 + 0.007 * np.arange(7) + 0.1j
    for k, z in enumerate(places):
        mutual = np.log(
            abs(1 - z.conjugate() * places) / np.where(places == z, 1e-3, abs(z - places))
        )
        assert seen[k] == pytest.approx(mutual.sum(), rel=0.03)


def test_wells_that_overlap_are_refused_by_name():
    rock = ROCKS["square"]
    wells = (
        Well(name="first", at=(0.01, 0.01), radius=3e-3, rate=1.0),
        Well(name="second", at=(0.015, 0.01), radius=3e-3, pressure=1.0),
    )
    with pytest.raises(ModelError, match="first and second overlap"):
        rock.observed(wells, (("outer", 0.0),), method="steady")


def test_rock_that_conducts_better_along_one_axis():
    """In coordinates that make it isotropic the well is an ellipse of mean half-axis r̄.

    There the region is a square, whose conformal radius about its centre is 0.5394 of its side.
    """
    along = 4.0
    stretch = along**0.25
    region = Rectangle(2.0 * stretch, 2.0 / stretch)
    rock = reservoir(square_lattice(1.5, 1 / 40, (0.003, 0.002)), region)
    net, open_ = rock.network, rock.apertures
    flat = np.abs(net.y[net.pipe_from] - net.y[net.pipe_to]) < 1e-6
    factor = np.where(flat, along, 1.0)
    rock = rock._replace(
        apertures=open_._replace(
            conductance=open_.conductance * factor,
            cut_conductance=open_.cut_conductance * factor[net.cut],
        )
    )
    middle = (0.0, 0.0)
    apart = spacing_around(rock.network, middle, 0.0)
    mobility = mobility_around(rock.network, rock.apertures, region, middle, 0.0, apart)
    assert mobility[0, 0] / mobility[1, 1] == pytest.approx(along, rel=1e-9)
    for ratio in (0.01, 0.3, 1.0, 2.5):
        radius = ratio * spacing(rock)
        seen = drawdown(rock, Well(name="w", at=(0.01, 0.004), radius=radius, rate=1.0))[0]
        mean = 0.5 * radius * (stretch + 1 / stretch)
        assert seen == pytest.approx(math.log(2.0 * 0.53935 / mean), rel=0.01)
