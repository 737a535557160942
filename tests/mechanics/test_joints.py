"""Smooth joints: they slip when Mohr–Coulomb says, along their plane, whatever the grains."""

import numpy as np
import pytest

from demflow.model.mechanics.contact.bonds import BROKEN_IN_SHEAR, BROKEN_IN_TENSION, INTACT
from demflow.model.mechanics.contact.grains import Grains, at_rest, scaled_mass
from demflow.model.mechanics.contact.joints import APART, LOOSE, Trace
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.loading.stress import load
from demflow.model.mechanics.motion.equilibrium import NEVER, Specimen
from demflow.model.mechanics.motion.servo import STANDING
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.scene import Bonds, Joint, JointLine, Stress
from tests.mechanics.rocks import net_forces, packed

pytestmark = pytest.mark.slow

KN = 40e9
FAR = 150.0 * np.array([-1.0, 1.0, -1.0, 1.0])
STRONG = Bonds(kind="parallel", tensile_strength=1e15, shear_strength=1e15)
PLANE = Joint(normal_stiffness=KN, shear_stiffness=KN, friction=np.tan(np.radians(30.0)))


def height(grains: Grains, angle: float) -> np.ndarray:
    """Height of the centres over a line through the origin."""
    return np.cos(angle) * grains.y - np.sin(angle) * grains.x


def tilted(angle: float, lean: float, joint: Joint) -> tuple[float, Specimen]:
    """A block of rock on a fixed one, with a joint between them at an angle, and a load on each
    grain of the block that leans by `lean` from the joint's normal.

    Returns the mean slip of the joint in the last 1,000 of 3,500 steps.
    """
    reach = 3.0 * np.array([np.cos(angle), np.sin(angle)])
    line = JointLine((-reach[0], -reach[1]), (reach[0], reach[1]), joint)
    specimen = build_specimen(packed(0.165, count=150), KN, 2.5, 0.5, STRONG, (line,))
    specimen.box[:] = FAR
    grains = specimen.grains
    upper = height(grains, angle) > 0.0
    grains.inverse_mass[~upper] = 0.0
    size = 0.1 / np.count_nonzero(upper)
    grains.load_x[upper] = size * np.sin(angle - lean)
    grains.load_y[upper] = -size * np.cos(angle - lean)
    specimen.relax(STANDING, NEVER, damping=0.5, steps=2500)
    before = specimen.joints.slipped.copy()
    specimen.relax(STANDING, NEVER, damping=0.5, steps=1000)
    return float(np.mean(specimen.joints.slipped[: len(before)] - before)), specimen


@pytest.mark.parametrize("angle", np.radians([0.0, 15.0, 37.0, 45.0, 70.0, 90.0]))
def test_a_block_slides_when_the_load_leans_by_the_friction_angle(angle: float) -> None:
    friction, half = np.radians(30.0), np.radians(0.5)
    creep, held = tilted(angle, friction - half, PLANE)
    way, slid = tilted(angle, friction + half, PLANE)
    assert np.count_nonzero(slid.joints.state == LOOSE) > 10
    assert mobilised(held) == pytest.approx(friction - half, abs=np.radians(0.05))
    assert mobilised(slid) == pytest.approx(friction, abs=half)
    assert way > 0.015
    assert creep < 0.1 * way
    # along the plane: it rides over no grain
    upper = slid.grains.inverse_mass > 0.0
    dx = np.median((slid.grains.x - held.grains.x)[upper])
    dy = np.median((slid.grains.y - held.grains.y)[upper])
    rise = np.cos(angle) * dy - np.sin(angle) * dx
    assert abs(rise) < 0.03 * np.hypot(dx, dy)


def mobilised(specimen: Specimen) -> float:
    """Angle between the force through the joint and its normal."""
    joints = specimen.joints
    return float(np.arctan2(abs(joints.shear.sum()), joints.normal.sum()))


