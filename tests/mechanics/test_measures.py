"""Measurements on grains: strain, stress, fabric, force chains, fitted floaters."""

import numpy as np
import pytest

from demflow.model.mechanics.packing.compaction import attempt
from demflow.model.mechanics.packing.floaters import fit, largest_circles
from demflow.model.mechanics.packing.packing import pack
from demflow.model.mechanics.packing.packing_targets import PRESSURE, by_porosity
from demflow.model.mechanics.packing.sizes import sizes_of
from demflow.model.mechanics.specimen import measures
from demflow.model.region import Circle, Polygon, Rectangle
from demflow.model.scene import Bonds, Grains, Scene, SceneError, Stress
from demflow.model.stages import run_stages
from tests.mechanics.rocks import REGIONS, packed
from tests.mechanics.test_stress import KN, loaded


def test_affine_strain_is_found_whatever_the_rotation() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.random((2, 50))
    turn, strain = 0.3, np.array([[1e-3, 4e-4], [4e-4, -2e-3]])
    gradient = strain + turn * np.array([[0.0, -1.0], [1.0, 0.0]])
    u, v = gradient @ np.array([x, y]) + np.array([[5.0], [-2.0]])
    np.testing.assert_allclose(measures.affine_strain(x, y, u, v), strain, atol=1e-12)
    with pytest.raises(ValueError, match="three grains"):
        measures.affine_strain(x[:2], y[:2], u[:2], v[:2])


def stress_in(region, state) -> np.ndarray:
    return measures.mean_stress(
        region, state.x, state.y, state.contact_a, state.contact_b,
        state.normal_force, state.shear_force,
    )  # fmt: skip


@pytest.mark.parametrize("half", [0.3, 0.9])
def test_stress_across_a_specimen_is_that_on_the_walls(half: float) -> None:
    """Each section from wall to wall bears a wall's force, however unevenly a part does."""
    rock = packed()
    state = loaded(rock, 16, 10)
    left, right, bottom, top = state.box
    upright = Polygon(((-half, bottom), (half, bottom), (half, top), (-half, top)))
    level = Polygon(((left, -half), (right, -half), (right, half), (left, half)))
    assert stress_in(upright, state)[0, 0] == pytest.approx(16e6, rel=0.01)
    assert stress_in(level, state)[1, 1] == pytest.approx(10e6, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    "region", [Circle(0.9), Polygon(((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)))]
)
def test_stress_in_a_part_of_an_even_specimen_is_that_on_the_walls(region) -> None:
    """A square lattice bears its stress evenly; a random packing of this size by ± 10 %."""
    rock = packed(None, kind="square", count=400)
    strong = Bonds(kind="contact", tensile_strength=1e9, shear_strength=1e9)
    found = stress_in(region, loaded(rock, 16, 10, bonds=strong))
    np.testing.assert_allclose(np.diag(found), [16e6, 10e6], rtol=0.02)
    assert abs(found[0, 1]) < 0.2e6


def test_fabric_of_lattices_is_isotropic_and_of_a_row_is_not() -> None:
    rock = packed(None, kind="hexagonal", count=100)
    a, b = rock.contact_a, rock.contact_b
    np.testing.assert_allclose(measures.fabric(rock.x, rock.y, a, b), 0.5 * np.eye(2), atol=0.03)
    row = measures.fabric(np.arange(3.0), np.zeros(3), np.array([0, 1]), np.array([1, 2]))
    np.testing.assert_allclose(row, [[1.0, 0.0], [0.0, 0.0]])


def test_force_chains_follow_the_larger_stress() -> None:
    rock = packed()
    state = loaded(rock, 18, 10)
    a, b = state.contact_a, state.contact_b
    chain = measures.force_chains(state.x, state.y, a, b, state.normal_force, state.shear_force)
    held = chain >= 0
    assert 0.05 < held.mean() < 0.6
    assert state.normal_force[held].mean() > 1.3 * state.normal_force.mean()
    dx, dy = state.x[b] - state.x[a], state.y[b] - state.y[a]
    along = np.abs(dx) / np.hypot(dx, dy)
    assert along[held].mean() > along.mean() + 0.05
    assert sorted(set(chain[held])) == list(range(chain.max() + 1))


