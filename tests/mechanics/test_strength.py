"""Tests to failure: moduli and strengths, their symmetries and scales, what has no peak."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from demflow.model.analytic.lattice import hexagonal_elasticity
from demflow.model.mechanics.loading.strength import GAUGE, relieve, strength
from demflow.model.mechanics.loading.stress import load, unit_loads
from demflow.model.mechanics.specimen import measures
from demflow.model.mechanics.static.moduli import in_plane_strain
from demflow.model.outcome import ModelError
from demflow.model.products import ENERGIES, Packing, StrengthTest
from demflow.model.region import Rectangle
from demflow.model.scene import (
    BiWing,
    Bonds,
    FailureTest,
    Fluid,
    Grains,
    Joint,
    JointLine,
    Matrix,
    Scene,
    Stress,
)
from demflow.model.stages import run_stages, simulate
from tests.mechanics.rocks import packed

pytestmark = pytest.mark.slow

KN = 62e9
CONTACTS = {"normal_stiffness": KN, "stiffness_ratio": 2.5, "friction": 0.5}


def bonds(strength_: float = 157e6, kind: str = "parallel") -> Bonds:
    return Bonds(kind=kind, tensile_strength=strength_, shear_strength=strength_)


def to_failure(rock, cement, friction: float = 0.5, **test) -> StrengthTest:
    return strength(rock, bonds=cement, test=of_steps(test), **CONTACTS | {"friction": friction})


def of_steps(test: dict) -> FailureTest:
    return FailureTest(**{"strain_step": 2e-6, **test})


GRAINS = 200


@pytest.fixture(scope="module")
def rock():
    return packed(0.165, count=GRAINS)


def outcome(cement: Bonds | None, **test) -> StrengthTest:
    """The rock tested to failure, once for all that look at it."""
    return broken_by(cement, of_steps(test))


@cache
def broken_by(cement: Bonds | None, test: FailureTest) -> StrengthTest:
    return strength(packed(0.165, count=GRAINS), bonds=cement, test=test, **CONTACTS)


@pytest.mark.parametrize("confinement", ["walls", "membrane"])
def test_energies_of_a_test_close_and_counting_them_changes_nothing(rock, confinement) -> None:
    test = FailureTest(confining_stress=10e6, strain_step=4e-6, confinement=confinement)
    plain, counted = (
        strength(rock, bonds=bonds(60e6), test=test, **CONTACTS, energy=energy)
        for energy in (None, True)
    )
    assert plain.energy.size == 0
    for name in ("axial_stress", "lateral_strain", "crack_x"):
        np.testing.assert_array_equal(getattr(counted, name), getattr(plain, name))
    found = dict(zip(ENERGIES, counted.energy.tolist(), strict=True))
    given, error = found.pop("input"), found.pop("error")
    assert given == pytest.approx(sum(found.values()) + error, rel=1e-12)
    assert abs(error) < 1e-3 * given
    assert min(found[lost] for lost in ("slip", "breakage", "damping")) > 0.0
    # what the axial stress did, less what went into the sides; strains are of the middle
    area = np.prod(np.diff(counted.box)[[0, 2]])
    work = np.trapezoid(counted.axial_stress, counted.axial_strain)
    work -= np.trapezoid(np.full_like(counted.lateral_strain, 10e6), counted.lateral_strain)
    assert given == pytest.approx(area * work, rel=0.2)


def static_moduli(rock: Packing, cement: Bonds, confining: float, axial: float) -> tuple:
    """E and ν between two states of the static solver, strains of the grains in the gauge."""
    rock = relieve(rock)
    units = unit_loads(rock, stiffness_ratio=2.5, friction=0.5, bonds=cement.elastic(KN))
    one, two = (
        load(
            rock,
            units,
            bonds=cement,
            stress=Stress(xx=confining, yy=yy, method="static", tolerance=1e-5),
            **CONTACTS,
        )
        for yy in (confining, axial)
    )
    half = 0.5 * GAUGE * np.diff(rock.box)[[0, 2]]
    middle = 0.5 * (rock.box[[0, 2]] + rock.box[[1, 3]])
    inside = (np.abs(one.x - middle[0]) < half[0]) & (np.abs(one.y - middle[1]) < half[1])
    place = one.x[inside], one.y[inside]
    moved = (two.x - one.x)[inside], (two.y - one.y)[inside]
    strain = measures.affine_strain(*place, *moved)
    return (confining - axial) / strain[1, 1], -strain[0, 0] / strain[1, 1]


def of_size(width: float, height: float, **given) -> Scene:
    """A specimen as a study asks for it."""
    return Scene(
        region=Rectangle(width, height),
        grains=Grains(count=250, porosity=0.16, floaters="fit", modulus=KN, stiffness_ratio=2.5),
        bonds=bonds(),
        test=FailureTest(confining_stress=10e6, strain_step=4e-6, confinement="membrane"),
        observe=("peak_strength",),
        **given,
    )


@pytest.mark.parametrize(("width", "height"), [(0.034, 0.1), (0.05, 0.1), (0.012, 0.12)])
def test_a_specimen_has_the_size_that_is_asked_for(width, height) -> None:
    """Aspect ratios 3, 2 and 10, few grains wide; and one that has flow, too, is tested alike."""
    scene = of_size(width, height)
    made = run_stages(scene)["strength"]
    assert np.diff(made.box)[[0, 2]] == pytest.approx([width, height], rel=0.01)
    both = dataclasses.replace(
        scene,
        matrix=Matrix(aperture=1e-6),
        fluid=Fluid(1e-3, 2e9),
        observe=("peak_strength", "permeability"),
    )
    assert run_stages(both)["strength"].peak_strength == made.peak_strength


def test_a_joint_across_the_region_parts_the_specimen() -> None:
    """It slides as one that goes on beyond the region does, at a tenth of the rock's strength."""
    across, beyond = (
        float(
            simulate(
                of_size(
                    0.034,
                    0.1,
                    fractures=(
                        BiWing(
                            name="plane",
                            at=(0.0, 0.0),
                            angle=np.radians(55.0),
                            half_length=half,
                            joint=Joint(2e13, 2e13, friction=0.364),
                        ),
                    ),
                )
            )["peak_strength"]
        )
        for half in (0.0297, 0.2)
    )
    assert across == pytest.approx(beyond, rel=0.01)
    assert across < 40e6


