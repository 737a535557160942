"""Closure laws of fractures, and the stress across their pieces."""

import dataclasses
import math

import numpy as np
import pytest

from demflow.model.network.fractures.closure import (
    RESIDUAL,
    barton_bandis,
    closed,
    normal_stress,
    on_joint,
)
from demflow.model.outcome import ModelError
from demflow.model.products import StressState
from demflow.model.region import Rectangle
from demflow.model.scene import (
    BartonBandis,
    Bonds,
    Closure,
    Fluid,
    Grains,
    Joint,
    Matrix,
    Scene,
    SceneError,
    Stress,
    Trace,
)
from demflow.model.stages import run_stages

W0, STRESS = np.array([5e-5, 2e-4]), np.array([0.0, 1e5, 1e6, 1e7, 5e7])
WALL = BartonBandis(jrc=8.0, jcs=8e7)
LAWS = (
    Closure(half_stress=5e6),
    Closure(stiffness=5e11),
    Closure(stiffness=5e11, largest_closure=3e-5),
    Closure(barton_bandis=WALL),
    Closure(table=((0.0, 3e-4), (1e6, 2e-4), (2e7, 1e-4))),
)


@pytest.mark.parametrize("law", LAWS)
def test_apertures_fall_with_stress_from_what_they_are_without(law):
    for w0 in W0:
        left = closed(np.full(len(STRESS), w0), STRESS, law)
        assert left[0] == pytest.approx(w0, rel=1e-12)
        assert np.all(np.diff(left) <= 0.0)
        assert np.all(left >= RESIDUAL * w0)
        assert closed(np.array([w0]), np.array([-1e6]), law)[0] == pytest.approx(w0, rel=1e-12)


def test_laws_by_hand():
    one = np.array([1e-4])
    assert closed(one, np.array([5e6]), LAWS[0])[0] == pytest.approx(5e-5)
    assert closed(one, np.array([1e7]), LAWS[1])[0] == pytest.approx(1e-4 - 1e7 / 5e11)
    # at σ = k_n V_m half of the largest closure is reached
    assert closed(one, np.array([1.5e7]), LAWS[2])[0] == pytest.approx(1e-4 - 1.5e-5)
    # by hand in mm and MPa: JRC 8, JCS 80 MPa, 100 µm hydraulic, 10 MPa
    mechanical = math.sqrt(100.0 * 8.0**2.5) / 1e3
    stiffness = -7.15 + 1.75 * 8.0 + 0.02 * 80.0 / mechanical
    largest = -0.296 - 0.0056 * 8.0 + 2.241 * (80.0 / mechanical) ** -0.245
    left = mechanical - 10.0 * largest / (stiffness * largest + 10.0)
    assert 0.0 < largest < mechanical
    expected = min(left, (1e3 * left) ** 2 / 8.0**2.5 / 1e3) * 1e-3
    assert barton_bandis(one, np.array([1e7]), WALL)[0] == pytest.approx(expected, rel=1e-9)


def test_a_table_is_scaled_to_the_fracture_and_none_leaves_it():
    measured = LAWS[4]
    at = np.array([0.0, 5e5, 1e6, 1.05e7, 1e9])
    expected = np.array([3.0, 2.5, 2.0, 1.5, 1.0]) / 3.0
    np.testing.assert_allclose(closed(np.full(5, 6e-5), at, measured), 6e-5 * expected)
    np.testing.assert_array_equal(closed(W0, np.full(2, 1e8), Closure(law="none")), W0)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (((0.0, 1e-4),), "at least two rows"),
        (((1e6, 1e-4), (2e6, 5e-5)), "the first at a stress of 0"),
        (((0.0, 1e-4), (0.0, 5e-5)), "must increase"),
        (((0.0, 1e-4), (1e6, 0.0)), "above 0"),
        (((0.0, 1e-4), (1e6, 2e-4)), "must not grow"),
    ],
)
def test_tables_that_say_no_closure_are_refused(table, told):
    with pytest.raises(SceneError, match=told):
        Closure(table=table)


def test_walls_without_stiffness_are_refused():
    with pytest.raises(ModelError, match="no stiffness"):
        barton_bandis(np.array([1e-2]), np.array([1e6]), BartonBandis(jrc=1.0, jcs=1e6))


def test_a_law_is_one_law():
    with pytest.raises(SceneError, match="exactly one"):
        Closure(half_stress=1e6, stiffness=1e10)
    with pytest.raises(SceneError, match="exactly one"):
        Closure(law="none", table=((0.0, 1e-4), (1e6, 5e-5)))
    with pytest.raises(SceneError, match="closes an aperture"):
        Trace(name="t", resistance=1e12, closure=LAWS[0], start=(0, 0), end=(1, 0))


