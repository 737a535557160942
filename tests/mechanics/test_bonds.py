"""Bonded discs: elastic constants, strengths, breakage."""

import numpy as np
import pytest

from demflow.model.mechanics.contact.bonds import (
    BROKEN_IN_SHEAR,
    BROKEN_IN_TENSION,
    INTACT,
    bond_state,
    install,
    load_parallel_bond,
    strengths,
)
from demflow.model.mechanics.contact.contacts import Sums, contact_forces
from demflow.model.mechanics.contact.grains import at_rest
from demflow.model.mechanics.contact.joints import no_joints
from demflow.model.mechanics.contact.law import Linear
from demflow.model.mechanics.contact.neighbours import Pairs
from demflow.model.mechanics.motion.equilibrium import NEVER, Specimen
from demflow.model.mechanics.motion.servo import STANDING
from demflow.model.mechanics.specimen.records import broken

FAR = np.array([-1e3, 1e3, -1e3, 1e3])


def bonds(kind: str, n: int, *, tensile=np.inf, shear=np.inf, kn=1.0, ks=0.4, radius=1.0):
    return install(
        kind,
        tensile_strength=tensile,
        shear_strength=shear,
        modulus=0.5 * kn,
        stiffness_ratio=kn / ks if ks > 0.0 else np.inf,
        radius_a=np.full(n, radius),
        radius_b=np.full(n, radius),
        distance=np.full(n, 2.0 * radius),
    )


def strained_star(kind: str, strain_x: float, strain_y: float, kn: float, ks: float) -> Sums:
    """A grain of the hexagonal lattice and its six bonded neighbours, rotations fixed."""
    angle = np.arange(6) * np.pi / 3
    x, y = np.r_[0.0, 2.0 * np.cos(angle)], np.r_[0.0, 2.0 * np.sin(angle)]
    grains = at_rest(x * (1 + strain_x), y * (1 + strain_y), np.ones(7), np.ones(7))
    start = np.r_[0, np.full(7, 6)]
    pairs = Pairs(
        start,
        np.zeros(6, np.int32),
        np.arange(1, 7, dtype=np.int32),
        np.zeros(6),
        np.zeros(6),
        np.arange(6, dtype=np.int32),
        x,
        y,
    )
    law = Linear(kn, ks, 0.0)
    cement = bonds(kind, 6, kn=kn, ks=ks)
    return contact_forces(
        grains, pairs, cement, no_joints(), law, FAR, 0, 0.0, strain_x, strain_y, None
    )


@pytest.mark.parametrize("ks", [0.0, 0.25, 1.0])
def test_hexagonal_lattice_has_its_closed_form_moduli(ks: float) -> None:
    kn, strain = 2.0, 1e-8
    cell = 2.0 * np.sqrt(3.0)
    sums = strained_star("contact", strain, 0.0, kn, ks)
    # each contact belongs to two cells; compression is positive
    c11, c12 = (-s / (2.0 * cell * strain) for s in (sums.virial_xx, sums.virial_yy))
    sums = strained_star("contact", 0.0, strain, kn, ks)
    assert -sums.virial_yy / (2.0 * cell * strain) == pytest.approx(c11, rel=1e-6)  # isotropic
    assert abs(sums.virial_xy) < 1e-6 * abs(sums.virial_yy)
    modulus, ratio = c11 - c12**2 / c11, c12 / c11
    assert modulus == pytest.approx(2 * np.sqrt(3) * kn * (kn + ks) / (3 * kn + ks), rel=1e-6)
    assert ratio == pytest.approx((kn - ks) / (3 * kn + ks), abs=1e-6)


def test_parallel_bonds_add_the_stiffness_of_the_grains() -> None:
    """k̄_n A = E_c 2 R̄ / (R_a + R_b) = k_n / 2: in tension the cement alone acts."""
    stretched = strained_star("parallel", 1e-8, 1e-8, 2.0, 0.8)
    pressed = strained_star("parallel", -1e-8, -1e-8, 2.0, 0.8)
    assert pressed.virial_xx / -stretched.virial_xx == pytest.approx(3.0, rel=1e-6)


def test_parallel_bond_is_a_beam() -> None:
    """Axial, shear and bending stiffness over its length 2 R: E_c A / L and E_c I / L."""
    modulus, radius = 3.0, 0.5
    cement = bonds("parallel", 1, kn=2 * modulus, ks=0.8 * modulus, radius=radius)
    fn, fs, moment = load_parallel_bond(cement, 0, 2 * radius - 1e-3, 2e-3, 1e-2)
    assert fn == pytest.approx(modulus * (2 * radius) / (2 * radius) * 1e-3)
    assert fs == pytest.approx(-0.4 * modulus * 2e-3)
    assert moment == pytest.approx(-modulus * (2 / 3 * radius**3) / (2 * radius) * 1e-2)
    again = load_parallel_bond(cement, 0, 2 * radius - 1e-3, -2e-3, -1e-2)
    np.testing.assert_allclose(again, (fn, 0.0, 0.0), atol=1e-18)