def test_slow_test_follows_the_static_solver(rock) -> None:
    """Moduli of two independent ways, with contacts that open and slip."""
    confining, axial = 1e6, 41e6
    modulus, ratio = static_moduli(rock, bonds(), confining, axial)
    found = outcome(bonds(), confining_stress=confining)
    strain, across = (
        float(np.interp(axial, found.axial_stress, part))
        for part in (found.axial_strain, found.lateral_strain)
    )
    assert (axial - found.axial_stress[0]) / strain == pytest.approx(modulus, rel=0.01)
    assert across / strain == pytest.approx(ratio, abs=0.01)


@pytest.mark.parametrize("stiffness_ratio", [2.5, 1.2, 1.0, 0.8])
def test_hexagonal_lattice_has_its_closed_form_moduli(stiffness_ratio) -> None:
    """Contact bonds: every contact is a spring in tension as in compression.

    Half a grain along either side stands beside the last row and bears nothing. Stiff in shear, all
    grains turn together at a frequency that local damping must not drive.
    """
    lattice = packed(None, count=150, kind="hexagonal")
    given = CONTACTS | {"stiffness_ratio": stiffness_ratio}
    test = FailureTest(confining_stress=1e5, strain_step=1e-6)
    found = strength(lattice, bonds=bonds(kind="contact"), test=test, **given)
    modulus, ratio = hexagonal_elasticity(KN, KN / stiffness_ratio)
    width = lattice.box[1] - lattice.box[0]
    borne = 1.0 - 2.0 * lattice.radius[0] / width
    assert float(found.youngs_modulus) == pytest.approx(modulus * borne, rel=0.01)
    assert float(found.poissons_ratio) == pytest.approx(ratio, abs=0.01)


