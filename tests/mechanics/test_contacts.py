"""Two or three discs: what the contact and motion kernels must keep, and closed forms."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.mechanics.contact.batches import BLOCK
from demflow.model.mechanics.contact.bonds import no_bonds
from demflow.model.mechanics.contact.contacts import contact_forces
from demflow.model.mechanics.contact.grains import Grains, at_rest
from demflow.model.mechanics.contact.joints import no_joints
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.contact.laws import (
    local_damping,
    normal_force,
    shear_force,
    slip,
    tangential_step,
)
from demflow.model.mechanics.contact.neighbours import find_pairs, no_pairs
from demflow.model.mechanics.motion.equilibrium import FIRE, NEVER, OUT_OF_STEPS, Specimen
from demflow.model.mechanics.motion.servo import STANDING, Servo

FAR = np.array([-1e3, 1e3, -1e3, 1e3])  # walls that nothing reaches


def discs(x, y, *, velocity, spin=0.0, radius=1.0, mass=1.0) -> Grains:
    ones = np.ones(len(x))
    grains = at_rest(np.array(x, float), np.array(y, float), radius * ones, mass * ones)
    grains.vx[:], grains.vy[:] = np.array(velocity, float).T
    grains.spin[:] = spin
    return grains


def fly(grains: Grains, *, friction: float, dt: float, time: float, box=FAR) -> Specimen:
    """Undamped motion; friction acts, nothing else takes energy."""
    law = Linear(1.0, 0.4, friction)
    specimen = Specimen(grains, box.copy(), law, dt=dt, skin=0.3)
    assert specimen.relax(STANDING, NEVER, damping=0.0, steps=round(time / dt)) == OUT_OF_STEPS
    return specimen


def kinetic_energy(grains: Grains) -> float:
    mass = 1.0 / grains.inverse_mass
    rotation = (grains.radius * grains.spin) ** 2  # I = m r²
    return float(np.sum(0.5 * mass * (grains.vx**2 + grains.vy**2 + rotation)))


def momenta(grains: Grains) -> np.ndarray:
    mass = 1.0 / grains.inverse_mass
    angular = mass * (grains.x * grains.vy - grains.y * grains.vx + grains.radius**2 * grains.spin)
    return np.array([np.sum(mass * grains.vx), np.sum(mass * grains.vy), np.sum(angular)])


def head_on(dt: float) -> tuple[float, Grains]:
    """Contact time and end state of a collision whose first touch falls on a step."""
    speed, wait, end = 0.01, 1.0, 8.0
    grains = discs(
        [-1.0 - speed * wait, 1.0 + speed * wait], [0, 0], velocity=[(speed, 0), (-speed, 0)]
    )
    fly(grains, friction=0.5, dt=dt, time=end)
    parting = grains.vx[1] - grains.vx[0]
    gap = grains.x[1] - grains.x[0] - 2.0
    return end - wait - gap / parting, grains


def test_head_on_collision_has_the_closed_form() -> None:
    duration, grains = head_on(0.01)
    assert duration == pytest.approx(np.pi * np.sqrt(0.5), rel=1e-4)  # π √(m_eff / k_n)
    assert grains.vx[1] == pytest.approx(0.01, rel=1e-4)  # restitution 1
    assert kinetic_energy(grains) == pytest.approx(1e-4, rel=2e-4)
    assert np.abs(momenta(grains)).max() < 1e-16
    assert grains.spin[0] == grains.spin[1] == 0.0


def stuck(dt: float, time: float) -> np.ndarray:
    """Centres of two discs that touch at first, in an oblique collision with holding friction."""
    direction = np.array([np.cos(0.3), np.sin(0.3)])
    across = np.array([-direction[1], direction[0]])
    centres = (1.0 - 1e-14) * np.array([-direction, direction])
    velocity = 0.1 * np.array([direction + across, -direction])
    grains = discs(centres[:, 0], centres[:, 1], velocity=velocity)
    fly(grains, friction=100.0, dt=dt, time=time)
    return np.array([grains.x, grains.y])


def test_motion_is_second_order_in_the_step() -> None:
    fine, finer = stuck(0.002, 1.6), stuck(0.001, 1.6)
    exact = finer + (finer - fine) / 3.0
    error = [np.abs(stuck(dt, 1.6) - exact).max() for dt in (0.1, 0.05, 0.025, 0.0125)]
    order = np.log2(np.array(error[:-1]) / error[1:])
    np.testing.assert_allclose(order, 2.0, atol=0.02)


@pytest.mark.parametrize("friction", [0.0, 0.3, 10.0])
def test_free_discs_keep_momentum_and_angular_momentum(friction: float) -> None:
    rng = np.random.Generator(np.random.PCG64(5))
    x, y = (v.ravel() for v in np.meshgrid(2.05 * np.arange(5), 2.05 * np.arange(5)))
    grains = discs(x, y, velocity=0.05 * rng.normal(size=(25, 2)), spin=0.1 * rng.normal(size=25))
    before, energy = momenta(grains), kinetic_energy(grains)
    specimen = fly(grains, friction=friction, dt=0.2, time=100.0)
    assert specimen.rebuilds > 0  # forces were handed from list to list
    np.testing.assert_allclose(momenta(grains), before, atol=1e-13)
    if friction == 0.3:
        assert kinetic_energy(grains) < 0.97 * energy  # slip takes energy
    if friction == 0.0:
        assert kinetic_energy(grains) == pytest.approx(energy, rel=0.02)


def test_action_equals_reaction_with_walls() -> None:
    rng = np.random.Generator(np.random.PCG64(2))
    x, y = rng.uniform(-4, 4, (2, 30))
    grains = discs(x, y, velocity=rng.normal(size=(30, 2)), spin=rng.normal(size=30))
    box = np.array([-4.5, 4.4, -4.3, 4.6])
    pairs = find_pairs(grains, 0.2, no_pairs(30))
    law = Linear(1.0, 0.4, 0.5)
    sums = contact_forces(grains, pairs, no_bonds(), no_joints(), law, box, 0, 0.01, 0.0, 0.0, None)
    assert sums.left_contacts > 0
    assert sums.top_contacts > 0
    assert grains.fx.sum() == pytest.approx(sums.left - sums.right, abs=1e-12)
    assert grains.fy.sum() == pytest.approx(sums.bottom - sums.top, abs=1e-12)
    # virial of all contacts = Σ x · F of the wall forces alone, by summation by parts
    inner = np.sum(grains.x * grains.fx)
    outer = -sums.left * box[0] + sums.right * box[1]
    assert sums.virial_xx == pytest.approx(outer + inner, rel=1e-12)


def test_forces_are_the_laws_pair_by_pair() -> None:
    """Two steps against a plain loop over all pairs; a large disc has more of them than a block."""
    rng = np.random.Generator(np.random.PCG64(4))
    n, dt, stretch, law = 300, 0.3, (1e-3, -2e-3), Linear(1.0, 0.4, 0.5)
    angle = 2.0 * np.pi * np.arange(1, n) / (n - 1)
    radius = np.r_[40.0, rng.uniform(0.3, 0.6, n - 1)]
    way = 40.0 + radius[1:] * rng.uniform(0.8, 1.1, n - 1)
    way[::50] = 60.0
    x, y = np.r_[0.0, way * np.cos(angle)], np.r_[0.0, way * np.sin(angle)]
    grains = at_rest(x, y, radius, np.ones(n))
    grains.vx[:], grains.vy[:], grains.spin[:] = 0.03 * rng.normal(size=(3, n))
    pairs = find_pairs(grains, 0.3, no_pairs(n))
    assert np.diff(pairs.start).max() > 2 * BLOCK

    fx, fy, torque, shear = np.zeros(n), np.zeros(n), np.zeros(n), {}
    for step in range(2):
        sums = contact_forces(
            grains, pairs, no_bonds(), no_joints(), law, FAR, step, dt, *stretch, None
        )
        fx[:], fy[:], torque[:], contacts, force = 0.0, 0.0, 0.0, 0, 0.0
        for i, j in itertools.combinations(range(n), 2):
            dx, dy = x[j] - x[i], y[j] - y[i]
            d = np.hypot(dx, dy)
            un = radius[i] + radius[j] - d
            if un <= 0.0:
                continue
            nx, ny = dx / d, dy / d
            ux = dt * (grains.vx[j] - grains.vx[i]) + stretch[0] * dx
            uy = dt * (grains.vy[j] - grains.vy[i]) + stretch[1] * dy
            arms = radius[i] - 0.5 * un, radius[j] - 0.5 * un
            turns = dt * grains.spin[i], dt * grains.spin[j]
            us = tangential_step(ux, uy, nx, ny, 1.0 / d, *turns, *arms)
            fn = law.kn * un
            fs = slip(shear.get((i, j), 0.0) - law.ks * us, law.friction * fn)
            shear[i, j] = fs
            for k, sign in ((i, -1.0), (j, 1.0)):
                fx[k] += sign * (fn * nx - fs * ny)
                fy[k] += sign * (fn * ny + fs * nx)
            torque[i] -= arms[0] * fs
            torque[j] -= arms[1] * fs
            contacts += 1
            force += np.hypot(fn, fs)
    listed = dict(zip(zip(pairs.one, pairs.other, strict=True), pairs.shear, strict=True))
    assert {pair: fs for pair, fs in listed.items() if fs != 0.0} == pytest.approx(shear, abs=1e-13)
    assert sums.contacts == contacts
    assert sums.force == pytest.approx(force, rel=1e-12)
    for got, wanted in ((grains.fx, fx), (grains.fy, fy), (grains.torque, torque)):
        np.testing.assert_allclose(got, wanted, atol=1e-11)


def test_disc_on_a_plane_slides_at_the_friction_limit() -> None:
    """A disc is drawn along a fixed, very large one with a given overlap."""
    radius = np.array([1e7, 1.0])
    overlap, mu, ks = 0.01, 0.5, 0.4
    grains = at_rest(np.zeros(2), np.array([-1e7, 1.0 - overlap]), radius, np.full(2, np.inf))
    grains.vx[1] = 1e-4
    specimen = Specimen(grains, 1e9 * np.array([-1, 1, -1, 1.0]), Linear(1.0, ks, mu), dt=1.0)
    limit = mu * overlap
    slide = int(limit / (ks * 1e-4))
    force = []
    for _ in range(2 * slide):
        specimen.relax(STANDING, NEVER, damping=0.0, steps=1)
        force.append(-specimen.grains.fx[1])
    force = np.array(force)
    step = np.arange(1, 2 * slide + 1)
    np.testing.assert_allclose(force, np.minimum(ks * 1e-4 * step, limit), rtol=1e-5)


def test_scalar_laws() -> None:
    assert normal_force(3.0, 0.5) == 1.5
    assert shear_force(0.2, 2.0, 0.05) == pytest.approx(0.1)
    assert [slip(f, 1.0) for f in (-2.0, -0.5, 0.5, 2.0)] == [-1.0, -0.5, 0.5, 1.0]
    for force in (2.0, -2.0):
        for velocity in (1.0, -1.0):
            wanted = force - 0.5 * abs(force) * np.sign(velocity)
            assert local_damping(force, velocity, 0.5) == wanted
        for standing in (0.0, -0.0):  # as if it moved against the force
            assert local_damping(force, standing, 0.5) == 1.5 * force


def gas(*, turn: float = 0.0, flip: float = 1.0, order=None) -> Grains:
    """Discs that collide with friction, turned, mirrored or numbered anew; after their flight."""
    rng = np.random.Generator(np.random.PCG64(8))
    x, y = (v.ravel() for v in np.meshgrid(2.1 * np.arange(4.0), 2.1 * np.arange(4.0)))
    v, spin = 0.05 * rng.normal(size=(2, 16)), 0.1 * rng.normal(size=16)
    c, s = np.cos(turn), np.sin(turn)

    def turned(a, b):
        return c * a - s * flip * b, s * a + c * flip * b

    order = np.arange(16) if order is None else order
    (px, py), (vx, vy) = turned(x, y), turned(*v)
    grains = discs(
        px[order], py[order], velocity=np.column_stack((vx, vy))[order], spin=flip * spin[order]
    )
    fly(grains, friction=0.4, dt=0.2, time=30.0)
    return grains


def test_motion_is_the_same_turned_mirrored_and_renumbered() -> None:
    plain = gas()
    assert np.hypot(plain.vx, plain.vy).max() > 0.01
    turn = 0.7
    c, s = np.cos(turn), np.sin(turn)
    turned = gas(turn=turn)
    np.testing.assert_allclose(turned.x, c * plain.x - s * plain.y, atol=1e-11)
    np.testing.assert_allclose(turned.y, s * plain.x + c * plain.y, atol=1e-11)
    mirrored = gas(flip=-1.0)
    np.testing.assert_allclose(mirrored.x, plain.x, atol=1e-11)
    np.testing.assert_allclose(mirrored.y, -plain.y, atol=1e-11)
    np.testing.assert_allclose(mirrored.spin, -plain.spin, atol=1e-11)
    order = np.random.Generator(np.random.PCG64(1)).permutation(16)
    renumbered = gas(order=order)
    np.testing.assert_allclose(renumbered.x, plain.x[order], atol=1e-11)
    np.testing.assert_allclose(renumbered.spin, plain.spin[order], atol=1e-11)


def test_shear_history_does_not_notice_when_the_list_is_made_anew() -> None:
    """The same flight with a list made at every step and with a list made once."""

    def flight(skin: float) -> tuple[Specimen, Grains]:
        rng = np.random.Generator(np.random.PCG64(3))
        x, y = (v.ravel() for v in np.meshgrid(1.98 * np.arange(4.0), 1.98 * np.arange(4.0)))
        grains = discs(
            x, y, velocity=0.01 * rng.normal(size=(16, 2)), spin=0.01 * rng.normal(size=16)
        )
        box = np.array([-0.99, 6.93, -0.99, 6.93])
        specimen = Specimen(grains, box, Linear(1.0, 0.4, 0.5), dt=0.2, skin=skin)
        specimen.relax(STANDING, NEVER, damping=0.0, steps=40)
        return specimen, grains

    often, one = flight(1e-3)
    never, two = flight(3.0)
    assert often.rebuilds > 10
    assert never.rebuilds == 0
    assert np.abs(often.pairs.shear).max() > 0.0
    np.testing.assert_allclose(one.x, two.x, atol=1e-13)
    np.testing.assert_allclose(one.spin, two.spin, atol=1e-13)


@pytest.mark.parametrize("damping", [FIRE, 0.7])
def test_lists_as_wide_as_pays_change_no_bit(damping: float) -> None:
    """A random packing is pressed from a gas to rest, by lists of a given width and by others."""

    def pressed(skin: float | None) -> Specimen:
        rng = np.random.Generator(np.random.PCG64(5))
        x, y = (v.ravel() for v in np.meshgrid(*2 * [2.2 * np.arange(-6.0, 7.0)]))
        radius, speed = rng.uniform(0.7, 1.3, 169), 0.02 * rng.normal(size=(169, 2))
        grains = discs(x, y, radius=radius, velocity=speed)
        box = np.array([-15.0, 15.0, -15.0, 15.0])
        specimen = Specimen(grains, box, Linear(1.0, 0.4, 0.3), skin=skin)
        servo = Servo(1e-3, 1e-3, 1e-3, 1e-3)
        specimen.relax(servo, NEVER, damping=damping, steps=3000)
        return specimen

    given, fits = pressed(0.3), pressed(None)
    assert fits.sums.contacts > 169
    assert len(fits.pairs.other) < len(given.pairs.other)
    for one, two in zip(given.grains, fits.grains, strict=True):
        np.testing.assert_array_equal(one, two)
    assert given.sums == fits.sums


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), speed=st.floats(1e-3, 0.5), skin=st.none() | st.floats(0.05, 1.0))
def test_no_contact_is_missed_between_lists(seed: int, speed: float, skin: float | None) -> None:
    """At whatever moment one looks, every touching pair is in the list."""
    rng = np.random.Generator(np.random.PCG64(seed))
    x, y = rng.uniform(-7, 7, (2, 40))
    grains = discs(x, y, velocity=speed * rng.normal(size=(40, 2)))
    box = np.array([-8.0, 8.0, -8.0, 8.0])
    specimen = Specimen(grains, box, Linear(1.0, 0.4, 0.3), dt=0.2, skin=skin)
    servo = Servo(1.0, 0.5, 1.0, 0.5, limit=1e-2)  # the affine stretch moves grains too
    for _ in range(30):
        specimen.relax(servo, NEVER, damping=0.3, steps=3)
        distance = np.hypot(grains.x[:, None] - grains.x, grains.y[:, None] - grains.y)
        a, b = np.nonzero(np.triu(distance < 2.0, 1))
        listed = np.repeat(np.arange(40), np.diff(specimen.pairs.start)) * 40 + specimen.pairs.other
        assert np.isin(a * 40 + b, listed).all()
