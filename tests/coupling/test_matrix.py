"""Equations of a step of rock and fluid against dense ones, with new and with earlier factors."""

import numpy as np
import pytest
from scipy.sparse import csr_array, random_array

from demflow.model.coupling.matrix import StepMatrix

M, D, CONTACTS, PIPES = 60, 25, 140, 45


@pytest.mark.parametrize("seed", range(3))
def test_equations_agree_with_dense_ones(seed):
    rng = np.random.default_rng(seed)
    strains = tuple(
        csr_array(random_array((CONTACTS, M), density=0.07, rng=rng, data_sampler=rng.normal))
        for _ in range(2)
    )
    push = csr_array(random_array((M, D), density=0.1, rng=rng, data_sampler=rng.normal))
    storage, anchor = rng.uniform(0.1, 1.0, D), np.full(M, 1e-3)
    i = rng.integers(0, D - 1, PIPES)
    j = i + 1 + rng.integers(0, D - 1 - i)
    link = rng.choice(D, 4, replace=False)
    matrix = StepMatrix(strains, anchor, push, storage, i, j, link)
    besides = 0.05 * csr_array(random_array((M + D, M + D), density=0.01, rng=rng))
    held = np.zeros(D, bool)
    held[3] = True
    stiffness, conductance = (
        rng.uniform(0.5, 2.0, 2 * CONTACTS),
        rng.uniform(0.1, 3.0, PIPES + len(link)),
    )
    for change in range(4):
        stiffness[rng.integers(0, len(stiffness), 3)] = 0.0  # cement that broke
        conductance[change] *= 10.0
        flow = np.zeros((D, D))
        for a, b, g in zip(i, j, conductance[:PIPES], strict=True):
            flow[[a, b], [a, b]] += g
            flow[[a, b], [b, a]] -= g
        flow[link, link] += conductance[PIPES:]
        parts = (stiffness[:CONTACTS], stiffness[CONTACTS:])
        elastic = np.diag(anchor) + sum(
            b.toarray().T @ np.diag(k) @ b.toarray() for b, k in zip(strains, parts, strict=True)
        )
        a = push.toarray()
        whole = np.block([[elastic, -a], [-a.T, -np.diag(storage) - flow]])
        at = M + np.flatnonzero(held)
        whole[at], whole[:, at] = 0.0, 0.0
        whole[at, at] = -1.0
        right = rng.normal(size=M + D)
        exact = np.linalg.solve(whole + besides.toarray(), right)
        upper = matrix.entries(stiffness, conductance, held)
        found = matrix.solve(upper, besides, right, 1e-10)
        assert np.linalg.norm(found - exact) < 1e-6 * np.linalg.norm(exact)
    assert matrix.factored < 4  # an earlier one served, too
