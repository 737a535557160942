"""Tests to failure: moduli and strengths of lattices, confinement, tension, what has no peak."""

import numpy as np
import pytest

from model.mechanics.moduli import elastic_moduli
from model.mechanics.strength import strength
from model.outcome import ModelError
from model.products import StrengthTest
from model.scene import Bonds, FailureTest
from tests.mechanics.rocks import packed

KN = 124e9


def bonds(strength_: float = 157e6, kind: str = "parallel") -> Bonds:
    return Bonds(kind=kind, tensile_strength=strength_, shear_strength=strength_)


def to_failure(rock, cement, **test) -> StrengthTest:
    return strength(
        rock,
        normal_stiffness=KN,
        stiffness_ratio=2.5,
        friction=0.5,
        bonds=cement,
        test=FailureTest(**{"strain_step": 4e-6, **test}),
    )


@pytest.fixture(scope="module")
def rock():
    return packed(0.165, count=400)


def test_modulus_is_that_of_the_bonded_grains(rock) -> None:
    found = to_failure(rock, bonds(kind="contact"), confining_stress=20e6)
    wanted = elastic_moduli(rock, stiffness_ratio=2.5, friction=0.5, bonds=bonds(kind="contact"))
    assert float(found.youngs_modulus) == pytest.approx(KN * wanted.youngs_modulus, rel=0.15)
    assert float(found.poissons_ratio) == pytest.approx(wanted.poissons_ratio, abs=0.1)


def test_confinement_strengthens(rock) -> None:
    loose, tight = (to_failure(rock, bonds(), confining_stress=p) for p in (1e6, 50e6))
    assert float(tight.peak_strength) > float(loose.peak_strength) + 50e6
    for found in (loose, tight):
        assert int(found.crack_count) == found.cracks[-1] >= int(found.cracks_at_peak) > 0
        assert np.all(np.diff(found.cracks) >= 0)
        assert float(found.peak_strength) == found.axial_stress.max()


def test_strength_follows_the_bonds(rock) -> None:
    """Without confinement and friction nothing but the bonds has a unit of stress.

    Pulled so slowly that waves cross the specimen many times before it breaks.
    """
    slow = {"kind": "tension", "strain_step": 2e-7}
    one, two = (to_failure(rock, bonds(s), **slow) for s in (60e6, 120e6))
    assert float(two.peak_strength) == pytest.approx(2.0 * float(one.peak_strength), rel=0.1)
    assert float(one.peak_strength) < 60e6
    assert float(two.youngs_modulus) == pytest.approx(float(one.youngs_modulus), rel=0.1)


def test_unbonded_grains_have_a_frictional_strength() -> None:
    found = to_failure(packed(0.165, count=400), None, confining_stress=20e6)
    assert 1.5 * 20e6 < float(found.peak_strength) < 6 * 20e6
    assert int(found.crack_count) == 0


def test_no_peak_within_the_largest_strain_is_told(rock) -> None:
    with pytest.raises(ModelError, match="no peak"):
        to_failure(rock, bonds(1e12), confining_stress=1e6, largest_strain=1e-3)


def test_cement_without_strength_bears_no_tension(rock) -> None:
    with pytest.raises(ModelError, match="bears"):
        to_failure(rock, bonds(0.0), kind="tension", largest_strain=1e-3)
