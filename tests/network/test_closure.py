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
)
from demflow.model.outcome import ModelError
from demflow.model.region import Rectangle
from demflow.model.scene import (
    BartonBandis,
    Bonds,
    Closure,
    Fluid,
    Grains,
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


def test_walls_without_stiffness_are_refused():
    with pytest.raises(ModelError, match="no stiffness"):
        barton_bandis(np.array([1e-2]), np.array([1e6]), BartonBandis(jrc=1.0, jcs=1e6))


def test_a_law_is_one_law():
    with pytest.raises(SceneError, match="exactly one"):
        Closure(half_stress=1e6, stiffness=1e10)
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