@pytest.mark.parametrize(
    ("distance", "slide", "turn", "state"),
    [
        (2.0 + 0.0099 * 4, 0.0, 0.0, INTACT),
        (2.0 + 0.0101 * 4, 0.0, 0.0, BROKEN_IN_TENSION),
        (2.0, 0.0199 * 10, 0.0, INTACT),
        (2.0, 0.0201 * 10, 0.0, BROKEN_IN_SHEAR),
        (2.0, 0.0, 0.0099 * 4, INTACT),  # |M| R̄ / I = k̄_n θ R̄
        (2.0, 0.0, -0.0101 * 4, BROKEN_IN_TENSION),
        (1.98, 0.0, 0.0101 * 4, INTACT),  # pressed: the tension of bending is relieved
    ],
)
def test_parallel_bond_breaks_at_its_strengths(distance, slide, turn, state) -> None:
    cement = bonds("parallel", 1, tensile=0.01, shear=0.02)
    load = load_parallel_bond(cement, 0, distance, slide, turn)
    assert cement.state[0] == state
    assert np.any(load) == (state == INTACT)


def test_contact_bond_breaks_at_force_over_its_section() -> None:
    cement = bonds("contact", 1, tensile=0.01, shear=0.02, radius=2.0)  # A = 4
    assert bond_state(cement, 0, -0.039, 0.079, 0.0) == INTACT
    assert bond_state(cement, 0, -0.041, 0.0, 0.0) == BROKEN_IN_TENSION
    assert bond_state(cement, 0, 1.0, -0.081, 0.0) == BROKEN_IN_SHEAR


@pytest.mark.parametrize("kind", ["contact", "parallel"])
def test_pulled_pair_comes_apart_for_good(kind: str) -> None:
    grains = at_rest(np.array([-1.0, 1.0]), np.zeros(2), np.ones(2), np.ones(2))
    pairs = Pairs(
        np.array([0, 1, 1]), np.array([0], np.int32), np.array([1], np.int32), np.zeros(1),
        np.zeros(1),
        np.zeros(1, np.int32), grains.x.copy(), grains.y.copy(),
    )  # fmt: skip
    cement = bonds(kind, 1, tensile=0.01)
    law = Linear(1.0, 0.4, 0.5)
    gaps, pull = np.linspace(0.0003, 0.0603, 61), []
    for step, gap in enumerate(gaps):
        grains.x[:] = [-1.0, 1.0 + gap]
        contact_forces(grains, pairs, cement, no_joints(), law, FAR, step, 0.0, 0.0, 0.0, None)
        pull.append(grains.fx[0])
        assert grains.fx[0] == -grains.fx[1]
    stiffness = 1.0 if kind == "contact" else 0.5
    expected = np.where(stiffness * gaps / 2.0 > 0.01, 0.0, stiffness * gaps)
    np.testing.assert_allclose(pull, expected, atol=1e-12)
    assert cement.state[0] == BROKEN_IN_TENSION
    grains.x[:] = [-1.0, 0.99]
    contact_forces(grains, pairs, cement, no_joints(), law, FAR, step, 0.0, 0.0, 0.0, None)
    assert grains.fx[1] == pytest.approx(0.01)  # touching again, grain to grain only


def test_cement_with_friction_holds_mohr_coulomb() -> None:
    cement = bonds("parallel", 1, shear=0.02)._replace(friction=0.5)
    assert bond_state(cement, 0, 0.04, 0.059, 0.0) == INTACT  # τ = 0.0295 < 0.02 + 0.5 · 0.02
    assert bond_state(cement, 0, 0.04, 0.061, 0.0) == BROKEN_IN_SHEAR
    assert bond_state(cement, 0, -0.04, 0.041, 0.0) == BROKEN_IN_SHEAR  # tension adds nothing


def test_strengths_are_normally_distributed_and_reproducible() -> None:
    """Lac du Bonnet granite: 157 ± 36 MPa."""

    def draw(seed):
        return strengths(157e6, 36e6, 20_000, np.random.Generator(np.random.PCG64(seed)))

    drawn = draw(1)
    assert drawn.mean() == pytest.approx(157e6, rel=0.01)
    assert drawn.std() == pytest.approx(36e6, rel=0.03)
    below = np.mean(drawn < 157e6 - 36e6)
    assert below == pytest.approx(0.1587, abs=0.01)  # one deviation below the mean
    np.testing.assert_array_equal(drawn, draw(1))
    assert np.any(drawn != draw(2))
    wide = strengths(1.0, 5.0, 1000, np.random.Generator(np.random.PCG64(1)))
    assert wide.min() == 0.0


