"""Bonded discs: elastic constants, strengths, breakage."""

import numpy as np
import pytest

from model.mechanics.bonds import (
    BROKEN_IN_SHEAR,
    BROKEN_IN_TENSION,
    INTACT,
    contact_bond_state,
    install,
    load_parallel_bond,
)
from model.mechanics.contacts import ContactLaw, Sums, contact_forces
from model.mechanics.grains import at_rest
from model.mechanics.neighbours import Pairs

FAR = np.array([-1e3, 1e3, -1e3, 1e3])


def bonds(kind: str, n: int, *, tensile=np.inf, shear=np.inf, kn=1.0, ks=0.4, radius=1.0):
    return install(
        kind,
        tensile_strength=tensile,
        shear_strength=shear,
        radius_multiplier=1.0,
        kn=kn,
        ks=ks,
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
        start, np.arange(1, 7, dtype=np.int32), np.zeros(6), np.arange(6, dtype=np.int32), x, y
    )
    law = ContactLaw(kn, ks, 0.0)
    cement = bonds(kind, 6, kn=kn, ks=ks)
    return contact_forces(grains, pairs, cement, law, FAR, 0.0, strain_x, strain_y)


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
    assert contact_bond_state(cement, 0, -0.039, 0.079) == INTACT
    assert contact_bond_state(cement, 0, -0.041, 0.0) == BROKEN_IN_TENSION
    assert contact_bond_state(cement, 0, 1.0, -0.081) == BROKEN_IN_SHEAR


@pytest.mark.parametrize("kind", ["contact", "parallel"])
def test_pulled_pair_comes_apart_for_good(kind: str) -> None:
    grains = at_rest(np.array([-1.0, 1.0]), np.zeros(2), np.ones(2), np.ones(2))
    pairs = Pairs(
        np.array([0, 1, 1]), np.array([1], np.int32), np.zeros(1), np.zeros(1, np.int32),
        grains.x.copy(), grains.y.copy(),
    )  # fmt: skip
    cement = bonds(kind, 1, tensile=0.01)
    law = ContactLaw(1.0, 0.4, 0.5)
    gaps, pull = np.linspace(0.0003, 0.0603, 61), []
    for gap in gaps:
        grains.x[:] = [-1.0, 1.0 + gap]
        contact_forces(grains, pairs, cement, law, FAR, 0.0, 0.0, 0.0)
        pull.append(grains.fx[0])
        assert grains.fx[0] == -grains.fx[1]
    stiffness = 1.0 if kind == "contact" else 0.5
    expected = np.where(stiffness * gaps / 2.0 > 0.01, 0.0, stiffness * gaps)
    np.testing.assert_allclose(pull, expected, atol=1e-12)
    assert cement.state[0] == BROKEN_IN_TENSION
    grains.x[:] = [-1.0, 0.99]
    contact_forces(grains, pairs, cement, law, FAR, 0.0, 0.0, 0.0)
    assert grains.fx[1] == pytest.approx(0.01)  # touching again, grain to grain only
