"""Kernels on faces against all-pairs searches."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.network.faces import crossing_pairs, locate


@given(seed=st.integers(0, 10**6), contacts=st.integers(1, 60))
@settings(max_examples=40)
def test_crossing_contacts_are_all_found(seed, contacts):
    """Long and short contacts, on a lattice of points so that ends meet and lines overlap."""
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 7, (2, 40)).astype(float)
    x += rng.choice([0.0, 0.3], 40)
    a, b = rng.integers(0, 40, (2, contacts))
    keep = (x[a] != x[b]) | (y[a] != y[b])
    a, b = a[keep], b[keep]
    if len(a) == 0:
        return

    def side(p, q, r):
        return np.sign((x[q] - x[p]) * (y[r] - y[p]) - (y[q] - y[p]) * (x[r] - x[p]))

    expected = {
        (e, f)
        for f in range(len(a))
        for e in range(f)
        if not {a[e], b[e]} & {a[f], b[f]}
        and side(a[e], b[e], a[f]) * side(a[e], b[e], b[f]) < 0
        and side(a[f], b[f], a[e]) * side(a[f], b[f], b[e]) < 0
    }
    for size in (0.5, 2.0, 50.0):
        found = [tuple(pair) for pair in crossing_pairs(a, b, x, y, size).tolist()]
        assert len(found) == len(set(found))
        assert set(found) == expected


@pytest.mark.parametrize("points", [0, 1, 2, 500])
def test_a_point_lies_in_the_face_that_holds_it(points):
    """Unit squares of a lattice, one after the other; some points lie outside of all."""
    side = 9
    node = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    corners = np.stack([node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]], axis=-1)
    y, x = (v.ravel().astype(float) for v in np.indices(node.shape))
    rng = np.random.default_rng(3)
    px, py = rng.uniform(-1, side + 1, (2, points))
    found = locate(px, py, np.arange(0, 4 * side**2 + 1, 4), corners.ravel(), x, y)
    within = (px > 0) & (px < side) & (py > 0) & (py < side)
    expected = np.where(within, np.floor(py) * side + np.floor(px), -1)
    np.testing.assert_array_equal(found, expected)