def cantilever(n: int, radius: float, ks: float) -> tuple[float, float]:
    """Shear force and clamping moment of n discs in a row, the ends held upright, one moved up."""
    x = 2.0 * radius * np.arange(n)
    middle = x - x.mean()
    mass = np.full(n, 4.0)
    mass[[0, -1]] = np.inf
    grains = at_rest(middle, np.zeros(n), np.full(n, radius), mass)
    start = np.r_[np.arange(n), n - 1]
    pairs = Pairs(
        start, np.arange(n - 1, dtype=np.int32), np.arange(1, n, dtype=np.int32),
        np.zeros(n - 1), np.zeros(n - 1), np.arange(n - 1, dtype=np.int32), middle, np.zeros(n),
    )  # fmt: skip
    cement = bonds("parallel", n - 1, ks=ks, radius=radius)
    law = Linear(1.0, ks, 0.0)
    specimen = Specimen(grains, FAR.copy(), law, bonds=cement, known=pairs)
    lift, steps = 1e-5 * radius, 100
    grains.vy[-1] = lift / (steps * specimen.dt)
    specimen.relax(STANDING, NEVER, damping=0.3, steps=steps)
    grains.vy[-1] = 0.0
    specimen.relax(STANDING, NEVER, damping=0.3, steps=100 * n * n)
    return grains.fy[0] / lift, specimen.bonds.moment[0] / lift


@pytest.mark.parametrize("ks", [0.4, 1.0])
def test_bonded_row_bends_as_a_timoshenko_beam(ks: float) -> None:
    """Clamped, guided: w = P L³ / 12 E I + P L / G A, E = k_n / 2, G A = E A k_s / k_n."""
    for n in (6, 15):
        radius, modulus = 0.5, 0.5
        length = 2.0 * radius * (n - 1)
        area, inertia = 2.0 * radius, 2.0 * radius**3 / 3.0
        bending = length**3 / (12.0 * modulus * inertia)
        shear = length / (modulus * ks * area)
        force, moment = cantilever(n, radius, ks)
        assert abs(force) == pytest.approx(1.0 / (bending + shear), rel=1.1 / (n - 1) ** 2)
        # the moment falls linearly from P L / 2; the first bond sits one radius from the clamp
        assert abs(moment / force) == pytest.approx(0.5 * length - radius, rel=1e-4)
        # the chain itself, bond by bond: Σ (x_k² / k_r) + (n − 1) / k_s
        at = 2.0 * radius * (np.arange(n - 1) - 0.5 * (n - 2))
        kr = modulus / (2.0 * radius) * inertia
        chain = np.sum(at**2) / kr + (n - 1) * 2.0 * radius / (modulus * ks * area)
        assert abs(force) == pytest.approx(1.0 / chain, rel=1e-5)


def test_breakages_are_told_with_step_place_and_mode() -> None:
    """A row is pulled until its weakest bond breaks."""
    n, weak = 6, 2
    x = 2.0 * np.arange(n) - n + 1
    mass = np.full(n, 4.0)
    mass[[0, -1]] = np.inf
    grains = at_rest(x, np.zeros(n), np.ones(n), mass)
    pairs = Pairs(
        np.r_[np.arange(n), n - 1], np.arange(n - 1, dtype=np.int32),
        np.arange(1, n, dtype=np.int32), np.zeros(n - 1), np.zeros(n - 1),
        np.arange(n - 1, dtype=np.int32), x, np.zeros(n),
    )  # fmt: skip
    cement = bonds("contact", n - 1, tensile=1e-3)
    cement.tensile_strength[weak] = 5e-4
    specimen = Specimen(grains, FAR.copy(), Linear(1.0, 0.4, 0.5), bonds=cement, known=pairs)
    speed = 1e-6
    grains.vx[-1] = speed
    specimen.relax(STANDING, NEVER, damping=0.7, steps=20_000)
    found = broken(specimen)
    assert found.mode.tolist() == [BROKEN_IN_TENSION]
    # strength · 2 R̄ = force = stretch of n − 1 contacts in a row
    stretch = 5e-4 * 2.0 * (n - 1)
    assert found.step[0] == pytest.approx(stretch / (speed * specimen.dt), rel=0.02)
    share = stretch / (n - 1)
    assert found.x[0] == pytest.approx(x[weak] + 1.0 + (weak + 0.5) * share, abs=2e-4)
    assert found.y[0] == 0.0
    assert found.strain_xx[0] == 0.0  # the walls stood