def test_pieces_feel_the_uniform_stress_and_the_matrix_whatever_its_grains():
    """n · σ · n of the specimen along each trace; half_stress leaves what it says at any size."""
    base = Scene(
        region=Rectangle(10.0, 10.0),
        grains=Grains(count=900, seed=2, porosity=0.17, modulus=2e10),
        bonds=Bonds(kind="parallel", tensile_strength=5e7, shear_strength=5e7),
        stress=Stress(2e7, 1e7),
        matrix=Matrix(permeability=1e-15, half_stress=5e6),
        fluid=Fluid(viscosity=1e-3, bulk_modulus=1e9),
        fractures=tuple(
            Trace(
                name=f"t{k}",
                aperture=1e-4,
                closure=LAWS[0],
                start=(-4 * math.cos(a), -4 * math.sin(a)),
                end=(4 * math.cos(a), 4 * math.sin(a)),
            )
            for k, a in enumerate((0.0, 0.8, math.pi / 2))
        ),
        observe=("permeability",),
    )
    made = run_stages(base)
    across = normal_stress(made["stress"], made["walk"])
    xx, yy, xy = made["stress"].stress
    line = made["walk"].branch_line
    for k, a in enumerate((0.0, 0.8, math.pi / 2)):
        n = np.array([-math.sin(a), math.cos(a)])
        expected = n @ np.array([[xx, xy], [xy, yy]]) @ n
        assert across[line == k].mean() == pytest.approx(expected, rel=0.02)
        left = made["open"].branch_aperture[line == k].mean()
        assert left == pytest.approx(1e-4 * 5e6 / (expected + 5e6), rel=0.02)
    kept = []
    for count in (250, 900):
        grains = dataclasses.replace(base.grains, count=count)
        alone = dataclasses.replace(base, grains=grains, fractures=())
        kept.append(np.trace(run_stages(alone)["observe"]["permeability"]) / 2e-15)
    assert kept[0] == pytest.approx(kept[1], rel=0.25)


def crossed(forces: np.ndarray, gaps: np.ndarray, slips: np.ndarray) -> StressState:
    """Grains in pairs across y = 0, unevenly along it, numbered at random; forces (n, 2)."""
    n = len(forces)
    rng = np.random.default_rng(3)
    x = (np.arange(n) + 0.5 + rng.uniform(-0.3, 0.3, n)) / n
    side = rng.choice([-1.0, 1.0], n)
    lean = rng.uniform(-0.01, 0.01, n)
    at = np.empty((2 * n, 2))
    at[0::2] = np.column_stack([x - lean, -0.02 * side])
    at[1::2] = np.column_stack([x + lean, 0.02 * side])
    branch = at[1::2] - at[0::2]
    normal = branch / np.hypot(*branch.T)[:, None]
    on_b = forces * side[:, None]  # the force on what lies above, given, is that on b or on a
    none = np.empty(0)
    whole = {name: none for name in StressState._fields}
    return StressState(
        **whole
        | {
            "x": at[:, 0],
            "y": at[:, 1],
            "contact_a": np.arange(0, 2 * n, 2),
            "contact_b": np.arange(1, 2 * n, 2),
            "normal_force": np.einsum("ij,ij->i", on_b, normal),
            "shear_force": on_b[:, 1] * normal[:, 0] - on_b[:, 0] * normal[:, 1],
            "joint_gap": gaps,
            "joint_slip": slips,
        }
    )


def test_a_joint_bears_what_its_contacts_do():
    n = 400
    every = np.ones(n)
    forces = np.column_stack([2e4 * every, 5e4 * every])  # N/m, n of them over 1 m
    state = crossed(forces, -1e-6 * every, 3e-4 * every)
    at = np.linspace(0.05, 0.95, 19)
    found = on_joint(state, np.array([0.0, 0.0]), np.array([1.0, 0.0]), at, 0.1)
    assert found is not None
    np.testing.assert_allclose(found.normal, 5e4 * n, rtol=0.03)
    np.testing.assert_allclose(found.shear, 2e4 * n, rtol=0.03)
    np.testing.assert_allclose(found.opening, 3e-5, rtol=1e-9)
    backwards = on_joint(state, np.array([1.0, 0.0]), np.array([0.0, 0.0]), 1.0 - at, 0.1)
    assert backwards is not None
    np.testing.assert_allclose(backwards.normal, found.normal, rtol=0.05)
    # gaps count where the joint bears nothing
    parted = on_joint(
        crossed(0.0 * forces, 2e-4 * every, 0.0 * every),
        np.array([0.0, 0.0]), np.array([1.0, 0.0]), at, 0.1,
    )  # fmt: skip
    assert parted is not None
    np.testing.assert_allclose(parted.opening, 2e-4, rtol=1e-9)
    assert on_joint(state, np.array([0.0, 5.0]), np.array([1.0, 5.0]), at, 0.1) is None


@pytest.mark.slow
def test_a_joint_that_slides_dilates():
    """The same rock and stress: a dilating joint is wider by its slip, where it slid."""
    apertures = []
    for dilation in (0.0, 0.2):
        plane = Joint(
            normal_stiffness=4e11, shear_stiffness=4e11, friction=0.2, dilation_angle=dilation
        )
        joint = Trace(
            name="j", start=(-3.0, -3.0), end=(3.0, 3.0), aperture=1e-4, closure=LAWS[0],
            joint=plane,
        )  # fmt: skip
        scene = Scene(
            region=Rectangle(10.0, 10.0),
            grains=Grains(count=300, seed=2, porosity=0.17, modulus=2e10),
            bonds=Bonds(kind="parallel", tensile_strength=5e8, shear_strength=5e8),
            stress=Stress(2e7, 6e6),
            matrix=Matrix(permeability=1e-15),
            fluid=Fluid(viscosity=1e-3, bulk_modulus=1e9),
            fractures=(joint,),
            observe=("permeability",),
        )
        made = run_stages(scene)
        assert made["stress"].joint_slip.max() > 1e-5
        apertures.append(made["open"].branch_aperture)
    assert apertures[1].mean() > 1.2 * apertures[0].mean()
