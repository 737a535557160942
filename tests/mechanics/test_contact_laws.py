"""Every law of contact keeps what any must, and follows its own closed forms."""

import math

import numpy as np
import pytest
from scipy.special import gamma

from demflow.model.mechanics.contact.bonds import no_bonds
from demflow.model.mechanics.contact.contacts import contact_forces
from demflow.model.mechanics.contact.grains import at_rest
from demflow.model.mechanics.contact.joints import no_joints
from demflow.model.mechanics.contact.law import (
    Hertz,
    Linear,
    Rolling,
    energy,
    press,
    presses,
    relative_radius,
    shear_stiffness,
    stiffness,
    stiffnesses,
)
from demflow.model.mechanics.contact.neighbours import find_pairs, no_pairs
from demflow.model.mechanics.loading.stress import load
from demflow.model.mechanics.motion.equilibrium import NEVER, Specimen
from demflow.model.mechanics.motion.servo import STANDING
from demflow.model.scene import Contact, Stress
from tests.mechanics.rocks import packed

LAWS = [Linear(1.0, 0.4, 0.5), Hertz(1.0, 14.0, 0.8, 0.5), Rolling(1.0, 0.4, 0.5, 0.3)]
FAR = 1e9 * np.array([-1.0, 1.0, -1.0, 1.0])
every_law = pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)


def pair_of(law, gap=0.0, radii=(1.0, 0.7), **options):
    """Two discs along a slanted line of centres."""
    along = np.array([math.cos(0.3), math.sin(0.3)])
    x, y = np.outer(along, [0.0, sum(radii) + gap])
    grains = at_rest(x, y, np.array(radii), np.ones(2))
    return Specimen(grains, FAR.copy(), law, **options), along


@every_law
def test_force_is_the_derivative_of_the_energy_and_stiffness_that_of_the_force(law):
    overlap, r, h = np.geomspace(1e-6, 0.1, 40), 0.37, 1e-4
    for un in overlap:
        up, down = un * (1.0 + h), un * (1.0 - h)
        slope = (energy(law, up, r) - energy(law, down, r)) / (up - down)
        assert slope == pytest.approx(press(law, un, r), rel=1e-6)
        slope = (press(law, up, r) - press(law, down, r)) / (up - down)
        assert slope == pytest.approx(stiffness(law, un, r), rel=1e-6)


@every_law
def test_grains_that_part_bear_nothing(law):
    for un in (0.0, -1e-12, -0.3):
        assert press(law, un, 0.5) == 0.0
        assert energy(law, un, 0.5) == 0.0


@every_law
def test_arrays_and_kernels_agree_with_the_scalar_law(law):
    rng = np.random.default_rng(1)
    overlap, r = rng.uniform(-0.1, 0.1, 50), rng.uniform(0.1, 2.0, 50)
    at = list(zip(overlap, r, strict=True))
    assert np.array_equal(presses(law, overlap, r), [press(law, *one) for one in at])
    normal, shear = stiffnesses(law, overlap, r)
    assert np.array_equal(normal, [stiffness(law, *one) for one in at])
    assert np.array_equal(shear, [shear_stiffness(law, *one) for one in at])


@every_law
def test_action_is_reaction_and_no_torque_is_left_over(law):
    rng = np.random.default_rng(2)
    n = 200
    grains = at_rest(*rng.uniform(0.0, 20.0, (2, n)), rng.uniform(0.5, 1.0, n), np.ones(n))
    grains.vx[:], grains.vy[:], grains.spin[:] = 1e-2 * rng.standard_normal((3, n))
    pairs = find_pairs(grains, 0.3, no_pairs(n))
    for step in range(3):
        contact_forces(grains, pairs, no_bonds(), no_joints(), law, FAR, step, 1.0, 0.0, 0.0, None)
    size = np.abs(grains.fx).sum()
    assert abs(grains.fx.sum()) < 1e-13 * size
    assert abs(grains.fy.sum()) < 1e-13 * size
    turning = (grains.x * grains.fy - grains.y * grains.fx + grains.torque).sum()
    assert abs(turning) < 1e-11 * size


@every_law
def test_colliding_discs_part_with_their_energy_and_momentum(law):
    specimen, along = pair_of(law, dt=0.02)
    grains, speed = specimen.grains, 0.01
    grains.vx[:], grains.vy[:] = np.outer(along, [0.5 * speed, -0.5 * speed])
    specimen.relax(STANDING, NEVER, damping=0.0, steps=1500)
    apart = (grains.vx[1] - grains.vx[0]) * along[0] + (grains.vy[1] - grains.vy[0]) * along[1]
    assert apart == pytest.approx(speed, rel=1e-4)
    assert abs(grains.vx.sum()) < 1e-15
    assert np.abs(grains.spin).max() < 1e-15


def test_a_collision_of_hertz_takes_the_time_of_its_closed_form():
    """t = 4 √π Γ(2/5) / (5 Γ(9/10)) δ/v with δ = (5 m v² / 4 K)^{2/5} (Landau & Lifshitz)."""
    law, speed, dt = LAWS[1], 0.01, 0.005
    specimen, along = pair_of(law, dt=dt)
    grains = specimen.grains
    grains.vx[:], grains.vy[:] = np.outer(along, [0.5 * speed, -0.5 * speed])
    k = 2.0 / 3.0 * law.modulus * math.sqrt(relative_radius(*grains.radius))
    deepest = (1.25 * 0.5 * speed**2 / k) ** 0.4
    whole = 0.8 * math.sqrt(math.pi) * gamma(0.4) / gamma(0.9) * deepest / speed
    overlaps = []
    for _ in range(int(1.2 * whole / dt)):
        specimen.relax(STANDING, NEVER, damping=0.0, steps=1)
        distance = math.hypot(grains.x[1] - grains.x[0], grains.y[1] - grains.y[0])
        overlaps.append(grains.radius.sum() - distance)
    assert max(overlaps) == pytest.approx(deepest, rel=1e-5)
    assert np.count_nonzero(np.array(overlaps) > 0.0) * dt == pytest.approx(whole, abs=2 * dt)


