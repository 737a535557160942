"""Parts of a loaded specimen: balanced cuts, boreholes, pressure on a rim."""

import numpy as np
import pytest

from demflow.model.mechanics.contact.joints import APART
from demflow.model.mechanics.contact.neighbours import JOINED
from demflow.model.mechanics.loading.stress import straight_path
from demflow.model.mechanics.motion.equilibrium import AT_REST, Specimen, Stop
from demflow.model.mechanics.motion.servo import STANDING
from demflow.model.mechanics.specimen.cut import cut, excavate, press_on
from demflow.model.mechanics.specimen.measures import listed, overlaps
from demflow.model.mechanics.specimen.rock import build_specimen
from demflow.model.region import Circle, Polygon, Rectangle, contains
from demflow.model.scene import Bonds, Joint, JointLine
from tests.mechanics.rocks import packed

BONDS = Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9)
KN = 40e9
PLANE = Joint(normal_stiffness=KN, shear_stiffness=KN, friction=0.6)
CEMENT = Joint(normal_stiffness=KN, shear_stiffness=KN, friction=0.6, cohesion=1e9,
               tensile_strength=1e9)  # fmt: skip
REGIONS = (Circle(8.0), Polygon(((-9.0, -6.0), (8.0, -7.0), (6.0, 9.0), (-5.0, 5.0))))


def pressed(bonds: Bonds | None, *joints: JointLine) -> Specimen:
    specimen = build_specimen(packed(), KN, 2.5, 0.5, bonds, joints)
    path = straight_path(2e-4, 3.5e-4, 2.5e-4)
    reason = specimen.relax(path, Stop(ratio=1e-4, stress=1e-3), damping=0.5, steps=100_000)
    assert reason == AT_REST
    return specimen


def contact_state(specimen: Specimen) -> np.ndarray:
    grains = specimen.grains
    a, b = listed(specimen.pairs)
    overlap = np.maximum(overlaps(grains.x, grains.y, grains.radius, a, b), 0.0)
    return np.column_stack([overlap, specimen.pairs.shear])[overlap > 0.0]


@pytest.mark.slow
@pytest.mark.parametrize("region", REGIONS)
@pytest.mark.parametrize("bonds", [None, BONDS])
def test_a_cut_is_as_balanced_as_the_whole(region, bonds) -> None:
    whole = pressed(bonds)
    part = cut(whole, region)
    grains = whole.grains
    inside = np.isin(grains.x, part.grains.x)
    assert 20 < len(part.grains.x) == inside.sum() < len(grains.x)
    np.testing.assert_allclose(part.grains.fx, grains.fx[inside], rtol=0, atol=1e-17)
    np.testing.assert_allclose(part.grains.fy, grains.fy[inside], rtol=0, atol=1e-17)
    np.testing.assert_allclose(part.grains.torque, grains.torque[inside], rtol=0, atol=1e-17)
    before = contact_state(part)
    stop = Stop(ratio=1e-4, stress=np.inf)
    assert part.relax(STANDING, stop, damping=0.5, steps=2000) == AT_REST
    after = contact_state(part)
    assert len(before) == len(after)
    assert np.linalg.norm(after - before) < 1e-3 * np.linalg.norm(before)


def jointed(joint: Joint) -> Specimen:
    """A bonded rock at rest with a joint across all of it, at 30 degrees."""
    return pressed(BONDS, JointLine((-1.6, -0.9), (1.7, 1.0), joint))


