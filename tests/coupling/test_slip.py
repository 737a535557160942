"""Joints that slide as pressure rises: their law, what they open, when they begin."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.sparse import csr_array

from demflow.model.analytic.mohr_coulomb import slip_pressure
from demflow.model.coupling.balance import openings
from demflow.model.coupling.setting import setting
from demflow.model.coupling.skeleton import (
    SLID,
    borne,
    forces,
    remembered,
    skeleton_of,
    slide_factors,
)
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.mechanics.static.load_carrying import contacts_of
from demflow.model.region import Rectangle
from demflow.model.scene import (
    Bonds,
    Fluid,
    FractureSet,
    Grains,
    Joint,
    Matrix,
    Scene,
    Stress,
    Trace,
    Well,
)
from demflow.model.scene.coupling import Coupling
from demflow.model.stages import STAGES, run_stages, simulate
from tests.coupling.bored import KN, joint, packed, rock, wet

pytestmark = pytest.mark.usefixtures("packed_once")

STRONG = Bonds(kind="parallel", tensile_strength=1e12, shear_strength=1e12)


@cache
def jointed(dilation: float = 0.2):
    """A loaded rock with a joint across it."""
    grains = rock(STRONG, stress=(10e6, 13e6), joints=(joint(0.9, dilation_angle=dilation),))
    return setting(packed(), None, rock=grains, wet=wet(half_force=5e4), wells=())


def moved(given, size: float, seed: int = 1):
    """A displacement near the loaded one, at which some joint contacts slide."""
    return given.u + size * np.random.default_rng(seed).normal(size=len(given.u))


def test_sliding_contacts_bear_what_friction_holds_and_dilate_at_once():
    given = jointed()
    s, u = given.case.skeleton, moved(given, 2e-4)
    found = borne(s, given.hold, u)
    slips = found.slips & s.joint
    assert slips.sum() > 3
    assert (s.joint & found.closed & ~found.slips).any()
    np.testing.assert_allclose(
        np.abs(found.shear[slips]), (s.friction * found.normal)[slips], rtol=1e-12
    )
    trial = given.hold.shear - s.ks * (found.slide - given.hold.slid)
    np.testing.assert_allclose(
        found.shear[slips], (np.sign(trial) * (np.abs(trial) - s.ks * found.slid))[slips]
    )
    overlap = given.hold.overlap - found.part + s.dilation * found.slid
    np.testing.assert_allclose(found.normal[slips], (s.kn * overlap)[slips], rtol=1e-9)
    later = borne(s, remembered(s, given.hold, found, u), u)  # where it stays, nothing changes
    np.testing.assert_allclose(later.normal, found.normal, atol=1e-15)
    np.testing.assert_allclose(later.shear, found.shear, atol=1e-15)


def test_the_tangent_is_that_of_the_forces():
    given = jointed()
    s, u = given.case.skeleton, moved(given, 2e-4)
    found, way = borne(s, given.hold, u), np.random.default_rng(2).normal(size=len(u))
    h = 1e-9
    ends = [borne(s, given.hold, u + sign * h * way) for sign in (1.0, -1.0)]
    same = np.array_equal(ends[0].slips, ends[1].slips)
    assert same
    numeric = (
        forces(s, given.hold, ends[0], u + h * way) - forces(s, given.hold, ends[1], u - h * way)
    ) / (2.0 * h)
    part, slide = s.parting @ way, s.sliding @ way
    normal = -found.kn * part + found.lifts * slide
    shear = -found.ks * slide + found.cross * part
    exact = s.parting.T @ normal + s.sliding.T @ shear
    exact -= s.bending.T @ (found.km * (s.bending @ way))
    np.testing.assert_allclose(numeric, exact, atol=1e-5 * np.abs(exact).max())


def test_what_slip_lifted_opens_the_joint_pressed_together_or_not():
    given = jointed()
    case, s = given.case, given.case.skeleton
    found = borne(s, given.hold, given.u)
    before, _ = openings(case, given.hold, found)
    slip = np.where(s.joint, 1e-3, 0.0)
    after, _ = openings(case, given.hold._replace(slip=slip), found)
    contact = case.conduits.contact
    across = (contact >= 0) & s.joint[contact]
    assert across.sum() > 5
    lifted = case.gap_factor * case.unit * np.tan(0.2) * 1e-3
    np.testing.assert_allclose((after.wide - before.wide)[across], lifted, rtol=1e-9)
    np.testing.assert_array_equal(after.wide[~across], before.wide[~across])
    assert np.any(found.closed[contact[across]])


def test_grains_that_touch_others_across_joints_alone_take_no_part():
    """Friction would have to hold them along the joint; once they slide they would go anywhere."""
    left = 0
    for seed in range(1, 6):
        lines = (joint(0.9), joint(-0.4), joint(1.5))
        specimen = build_specimen(packed(seed=seed), KN, 2.5, 0.5, STRONG, lines)
        s, _ = skeleton_of(specimen)
        n, plain = len(specimen.grains.x), ~s.joint & (s.b >= 0)
        held = np.bincount(np.append(s.a[plain], s.b[plain]), minlength=n) > 0
        ends = np.append(s.a, s.b[s.b >= 0])
        assert held[ends].all()
        touching = contacts_of(specimen)
        left += np.count_nonzero(~held[np.append(touching.a, touching.b)])
    assert left > 0  # there were some


def test_a_contact_that_slid_or_holds_cement_has_no_onset_before_it():
    given = jointed()
    s = given.case.skeleton
    found = borne(s, given.hold, moved(given, 2e-4))
    factors = slide_factors(s, given.hold, found)
    assert np.all(factors[~s.joint] == 0.0)
    assert np.all(factors[given.hold.mode == SLID] == 0.0)
    np.testing.assert_array_equal(factors > 1.0, s.joint & (given.hold.mode != SLID) & found.slips)


REACH = 0.6 / np.cos(np.pi / 3)
FAULT = Scene(
    region=Rectangle(1.0, 3.0**0.5),
    grains=Grains(count=180, porosity=0.16, modulus=20e9),
    bonds=STRONG,
    stress=Stress(xx=10e6, yy=24e6),
    matrix=Matrix(aperture=4e-4, gap_factor=1.0),
    fluid=Fluid(viscosity=1e-3, bulk_modulus=2e9),
    fractures=(
        Trace(
            name="fault",
            start=(-0.5 * REACH, -(0.75**0.5) * REACH),
            end=(0.5 * REACH, 0.75**0.5 * REACH),
            joint=Joint(
                normal_stiffness=50e9, shear_stiffness=50e9, friction=0.6, dilation_angle=0.17
            ),
        ),
    ),
    wells=(Well(name="w", at=(0.0, 0.0), radius=0.01, rate=-1e-3),),
    initial_pressure=0.0,
    coupling=Coupling(method="breaking"),
    times=tuple(np.arange(0.1, 1.41, 0.1)),
    observe=("well_pressure", "joint_slip", "crack_length", "permeability_in_time"),
)


@cache
def faulted():
    return run_stages(FAULT)


@pytest.mark.slow
def test_a_fault_slides_at_the_pressure_of_mohr_and_coulomb_and_conducts():
    products = faulted()
    found = products["observe"]
    expected = slip_pressure(10e6, 24e6, np.pi / 3, 0.6)
    pressure, slip = found["well_pressure"][0], found["joint_slip"]
    assert "stopped" not in found
    assert pressure.max() == pytest.approx(expected, rel=0.1)
    early = pressure < 0.6 * expected
    assert early.sum() > 3
    # it slides as a whole then: far more a second than before
    assert np.diff(slip)[-1] > 4.0 * np.diff(slip[early]).max()
    assert np.all(np.diff(slip) >= 0.0)
    assert np.all(np.diff(found["slid_joint_share"]) >= 0.0)
    assert np.all(found["largest_joint_slip"] >= slip)
    # events, each where a contact first slides; nothing broke
    events = products["fracture"].events
    assert np.all(events.mode == SLID)
    assert len(np.unique(events.contact)) == len(events.contact) == found["slide_events"]
    assert found["broken_bonds"] == 0.0
    assert np.all(found["crack_length"] == 0.0)
    assert np.all(events.energy == 0.0)
    assert np.all(np.diff(events.time) >= 0.0)
    # books
    assert found["energy_imbalance"] < 1e-9
    assert found["mass_imbalance"] < 1e-9
    assert found["slip_loss"] > 0.0
    # permeability, before and after: along the fault more, by no more than it opened
    before, after = found["permeability_at_start"], found["permeability_in_time"]
    along = np.array([np.cos(np.pi / 3), np.sin(np.pi / 3)])
    grown = [along @ k @ along for k in (before, *after)]
    assert np.all(np.diff(grown) > -1e-6 * grown[0])
    widest = 1.0 + np.tan(0.17) * found["largest_joint_slip"][-1] / 4e-4  # of any aperture
    assert 1.1 < grown[-1] / grown[0] < widest**3
    np.testing.assert_allclose(after, np.swapaxes(after, 1, 2), rtol=1e-9)


@pytest.mark.slow
def test_slip_goes_on_from_leg_to_leg():
    (stage,) = [one for one in STAGES if one.name == "fracture"]
    scene = dataclasses.replace(FAULT, times=tuple(np.arange(0.05, 0.66, 0.05)))
    assert len(stage.legs_of(scene)) == 2
    one = run_stages(scene)["fracture"]
    assert len(one.records.time) == len(scene.times)
    assert np.all(np.diff(one.records.slip[:, 0]) >= 0.0)  # goes on from what it was


@pytest.mark.slow
def test_without_shear_stress_nothing_slides_as_a_whole():
    scene = dataclasses.replace(FAULT, stress=Stress(xx=12e6, yy=12e6), times=(0.5, 1.0, 1.4))
    slid, still = faulted()["observe"], simulate(scene)
    assert still["joint_slip"][-1] < 0.1 * slid["joint_slip"][-1]


def test_a_joint_that_dilates_stays_closed_as_far_as_its_slip_lifts_it():
    given = jointed()
    s, hold = given.case.skeleton, given.hold
    found = borne(s, hold, given.u)
    pressed = s.joint & found.closed & (found.shear != 0.0)
    assert pressed.sum() > 5
    hold = remembered(s, hold, found, given.u)
    # walls part by half of what a slip lifts them by: they still press; by twice that: no more
    size = 10.0 * float(found.force.max()) / float(s.ks[pressed].min())
    for share, closed in ((0.5, True), (2.0, False)):
        part = found.part + hold.overlap - found.part + share * s.dilation * size
        apart = borne_at(s, hold, part, found.slide - np.sign(found.shear) * size)
        np.testing.assert_array_equal(apart.closed[pressed], closed)
        if closed:
            bears = apart.normal[pressed]
            lifted = (s.kn * (hold.overlap - part + s.dilation * apart.slid))[pressed]
            assert np.all(bears > 0.0)
            np.testing.assert_allclose(bears, lifted)
            np.testing.assert_allclose(np.abs(apart.shear)[pressed], s.friction[pressed] * bears)


def borne_at(s, hold, part, slide):
    """What contacts bear where they part and slide by given lengths, each by itself."""
    c = len(part)
    zero = csr_array((c, 2 * c))
    by_part = csr_array((np.ones(c), (np.arange(c), np.arange(c))), (c, 2 * c))
    by_slide = csr_array((np.ones(c), (np.arange(c), c + np.arange(c))), (c, 2 * c))
    alone = s._replace(parting=by_part, sliding=by_slide, bending=zero)
    return borne(alone, hold, np.append(part, slide))


@pytest.mark.slow
def test_a_rock_with_a_set_of_joints_finds_how_it_bears_its_stresses():
    scene = dataclasses.replace(
        FAULT,
        region=Rectangle(20.0, 20.0),
        grains=Grains(count=700, porosity=0.16, modulus=20e9),
        stress=Stress(xx=10e6, yy=20e6),
        fractures=(
            FractureSet(
                name="joints",
                angle=np.pi / 3,
                length=8.0,
                spacing=7.0,
                gap=8.0,
                joint=Joint(
                    normal_stiffness=5e11, shear_stiffness=5e11, friction=0.6, dilation_angle=0.17
                ),
            ),
        ),
        times=(1.0,),
    )
    (stage,) = [one for one in STAGES if one.name == "fracture"]
    packing = next(one for one in STAGES if one.name == "pack")
    told = stage.given(scene, 0)
    grains = packing.run(**packing.given(scene, 0))
    given = setting(grains, None, rock=told["rock"], wet=told["wet"], wells=told["wells"])
    s, u = given.case.skeleton, given.u
    found = borne(s, given.hold, u)
    off = given.case.load + forces(s, given.hold, found, u)
    assert np.abs(off).max() < 1e-3 * np.mean(np.abs(found.force))
    assert (given.hold.mode[s.joint] == SLID).sum() > 10  # they had to slide to find it
    holds = (s.friction * found.normal)[s.joint]
    assert np.all(np.abs(found.shear[s.joint]) <= holds * (1.0 + 1e-9))
