"""Graphs of unknowns: who is joined to whom, by any numbering."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import Array, kernel


class Graph(NamedTuple):
    """Neighbours of each node, without loops or repetition."""

    start: np.ndarray  # (n + 1,) int32
    neighbour: np.ndarray  # (2 e,) int32


def graph_of(n: int, i: np.ndarray, j: np.ndarray) -> Graph:
    """The graph of n nodes with edges (i, j).

    Parameters
    ----------
    n : number of nodes
    i : first ends of the edges, (e,) int
    j : second ends, (e,) int
    """
    return Graph(*_adjacency(n, i, j))


def renumbered(graph: Graph, order: np.ndarray) -> Graph:
    """The same graph with node order[k] called k."""
    return Graph(*_renumber(graph.start, graph.neighbour, order, inverse(order)))


def inverse(order: np.ndarray) -> np.ndarray:
    """Rank of each node in an order."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order), dtype=order.dtype)
    return rank


def breadth_first(graph: Graph) -> np.ndarray:
    """Nodes in breadth-first order, part by part, (n,) int32."""
    return np.asarray(_breadth_first(*graph))


@kernel
def _adjacency(n: int, i: Array, j: Array) -> tuple[Array, Array]:
    start = np.zeros(n + 1, np.int32)
    for e in range(i.size):
        if i[e] != j[e]:
            start[i[e] + 1] += 1
            start[j[e] + 1] += 1
    for k in range(n):
        start[k + 1] += start[k]
    neighbour = np.empty(start[n], np.int32)
    fill = start[:n].copy()
    for e in range(i.size):
        a, b = i[e], j[e]
        if a != b:
            neighbour[fill[a]] = b
            fill[a] += 1
            neighbour[fill[b]] = a
            fill[b] += 1
    seen = np.full(n, -1, np.int32)
    used, lo = 0, 0
    for k in range(n):
        hi = start[k + 1]
        for p in range(lo, hi):
            b = neighbour[p]
            if seen[b] != k:
                seen[b] = k
                neighbour[used] = b
                used += 1
        lo = hi
        start[k + 1] = used
    return start, neighbour[:used].copy()


@kernel
def _renumber(start: Array, neighbour: Array, order: Array, rank: Array) -> tuple[Array, Array]:
    new_start = np.empty_like(start)
    new = np.empty_like(neighbour)
    new_start[0] = 0
    used = 0
    for k in range(order.size):
        for p in range(start[order[k]], start[order[k] + 1]):
            new[used] = rank[neighbour[p]]
            used += 1
        new_start[k + 1] = used
    return new_start, new


@kernel
def _breadth_first(start: Array, neighbour: Array) -> Array:
    n = start.size - 1
    order = np.empty(n, np.int32)
    seen = np.zeros(n, np.bool_)
    head, tail = 0, 0
    for root in range(n):
        if seen[root]:
            continue
        seen[root] = True
        order[tail] = root
        tail += 1
        while head < tail:
            k = order[head]
            head += 1
            for p in range(start[k], start[k + 1]):
                if not seen[neighbour[p]]:
                    seen[neighbour[p]] = True
                    order[tail] = neighbour[p]
                    tail += 1
    return order
