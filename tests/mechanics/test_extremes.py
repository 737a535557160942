"""Hard cases of mechanics: each ends in equilibrium or in words, never in NaN or for ever."""

import numpy as np
import pytest

from demflow.model.mechanics.contact.grains import at_rest, scaled_mass
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.loading.strength import strength
from demflow.model.mechanics.loading.stress import build_specimen, load, unit_loads
from demflow.model.mechanics.motion.equilibrium import (
    AT_REST,
    FIRE,
    NEVER,
    OSCILLATES,
    OUT_OF_STEPS,
    TIME_STEP,
    Specimen,
    Stop,
)
from demflow.model.mechanics.motion.servo import STANDING, Servo
from demflow.model.mechanics.packing.compaction import hydrostatic
from demflow.model.mechanics.specimen.measures import listed, overlaps
from demflow.model.outcome import ModelError
from demflow.model.parameters import SceneError
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, FailureTest, Grains, Joint, JointLine, Scene, Stress
from demflow.model.stages import simulate
from demflow.sweep.study.expect import Expectation, beyond_bounds
from tests.mechanics.rocks import packed

pytestmark = pytest.mark.slow

KN = 40e9
SLIDING = Joint(normal_stiffness=KN, shear_stiffness=KN, friction=0.3)


def bonds(size: float, kind: str = "parallel", **more) -> Bonds:
    return Bonds(kind=kind, tensile_strength=size, shear_strength=size, **more)


def loaded(rock, xx: float, yy: float, *, friction=0.5, cement=None, method="auto", joints=()):
    return load(
        rock,
        normal_stiffness=KN,
        stiffness_ratio=2.5,
        friction=friction,
        bonds=cement,
        joints=joints,
        stress=Stress(xx=xx, yy=yy, method=method),
    )


def to_failure(rock, cement, *, friction=0.5, **test):
    return strength(
        rock,
        normal_stiffness=KN,
        stiffness_ratio=2.5,
        friction=friction,
        bonds=cement,
        test=FailureTest(**{"strain_step": 4e-6, **test}),
    )


@pytest.fixture(scope="module")
def rock():
    return packed(0.165, count=150)


def test_ten_to_one_is_borne_by_strong_bonds_alone(rock) -> None:
    with pytest.raises(ModelError, match=r"ratio 2\.\d+:1.*beyond its strength; try"):
        loaded(rock, 50e6, 5e6)
    state = loaded(rock, 50e6, 5e6, cement=bonds(1e9))
    np.testing.assert_allclose(state.wall_stress, np.array([50, 50, 5, 5]) * 1e6, rtol=5e-3)
    assert float(state.unbalanced_ratio) <= 1e-3


@pytest.mark.parametrize("cement", [None, bonds(1e9)])
def test_sizes_of_one_to_ten(cement) -> None:
    state = loaded(packed(0.165, count=150, ratio=10.0), 15e6, 10e6, cement=cement)
    np.testing.assert_allclose(state.wall_stress, np.array([15, 15, 10, 10]) * 1e6, rtol=5e-3)
    assert float(state.unbalanced_ratio) <= 1e-3


def test_grains_without_friction_bear_no_more_than_their_confinement(rock) -> None:
    found = to_failure(rock, None, friction=0.0, confining_stress=10e6)
    assert 1.2 * 10e6 < float(found.peak_strength) < 1.8 * 10e6  # fewer than 20 grains across


@pytest.mark.parametrize(("n", "spread"), [(2, 0.0), (60, 1e-9), (60, 2.0)])
def test_grains_on_top_of_each_other_part(n: int, spread: float) -> None:
    """Deep overlap, to the very same place: no force is NaN, and all come to rest."""
    rng = np.random.default_rng(2)
    x, y = spread * rng.uniform(-1.0, 1.0, (2, n))
    radius = rng.uniform(0.6, 1.4, n)
    grains = at_rest(x, y, radius, scaled_mass(radius, 1.0, TIME_STEP))
    box = 12.0 * np.array([-1.0, 1.0, -1.0, 1.0])
    specimen = Specimen(grains, box, Linear(1.0, 0.4, 0.0))
    stop = Stop(ratio=0.1, stress=np.inf, force=1e-5)
    assert specimen.relax(STANDING, stop, damping=FIRE, steps=20_000) == AT_REST
    a, b = listed(specimen.pairs)
    assert overlaps(grains.x, grains.y, radius, a, b).max() < 0.1
    assert np.abs(grains.x).max() < 12.0
    assert np.abs(grains.y).max() < 12.0


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("kind", ["biaxial", "tension"])
def test_few_grains_are_tested_within_more_of_them(count: int, kind: str) -> None:
    found = to_failure(packed(0.18, count=count), bonds(50e6), kind=kind, confining_stress=5e6)
    # over the strength of its bonds: in compression some 3.6 times what it is in tension
    low, high = (1.4, 2.0) if kind == "biaxial" else (0.4, 0.55)
    assert low * 50e6 < float(found.peak_strength) < high * 50e6
    assert all(np.isfinite(field).all() for field in found)