def test_confinement_strengthens(rock) -> None:
    loose, tight = (outcome(bonds(), confining_stress=p) for p in (1e6, 50e6))
    assert float(tight.peak_strength) > float(loose.peak_strength) + 50e6
    for found in (loose, tight):
        assert int(found.crack_count) == found.cracks[-1] >= int(found.cracks_at_peak) > 0
        assert np.all(np.diff(found.cracks) >= 0)
        assert float(found.peak_strength) == found.axial_stress.max()


def test_cracks_are_told_with_place_and_mode(rock) -> None:
    found = outcome(bonds(), confining_stress=1e6)
    assert len(found.crack_x) == len(found.crack_y) == int(found.crack_count)
    assert set(np.unique(found.crack_mode)) <= {1, 2}
    width = found.box[1] - found.box[0]
    assert np.all(np.abs(found.crack_x - 0.5 * (found.box[0] + found.box[1])) < 0.55 * width)


def test_breakage_is_told_with_step_and_strain(rock) -> None:
    """Cracks come in order, none before the test, and as many by each strain as are counted."""
    for kind in ("biaxial", "tension"):
        found = outcome(bonds(), kind=kind, confining_stress=1e6)
        assert len(found.crack_step) == len(found.crack_strain) == int(found.crack_count) > 3
        assert np.all(np.diff(found.crack_step) >= 0)
        assert np.all((found.crack_step > 0) & (found.crack_step <= int(found.steps)))
        for k in range(0, len(found.cracks), 7):
            counted = int(found.cracks[k])
            assert np.all(found.crack_strain[:counted] <= found.axial_strain[: k + 1].max())
            assert np.all(found.crack_strain[counted:] >= found.axial_strain[k:].min())


@pytest.mark.parametrize("confining", [0.1e6, 1e6, 10e6])
def test_confining_stress_is_held_by_a_slow_test(rock, confining: float) -> None:
    found = outcome(bonds(), confining_stress=confining, strain_step=1e-6)
    peak = int(np.argmax(found.axial_stress))
    assert found.axial_stress[0] == pytest.approx(confining, rel=0.02)
    assert found.lateral_stress[0] == pytest.approx(confining, rel=0.02)
    assert int(found.confinement_held) == 1
    assert float(found.confining_deviation) < 0.01 * float(found.peak_strength)
    assert float(found.confining_stress_achieved) == pytest.approx(
        found.lateral_stress[: peak + 1].mean()
    )
    assert abs(float(found.confining_stress_achieved) - confining) <= 0.3e6


def test_cement_stands_at_every_contact_of_the_packing_also_where_it_opened(rock) -> None:
    """Lists of pairs that are as narrow as pays do not hold them all."""
    relieved, n = relieve(rock), len(rock.x)
    packed_, found = (part.contact_a * n + part.contact_b for part in (rock, relieved))
    assert np.isin(packed_, found).all()
    assert np.count_nonzero(relieved.normal_force == 0.0) > 0.02 * len(packed_)


def test_confining_stress_that_a_fast_test_loses_is_told(rock) -> None:
    """The walls lag behind grains that widen, the more the faster the platens are."""
    slow, fast = (outcome(bonds(), confining_stress=1e5, strain_step=step) for step in (1e-6, 2e-5))
    assert float(fast.confining_deviation) > 2.0 * float(slow.confining_deviation)
    assert int(fast.confinement_held) == 0


def test_a_membrane_holds_its_stress(rock) -> None:
    found = outcome(bonds(), confining_stress=5e6, confinement="membrane")
    assert float(found.confining_stress_achieved) == pytest.approx(5e6)
    assert float(found.confining_deviation) < 1.0


def test_grains_that_do_not_bear_the_confining_stress_are_told(monkeypatch) -> None:
    """With too few steps nothing is at rest, and no half-loaded specimen is tested."""
    monkeypatch.setattr("demflow.model.mechanics.loading.strength.HOLDING", 10)
    with pytest.raises(ModelError, match="does not hold the confining stress of 1e"):
        to_failure(packed(0.165, count=GRAINS), bonds(), confining_stress=10e6)
    monkeypatch.setattr("demflow.model.mechanics.loading.strength.RELIEVING", 10)
    with pytest.raises(ModelError, match="relieved"):
        to_failure(packed(0.165, count=GRAINS), bonds(), confining_stress=10e6)


