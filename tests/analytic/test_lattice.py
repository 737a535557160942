"""Lattice formulas against sums over one cell."""

import math

import numpy as np
import pytest

from demflow.model.analytic import lattice


def conductivity(bonds, conductance, cell_area):
    """Σ g d dᵀ / A over the pipes of a cell: exact where all pores see the same surroundings."""
    return sum(conductance * np.outer(d, d) for d in bonds) / cell_area


def test_square_permeability_is_the_sum_over_a_cell():
    w, R, mu = 3e-5, 0.02, 0.7
    g = w**3 / (12 * mu * 2 * R)
    bonds = 2 * R * np.eye(2)
    tensor = mu * conductivity(bonds, g, (2 * R) ** 2)
    np.testing.assert_allclose(tensor, lattice.square_permeability(w, R) * np.eye(2), atol=1e-25)


def test_hexagonal_permeability_is_the_sum_over_a_cell():
    w, R, mu = 3e-5, 0.02, 0.7
    g = w**3 / (12 * mu * 2 * R)
    angles = np.pi / 2 + 2 * np.pi / 3 * np.arange(3)
    bonds = 2 * R / math.sqrt(3) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    tensor = mu * conductivity(bonds, g, 2 * math.sqrt(3) * R**2)  # two pores a grain
    expected = lattice.hexagonal_permeability(w, R)
    np.testing.assert_allclose(tensor, expected * np.eye(2), atol=1e-12 * expected)


def test_porosities_are_what_discs_leave_of_a_cell():
    assert pytest.approx((4 - math.pi) / 4, rel=1e-15) == lattice.SQUARE_POROSITY
    hexagon = 2 * math.sqrt(3)
    assert pytest.approx((hexagon - math.pi) / hexagon, rel=1e-15) == lattice.HEXAGONAL_POROSITY


@pytest.mark.parametrize("ratio", [1.0, 2.5, 1e9])
def test_elastic_constants_follow_from_the_energy_of_a_cell(ratio):
    """Stiffness C = Σ (k_n n n n n + k_s n t n t) l² / A over the three contacts of a grain."""
    kn = 5e9
    ks = kn / ratio
    angles = np.pi / 3 * np.arange(3)
    n = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    t = np.stack([-n[:, 1], n[:, 0]], axis=1)
    area, length = 2 * math.sqrt(3), 2.0

    def energy(strain):
        stretch = length * np.einsum("ci,ij,cj->c", n, strain, n)
        slide = length * np.einsum("ci,ij,cj->c", t, strain, n)
        return 0.5 * np.sum(kn * stretch**2 + ks * slide**2) / area

    c11 = 2 * energy(np.diag([1.0, 0.0]))
    c12 = energy(np.eye(2)) - c11
    young, poisson = lattice.hexagonal_elasticity(kn, ks)
    np.testing.assert_allclose(poisson, c12 / c11, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(young, c11 * (1 - (c12 / c11) ** 2), rtol=1e-12)