def few(n: int) -> Specimen:
    """One to three grains in a box that is a little too wide for them."""
    x = np.array([[0.0], [-1.0, 1.0], [-1.0, 1.0, 0.0]][n - 1])
    y = np.array([[0.0], [0.0, 0.0], [-0.8, -0.8, 0.9]][n - 1])
    radius = np.array([1.0, 0.9, 1.1])[:n]
    grains = at_rest(x, y, radius, scaled_mass(radius, 1.0, TIME_STEP))
    return Specimen(grains, 2.1 * np.array([-1.0, 1.0, -1.0, 1.0]), Linear(1.0, 0.4, 0.5))


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("damping", [0.5, FIRE])
def test_one_to_three_grains_come_to_rest_between_walls(n: int, damping: float) -> None:
    for ratio in (1.0, 1.2):
        specimen = few(n)
        servo = hydrostatic(2e-4)._replace(target_xx=ratio * 2e-4)
        stop = Stop(ratio=1e-3, stress=1e-3)
        assert specimen.relax(servo, stop, damping=damping, steps=10_000) == AT_REST
        assert all(np.isfinite(part).all() for part in (*specimen.grains, specimen.box))
        width, height = specimen.box[[1, 3]] - specimen.box[[0, 2]]
        sums = specimen.sums
        walls = [sums.left / height, sums.right / height, sums.bottom / width, sums.top / width]
        wanted = 2e-4 * np.array([ratio, ratio, 1.0, 1.0])
        np.testing.assert_allclose(walls, wanted, rtol=1e-3)


@pytest.mark.parametrize("kind", ["contact", "parallel"])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_one_to_three_bonded_grains_are_loaded_or_refused_in_words(n: int, kind: str) -> None:
    """One grain a wall does not keep it from tilting, which the static solver needs."""
    specimen = few(n)
    rest = Stop(ratio=1e-3, stress=5e-3)
    assert specimen.relax(hydrostatic(2e-4), rest, damping=FIRE, steps=10_000) == AT_REST
    grains = specimen.grains
    a, b = listed(specimen.pairs)
    overlap = overlaps(grains.x, grains.y, grains.radius, a, b)
    touch = overlap > 0.0
    few_packed = packed(count=150)._replace(
        x=grains.x, y=grains.y, radius=grains.radius, box=specimen.box,
        contact_a=a[touch], contact_b=b[touch], normal_force=overlap[touch],
        shear_force=specimen.pairs.shear[touch], packing_pressure=np.array(2e-4),
    )  # fmt: skip
    cement = bonds(1e9, kind)
    law = {"stiffness_ratio": 2.5, "friction": 0.5}
    with pytest.raises(ModelError, match=r"tilt without resistance.*raise grains\.count"):
        unit_loads(few_packed, bonds=cement.elastic(KN), **law)
    stress = Stress(xx=12e6, yy=10e6)
    state = load(few_packed, normal_stiffness=KN, bonds=cement, stress=stress, **law)
    np.testing.assert_allclose(state.wall_stress, np.array([12, 12, 10, 10]) * 1e6, rtol=1e-3)
    assert float(state.unbalanced_ratio) <= 1e-3
    with pytest.raises(ModelError, match=r"fewer than three grains|came to no peak"):
        to_failure(few_packed._replace(packing_pressure=np.array(0.0)), cement)


