"""What eliminating the nodes of a graph will do, found before any number is known.

The elimination tree (Liu 1990, SIAM J. Matrix Anal. Appl. 11, 134–172) gives the pattern of
the factor; the number of entries of each of its columns comes from the tree and the edges
alone (Gilbert, Ng & Peyton 1994, same journal 15, 1075–1091), so that the size of a factor is
known before it is made. Neighbouring columns of (nearly) one pattern are put together into
fronts, dense blocks that are fast to work with (Ashcraft & Grimes 1989, ACM Trans. Math.
Softw. 15, 291–309).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import Array, kernel
from demflow.model.flow.linear.graph import graph_of, inverse, renumbered
from demflow.model.flow.linear.kept import Kept
from demflow.model.flow.linear.ordering import minimum_degree

# Fronts join while explicit zeros are at most this part of their entries: small ones save
# bookkeeping, large ones would cost arithmetic.
SMALL_FRONT = 16
ZEROS_IN_SMALL = 0.3
ZEROS = 0.02

# Memory that analyses of other graphs may keep.
KEPT_BYTES = 1 << 26


class Symbolic(NamedTuple):
    """Elimination order and fronts of the factor; shared by every matrix of one graph.

    Front s eliminates the nodes ranked first[s] … first[s + 1] − 1 and joins them to the rows
    row[row_start[s]] … below; its columns lie dense, one after the other, from place[s] on.
    """

    order: np.ndarray  # (n,) node eliminated k-th
    rank: np.ndarray  # (n,) its inverse
    first: np.ndarray  # (fronts + 1,)
    row_start: np.ndarray  # (fronts + 1,)
    row: np.ndarray  # ranks, ascending in each front
    place: np.ndarray  # (fronts + 1,) first entry of each front in the factor
    children: np.ndarray  # (fronts,) how many fronts hand their rest to this one
    edge_slot: np.ndarray  # (e,) entry of the factor that an edge starts in
    stacked: int  # most entries that wait to be handed on
    widest: int  # most rows below a front

    @property
    def factor_bytes(self) -> int:
        """Memory of one factor."""
        return 8 * (int(self.place[-1]) + len(self.order))

    @property
    def work_bytes(self) -> int:
        """Memory that making a factor takes beside it."""
        return 8 * (self.stacked + 2 * self.widest**2 + 4 * len(self.order))


def analyse(n: int, i: np.ndarray, j: np.ndarray) -> Symbolic:
    """Order the n nodes of a graph with edges (i, j), (e,), and find the pattern of its factor.

    The last few analyses are kept: fluids, apertures and time steps change the numbers of a
    case, seldom its graph.

    Parameters
    ----------
    n : number of nodes
    i : first ends of the edges, (e,) int
    j : second ends, (e,) int
    """
    return _kept.get(
        (n, np.asarray(i, dtype=np.int64), np.asarray(j, dtype=np.int64)),
        lambda: analyse_anew(n, i, j),
    )


_kept: Kept[Symbolic] = Kept(KEPT_BYTES, lambda s: sum(np.asarray(array).nbytes for array in s))


def analyse_anew(n: int, i: np.ndarray, j: np.ndarray) -> Symbolic:
    """As `analyse`, without a look at what is known already.

    Parameters
    ----------
    n : number of nodes
    i : first ends of the edges, (e,) int
    j : second ends, (e,) int
    """
    graph = graph_of(n, i, j)
    order = minimum_degree(graph)
    by_degree = renumbered(graph, order)
    parent = elimination_tree(*by_degree)
    post = postorder(parent, np.zeros(n, dtype=np.int64))
    count = column_counts(*by_degree, parent, post)
    # children with larger columns last: they are the ones to join their parent's front
    post = postorder(parent, count)
    order, count = order[post], count[post]
    parent = np.append(inverse(post), np.int32(-1))[parent[post]]
    begins = _fronts(parent, count, SMALL_FRONT, ZEROS_IN_SMALL, ZEROS)
    first = np.append(np.flatnonzero(begins), n)
    row_start = np.concatenate([[0], np.cumsum(count[first[1:] - 1])])
    place = np.concatenate([[0], np.cumsum(np.diff(first) * (np.diff(first) + np.diff(row_start)))])
    front_of = np.cumsum(begins) - 1
    above = np.append(front_of, -1)[parent[first[1:] - 1]]
    row = _rows(*renumbered(graph, order), front_of, above, row_start)
    rank = inverse(order)
    children = np.bincount(above[above >= 0], minlength=len(above))
    return Symbolic(
        order=order,
        rank=rank,
        first=first,
        row_start=row_start,
        row=row,
        place=place,
        children=children,
        edge_slot=_slots(rank[i], rank[j], front_of, first, row_start, row, place),
        stacked=_stacked(row_start, children),
        widest=int(np.diff(row_start).max(initial=0)),
    )


@kernel
def elimination_tree(start: Array, neighbour: Array) -> Array:
    """Parent of each column (Liu 1990), −1 of a root."""
    n = start.size - 1
    parent = np.full(n, -1, np.int32)
    ancestor = np.full(n, -1, np.int32)
    for k in range(n):
        for p in range(start[k], start[k + 1]):
            i = neighbour[p]
            while i != -1 and i < k:
                up = ancestor[i]
                ancestor[i] = k
                if up == -1:
                    parent[i] = k
                i = up
    return parent


@kernel
def postorder(parent: Array, weight: Array) -> Array:
    """Nodes of a forest, children before parents, lighter children first."""
    n = parent.size
    heaviest = 0
    for k in range(n):
        heaviest = max(heaviest, weight[k])
    fill = np.zeros(heaviest + 2, np.int64)
    for k in range(n):
        fill[weight[k] + 1] += 1
    for c in range(heaviest + 1):
        fill[c + 1] += fill[c]
    by_weight = np.empty(n, np.int32)
    for k in range(n):
        by_weight[fill[weight[k]]] = k
        fill[weight[k]] += 1
    child = np.full(n, -1, np.int32)
    sibling = np.full(n, -1, np.int32)
    for q in range(n - 1, -1, -1):
        k = by_weight[q]
        if parent[k] >= 0:
            sibling[k] = child[parent[k]]
            child[parent[k]] = k
    order = np.empty(n, np.int32)
    path = np.empty(n, np.int32)
    done = 0
    for root in range(n):
        if parent[root] >= 0:
            continue
        top = 0
        path[0] = root
        while top >= 0:
            k = path[top]
            c = child[k]
            if c >= 0:
                child[k] = sibling[c]
                top += 1
                path[top] = c
            else:
                order[done] = k
                done += 1
                top -= 1
    return order


@kernel
def column_counts(  # noqa: C901 (a kernel)
    start: Array, neighbour: Array, parent: Array, post: Array
) -> Array:
    """Count, for each column, the leaves of the row subtrees that hang on it.

    Parameters
    ----------
    start : where the neighbours of each node begin, (n + 1,)
    neighbour : neighbours, by the order of elimination
    parent : elimination tree, (n,)
    post : its postorder, (n,)
    """
    n = parent.size
    first = np.full(n, -1, np.int32)  # descendant that comes first in the postorder
    count = np.zeros(n, np.int64)
    for k in range(n):
        j = post[k]
        count[j] = 1 if first[j] == -1 else 0
        while j != -1 and first[j] == -1:
            first[j] = k
            j = parent[j]
    furthest = np.full(n, -1, np.int32)
    last_leaf = np.full(n, -1, np.int32)
    ancestor = np.arange(n).astype(np.int32)
    for k in range(n):
        j = post[k]
        if parent[j] != -1:
            count[parent[j]] -= 1
        for p in range(start[j], start[j + 1]):
            i = neighbour[p]
            if i <= j or first[j] <= furthest[i]:
                continue
            furthest[i] = first[j]
            leaf = last_leaf[i]
            last_leaf[i] = j
            count[j] += 1
            if leaf != -1:
                meet = leaf
                while meet != ancestor[meet]:
                    meet = ancestor[meet]
                while leaf != meet:
                    up = ancestor[leaf]
                    ancestor[leaf] = meet
                    leaf = up
                count[meet] -= 1
        if parent[j] != -1:
            ancestor[j] = parent[j]
    for j in range(n):
        if parent[j] != -1:
            count[parent[j]] += count[j]
    return count - 1


@kernel
def _fronts(
    parent: Array, count: Array, small: int, zeros_in_small: float, zeros_in_large: float
) -> Array:
    """Which columns begin a front, the nodes in postorder.

    From the last column back, a run of columns of one pattern joins the front of its parent
    where that does not bring in too many zeros.
    """
    n = parent.size
    begins = np.ones(n, np.bool_)
    for j in range(1, n):
        begins[j] = parent[j - 1] != j or count[j - 1] != count[j] + 1
    front, width, rows, zeros = -1, 0, 0, 0
    j = n - 1
    while j >= 0:
        last = j
        while not begins[j]:
            j -= 1
        own = last - j + 1
        joins = False
        if front >= 0 and parent[last] == front:
            more = zeros + own * (width + rows - count[last])
            both = own + width
            share = zeros_in_small if both <= small else zeros_in_large
            joins = more <= share * (both * (both + 1) // 2 + both * rows)
        if joins:
            begins[front] = False
            width, zeros = both, more
        else:
            width, rows, zeros = own, count[last], 0
        front = j
        j -= 1
    return begins


@kernel
def _rows(start: Array, neighbour: Array, front_of: Array, above: Array, row_start: Array) -> Array:
    """Rows below each front: from each edge up the tree, until the row itself is eliminated."""
    row = np.empty(row_start[-1], np.int32)
    fill = row_start[:-1].copy()
    seen = np.full(above.size, -1, np.int32)
    for i in range(front_of.size):
        seen[front_of[i]] = i
        for p in range(start[i], start[i + 1]):
            if neighbour[p] < i:
                s = front_of[neighbour[p]]
                while seen[s] != i:
                    seen[s] = i
                    row[fill[s]] = i
                    fill[s] += 1
                    s = above[s]
    return row


@kernel
def _slots(
    a: Array, b: Array, front_of: Array, first: Array, row_start: Array, row: Array, place: Array
) -> Array:
    slot = np.empty(a.size, np.int64)
    for e in range(a.size):
        low, high = min(a[e], b[e]), max(a[e], b[e])
        s = front_of[low]
        width = first[s + 1] - first[s]
        height = width + row_start[s + 1] - row_start[s]
        at = high - first[s]
        if at >= width:
            lo, hi = row_start[s], row_start[s + 1]
            while lo < hi:
                middle = (lo + hi) // 2
                if row[middle] < high:
                    lo = middle + 1
                else:
                    hi = middle
            at = width + lo - row_start[s]
        slot[e] = place[s] + (low - first[s]) * height + at
    return slot


@kernel
def _stacked(row_start: Array, children: Array) -> int:
    """Most entries on the stack of what fronts hand on."""
    waiting = np.empty(children.size + 1, np.int64)
    count, top, most = 0, 0, 0
    for s in range(children.size):
        for _ in range(children[s]):
            count -= 1
            top -= waiting[count]
        m = row_start[s + 1] - row_start[s]
        if m > 0:
            waiting[count] = m * (m - 1) // 2
            top += waiting[count]
            count += 1
            most = max(most, top)
    return most