def pair(branch: float, plane: float, **joint) -> Specimen:
    """Two discs whose line of centres lies at an angle to the joint between them."""
    properties = {
        "normal_stiffness": 0.3, "shear_stiffness": 0.2, "friction": 0.6,
        "tensile_strength": 0.0, "cohesion": 0.0, "dilation": 0.0,
    } | joint  # fmt: skip
    reach = 50.0 * np.array([np.cos(plane), np.sin(plane)])
    trace = Trace((-reach[0], -reach[1]), (reach[0], reach[1]), **properties)
    x, y = np.array([-0.99, 0.99]) * np.cos(branch), np.array([-0.99, 0.99]) * np.sin(branch)
    grains = at_rest(x, y, np.ones(2), np.full(2, np.inf))
    return Specimen(grains, FAR.copy(), Linear(1.0, 0.4, 0.5), dt=1.0, traces=[trace])


def drive(specimen: Specimen, normal: float, along: float, plane: float, steps: int) -> None:
    """Move the second disc by steps across and along the joint."""
    joints = specimen.joints
    nx, ny = joints.nx[0], joints.ny[0]
    specimen.grains.vx[1] = normal * nx - along * ny
    specimen.grains.vy[1] = normal * ny + along * nx
    specimen.relax(STANDING, NEVER, damping=0.0, steps=steps)
    specimen.stand_still()


@pytest.mark.parametrize("branch", [0.3, 0.9, 1.4])
def test_the_law_follows_the_plane_not_the_grains(branch: float) -> None:
    plane = -0.4
    specimen = pair(branch, plane, dilation=0.1)
    joints = specimen.joints
    start = 0.02 * np.sin(branch - plane)
    assert joints.normal[0] == pytest.approx(start)  # the contact's force, along the normal
    # b is pushed along its branch, and the joint's tangent points the other way along the plane
    assert joints.shear[0] == pytest.approx(
        np.clip(-0.02 * np.cos(branch - plane), -0.6 * start, 0.6 * start)
    )
    drive(specimen, -1e-3, 0.0, plane, 100)
    pressed = start + 0.3 * 2.0 * 0.1  # stiffness per area on a width of one diameter
    assert joints.normal[0] == pytest.approx(pressed, rel=1e-9)
    before, slipped = joints.shear[0], joints.slipped[0]
    drive(specimen, 0.0, 1e-4, plane, 100)
    assert joints.shear[0] == pytest.approx(before - 0.4 * 0.01)
    drive(specimen, 0.0, 1e-3, plane, 200)
    assert joints.shear[0] < 0.0
    slid = joints.slipped[0] - slipped
    assert joints.normal[0] == pytest.approx(pressed + 0.6 * 0.1 * slid)  # dilation closes it
    assert joints.shear[0] == pytest.approx(-0.6 * joints.normal[0], rel=1e-3)
    grains = specimen.grains
    force = np.array([grains.fx[1], grains.fy[1]])
    assert force @ [joints.nx[0], joints.ny[0]] == pytest.approx(joints.normal[0])
    assert grains.fx[0] == -grains.fx[1]
    moment = grains.torque.sum() + (grains.x * grains.fy - grains.y * grains.fx).sum()
    assert moment == pytest.approx(0.0, abs=1e-15)


def test_cement_of_a_joint_breaks_at_its_strengths() -> None:
    for way, mode in ((-1.0, BROKEN_IN_TENSION), (1.0, BROKEN_IN_SHEAR)):
        specimen = pair(np.pi / 2, 0.0, tensile_strength=0.01, cohesion=0.03)
        joints = specimen.joints
        drive(specimen, -0.02 if way > 0 else 0.0, 0.0, 0.0, 1)
        compression = joints.normal[0]
        held = 0
        while joints.state[0] == INTACT:
            if way > 0:
                drive(specimen, 0.0, 1e-4, 0.0, 1)
            else:
                drive(specimen, 1e-4, 0.0, 0.0, 1)
            held += 1
            assert held < 10_000
        assert joints.state[0] == mode
        if way > 0:  # (c + μ σ) A
            slide = (0.03 * 2.0 + 0.6 * compression) / 0.4
            assert held * 1e-4 == pytest.approx(slide, abs=2e-4)
            assert joints.shear[0] == pytest.approx(-0.6 * joints.normal[0])
        else:
            assert held * 1e-4 == pytest.approx(compression / 0.6 + 0.02 / 0.6, abs=2e-4)
            assert joints.normal[0] == joints.shear[0] == 0.0
        assert joints.cracks.step[0] > 0