def test_shear_of_hertz_grows_with_mindlins_stiffness():
    law = LAWS[1]
    nu = 0.25
    assert 2.0 * (1.0 - nu) / (2.0 - nu) == pytest.approx(6.0 / 7.0)
    for un in (1e-5, 1e-3):
        ratio = shear_stiffness(law, un, 0.5) / stiffness(law, un, 0.5)
        assert ratio == pytest.approx(law.shear_ratio, rel=1e-14)


def rolled(law, angle, steps=50, overlap=1e-3):
    """Moment on b of two discs that press and roll on each other, by angle; and the limit."""
    specimen, _ = pair_of(law, gap=-overlap, radii=(1.0, 1.0))
    grains, pairs = specimen.grains, specimen.pairs
    turn = angle / steps
    grains.spin[:] = [-0.5 * turn, 0.5 * turn]  # no shear: the surfaces move alike
    moments = []
    for step in range(steps):
        contact_forces(grains, pairs, no_bonds(), no_joints(), law, FAR, step, 1.0, 0.0, 0.0, None)
        moments.append(grains.torque[1])
    return np.array(moments), turn * np.arange(1, steps + 1)


def test_rolling_is_resisted_elastically_up_to_its_limit():
    law = LAWS[2]
    moments, angle = rolled(law, 5e-3)
    r, fn = 0.5, press(law, 1e-3, 0.5)
    expected = np.maximum(-law.ks * r * r * angle, -law.rolling_friction * r * fn)
    np.testing.assert_allclose(moments, expected, rtol=1e-12)
    assert moments[-1] == moments[-2]  # it yields
    assert moments[0] > moments[1]  # and did not at first


@pytest.mark.parametrize("law", LAWS[:2], ids=["linear", "hertz"])
def test_other_laws_let_grains_roll(law):
    moments, _ = rolled(law, 5e-3)
    assert not moments.any()


@every_law
def test_energy_is_accounted_for_while_grains_tumble(law):
    """What is put in, stored and lost balances, better with the square of the step."""
    errors = []
    for dt in (0.1, 0.05):
        rng = np.random.default_rng(3)
        n = 40
        at = np.stack(np.meshgrid(np.arange(8.0), np.arange(5.0))).reshape(2, n) * 2.1 - 8.0
        at += 0.02 * rng.standard_normal((2, n))
        grains = at_rest(at[0], at[1], rng.uniform(0.8, 1.0, n), np.ones(n))
        grains.vx[:], grains.vy[:], grains.spin[:] = 0.02 * rng.standard_normal((3, n))
        specimen = Specimen(grains, np.array([-9.5, 9.5, -9.5, 4.0]), law, dt=dt)
        specimen.open_ledger()
        specimen.relax(STANDING, NEVER, damping=0.02, steps=round(200 / dt))
        found = specimen.energies()
        scale = found.damping + abs(found.slip)
        assert found.damping > 0.0
        errors.append(abs(found.error) / scale)
    assert errors[1] < 0.35 * errors[0] + 4e-5


def test_a_packing_of_hertz_stiffens_with_the_cube_root_of_its_pressure():
    """Overlaps grow with p^{2/3}, so that eight times the pressure closes four times as much."""
    rock = packed()
    strains = []
    for pressure in (1e6, 8e6):
        state = load(
            rock, normal_stiffness=60e9, stiffness_ratio=2.5, friction=0.5, bonds=None,
            contact=Contact("hertz", poissons_ratio=0.25),
            stress=Stress(xx=pressure, yy=pressure),
        )  # fmt: skip
        assert state.stress[:2] == pytest.approx([pressure, pressure], rel=2e-3)
        a, b = state.contact_a, state.contact_b
        distance = np.hypot(state.x[a] - state.x[b], state.y[a] - state.y[b])
        overlap = rock.radius[a] + rock.radius[b] - distance
        weight = state.normal_force ** (2.0 / 3.0)
        strains.append(overlap.sum() / weight.sum())
        effective = 60e9 / (2.0 * (1.0 - 0.25**2))
        r = relative_radius(rock.radius[a], rock.radius[b])
        closed = 2.0 / 3.0 * effective / rock.radius.mean() * np.sqrt(r) * overlap**1.5
        np.testing.assert_allclose(closed, state.normal_force, rtol=1e-9)
    assert strains[0] == pytest.approx(strains[1], rel=0.05)


def test_rolling_resistance_lets_unbonded_grains_bear_more():
    """2.4 to 1 is what discs with a friction of 0.5 bear; with rolling resistance 3 to 1 rests."""
    rock = packed()
    state = load(
        rock, normal_stiffness=20e9, stiffness_ratio=2.5, friction=0.5, bonds=None,
        contact=Contact("rolling", rolling_friction=0.5), stress=Stress(xx=15e6, yy=5e6),
    )  # fmt: skip
    assert state.stress[0] / state.stress[1] == pytest.approx(3.0, rel=5e-3)
