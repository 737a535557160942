"""Jointed specimens tested to failure: sliding along a plane of weakness as Jaeger says."""

import re

import numpy as np
import pytest

from demflow.model.analytic.jaeger import mobilised_friction
from demflow.model.mechanics.loading.strength import strength
from demflow.model.mechanics.packing.packing import pack
from demflow.model.outcome import ModelError
from demflow.model.products import StrengthTest
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, FailureTest, Joint, JointLine

pytestmark = pytest.mark.slow

KN, CONFINING, FRICTION = 62e9, 10e6, 20.0
BONDS = Bonds(kind="parallel", tensile_strength=157e6, shear_strength=157e6)


@pytest.fixture(scope="module")
def rock():
    return pack(
        region=Rectangle(0.034, 0.1), count=880, mean_radius=None, packing="random",
        radius_ratio=1.66, porosity=0.16, seed=1, floaters="fit",
    )  # fmt: skip


def pressed(rock, degrees: float, **how: float) -> StrengthTest:
    """A test with a joint through the middle of the specimen, at an angle to its flat ends."""
    along = 0.2 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    joint = Joint(
        normal_stiffness=2e13, shear_stiffness=2e13, friction=np.tan(np.radians(FRICTION))
    )
    test = FailureTest(confining_stress=CONFINING, confinement="membrane", **how)
    return strength(
        rock, normal_stiffness=KN, stiffness_ratio=2.5, friction=0.5, bonds=BONDS, test=test,
        joints=(JointLine(tuple(-along), tuple(along), joint),),
    )  # fmt: skip


@pytest.mark.parametrize("degrees", [45.0, 55.0, 60.0])
def test_a_joint_slides_when_its_friction_is_mobilised(rock, degrees: float) -> None:
    found = pressed(rock, degrees, strain_step=2e-7, largest_strain=6e-4)
    mobilised = np.degrees(mobilised_friction(found.axial_stress, CONFINING, np.radians(degrees)))
    assert mobilised.max() == pytest.approx(FRICTION, abs=3.0)
    sliding = mobilised[len(mobilised) // 2 :]
    assert sliding.mean() == pytest.approx(FRICTION, abs=2.0)
    assert int(found.crack_count) < 10


def test_a_joint_flatter_than_its_friction_angle_holds(rock) -> None:
    with pytest.raises(ModelError, match="no peak") as caught:
        pressed(rock, 10.0, strain_step=1e-6, largest_strain=1.2e-3)
    borne = float(re.findall(r"it bears ([\d.e+]+) Pa", str(caught.value))[0])
    assert borne > 60e6
