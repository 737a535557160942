"""Subtraction-free factorisation of the flow equation's matrices.

K = G + s C is a diagonally dominant M-matrix: it is given by conductances of edges and
by each row's excess (conductance to fixed pressures plus s times storage), and its
diagonal is their sum. Eliminating a node turns its edges into edges between its
neighbours; written with edges and excesses, every step adds positive numbers, so that
no digit cancels however far the conductances lie apart (Grassmann, Taksar & Heyman
1985; O'Cinneide 1993). An ordinary LDLᵀ stores the diagonal and loses, at a contrast of
1e12, whatever the excess held.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import qdldl
from scipy.sparse import coo_array, csc_array

from model.compile import kernel


class Symbolic(NamedTuple):
    """Elimination order and pattern of the factor; shared by every matrix of one graph."""

    order: np.ndarray  # (n,) node eliminated k-th
    rank: np.ndarray  # (n,) its inverse
    start: np.ndarray  # (n + 1,) first entry of each column of L
    row: np.ndarray  # (nnz,) rows below the diagonal, ascending
    edge_slot: np.ndarray  # (e,) entry of L that an edge starts in


class Factor(NamedTuple):
    """K = L D Lᵀ of one matrix, in elimination order; L is −`lower` below a unit diagonal."""

    symbolic: Symbolic
    lower: np.ndarray  # (nnz,)
    pivot: np.ndarray  # (n,)


def analyse(n: int, i: np.ndarray, j: np.ndarray) -> Symbolic:
    """Order the nodes of a graph with edges (i, j) to keep the factor sparse, and find its pattern.

    Minimum-degree order (AMD, through qdldl).
    """
    order = _minimum_degree(n, i, j)
    rank = np.empty(n, dtype=np.int64)
    rank[order] = np.arange(n)
    low = np.minimum(rank[i], rank[j])
    high = np.maximum(rank[i], rank[j])
    by_row = np.lexsort((low, high))
    row_start = np.searchsorted(high[by_row], np.arange(n + 1))
    parent, counts = _elimination_tree(n, row_start, low[by_row])
    start = np.concatenate([[0], np.cumsum(counts)])
    row = _fill_pattern(n, row_start, low[by_row], parent, start)
    edge_slot = _find_slots(start, row, low, high)
    return Symbolic(order, rank, start, row, edge_slot)


def factorise(symbolic: Symbolic, conductance: np.ndarray, excess: np.ndarray) -> Factor:
    """Factor the matrix with the given edge conductances (e,) ≥ 0 and row excesses (n,) ≥ 0.

    A node with neither edge nor excess makes the matrix singular; its pivot is zero and
    the solution there infinite.
    """
    lower, pivot = _numeric(
        symbolic.start,
        symbolic.row,
        symbolic.edge_slot,
        conductance,
        np.ascontiguousarray(excess[symbolic.order]),
    )
    return Factor(symbolic, lower, pivot)


def solve(factor: Factor, rhs: np.ndarray) -> np.ndarray:
    """Solve K x = rhs for one (n,) or several (n, k) right-hand sides."""
    symbolic = factor.symbolic
    flat = rhs.ndim == 1
    x = np.ascontiguousarray(rhs[symbolic.order].reshape(len(rhs), 1 if flat else rhs.shape[1]))
    _substitute(symbolic.start, symbolic.row, factor.lower, factor.pivot, x)
    x = x[symbolic.rank]
    return x[:, 0] if flat else x


def _minimum_degree(n: int, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Approximate-minimum-degree order of a graph."""
    if n < 3 or len(i) == 0:
        return np.arange(n)
    upper = coo_array(
        (np.full(len(i), -1.0), (np.minimum(i, j), np.maximum(i, j))), shape=(n, n)
    ).tocsc()
    diagonal = np.ones(n) + np.bincount(i, minlength=n) + np.bincount(j, minlength=n)
    matrix = upper + coo_array((diagonal, (np.arange(n), np.arange(n))), shape=(n, n)).tocsc()
    _, _, order = qdldl.Solver(csc_array(matrix), upper=True).factors()
    return np.asarray(order, dtype=np.int64)


@kernel
def _elimination_tree(n, row_start, low):
    """Parent of each column and number of entries below the diagonal (Liu 1990)."""
    parent = np.full(n, -1, np.int64)
    counts = np.zeros(n, np.int64)
    mark = np.empty(n, np.int64)
    for i in range(n):
        mark[i] = i
        for p in range(row_start[i], row_start[i + 1]):
            k = low[p]
            while mark[k] != i:
                if parent[k] < 0:
                    parent[k] = i
                counts[k] += 1
                mark[k] = i
                k = parent[k]
    return parent, counts


@kernel
def _fill_pattern(n, row_start, low, parent, start):
    row = np.empty(start[n], np.int64)
    filled = start[:n].copy()
    mark = np.empty(n, np.int64)
    for i in range(n):
        mark[i] = i
        for p in range(row_start[i], row_start[i + 1]):
            k = low[p]
            while mark[k] != i:
                row[filled[k]] = i
                filled[k] += 1
                mark[k] = i
                k = parent[k]
    return row


@kernel
def _find_slots(start, row, low, high):
    slot = np.empty(low.size, np.int64)
    for e in range(low.size):
        lo, hi = start[low[e]], start[low[e] + 1]
        while lo < hi:
            middle = (lo + hi) // 2
            if row[middle] < high[e]:
                lo = middle + 1
            else:
                hi = middle
        slot[e] = lo
    return slot


@kernel
def _numeric(start, row, edge_slot, conductance, excess):
    """Left-looking elimination; `waiting` links the columns whose next row is the current one."""
    n = excess.size
    lower = np.zeros(row.size)
    for e in range(edge_slot.size):
        lower[edge_slot[e]] += conductance[e]
    pivot = np.empty(n)
    work = np.zeros(n)
    head = np.full(n, -1, np.int64)
    waiting = np.full(n, -1, np.int64)
    place = np.empty(n, np.int64)
    for k in range(n):
        s = excess[k]
        for p in range(start[k], start[k + 1]):
            work[row[p]] = lower[p]
        c = head[k]
        while c >= 0:
            after = waiting[c]
            p = place[c]
            edge = lower[p] * pivot[c]  # conductance c–k when c was eliminated
            s += lower[p] * excess[c]
            for r in range(p + 1, start[c + 1]):
                work[row[r]] += edge * lower[r]
            if p + 1 < start[c + 1]:
                place[c] = p + 1
                waiting[c] = head[row[p + 1]]
                head[row[p + 1]] = c
            c = after
        excess[k] = s
        d = s
        for p in range(start[k], start[k + 1]):
            d += work[row[p]]
        pivot[k] = d
        for p in range(start[k], start[k + 1]):
            lower[p] = work[row[p]] / d
            work[row[p]] = 0.0
        if start[k] < start[k + 1]:
            place[k] = start[k]
            waiting[k] = head[row[start[k]]]
            head[row[start[k]]] = k
    return lower, pivot


@kernel
def _substitute(start, row, lower, pivot, x):
    n = pivot.size
    m = x.shape[1]
    for k in range(n):
        for p in range(start[k], start[k + 1]):
            for c in range(m):
                x[row[p], c] += lower[p] * x[k, c]
    for k in range(n - 1, -1, -1):
        for c in range(m):
            x[k, c] /= pivot[k]
        for p in range(start[k], start[k + 1]):
            for c in range(m):
                x[k, c] += lower[p] * x[row[p], c]
