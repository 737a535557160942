"""The rational Krylov space: what the recurrences say of it is what is measured."""

import numpy as np
import pytest

from demflow.model.flow.equation.algebraic import algebraic
from demflow.model.flow.linear.factor import analyse, factorise
from demflow.model.flow.solvers.subspace import Subspace
from tests.diffusion import well_problem
from tests.reservoirs import dense_matrices

PROBLEM = well_problem(250, decades=5.0)
SYSTEM = PROBLEM.system
POLES = (1.0 / PROBLEM.lag[-1], 1.0 / PROBLEM.lag[0])


def grown(drained: bool = True) -> Subspace:
    everywhere = np.full(SYSTEM.n, drained)
    source = SYSTEM.source(1)
    space = Subspace(SYSTEM, algebraic(SYSTEM), PROBLEM.records, source, everywhere)
    symbolic = analyse(SYSTEM.n, SYSTEM.edge_i, SYSTEM.edge_j)
    for k in range(12):
        pole = POLES[k % 2]
        excess = SYSTEM.excess + pole * SYSTEM.storage
        assert space.extend(pole, factorise(symbolic, SYSTEM.edge_g, excess))
    return space


def test_recurrences_and_edge_differences_give_one_projection():
    space = grown()
    known = space.modes(13)
    assert space.noise() < 1e-9
    space.measure()
    measured = space.modes(13)
    np.testing.assert_allclose(np.sort(measured.decay), np.sort(known.decay), rtol=1e-8)
    one, other = measured.pressure(PROBLEM.lag), known.pressure(PROBLEM.lag)
    np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())
    assert space.noise() < 1e-12


@pytest.mark.parametrize(("noise", "within"), [(0.0, 1e-9), (1.0, 1e-8)])
def test_the_closed_space_holds_the_constants_and_projects_the_dense_matrix(noise, within):
    """Measured, and by the recurrences alone."""
    basis = grown().close(noise)
    matrix, storage = dense_matrices(SYSTEM)
    m = SYSTEM.pores
    gram = basis.vectors[:m].T @ (storage[:, None] * basis.vectors[:m])
    np.testing.assert_allclose(gram, np.eye(len(gram)), atol=1e-12)
    constants = basis.vectors[:m] @ (basis.vectors[:m].T @ storage)
    np.testing.assert_allclose(constants, 1.0, atol=1e-12)
    projected = basis.modes.vectors.T @ (basis.vectors.T @ matrix @ basis.vectors)
    projected = projected @ basis.modes.vectors
    np.testing.assert_allclose(
        np.diag(projected), basis.modes.decay, rtol=within, atol=1e-12 * basis.modes.decay.max()
    )
    np.testing.assert_allclose(basis.stored, storage @ basis.vectors[:m], rtol=1e-12)


def test_what_nothing_drains_keeps_its_constants_as_a_mode_at_rest():
    space = grown(drained=False)
    assert space.start == 1
    assert space.modes(5).decay.min() == 0.0
