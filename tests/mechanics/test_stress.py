"""Specimens under wall stresses: equilibrium, targets, path, bonds, what cannot be carried."""

import re

import numpy as np
import pytest

from demflow.model.mechanics.loading.stress import load
from demflow.model.outcome import ModelError
from demflow.model.products import Packing, StressState
from demflow.model.scene import Bonds, Stress
from tests.mechanics.rocks import net_forces, packed, wall_forces

KN = 40e9  # grains of 20 GPa
CEMENT = {
    kind: Bonds(kind=kind, tensile_strength=10e6, shear_strength=20e6)
    for kind in ("contact", "parallel")
}


def loaded(rock: Packing, xx: float, yy: float, *, friction=0.5, bonds=None) -> StressState:
    return load(
        rock,
        normal_stiffness=KN,
        stiffness_ratio=2.5,
        friction=friction,
        bonds=bonds,
        stress=Stress(xx=xx * 1e6, yy=yy * 1e6),
    )


def volume_stress(rock: Packing, state: StressState) -> np.ndarray:
    """Mean stress (2, 2) by Σ f ⊗ l over contacts between grains and with walls."""
    a, b = state.contact_a, state.contact_b
    branch = np.column_stack((state.x[b] - state.x[a], state.y[b] - state.y[a]))
    normal = branch / np.hypot(*branch.T)[:, None]
    tangent = np.column_stack((-normal[:, 1], normal[:, 0]))
    on_b = state.normal_force[:, None] * normal + state.shear_force[:, None] * tangent
    virial = on_b.T @ branch
    box, walls = state.box, wall_forces(state, rock.radius, KN)
    virial[0, 0] += np.sum(walls[:, 0] * (state.x - box[0]) + walls[:, 1] * (box[1] - state.x))
    virial[1, 1] += np.sum(walls[:, 2] * (state.y - box[2]) + walls[:, 3] * (box[3] - state.y))
    return virial / ((box[1] - box[0]) * (box[3] - box[2]))


def check(rock: Packing, state: StressState, xx: float, yy: float) -> None:
    """Rest, targets, and agreement of walls and volume, all measured on the product."""
    box = state.box
    sides = np.array([box[3] - box[2]] * 2 + [box[1] - box[0]] * 2)
    walls = wall_forces(state, rock.radius, KN).sum(axis=0) / sides
    np.testing.assert_allclose(walls, state.wall_stress, rtol=1e-6)
    np.testing.assert_allclose(walls, 1e6 * np.array([xx, xx, yy, yy]), rtol=0.005)
    volume = volume_stress(rock, state)
    np.testing.assert_allclose(volume[[0, 1, 0], [0, 1, 1]], state.stress, rtol=1e-6, atol=2e4)
    np.testing.assert_allclose(np.diag(volume), 0.5 * (walls[::2] + walls[1::2]), rtol=0.005)
    force, _ = net_forces(state, rock.radius, KN)
    contact = np.hypot(state.normal_force, state.shear_force).mean()
    assert np.hypot(*force.T).mean() <= 1.1e-3 * contact
    assert float(state.unbalanced_ratio) <= 1e-3