def test_a_lattice_bears_in_the_region_what_its_walls_bear_in_chains() -> None:
    """Square lattice under 2:1: rows along x are chains, and nothing else is."""
    scene = Scene(
        region=Rectangle(2.0, 2.0),
        grains=Grains(count=400, packing="square", modulus=KN),
        bonds=Bonds(kind="contact", tensile_strength=1e9, shear_strength=1e9),
        stress=Stress(20e6, 10e6),
        observe=("force_chains", "elastic_moduli"),
    )
    made = run_stages(scene)
    seen = made["observe"]
    np.testing.assert_allclose(seen["region_stress"], [20e6, 10e6, 0.0], rtol=0.02, atol=0.1e6)
    assert 0.6 < seen["chained_force_share"] < 0.7  # two of three parts, but for the rim
    assert seen["force_chains"] == len(np.unique(made["pack"].y.round(6)))
    # k_n along rows, nothing across
    assert seen["elastic_youngs_modulus"] == pytest.approx(KN, rel=0.02)
    assert seen["elastic_poissons_ratio"] == pytest.approx(0.0, abs=0.01)
    assert seen["rock_youngs_modulus"] == pytest.approx(KN, rel=0.02)


@pytest.mark.parametrize("word", ["force_chains", "elastic_moduli"])
def test_what_lacks_a_load_or_cement_is_refused(word: str) -> None:
    grains = Grains(count=400, packing="square", modulus=KN)
    with pytest.raises(SceneError, match=r"there (is no stress|are no bonds)"):
        Scene(region=Rectangle(2.0, 2.0), grains=grains, observe=(word,))


def test_a_row_under_its_ends_is_one_chain() -> None:
    x, a = 2.0 * np.arange(5.0), np.arange(4)
    one = measures.force_chains(x, np.zeros(5), a, a + 1, np.ones(4), np.zeros(4))
    np.testing.assert_array_equal(one, [-1, 0, 0, -1])


def test_largest_circle_between_three_discs() -> None:
    """The inner Soddy circle: 1 / ρ = 3 + 2 √3 for three unit discs that touch."""
    x, y = np.array([[0.0, 2.0, 1.0]] * 2), np.array([[0.0, 0.0, np.sqrt(3.0)]] * 2)
    at = np.array([1.0, 9.0]), np.array([0.6, 9.0])
    found, none = largest_circles(x, y, np.ones((2, 3)), *at, np.ones(2))
    assert found is not None
    assert found[2] == pytest.approx(1.0 / (3.0 + 2.0 * np.sqrt(3.0)), rel=1e-9)
    assert found[:2] == pytest.approx((1.0, 1.0 / np.sqrt(3.0)))
    assert none is None


def test_floaters_are_fitted_without_overlap_and_touch_three() -> None:
    law, size = sizes_of("uniform", 1.66, None, None), np.array([57.0, 57.0])
    left, fitted = (
        attempt(by_porosity(0.18, PRESSURE), 0.18, size, law, [1, 0], fits=fits)
        for fits in (False, True)
    )
    before, grains = left.specimen.grains, fitted.specimen.grains
    n = len(grains.x)
    moved = grains.radius != before.radius
    assert moved.sum() > 0.03 * n
    np.testing.assert_array_equal(grains.x[~moved], before.x[~moved])
    np.testing.assert_array_equal(grains.y[~moved], before.y[~moved])
    touches = np.bincount(np.concatenate(fitted.fitted), minlength=n)
    assert np.all(touches[moved] >= 3)
    distance = np.hypot(grains.x[:, None] - grains.x, grains.y[:, None] - grains.y)
    gap = distance - grains.radius[:, None] - grains.radius + 10.0 * np.eye(n)
    assert gap[moved].min() > -1e-8


def test_a_packing_of_fitted_floaters_has_few_and_its_porosity() -> None:
    rock = pack(
        region=REGIONS["square"], count=400, mean_radius=None, packing="random",
        radius_ratio=1.66, porosity=0.18, seed=1, floaters="fit",
    )  # fmt: skip
    assert float(rock.porosity) == pytest.approx(0.18, abs=0.005)
    a, b = rock.contact_a, rock.contact_b
    touches = np.bincount(np.r_[a, b], minlength=len(rock.x))
    box, near = rock.box, 3.0 * rock.radius.mean()  # a void at a wall is not closed by grains
    inner = (rock.x > box[0] + near) & (rock.x < box[1] - near)
    inner &= (rock.y > box[2] + near) & (rock.y < box[3] - near)
    assert np.count_nonzero(touches[inner] < 2) <= 0.003 * len(rock.x)
    assert int(rock.floaters) <= 0.02 * len(rock.x)


def test_fitting_needs_grains_around() -> None:
    x = np.array([0.0, 2.0, 1.0])
    a, b = fit(
        x, np.zeros(3), np.ones(3), np.array([False, False, True]), np.array([-9.0, 9.0, -9.0, 9.0])
    )
    assert len(a) == len(b) == 0
