"""Measurements on grains: strain, stress, fabric, force chains, fitted floaters."""

import numpy as np
import pytest

from model.mechanics import measures
from model.mechanics.floaters import fit, largest_circle
from model.mechanics.packing import pack
from model.region import Circle, Polygon
from tests.mechanics.rocks import REGIONS, packed
from tests.mechanics.test_stress import loaded


def test_affine_strain_is_found_whatever_the_rotation() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.random((2, 50))
    turn, strain = 0.3, np.array([[1e-3, 4e-4], [4e-4, -2e-3]])
    gradient = strain + turn * np.array([[0.0, -1.0], [1.0, 0.0]])
    u, v = gradient @ np.array([x, y]) + np.array([[5.0], [-2.0]])
    np.testing.assert_allclose(measures.affine_strain(x, y, u, v), strain, atol=1e-12)
    with pytest.raises(ValueError, match="three grains"):
        measures.affine_strain(x[:2], y[:2], u[:2], v[:2])


@pytest.mark.parametrize(
    "region", [Circle(0.9), Polygon(((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)))]
)
def test_stress_in_a_part_is_that_on_the_walls(region) -> None:
    rock = packed()
    state = loaded(rock, 16, 10)
    found = measures.mean_stress(
        region, state.x, state.y, state.contact_a, state.contact_b,
        state.normal_force, state.shear_force,
    )  # fmt: skip
    np.testing.assert_allclose(np.diag(found), [16e6, 10e6], rtol=0.06)
    assert abs(found[0, 1]) < 1e6


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


def test_a_row_under_its_ends_is_one_chain() -> None:
    x, a = 2.0 * np.arange(5.0), np.arange(4)
    one = measures.force_chains(x, np.zeros(5), a, a + 1, np.ones(4), np.zeros(4))
    assert set(one) <= {-1, 0}


def test_largest_circle_between_three_discs() -> None:
    """The inner Soddy circle: 1 / ρ = 3 + 2 √3 for three unit discs that touch."""
    x, y = np.array([0.0, 2.0, 1.0]), np.array([0.0, 0.0, np.sqrt(3.0)])
    found = largest_circle(x, y, np.ones(3), (1.0, 0.6), 1.0)
    assert found is not None
    assert found[2] == pytest.approx(1.0 / (3.0 + 2.0 * np.sqrt(3.0)), rel=1e-9)
    assert found[:2] == pytest.approx((1.0, 1.0 / np.sqrt(3.0)))
    assert largest_circle(x, y, np.ones(3), (9.0, 9.0), 1.0) is None


def test_floaters_are_fitted_without_overlap_and_touch_three() -> None:
    def packing(floaters: str):
        return pack(
            region=REGIONS["square"], count=400, mean_radius=None, packing="random",
            radius_ratio=1.66, porosity=0.18, seed=1, floaters=floaters,
        )  # fmt: skip

    left, fitted = packing("leave"), packing("fit")
    n = len(left.x)
    assert int(left.floaters) > 0.03 * n
    assert int(fitted.floaters) <= 0.01 * n
    assert float(fitted.porosity) == pytest.approx(0.18, abs=0.005)
    moved = fitted.radius != left.radius
    kept = ~moved[fitted.contact_a] & ~moved[fitted.contact_b]
    assert np.array_equal(fitted.contact_a[kept], left.contact_a)
    np.testing.assert_allclose(fitted.normal_force[kept], left.normal_force)
    assert not np.any(fitted.normal_force[~kept])
    touches = np.bincount(np.r_[fitted.contact_a, fitted.contact_b], minlength=n)
    assert np.all(touches[moved] >= 3)
    distance = np.hypot(fitted.x[:, None] - fitted.x, fitted.y[:, None] - fitted.y)
    gap = distance - fitted.radius[:, None] - fitted.radius + 10.0 * np.eye(n)
    assert gap[moved].min() > -1e-8 * fitted.radius.mean()


def test_fitting_needs_grains_around() -> None:
    x = np.array([0.0, 2.0, 1.0])
    a, b = fit(
        x, np.zeros(3), np.ones(3), np.array([False, False, True]), np.array([-9.0, 9.0, -9.0, 9.0])
    )
    assert len(a) == len(b) == 0