@pytest.mark.parametrize(("xx", "yy"), [(10, 10), (20, 10), (10, 18), (2, 2)])
def test_unbonded_grains_reach_the_stresses(xx: float, yy: float) -> None:
    rock = packed()
    state = loaded(rock, xx, yy)
    check(rock, state, xx, yy)
    slack = 1e-9 * state.normal_force.max()
    assert np.all(np.abs(state.shear_force) <= 0.5 * state.normal_force + slack)
    assert state.normal_force.min() > 0
    assert not state.bonded.any()
    order = np.lexsort((state.contact_b, state.contact_a))
    np.testing.assert_array_equal(order, np.arange(len(order)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["contact", "parallel"])
@pytest.mark.parametrize("porosity", [0.165, 0.19])
def test_bonded_grains_reach_the_stresses(kind: str, porosity: float) -> None:
    rock = packed(porosity)
    state = loaded(rock, 20, 10, bonds=CEMENT[kind])
    check(rock, state, 20, 10)
    assert state.bonded.sum() + int(state.broken_bonds) == len(rock.contact_a)
    assert state.bonded.sum() > 0.6 * len(rock.contact_a)
    pairs = set(zip(rock.contact_a.tolist(), rock.contact_b.tolist(), strict=True))
    glued = zip(state.contact_a[state.bonded], state.contact_b[state.bonded], strict=True)
    assert pairs.issuperset((int(a), int(b)) for a, b in glued)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_bonded_lattices_carry_stress(kind: str) -> None:
    rock = packed(None, kind=kind, count=100)
    strong = Bonds(kind="contact", tensile_strength=1e9, shear_strength=1e9)
    state = loaded(rock, 10, 6, bonds=strong)
    check(rock, state, 10, 6)
    assert int(state.broken_bonds) == 0
    if kind == "square":  # rows carry their stress over one diameter each
        along_x = np.abs(rock.y[state.contact_a] - rock.y[state.contact_b]) < rock.radius[0]
        force = 2 * rock.radius[0] * np.where(along_x, 10e6, 6e6)
        np.testing.assert_allclose(state.normal_force, force, rtol=0.005)
        assert np.abs(state.shear_force).max() < 1e-3 * force.max()


def test_stiffness_only_sets_the_scale() -> None:
    """Forces follow the stresses, displacements stresses over stiffness."""
    rock = packed()
    stiff = load(
        rock,
        normal_stiffness=10 * KN,
        stiffness_ratio=2.5,
        friction=0.5,
        bonds=None,
        stress=Stress(xx=150e6, yy=100e6),
    )
    soft = loaded(rock, 15, 10)
    np.testing.assert_allclose(soft.x, stiff.x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(10 * soft.normal_force, stiff.normal_force, rtol=1e-6, atol=1.0)


def test_same_state_whatever_ran_before() -> None:
    rock = packed()
    first = loaded(rock, 15, 10)
    loaded(rock, 10, 15)
    for one, two in zip(first, loaded(rock, 15, 10), strict=True):
        np.testing.assert_array_equal(one, two)


def test_quarter_turn_turns_the_state() -> None:
    """The law knows no direction: turned grains under turned stresses give turned forces."""
    rock = packed()
    turned = rock._replace(
        x=-rock.y, y=rock.x, box=np.array([-rock.box[3], -rock.box[2], rock.box[0], rock.box[1]])
    )
    state, other = loaded(rock, 16, 10), loaded(turned, 10, 16)
    unit = rock.radius.mean()
    np.testing.assert_allclose(other.x, -state.y, rtol=0, atol=1e-5 * unit)
    np.testing.assert_allclose(other.y, state.x, rtol=0, atol=1e-5 * unit)
    assert other.stress[0] == pytest.approx(state.stress[1], rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("bonds", [None, CEMENT["parallel"]])
def test_beyond_the_strength_is_an_error_that_says_how_far(bonds) -> None:
    with pytest.raises(ModelError) as caught:
        loaded(packed(), 200, 10, bonds=bonds)
    text = str(caught.value)
    assert "try" in text
    assert ("stronger bonds" if bonds else "bonds") in text
    ratio = float(re.findall(r"ratio ([\d.]+):1", text)[0])
    assert 1.5 < ratio < 10.0


@pytest.mark.slow
def test_frictionless_grains_carry_pressure_but_no_difference() -> None:
    rock = packed()
    check(rock, loaded(rock, 10, 10, friction=0.0), 10, 10)
    with pytest.raises(ModelError, match="friction 0"):
        loaded(rock, 20, 10, friction=0.0)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_grains(count: int) -> None:
    rock = packed(0.18, count=count)
    check(rock, loaded(rock, 12, 10), 12, 10)