def test_cemented_joints_count_as_they_break(rock) -> None:
    joint = Joint(normal_stiffness=2e13, shear_stiffness=2e13, friction=0.4, cohesion=2e7,
                  tensile_strength=2e7)  # fmt: skip
    plane = JointLine((-3.0, -3.0), (3.0, 3.0), joint)
    found = strength(
        rock, bonds=bonds(), joints=(plane,),
        test=FailureTest(strain_step=2e-6, confining_stress=1e6, confinement="membrane"),
        **CONTACTS,
    )  # fmt: skip
    assert int(found.crack_count) == len(found.crack_x) == found.cracks[-1] > 10


def test_slower_is_the_same(rock) -> None:
    one, two = (outcome(bonds(), confining_stress=1e6, strain_step=step) for step in (2e-6, 1e-6))
    assert float(two.youngs_modulus) == pytest.approx(float(one.youngs_modulus), rel=0.01)
    assert float(two.poissons_ratio) == pytest.approx(float(one.poissons_ratio), abs=0.01)
    assert float(two.peak_strength) == pytest.approx(float(one.peak_strength), rel=0.05)


def test_mirrored_specimen_is_as_strong(rock) -> None:
    mirrored = rock._replace(
        x=-rock.x, shear_force=-rock.shear_force, box=rock.box[[1, 0, 2, 3]] * [-1, -1, 1, 1]
    )
    one = outcome(bonds(), confining_stress=1e6)
    two = to_failure(mirrored, bonds(), confining_stress=1e6)
    assert float(two.peak_strength) == pytest.approx(float(one.peak_strength), rel=1e-3)
    assert float(two.youngs_modulus) == pytest.approx(float(one.youngs_modulus), rel=1e-6)


@pytest.mark.parametrize("kind", ["biaxial", "tension"])
def test_strength_follows_the_bonds(rock, kind: str) -> None:
    """Without confinement nothing but the bonds has a unit of stress."""
    slow = {"kind": kind, "confining_stress": 0.0, "strain_step": 1e-6}
    one, two = (outcome(bonds(s), **slow) for s in (60e6, 120e6))
    assert float(two.peak_strength) == pytest.approx(2.0 * float(one.peak_strength), rel=0.1)
    assert float(two.youngs_modulus) == pytest.approx(float(one.youngs_modulus), rel=0.1)
    if kind == "tension":
        assert float(one.peak_strength) < 60e6


def test_unbonded_grains_have_a_frictional_strength() -> None:
    found = outcome(None, confining_stress=20e6)
    assert 1.5 * 20e6 < float(found.peak_strength) < 6 * 20e6
    assert int(found.crack_count) == 0


def test_no_peak_within_the_largest_strain_is_told(rock) -> None:
    with pytest.raises(ModelError, match="no peak"):
        outcome(bonds(1e12), confining_stress=1e6, largest_strain=1e-3)


def test_cement_without_strength_bears_no_tension(rock) -> None:
    with pytest.raises(ModelError, match="bears"):
        outcome(bonds(0.0), kind="tension", largest_strain=1e-3)


def test_plane_strain_is_the_slice_that_cannot_strain_out_of_its_plane() -> None:
    """Hooke's law in three dimensions with ε_zz = 0 and σ_xx = 0."""
    modulus, ratio = 7.0, 0.3
    compliance = (np.eye(3) * (1.0 + ratio) - ratio) / modulus
    stress_zz = ratio * 1.0  # of σ_yy = 1
    strain = compliance @ [0.0, 1.0, stress_zz]
    assert strain[2] == pytest.approx(0.0, abs=1e-15)
    found = in_plane_strain(1.0 / strain[1], -strain[0] / strain[1])
    assert found == pytest.approx((modulus, ratio))
