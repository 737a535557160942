"""Probes between pores: linear fields, sides, barriers and wells."""

import numpy as np
import pytest

from demflow.model.region import Polygon, Rectangle
from demflow.model.scene import Probe, Trace, Well
from tests.reservoirs import reservoir
from tests.rocks import hexagonal_lattice, random_graph, square_lattice

BOX = Rectangle(2.0, 1.4)
ACROSS = (("left", 1.0), ("right", -1.0))
PACKINGS = {
    "square": square_lattice(1.3, 0.04, (0.011, 0.023)),
    "hexagonal": hexagonal_lattice(1.3, 0.04, (0.011, 0.023)),
    "random": random_graph(1.3, 900, 4),
}


def probes_at(points):
    return tuple(Probe(f"{k}", tuple(map(float, at))) for k, at in enumerate(points))


@pytest.mark.parametrize(
    ("name", "within", "mean"),
    [("square", 1e-4, 1e-5), ("hexagonal", 1e-2, 1e-3), ("random", 0.15, 0.02)],
)
def test_a_linear_pressure_is_met_anywhere_between_the_sides(name, within, mean):
    """p = −x, up to the sides at a pressure; before, a probe had the pressure of its pore."""
    rock = reservoir(PACKINGS[name], BOX)
    points = np.random.default_rng(1).uniform((-1.0, -0.6), (1.0, 0.6), (200, 2))
    points[:20, 0] = np.linspace(-0.9999, -0.95, 20)
    seen = rock.observed((), ACROSS, method="steady", probes=probes_at(points))
    place = np.column_stack([seen["probe_place_x"], seen["probe_place_y"]])
    np.testing.assert_allclose(seen["probe_pressure"], -points[:, 0], atol=within)
    assert abs(np.mean(seen["probe_pressure"] + points[:, 0])) < mean
    np.testing.assert_allclose(place, points, atol=0.01)


def test_no_probe_exceeds_what_is_imposed_and_sealed_corners_say_their_place():
    corners = ((-1.0, -0.7), (1.0, -0.7), (1.0, 0.1), (0.0, 0.1), (0.0, 0.7), (-1.0, 0.7))
    rock = reservoir(PACKINGS["random"], Polygon(corners))
    points = np.array([(x, y) for x in np.linspace(-0.99, -0.01, 9) for y in (-0.699, 0.0, 0.699)])
    held = (("side[1]", 0.0), ("side[5]", 1.0))
    seen = rock.observed((), held, method="steady", probes=probes_at(points))
    assert np.all((seen["probe_pressure"] >= 0) & (seen["probe_pressure"] <= 1))
    place = np.column_stack([seen["probe_place_x"], seen["probe_place_y"]])
    moved = np.linalg.norm(place - points, axis=1)
    assert moved.max() < 0.2
    assert np.count_nonzero(moved > 1e-3) > 3


def test_a_probe_beside_a_barrier_does_not_look_through_it():
    """Two plateaux, 1 and −1, up to the wall between them."""
    wall = (
        Trace(name="wall", transmissibility_multiplier=1e-6, start=(0.0, -1.0), end=(0.0, 1.0)),
    )
    rock = reservoir(PACKINGS["square"], BOX, 1e-5, wall)
    points = [(x, y) for x in (-0.06, -0.03, 0.05, 0.08) for y in (-0.3, 0.111)]
    seen = rock.observed((), ACROSS, method="steady", probes=probes_at(points))
    assert np.all(np.abs(np.abs(seen["probe_pressure"]) - 1.0) < 1e-3)


def test_a_probe_inside_a_well_has_its_pressure():
    rock = reservoir(PACKINGS["random"], BOX)
    well = (Well(name="w", at=(0.1, 0.0), radius=0.3, pressure=3.0),)
    points = [(0.1, 0.0), (0.25, 0.05), (0.1, -0.2)]
    seen = rock.observed(well, ACROSS, method="steady", probes=probes_at(points))
    np.testing.assert_allclose(seen["probe_pressure"], 3.0, rtol=1e-12)


def test_a_probe_has_the_pressure_of_its_side_of_a_barrier_whatever_its_pore_s_centroid():
    """Two plateaux up to a slanted wall: points a tenth of a pore from it."""
    wall = Trace(
        name="wall", thickness=1e-3, permeability=1e-22, start=(-0.3, -1.0), end=(0.3, 1.0)
    )
    rock = reservoir(PACKINGS["random"], BOX, 1e-5, (wall,))
    at = np.linspace(-0.6, 0.6, 60)
    off = np.where(np.arange(60) % 2 == 0, -0.005, 0.005)
    points = np.column_stack([0.3 * at + off, at])
    seen = rock.observed((), ACROSS, method="steady", probes=probes_at(points))
    np.testing.assert_allclose(seen["probe_pressure"], -np.sign(off), atol=1e-3)