def joint_contacts(specimen: Specimen) -> dict[tuple[float, ...], tuple[float, ...]]:
    """Forces, gap and slip by the places of the two grains, whatever their numbers."""
    grains, joints = specimen.grains, specimen.joints
    places = np.column_stack(
        [grains.x[joints.a], grains.y[joints.a], grains.x[joints.b], grains.y[joints.b]]
    )
    held = np.column_stack([joints.normal, joints.shear, joints.gap, joints.slipped, joints.state])
    acts = joints.state != APART
    return dict(zip(map(tuple, places[acts]), map(tuple, held[acts]), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("joint", [PLANE, CEMENT])
@pytest.mark.parametrize("region", REGIONS)
def test_a_cut_keeps_its_joints_and_its_balance(region, joint) -> None:
    whole = jointed(joint)
    part = cut(whole, region)
    grains = whole.grains
    inside = np.isin(grains.x, part.grains.x)
    every, kept = joint_contacts(whole), joint_contacts(part)
    places = set(zip(part.grains.x, part.grains.y, strict=True))
    assert kept == {pair: held for pair, held in every.items() if {pair[:2], pair[2:]} <= places}
    assert 4 < len(kept) < len(every)
    for force in ("fx", "fy", "torque"):
        np.testing.assert_allclose(
            getattr(part.grains, force), getattr(grains, force)[inside], rtol=0, atol=1e-17
        )
    before = np.concatenate([part.joints.normal, part.joints.shear])
    stop = Stop(ratio=1e-4, stress=np.inf)
    assert part.relax(STANDING, stop, damping=0.5, steps=3000) == AT_REST
    after = np.concatenate([part.joints.normal, part.joints.shear])
    assert np.linalg.norm(after - before) < 1e-3 * np.linalg.norm(before)


@pytest.mark.slow
@pytest.mark.parametrize("joint", [PLANE, CEMENT])
def test_an_excavation_leaves_the_joints_outside_it(joint) -> None:
    whole = jointed(joint)
    opened = excavate(whole, Circle(4.0))
    every, kept = joint_contacts(whole), joint_contacts(opened)
    places = set(zip(opened.grains.x, opened.grains.y, strict=True))
    assert kept == {pair: held for pair, held in every.items() if {pair[:2], pair[2:]} <= places}
    assert 10 < len(kept) < len(every)
    opened.relax(STANDING, Stop(ratio=0.0, stress=-1.0), damping=0.5, steps=0)
    stay = np.isin(whole.grains.x, opened.grains.x)
    far = np.hypot(opened.grains.x, opened.grains.y) > 4.0 + 3.0 * opened.grains.radius.max()
    for force in ("fx", "fy", "torque"):
        as_before = getattr(whole.grains, force)[stay][far]
        np.testing.assert_allclose(getattr(opened.grains, force)[far], as_before, atol=1e-17)
    held = straight_path(2e-4, 3.5e-4, 2.5e-4)._replace(start_xx=3.5e-4, start_yy=2.5e-4)
    stop = Stop(ratio=1e-3, stress=5e-3)
    assert opened.relax(held, stop, damping=0.5, steps=60_000) == AT_REST
    a, b = listed(opened.pairs)
    across, joints, n = opened.pairs.bond == JOINED, opened.joints, len(opened.grains.x)
    assert set(a[across] * n + b[across]) <= set(joints.a * n + joints.b)


@pytest.mark.slow
def test_a_borehole_is_found_anew_in_equilibrium_and_can_be_held_open() -> None:
    whole = pressed(BONDS)
    hole = Circle(4.0)
    gone = contains(hole, np.column_stack([whole.grains.x, whole.grains.y]))
    rim = press_on(whole, gone, 3e-4)[~gone]
    opened = excavate(whole, hole)
    assert len(opened.grains.x) == len(rim) < len(whole.grains.x)
    held = straight_path(2e-4, 3.5e-4, 2.5e-4)._replace(start_xx=3.5e-4, start_yy=2.5e-4)
    stop = Stop(ratio=1e-3, stress=5e-3)
    assert opened.relax(held, stop, damping=0.5, steps=60_000) == AT_REST
    ring = np.hypot(opened.grains.x, opened.grains.y)
    near = ring < 8.0
    closed = ring[near].mean()
    opened.grains.load_x[:], opened.grains.load_y[:] = rim.T
    assert opened.relax(held, stop, damping=0.5, steps=60_000) == AT_REST
    assert np.hypot(opened.grains.x, opened.grains.y)[near].mean() > closed
    with pytest.raises(ValueError, match="no grain"):
        excavate(whole, Circle(0.01))


HORSESHOE = Polygon(((-4.0, -4.0), (4.0, -4.0), (4.0, 1.0), (0.0, 5.0), (-1.0, 0.0), (-4.0, 1.0)))


@pytest.mark.parametrize("hole", [Circle(4.0), Rectangle(9.0, 5.0), HORSESHOE])
def test_a_pressure_in_a_hole_moves_and_turns_nothing_as_a_whole(hole) -> None:
    specimen = build_specimen(packed(), KN, 2.5, 0.5, BONDS)
    grains = specimen.grains
    gone = contains(hole, np.column_stack([grains.x, grains.y]))
    loads = press_on(specimen, gone, 2.0)
    x, y = loads.T
    assert not loads[gone].any()
    most = np.abs(loads).max()
    assert abs(x.sum()) < 1e-12 * most
    assert abs(y.sum()) < 1e-12 * most
    assert abs((grains.x * y - grains.y * x).sum()) < 1e-11 * most
    # the moment of a pressure on a closed rim is twice the area within, for each unit of it
    within = 0.5 * (grains.x * x + grains.y * y).sum() / 2.0
    assert hole.area < within < hole.area * (1.0 + 1.2 / np.sqrt(hole.area / np.pi)) ** 2
