"""The factor of the stiffness matrix tells when nothing holds some of the grains."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from demflow.model.mechanics.static.stiffness import factorise, solve
from demflow.model.outcome import ModelError


def springs(rng, nodes, first=0):
    """A connected random network of springs between unknowns, nothing holding it."""
    ends = [(first + k, first + int(rng.integers(0, k))) for k in range(1, nodes)]
    ends += [tuple(first + rng.choice(nodes, 2, replace=False)) for _ in range(nodes)]
    return [(a, b, float(rng.uniform(0.1, 10.0))) for a, b in ends]


def laplacian(size, edges):
    matrix = np.zeros((size, size))
    for a, b, k in edges:
        matrix[[a, b], [a, b]] += k
        matrix[[a, b], [b, a]] -= k
    return matrix


@pytest.mark.parametrize("seed", range(12))
def test_a_part_that_nothing_holds_is_named(seed):
    """Two networks, the second held by one spring: the grains of the first are told."""
    rng = np.random.default_rng(seed)
    free, held = 3 * int(rng.integers(4, 12)), 3 * int(rng.integers(4, 12))
    matrix = laplacian(free + held, springs(rng, free) + springs(rng, held, free))
    matrix[-1, -1] += 1.0
    with pytest.raises(ModelError, match=f"nothing holds {free // 3} grains.*first 0, 1, 2"):
        factorise(csc_array(matrix))
    matrix[0, 0] += 1e-6
    load = rng.normal(size=len(matrix))
    found = solve(factorise(csc_array(matrix)), load)
    np.testing.assert_allclose(matrix @ found, load, atol=1e-6 * np.abs(load).max())
