"""Packings that are finer around chosen places, and rock that is one everywhere."""

from functools import cache

import numpy as np
import pytest

from demflow.model.mechanics.packing.grading import SLOPE, coarse_radius, graded, strew
from demflow.model.mechanics.packing.packing import pack
from demflow.model.network.domains import network
from demflow.model.permeability import unit_permeability
from demflow.model.products import Packing
from demflow.model.region import Circle, Rectangle
from demflow.model.scene.lines import RefinedPlace

DISC = Circle(1.0)
HERE = (RefinedPlace((0.2, 0.1), (0.2, 0.1), 0.15, 0.25),)


@cache
def finer() -> Packing:
    """Grains that are finer around the middle."""
    return pack(
        region=DISC, count=900, mean_radius=None, packing="random", radius_ratio=1.66,
        porosity=0.18, seed=3, refine=HERE,
    )  # fmt: skip


def test_grains_are_finest_within_and_grow_slowly_to_the_coarse_ones():
    place = np.column_stack([finer().x, finer().y])
    distance = np.hypot(place[:, 0] - 0.2, place[:, 1] - 0.1)
    inside = np.hypot(*place.T) < 1.0
    assert np.count_nonzero(inside) == pytest.approx(900, rel=0.03)
    fine, coarse = finer().radius[distance < 0.15].mean(), finer().radius[distance > 0.8].mean()
    size = finer().scale * finer().radius.max() / finer().scale.max()
    assert fine < 0.5 * coarse
    assert np.all(finer().scale[distance < 0.14] == 0.25)
    # each grain is of its place's size, within the law of radii
    ratio = finer().radius / size
    assert ratio.max() / ratio.min() < 2.2
    beside = np.abs(np.diff(finer().scale[[finer().contact_a, finer().contact_b]], axis=0))
    assert beside.max() < 2.5 * SLOPE


def test_it_packs_as_grains_of_one_size_do():
    assert finer().porosity == pytest.approx(0.18, abs=0.005)
    assert finer().unbalanced_ratio <= 1e-3
    assert 3.2 < finer().coordination < 4.2


def test_one_aperture_is_one_permeability_in_fine_grains_and_in_coarse():
    """Measured where grains are four times finer, and in the whole; porosities, too."""
    whole = network(finer(), region=DISC, even=True)
    moved = finer()._replace(x=finer().x - 0.2, y=finer().y - 0.1)
    fine = network(moved, region=Circle(0.25), even=True)
    k = np.trace(unit_permeability(whole))
    assert np.trace(unit_permeability(fine)) == pytest.approx(k, rel=0.03)
    near = whole.inside & (np.hypot(whole.x - 0.2, whole.y - 0.1) < 0.25)
    assert whole.volume[near].sum() == pytest.approx(
        float(whole.porosity) * whole.area[near].sum(), rel=0.025
    )
    unscaled = moved._replace(scale=np.empty(0))
    assert np.trace(unit_permeability(network(unscaled, region=Circle(0.25)))) > 2.5 * k


def test_a_lattice_is_even_as_it_is():
    """All its pores conduct alike but for those at the edge of the packing."""
    lattice = pack(
        region=DISC,
        count=900,
        mean_radius=None,
        packing="hexagonal",
        radius_ratio=1.0,
        porosity=None,
        seed=1,
    )
    plain, evened = network(lattice, region=DISC), network(lattice, region=DISC, even=True)
    middle = np.hypot(plain.x, plain.y) < 0.5
    ends = middle[plain.pipe_from] & middle[plain.pipe_to]
    ratio = (evened.pipe_length / plain.pipe_length)[ends]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)


@pytest.mark.slow
def test_evened_rock_conducts_and_stores_alike_everywhere():
    """In discs of some 100 pores all over a random packing, by their own measure of k."""
    packed = pack(
        region=DISC, count=1500, mean_radius=None, packing="random", radius_ratio=1.66,
        porosity=0.18, seed=5,
    )  # fmt: skip
    spread = {}
    for even in (None, True):
        found = []
        for angle in np.arange(6) * np.pi / 3:
            x, y = 0.6 * np.cos(angle), 0.6 * np.sin(angle)
            whole = network(packed, region=DISC, even=even)
            near = whole.inside & (np.hypot(whole.x - x, whole.y - y) < 0.3)
            joins = near[whole.pipe_from] & near[whole.pipe_to]
            squared = (np.diff(whole.x[[whole.pipe_from, whole.pipe_to]], axis=0) ** 2)[0]
            squared += (np.diff(whole.y[[whole.pipe_from, whole.pipe_to]], axis=0) ** 2)[0]
            area = whole.area[near].sum()
            conducts = (squared / whole.pipe_length)[joins].sum() / area
            found.append((conducts, whole.volume[near].sum() / area))
        spread[even] = np.std(found, axis=0) / np.mean(found, axis=0)
    assert np.all(spread[True] < np.array([0.6, 0.9]) * spread[None])


@pytest.mark.slow
def test_evened_rock_conducts_alike_in_every_direction():
    """What a window of some 100 pores conducts along one axis more than along others."""
    packed = pack(
        region=DISC, count=1500, mean_radius=None, packing="random", radius_ratio=1.66,
        porosity=0.18, seed=6,
    )  # fmt: skip
    size = {}
    for even in (None, True):
        whole, found = network(packed, region=DISC, even=even), []
        place = np.column_stack([whole.x, whole.y])
        step = place[whole.pipe_to] - place[whole.pipe_from]
        for angle in np.arange(12) * np.pi / 6:
            far = np.hypot(*(place - 0.6 * np.array([np.cos(angle), np.sin(angle)])).T)
            near = whole.inside & (far < 0.3)
            share = near[whole.pipe_from].astype(float) + near[whole.pipe_to]
            tensor = (step * (share / whole.pipe_length)[:, None]).T @ step
            low, high = np.linalg.eigvalsh(tensor)
            found.append((high - low) / (high + low))
        size[even] = np.mean(found)
    assert size[True] < 0.6 * size[None]


@pytest.mark.parametrize("count", [200, 5000])
def test_the_coarse_radius_makes_the_count_asked_for(count):
    """Strewn over the region alone, there are as many points."""
    places = (
        RefinedPlace((-0.5, 0.0), (0.6, 0.3), 0.05, 0.2),
        RefinedPlace((0.3, -0.4), (0.3, -0.4), 0.1, 0.5),
    )
    grading, region = graded(places), Rectangle(2.0, 1.4)
    radius = coarse_radius(grading, region, count, 4.0)
    moved = grading.moved(np.zeros(2), radius)
    points = strew(moved, np.array([2.0, 1.4]) / radius, 4.0, np.random.default_rng(1))
    assert len(points) == pytest.approx(count, rel=0.02, abs=2)
    near = np.hypot(points[:, 0] - 0.3 / radius, points[:, 1] + 0.4 / radius) < 0.1 / radius
    assert near.sum() == pytest.approx(np.pi * 0.01 / (4.0 * (0.5 * radius) ** 2), rel=0.2, abs=4)