def test_grains_slide_past_and_meet_others_without_a_kick() -> None:
    """A row of discs is led over another along a joint: overlap as such gives no force."""
    n = 12
    x = np.r_[2.0 * np.arange(n), 2.0 * np.arange(n) + 0.7] - n
    y = np.r_[np.full(n, -0.9), np.full(n, 0.9)]
    grains = at_rest(x, y, np.ones(2 * n), np.full(2 * n, np.inf))
    trace = Trace((-99.0, 0.0), (99.0, 0.0), 1.0, 1.0, 0.5, 0.0, 0.0, 0.0)
    specimen = Specimen(grains, FAR.copy(), Linear(1.0, 0.4, 0.5), dt=1.0, traces=[trace])
    most = specimen.joints.normal.max()
    known = len(specimen.joints.a)
    grains.vx[n:] = 0.01
    specimen.relax(STANDING, NEVER, damping=0.0, steps=500)
    joints = specimen.joints
    assert specimen.rebuilds > 0
    assert len(joints.a) > known
    assert joints.normal.max() <= most + 1e-12
    assert np.any(joints.state == APART)
    np.testing.assert_allclose(grains.fy[n:].sum(), joints.normal.sum())


def test_a_joint_weakens_the_rock_where_it_says() -> None:
    """Loaded rock with a joint: in equilibrium, its forces along the joint within friction."""
    rock = packed()
    joint = Joint(normal_stiffness=10 * KN, shear_stiffness=10 * KN, friction=0.2)
    line = JointLine((-0.6, -0.3), (0.6, 0.3), joint)
    state = load(
        rock, normal_stiffness=KN, stiffness_ratio=2.5, friction=0.5, bonds=STRONG,
        joints=(line,), stress=Stress(xx=10e6, yy=20e6),
    )  # fmt: skip
    on = ~np.isnan(state.joint_gap)
    assert np.count_nonzero(on) > 4
    assert int(state.idle_joints) == 0
    a, b = state.contact_a[on], state.contact_b[on]
    branch = np.column_stack((state.x[b] - state.x[a], state.y[b] - state.y[a]))
    unit = branch / np.hypot(*branch.T)[:, None]
    force = state.normal_force[on, None] * unit
    force += state.shear_force[on, None] * np.column_stack((-unit[:, 1], unit[:, 0]))
    along = np.array([2.0, 1.0]) / np.sqrt(5.0)
    across = np.array([-along[1], along[0]])
    pressed = np.abs(force @ across)
    assert np.all(np.abs(force @ along) <= 0.2 * pressed + 1e-6 * pressed.max())
    net, _ = net_forces(state, rock.radius, KN)
    mean = np.hypot(state.normal_force, state.shear_force).mean()
    assert np.hypot(*net.T).mean() < 1.2e-3 * mean


@pytest.mark.parametrize(
    "line", [((0.0, 0.0), (1e-6, 1e-6)), ((50.0, 50.0), (60.0, 50.0))], ids=["tiny", "outside"]
)
def test_a_trace_that_crosses_no_contact_is_counted(line) -> None:
    plain = build_specimen(packed(), KN, 2.5, 0.5, STRONG)
    idle = build_specimen(packed(), KN, 2.5, 0.5, STRONG, (JointLine(*line, PLANE),))
    assert idle.idle_traces == 1
    assert len(idle.joints.a) == 0
    np.testing.assert_array_equal(plain.pairs.bond, idle.pairs.bond)


def test_where_traces_cross_the_first_has_the_contact() -> None:
    radius = np.ones(2)
    grains = at_rest(np.array([-0.99, 0.99]), np.zeros(2), radius, scaled_mass(radius, 1.0, 0.5))
    one = Trace((0.0, -3.0), (0.0, 3.0), 1.0, 1.0, 0.1, 0.0, 0.0, 0.0)
    two = Trace((-1.0, -3.0), (1.0, 3.0), 1.0, 1.0, 0.9, 0.0, 0.0, 0.0)
    specimen = Specimen(grains, FAR.copy(), Linear(1.0, 0.4, 0.5), traces=[one, two])
    assert specimen.joints.friction.tolist() == [0.1]
    assert specimen.idle_traces == 1
