"""The subtraction-free factor: against dense and exact solutions, at any contrast."""

from fractions import Fraction
from itertools import pairwise

import flint
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.flow.linear.factor import analyse, factorise, solve


def random_graph(rng, n, extra):
    """A connected graph: a random tree and some edges more, parallel ones among them."""
    i = np.concatenate([np.arange(1, n), rng.integers(0, n, extra)])
    j = np.concatenate([[rng.integers(0, k) for k in range(1, n)], rng.integers(0, n, extra)])
    keep = i != j
    return i[keep].astype(np.int64), j[keep].astype(np.int64)


def dense(n, i, j, g, excess, number=float):
    """K written out, in floats or fractions."""
    matrix = [[number(0)] * n for _ in range(n)]
    for a, b, c in zip(i.tolist(), j.tolist(), g.tolist(), strict=True):
        matrix[a][a] += number(c)
        matrix[b][b] += number(c)
        matrix[a][b] -= number(c)
        matrix[b][a] -= number(c)
    for a, c in enumerate(excess.tolist()):
        matrix[a][a] += number(c)
    return matrix


def eliminate(matrix, rhs):
    """The solution in exact numbers, of fractions."""
    found = flint.fmpq_mat(_ratios(matrix)).solve(flint.fmpq_mat(_ratios([[b] for b in rhs])))
    return [Fraction(int(x.p), int(x.q)) for x in found.entries()]


def _ratios(rows):
    return [[flint.fmpq(*x.as_integer_ratio()) for x in row] for row in rows]


@given(seed=st.integers(0, 10**6), n=st.integers(1, 60), extra=st.integers(0, 90))
@settings(max_examples=40)
def test_agrees_with_a_dense_solution(seed, n, extra):
    rng = np.random.default_rng(seed)
    i, j = random_graph(rng, n, extra)
    g, excess = rng.uniform(0.5, 2, len(i)), rng.uniform(0.1, 1, n)
    rhs = rng.normal(size=(n, 3))
    factor = factorise(analyse(n, i, j), g, excess)
    expected = np.linalg.solve(np.array(dense(n, i, j, g, excess)), rhs)
    np.testing.assert_allclose(solve(factor, rhs), expected, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(solve(factor, rhs[:, 0]), expected[:, 0], rtol=1e-10, atol=1e-12)


def unit_lower(factor):
    """L of a factor, written out."""
    symbolic = factor.symbolic
    lower = np.eye(len(factor.pivot))
    for s, (begin, end) in enumerate(pairwise(symbolic.first)):
        below = symbolic.row[symbolic.row_start[s] : symbolic.row_start[s + 1]]
        assert np.all(np.diff(below) > 0)
        rows = np.concatenate([np.arange(begin, end), below])
        columns = factor.lower[symbolic.place[s] : symbolic.place[s + 1]].reshape(-1, len(rows))
        for k in range(end - begin):
            lower[rows[k + 1 :], begin + k] = -columns[k, k + 1 :]
    return lower


@pytest.mark.parametrize("n", [1, 2, 30, 300])
def test_is_l_d_l_transposed(n):
    rng = np.random.default_rng(2)
    i, j = random_graph(rng, n, 2 * n)
    g, excess = rng.uniform(0.5, 2, len(i)), rng.uniform(0, 1, n)
    symbolic = analyse(n, i, j)
    factor = factorise(symbolic, g, excess)
    np.testing.assert_array_equal(np.sort(symbolic.order), np.arange(n))
    lower = unit_lower(factor)
    matrix = np.array(dense(n, i, j, g, excess))[np.ix_(symbolic.order, symbolic.order)]
    np.testing.assert_allclose(lower @ np.diag(factor.pivot) @ lower.T, matrix, atol=1e-12)
    assert np.all(lower - np.eye(n) <= 0)
    assert np.all(factor.pivot > 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_every_component_is_right_at_a_contrast_of_1e12(seed):
    """Against rational arithmetic; an ordinary dense solution is lost beside it.

    Clusters of strong edges hang together and on to the fixed pressure by weak ones, which
    a stored diagonal forgets.
    """
    rng = np.random.default_rng(seed)
    n = 40
    i, j = random_graph(rng, n, 30)
    g = rng.uniform(0.5, 2, len(i)) * np.where(rng.random(len(i)) < 0.7, 1e12, 1.0)
    excess = np.zeros(n)
    excess[rng.integers(n)] = 1e-3
    rhs = rng.uniform(0, 1, n)
    exact = eliminate(dense(n, i, j, g, excess, Fraction), [Fraction(b) for b in rhs.tolist()])
    exact = np.array([float(x) for x in exact])
    ours = solve(factorise(analyse(n, i, j), g, excess), rhs)
    assert np.max(np.abs(ours / exact - 1)) < 1e-13
    ordinary = np.linalg.solve(np.array(dense(n, i, j, g, excess)), rhs)
    assert np.max(np.abs(ordinary / exact - 1)) > 1e-6


def test_every_weight_may_span_thirty_decades():
    rng = np.random.default_rng(7)
    n = 30
    i, j = random_graph(rng, n, 30)
    g = 10 ** rng.uniform(-15, 15, len(i))
    excess = 10 ** rng.uniform(-30, 0, n)
    rhs = rng.uniform(0, 1, n)
    exact = eliminate(dense(n, i, j, g, excess, Fraction), [Fraction(b) for b in rhs.tolist()])
    ours = solve(factorise(analyse(n, i, j), g, excess), rhs)
    np.testing.assert_allclose(ours, [float(x) for x in exact], rtol=1e-13)


def test_one_analysis_serves_all_values():
    rng = np.random.default_rng(3)
    i, j = random_graph(rng, 25, 20)
    symbolic = analyse(25, i, j)
    for _ in range(3):
        g, excess = rng.uniform(0.1, 9, len(i)), rng.uniform(0, 9, 25)
        rhs = rng.normal(size=25)
        expected = np.linalg.solve(np.array(dense(25, i, j, g, excess)), rhs)
        np.testing.assert_allclose(solve(factorise(symbolic, g, excess), rhs), expected, rtol=1e-9)


def test_nodes_without_edges_stand_alone():
    none = np.empty(0, dtype=np.int64)
    factor = factorise(analyse(4, none, none), np.empty(0), np.array([1.0, 2.0, 4.0, 8.0]))
    np.testing.assert_array_equal(solve(factor, np.ones(4)), [1, 0.5, 0.25, 0.125])


def test_edges_of_no_conductance_and_inputs_are_left_alone():
    i, j = np.array([0, 1, 2]), np.array([1, 2, 3])
    g, excess = np.array([1.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0, 2.0])
    rhs = np.array([1.0, 0.0, 0.0, 1.0])
    x = solve(factorise(analyse(4, i, j), g, excess), rhs)
    np.testing.assert_allclose(x, [1, 1, 0.5, 0.5])
    np.testing.assert_array_equal(excess, [1, 0, 0, 2])
    np.testing.assert_array_equal(rhs, [1, 0, 0, 1])
