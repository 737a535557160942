"""Packings: porosity, rest, what is named in the product, small and impossible ones."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from demflow.model.mechanics.packing import compaction
from demflow.model.mechanics.packing.packing import pack
from demflow.model.mechanics.packing.packing_targets import PRESSURE, by_porosity, find_pressure
from demflow.model.mechanics.packing.sizes import draw_radii, sizes_of
from demflow.model.mechanics.specimen.measures import packing_quality, porosity
from demflow.model.outcome import ModelError
from demflow.model.products import Packing
from demflow.model.region import Polygon, Rectangle, bounding_box, contains
from tests.mechanics.rocks import REGIONS, net_forces, packed, wall_forces


def covered(x, y, radius, points) -> np.ndarray:
    """Which points lie in a disc, by looking at every disc."""
    inside = np.zeros(len(points), dtype=bool)
    px, py = points.T.copy()
    for cx, cy, reach in zip(x, y, radius, strict=True):
        inside |= (px - cx) ** 2 + (py - cy) ** 2 < reach**2
    return inside


def test_porosity_of_a_box_counts_cut_discs_by_their_part() -> None:
    x, y = np.array([0.0, 1.0, 0.9, -0.4, 3.0]), np.array([0.0, 0.1, 1.05, -0.8, 0.0])
    radius = np.array([0.45, 0.5, 0.4, 0.3, 0.5])  # inside, over an edge, over a corner, …
    box = np.array([-0.5, 1.0, -0.9, 1.0])
    side = (np.arange(700) + 0.5) / 700
    px = box[0] + (box[1] - box[0]) * side
    py = box[2] + (box[3] - box[2]) * side
    inside = np.zeros((700, 700), bool)
    for k in range(5):
        inside |= (px[:, None] - x[k]) ** 2 + (py - y[k]) ** 2 < radius[k] ** 2
    assert porosity(x, y, radius, box) == pytest.approx(1.0 - inside.mean(), abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [0.16, 0.165, 0.18, 0.2])
@pytest.mark.parametrize("seed", [1, 2])
def test_wanted_porosity_is_met(wanted: float, seed: int) -> None:
    rock = packed(wanted, seed=seed)
    unit = rock.radius.mean()
    inner = rock.box + 6.0 * unit * np.array([1, -1, 1, -1])
    rng = np.random.Generator(np.random.PCG64(seed))
    points = rng.uniform(inner[[0, 2]], inner[[1, 3]], (20_000, 2))
    found = 1.0 - covered(rock.x, rock.y, rock.radius, points).mean()
    assert float(rock.porosity) == pytest.approx(wanted, abs=0.003)
    assert found == pytest.approx(float(rock.porosity), abs=0.009)  # three sigma of the points


@pytest.mark.parametrize("wanted", [0.165, 0.19])
def test_packed_grains_are_in_equilibrium(wanted: float) -> None:
    rock = packed(wanted)
    force, torque = net_forces(rock, rock.radius, 1.0)
    contact = np.hypot(rock.normal_force, rock.shear_force).mean()
    loaded = np.hypot(*force.T) > 0
    unbalanced = np.hypot(*force.T)[loaded].mean() / contact
    assert unbalanced <= 1.1e-3
    assert unbalanced == pytest.approx(float(rock.unbalanced_ratio), rel=0.1)
    assert np.hypot(*force.T).max() < 0.05 * contact  # every single grain
    assert np.abs(torque / rock.radius).mean() < 2e-3 * contact
    width, height = rock.box[1] - rock.box[0], rock.box[3] - rock.box[2]
    walls = wall_forces(rock, rock.radius, 1.0).sum(axis=0)
    stress = walls / np.array([height, height, width, width])
    np.testing.assert_allclose(stress, PRESSURE, rtol=0.006)


def test_contacts_are_all_touching_pairs_in_order() -> None:
    rock = packed()
    n = len(rock.x)
    distance = np.hypot(rock.x[:, None] - rock.x, rock.y[:, None] - rock.y)
    a, b = np.nonzero(np.triu(rock.radius[:, None] + rock.radius - distance > 0.0, 1))
    np.testing.assert_array_equal(rock.contact_a, a)
    np.testing.assert_array_equal(rock.contact_b, b)
    assert rock.contact_a.dtype == rock.contact_b.dtype == np.int64
    overlap = (rock.radius[:, None] + rock.radius - distance)[a, b]
    np.testing.assert_allclose(rock.normal_force, overlap, atol=1e-15)
    assert overlap.max() < 0.01 * rock.radius.mean()
    counts = np.bincount(a, minlength=n) + np.bincount(b, minlength=n)
    counts = counts + np.count_nonzero(wall_forces(rock, rock.radius, 1.0), axis=1)
    assert int(rock.floaters) == np.count_nonzero(counts < 2)
    assert float(rock.coordination) == pytest.approx(counts[counts >= 2].mean())


def test_radii_are_uniform_between_the_bounds() -> None:
    radius = np.sort(packed().radius)
    assert radius[-1] / radius[0] <= 1.66 + 1e-12
    uniform = np.linspace(1.0, 1.66, len(radius)) * radius.mean() / 1.33
    assert np.abs(radius - uniform).max() < 0.05 * radius.mean()


@pytest.mark.parametrize("region", ["square", "disc", "slab"])
def test_count_and_margin(region: str) -> None:
    rock = packed(0.18, region=region)
    shape = REGIONS[region]
    inside = np.count_nonzero(contains(shape, np.column_stack((rock.x, rock.y))))
    assert inside == pytest.approx(400, rel=0.06)
    margin = (np.array(bounding_box(shape)) - rock.box) * np.array([1, -1, 1, -1])
    assert margin.min() > 8.0 * rock.radius.mean()
    assert rock.x.min() > rock.box[0]
    assert rock.y.max() < rock.box[3]


def test_mean_radius_and_a_polygon_off_the_origin() -> None:
    shape = Polygon(((10.0, 5.0), (14.0, 5.0), (12.0, 9.0)))
    rock = pack(
        region=shape,
        count=None,
        mean_radius=0.1,
        packing="random",
        radius_ratio=2.0,
        porosity=0.18,
        seed=3,
    )
    assert rock.radius.mean() == pytest.approx(0.1, rel=0.02)
    box = bounding_box(shape)
    centre = [0.5 * (rock.box[0] + rock.box[1]), 0.5 * (rock.box[2] + rock.box[3])]
    np.testing.assert_allclose(centre, [0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3])])
    solid = np.pi * 0.01 * sizes_of("uniform", 2.0, None, None).mean_square / (1.0 - 0.18)
    inside = np.count_nonzero(contains(shape, np.column_stack((rock.x, rock.y))))
    assert inside == pytest.approx(shape.area / solid, rel=0.08)


def test_same_scene_same_bits_and_seeds_differ() -> None:
    rock = packed(0.18)
    packed.cache_clear()
    for one, two in zip(rock, packed(0.18), strict=True):
        np.testing.assert_array_equal(one, two)
    assert not np.array_equal(rock.x, packed(0.18, seed=2).x)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("ratio", [1.0, 10.0])
def test_few_grains_and_extreme_sizes(count: int, ratio: float) -> None:
    rock = packed(0.18, count=count, ratio=ratio)
    assert all(np.isfinite(field).all() for field in rock)
    assert float(rock.porosity) == pytest.approx(0.18, abs=0.003)
    assert float(rock.unbalanced_ratio) <= 1e-3


@pytest.mark.parametrize("wanted", [0.1, 0.3])
def test_impossible_porosity_names_the_range(wanted: float) -> None:
    with pytest.raises(ModelError, match="cannot be reached") as caught:
        packed(wanted, count=100)
    low, high = map(float, re.findall(r"about ([\d.]+) to ([\d.]+)", str(caught.value))[0])
    assert 0.14 < low < 0.17
    assert 0.2 < high < 0.24


@pytest.mark.parametrize(
    ("kind", "cell", "neighbours"), [("square", 4.0, 4), ("hexagonal", 2.0 * np.sqrt(3.0), 6)]
)
def test_lattices_are_exact(kind: str, cell: float, neighbours: int) -> None:
    rock = packed(None, kind=kind)
    radius = rock.radius[0]
    assert np.all(rock.radius == radius)
    assert 4.0 / (cell * radius**2) == pytest.approx(400)  # cells in the region
    assert float(rock.porosity) == pytest.approx(1.0 - np.pi / cell, abs=1e-15)
    distance = np.hypot(
        rock.x[rock.contact_b] - rock.x[rock.contact_a],
        rock.y[rock.contact_b] - rock.y[rock.contact_a],
    )
    np.testing.assert_allclose(distance, 2.0 * radius, rtol=1e-13)
    counts = np.bincount(np.r_[rock.contact_a, rock.contact_b], minlength=len(rock.x))
    within = contains(Rectangle(2.0, 2.0), np.column_stack((rock.x, rock.y)))
    assert np.all(counts[within] == neighbours)
    assert not rock.normal_force.any()
    assert not rock.shear_force.any()
    assert np.hypot(rock.x, rock.y).min() > 1.1 * radius  # a pore at the origin
    walls = [rock.x.min(), rock.x.max(), rock.y.min(), rock.y.max()]
    np.testing.assert_allclose(rock.box - walls, radius * np.array([-1, 1, -1, 1]), rtol=1e-12)


@pytest.mark.parametrize(
    "law",
    [
        sizes_of("uniform", 3.0, None, None),
        sizes_of("log-normal", 0.0, 0.3, None),
        sizes_of("list", 0.0, None, (1.0, 1.0, 2.5)),
    ],
    ids=lambda law: law.kind,
)
def test_radii_follow_their_law(law) -> None:
    drawn = draw_radii(law, 30_000, np.random.default_rng(1))
    assert drawn.mean() == pytest.approx(1.0, abs=0.01)
    assert np.mean(drawn**2) == pytest.approx(law.mean_square, rel=0.01)
    assert drawn.max() / drawn.min() <= law.ratio * (1 + 1e-12)
    if law.kind == "log-normal":
        assert np.log(drawn).std() == pytest.approx(0.3, rel=0.06)  # its tails are cut


@pytest.mark.parametrize(
    "law",
    [{"sizes": "log-normal", "radius_deviation": 0.2}, {"sizes": "list", "radii": (0.1, 0.2)}],
)
def test_other_sizes_are_packed(law) -> None:
    rock = pack(
        region=REGIONS["square"], count=400, mean_radius=None, packing="random",
        radius_ratio=1.66, porosity=0.18, seed=1, **law,
    )  # fmt: skip
    assert float(rock.porosity) == pytest.approx(0.18, abs=0.003)
    assert float(rock.unbalanced_ratio) <= 1e-3


def targeted(packing: str = "random", count: int = 800, **target) -> Packing:
    return pack(
        region=REGIONS["square"], count=count, mean_radius=None, packing=packing,
        radius_ratio=1.66, seed=1, **{"porosity": None, **target},
    )  # fmt: skip


def test_porosity_follows_from_friction_and_stress() -> None:
    """The relation of the three: it rises with friction and falls with stress."""
    rocks = [targeted(packing_friction=f, packing_pressure=1e-3) for f in (0.0, 0.2, 0.5)]
    found = [float(rock.porosity) for rock in rocks]
    assert found[0] == pytest.approx(0.162, abs=0.005)
    assert found[0] + 0.015 < found[1] < found[2] - 0.01
    crushed = targeted(packing_friction=0.0, packing_pressure=5e-3)
    assert float(crushed.porosity) < found[0] - 0.01
    for rock in (*rocks, crushed):
        width, height = rock.box[1] - rock.box[0], rock.box[3] - rock.box[2]
        walls = wall_forces(rock, rock.radius, 1.0).sum(axis=0)
        stress = walls / np.array([height, height, width, width])
        np.testing.assert_allclose(stress, rock.packing_pressure, rtol=0.006)
        assert float(rock.unbalanced_ratio) <= 1e-3


@pytest.mark.parametrize("pressure", [5e-5, 2e-3])
def test_porosity_and_stress_are_met_together(pressure: float) -> None:
    rock = targeted(porosity=0.18, packing_pressure=pressure)
    assert float(rock.porosity) == pytest.approx(0.18, abs=0.003)
    assert float(rock.packing_pressure) == pressure
    assert 0.0 < float(rock.packing_friction) < 0.5


def test_porosity_and_friction_are_met_together_by_the_stress() -> None:
    rock = targeted(porosity=0.155, packing_friction=0.0)
    assert float(rock.porosity) == pytest.approx(0.155, abs=0.003)
    assert float(rock.packing_friction) == 0.0
    assert 1e-3 < float(rock.packing_pressure) < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize(("wanted", "friction"), [(0.2, 0.0), (0.15, 0.5)])
def test_porosity_that_a_friction_cannot_have_names_the_range(wanted, friction) -> None:
    with pytest.raises(ModelError, match="contradict each other") as caught:
        targeted(porosity=wanted, packing_friction=friction)
    low, high = map(float, re.findall(r"about ([\d.]+) .* to ([\d.]+)", str(caught.value))[0])
    assert low < high
    assert not low < wanted < high


def test_packings_in_range_that_do_not_rest_are_told_from_a_contradiction() -> None:
    """Here porosity falls with pressure as it should, but nothing ever comes to rest."""

    def attempt(recipe, draw=0):
        porosity = 0.2 - 0.6 * np.sqrt(recipe.pressure)
        return SimpleNamespace(porosity=porosity, rested=False, specimen=SimpleNamespace(steps=0))

    restless = SimpleNamespace(attempt=attempt, law=SimpleNamespace(ratio=1.66))
    with pytest.raises(ModelError, match="came to rest") as caught:
        find_pressure(0.17, 0.3, restless)
    assert "contradict" not in str(caught.value)


def test_quality_of_a_packing_is_as_counted_by_hand() -> None:
    rock = packed(0.18)
    found = packing_quality(rock)
    n = len(rock.x)
    gap = np.hypot(rock.x[:, None] - rock.x, rock.y[:, None] - rock.y)
    touch = (gap < rock.radius[:, None] + rock.radius) & ~np.eye(n, dtype=bool)
    a, b = np.nonzero(touch)
    direction = np.arctan2(rock.y[b] - rock.y[a], rock.x[b] - rock.x[a])
    assert found["fabric"][0, 0] == pytest.approx(np.mean(np.cos(direction) ** 2))
    assert found["fabric"][0, 1] == pytest.approx(np.mean(np.sin(2 * direction)) / 2)
    assert found["fabric_anisotropy"] == pytest.approx(
        np.hypot(np.mean(np.cos(2 * direction)), np.mean(np.sin(2 * direction)))
    )
    assert float(found["fabric_anisotropy"]) < 0.1
    walls = np.count_nonzero(wall_forces(rock, rock.radius, 1.0), axis=1)
    counts = touch.sum(axis=1) + walls
    assert found["floater_fraction"] == np.count_nonzero(counts < 2) / n
    overlap = (rock.radius[a] + rock.radius[b] - gap[a, b]).max()
    assert found["largest_overlap"] == pytest.approx(overlap / rock.radius.mean())


def test_phases_that_meet_their_bound_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Easing has one by its recipe; grains that were not parted or compacted are not at rest."""
    law, size = sizes_of("uniform", 1.66, None, None), np.array([30.0, 30.0])
    recipe = by_porosity(0.165, 2e-4)
    assert compaction.attempt(recipe, 0.165, size, law, [1, 0]).rested
    monkeypatch.setattr(compaction, "COMPACTING", 20)
    assert not compaction.attempt(recipe, 0.165, size, law, [1, 0]).rested
    monkeypatch.setattr(compaction, "PARTING", 20)
    with pytest.raises(ModelError, match=r"did not part in 20 steps.*try another grains\.seed"):
        compaction.attempt(recipe, 0.165, size, law, [1, 0])