@pytest.mark.parametrize("field", ["vx", "spin", "load_y", "x"])
def test_grains_that_run_away_are_told_at_once(rock, field: str) -> None:
    specimen = build_specimen(rock, KN, 2.5, 0.5, None)
    grain = rock.contact_a[len(rock.contact_a) // 2]
    getattr(specimen.grains, field)[grain] = np.nan
    for damping in (0.5, FIRE):
        with pytest.raises(ModelError, match=r"ran away.*try"):
            specimen.relax(hydrostatic(2e-4), NEVER, damping=damping, steps=1000)
    assert specimen.steps <= 2


def test_a_specimen_pulled_too_far_comes_apart_at_a_load(rock) -> None:
    found = to_failure(rock, bonds(50e6), kind="tension")
    peak = float(found.peak_strength)
    assert 0.35 * 50e6 < peak < 0.5 * 50e6
    assert found.axial_stress[-1] <= 0.7 * peak
    assert int(found.crack_count) > 10
    with pytest.raises(SceneError, match="not above 0"):
        Stress(xx=-1e6, yy=1e6)


@pytest.fixture(scope="module")
def loose(rock):
    """The rock without bonds, tested to failure."""
    return to_failure(rock, None, confining_stress=10e6)


@pytest.mark.parametrize("kind", ["contact", "parallel"])
def test_bonds_of_no_strength_leave_grains_as_they_are(rock, loose, kind: str) -> None:
    state = loaded(rock, 12e6, 10e6, cement=bonds(0.0, kind))
    assert int(state.broken_bonds) == len(rock.contact_a)
    assert not state.bonded.any()
    np.testing.assert_allclose(state.wall_stress, np.array([12, 12, 10, 10]) * 1e6, rtol=5e-3)
    found = to_failure(rock, bonds(0.0, kind), confining_stress=10e6)
    assert float(found.peak_strength) == pytest.approx(float(loose.peak_strength), rel=0.15)
    with pytest.raises(ModelError, match="comes apart at once, before it bears any tension; try"):
        to_failure(rock, bonds(0.0, kind), kind="tension", largest_strain=1e-3)


def test_a_servo_that_overshoots_for_ever_is_told(rock) -> None:
    """A stretch that corrects more than twice the error turns it round, and grows it."""
    calm = Servo(3e-4, 3e-4, 3e-4, 3e-4)
    stop = Stop(ratio=1e-3, stress=1e-3)
    for gain, end in ((0.05, AT_REST), (1.0, AT_REST), (4.0, OSCILLATES)):
        specimen = build_specimen(rock, KN, 2.5, 0.5, None)
        servo = calm._replace(gain=gain, limit=1e-3)
        assert specimen.relax(servo, stop, damping=0.5, steps=50_000) == end
        assert specimen.steps < 1000
    driven = build_specimen(rock, KN, 2.5, 0.5, None)  # in y; the servo of x is watched on
    servo = calm._replace(gain=4.0, limit=1e-3, drive_y=-1e-9)
    ends = [driven.relax(servo, NEVER, damping=0.5, steps=5) for _ in range(200)]
    assert ends.index(OSCILLATES) > 1
    assert set(ends[ends.index(OSCILLATES) :]) == {OSCILLATES}
    held = servo._replace(gain=0.05)
    assert driven.relax(held, NEVER, damping=0.5, steps=1000) == OUT_OF_STEPS
    stiff = bonds(1e15, modulus=200 * KN)
    with pytest.raises(
        ModelError, match=r"servo oscillates .* without decay.*try a bonds\.modulus"
    ):
        loaded(rock, 12e6, 10e6, cement=stiff, method="explicit")
    with pytest.raises(ModelError, match=r"servo .* oscillates.*try a bonds\.modulus"):
        to_failure(rock, stiff, confining_stress=10e6)


@pytest.mark.parametrize(
    "line", [((9.0, 9.0), (12.0, 9.0)), ((0.0, 0.0), (1e-4, 0.0))], ids=["outside", "in one grain"]
)
def test_a_joint_that_meets_no_contact_changes_nothing_and_is_counted(rock, line) -> None:
    plain = loaded(rock, 12e6, 10e6)
    idle = loaded(rock, 12e6, 10e6, joints=(JointLine(*line, SLIDING),))
    assert int(idle.idle_joints) == 1
    np.testing.assert_array_equal(idle.normal_force, plain.normal_force)


def test_a_stress_that_presses_grains_flat_is_borne(rock) -> None:
    state = loaded(rock, 1e9, 1e9)
    np.testing.assert_allclose(state.wall_stress, 1e9, rtol=5e-3)
    assert np.isfinite(state.normal_force).all()


@pytest.mark.parametrize("cement", [None, bonds(1e9)], ids=["loose", "bonded"])
@pytest.mark.parametrize(
    ("modulus", "ends"), [(2e10, "good"), (4e7, "not good"), (5e6, r"overlap by 0\.[56]")]
)
def test_grains_that_pass_through_one_another_are_told(modulus, ends, cement):
    """At 5 MPa: a few thousandths of a radius, a third of one, more than a whole one.

    The last is told on the way to it, as soon as grains overlap by half a radius.
    """
    if cement is not None and ends.startswith("overlap"):
        cement = bonds(1e9, "contact")  # which need half of the steps
    scene = Scene(
        region=Rectangle(1.0, 1.0),
        grains=Grains(count=30, porosity=0.17, modulus=modulus, stiffness_ratio=2.5),
        bonds=cement,
        stress=Stress(5e6, 5e6),
        observe=("force_chains",),
    )
    if ends.startswith("overlap"):
        with pytest.raises(ModelError, match=ends):
            simulate(scene)
        return
    overlap = float(simulate(scene)["loaded_overlap"])
    assert bool(beyond_bounds(Expectation(), {"loaded_overlap": overlap})) == (ends == "not good")
    # the mean contact of a packing bears about 2 r times the stress, the most loaded ten times that
    assert 5e6 / modulus < overlap < 50e6 / modulus
