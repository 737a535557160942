"""Orders, patterns and sizes of factors, against elimination written out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.flow.linear.elimination import (
    analyse,
    analyse_anew,
    column_counts,
    elimination_tree,
    postorder,
)
from demflow.model.flow.linear.factor import factorise
from demflow.model.flow.linear.graph import graph_of, inverse, renumbered
from demflow.model.flow.linear.ordering import minimum_degree
from demflow.model.memory import limited
from demflow.model.outcome import OutOfMemory
from tests.flow.test_factor import random_graph


def grid(side):
    """Edges of a square grid."""
    node = np.arange(side * side).reshape(side, side)
    i = np.concatenate([node[:-1].ravel(), node[:, :-1].ravel()])
    j = np.concatenate([node[1:].ravel(), node[:, 1:].ravel()])
    return i, j


def counted(graph):
    """Entries below the diagonal of each column, nodes eliminated as numbered."""
    parent = elimination_tree(*graph)
    post = postorder(parent, np.zeros(len(parent), dtype=np.int64))
    return column_counts(*graph, parent, post)


def filled(n, i, j, order):
    """Pattern below the diagonal after eliminating in the order, (n, n), by sets."""
    joined = [set() for _ in range(n)]
    rank = inverse(np.asarray(order))
    for a, b in zip(rank[i].tolist(), rank[j].tolist(), strict=True):
        if a != b:
            joined[a].add(b)
            joined[b].add(a)
    pattern = np.zeros((n, n), dtype=bool)
    for k in range(n):
        later = {b for b in joined[k] if b > k}
        pattern[list(later), k] = True
        for b in later:
            joined[b] |= later - {b}
    return pattern


@given(seed=st.integers(0, 10**6), n=st.integers(1, 70), extra=st.integers(0, 120))
@settings(max_examples=40)
def test_pattern_and_counts_are_those_of_elimination(seed, n, extra):
    i, j = random_graph(np.random.default_rng(seed), n, extra)
    symbolic = analyse_anew(n, i, j)
    np.testing.assert_array_equal(np.sort(symbolic.order), np.arange(n))
    pattern = filled(n, i, j, symbolic.order)
    counts = counted(renumbered(graph_of(n, i, j), symbolic.order))
    np.testing.assert_array_equal(counts, pattern.sum(axis=0))
    for s in range(len(symbolic.first) - 1):
        begin, end = symbolic.first[s : s + 2]
        below = symbolic.row[symbolic.row_start[s] : symbolic.row_start[s + 1]]
        rows = np.flatnonzero(pattern[:, begin:end].any(axis=1))
        np.testing.assert_array_equal(below, rows[rows >= end])


@pytest.mark.parametrize("side", [2, 9, 40])
def test_the_order_keeps_a_grid_sparse(side):
    """Fill grows as n log n, far below the n √n of a band."""
    n = side * side
    graph = graph_of(n, *grid(side))
    counts = counted(renumbered(graph, minimum_degree(graph)))
    assert counts.sum() <= 1.4 * n * np.log2(n)


def test_little_room_for_lists_changes_nothing():
    rng = np.random.default_rng(5)
    i, j = random_graph(rng, 3000, 9000)
    graph = graph_of(3000, i, j)
    np.testing.assert_array_equal(minimum_degree(graph, room=1.0), minimum_degree(graph, room=9.0))


def test_a_hub_is_eliminated_last():
    """A well that touches every pore joins them all, whenever it goes before them."""
    i, j = grid(30)
    hub = np.full(900, 900)
    order = minimum_degree(
        graph_of(901, np.concatenate([i, hub]), np.concatenate([j, np.arange(900)]))
    )
    assert order[-1] == 900


def test_a_known_graph_is_not_analysed_again():
    i, j = grid(12)
    one = analyse(144, i, j)
    assert analyse(144, i.copy(), j.astype(np.int32)) is one
    assert analyse(145, i, j) is not one
    assert analyse(144, j, i) is not one


def test_a_factor_that_will_not_fit_is_not_begun():
    i, j = grid(500)
    symbolic = analyse_anew(250_000, i, j)
    assert symbolic.factor_bytes > 5e7
    with limited(1e8), pytest.raises(OutOfMemory, match=r"needs 0\.\d+ GB .* limits.memory"):
        factorise(symbolic, np.ones(len(i)), np.ones(250_000))
