"""Order of elimination that keeps the factor of a graph's matrix sparse.

Approximate minimum degree on the quotient graph (Amestoy, Davis & Duff 1996, SIAM J. Matrix
Anal. Appl. 17, 886–905). Eliminating a node makes its neighbours a clique; the clique is kept
as one list of its members, an *element*, so that the graph never grows. Nodes with the same
neighbours are eliminated together. The node with the least bound on its degree goes next.

Nodes are numbered breadth first before: neighbours then lie near each other in memory, which
on networks of a million pores saves more time than the numbering takes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.compile import kernel

# A node with more than this times √n neighbours is eliminated last: it would be scanned too
# often. (A well that touches very many pores.)
DENSE = 10.0

STAMPS = 2_000_000_000  # marks start anew before 32 bits run out

NONE = -1
LATE = -2  # `host` of the nodes that are eliminated last


class Graph(NamedTuple):
    """Neighbours of each node, without loops or repetition."""

    start: np.ndarray  # (n + 1,) int32
    neighbour: np.ndarray  # (2 e,) int32


def graph_of(n: int, i: np.ndarray, j: np.ndarray) -> Graph:
    """The graph of n nodes with edges (i, j)."""
    return Graph(*_adjacency(n, i, j))


def renumbered(graph: Graph, order: np.ndarray) -> Graph:
    """The same graph with node order[k] called k."""
    return Graph(*_renumber(graph.start, graph.neighbour, order, inverse(order)))


def inverse(order: np.ndarray) -> np.ndarray:
    """Rank of each node in an order."""
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order), dtype=order.dtype)
    return rank


def minimum_degree(graph: Graph, room: float = 1.25) -> np.ndarray:
    """Nodes of a graph in an order of approximately least degree, (n,) int32.

    `room` is the memory for lists over that of the graph.
    """
    n = len(graph.start) - 1
    nearby = _breadth_first(graph.start, graph.neighbour)
    start, neighbour = renumbered(graph, nearby)
    entry = np.empty(int(room * len(neighbour)) + n + 1, dtype=np.int32)
    entry[: len(neighbour)] = neighbour
    return nearby[_eliminate(start, entry)]


@kernel
def _adjacency(n, i, j):
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
    seen = np.full(n, NONE, np.int32)
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
def _renumber(start, neighbour, order, rank):
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
def _breadth_first(start, neighbour):
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


@kernel
def _eliminate(start, entry):
    """Eliminate all nodes; the order."""
    n = start.size - 1
    place, length = start[:n].copy(), start[1:] - start[:n]
    elements, size, degree = np.zeros(n, np.int32), np.ones(n, np.int32), length.copy()
    host, mark = np.full(n, NONE, np.int32), np.ones(n, np.int32)
    head, bucket = np.full(n, NONE, np.int32), np.full(n, NONE, np.int32)
    after, before = np.full(n, NONE, np.int32), np.full(n, NONE, np.int32)
    free = start[n]
    pivots = np.empty(n, np.int32)
    done, steps, least, largest = 0, 0, 0, 0
    dense = max(16, int(DENSE * np.sqrt(n)))
    for i in range(n):
        if length[i] == 0:
            place[i] = NONE
        if degree[i] > dense:
            size[i] = 0
            place[i] = NONE
            host[i] = LATE
            done += 1
        else:
            _enlist(degree, head, after, before, i, degree[i])
    stamp = 2
    while done < n:
        while head[least] == NONE:
            least += 1
        k = head[least]
        _delist(degree, head, after, before, k)
        pivots[steps] = k
        steps += 1
        done += size[k]
        had_elements = elements[k] > 0
        if had_elements and free + least >= entry.size:
            free = _squeeze(entry, place, length, free)
        end = _gather(
            entry, place, length, elements, size, degree, mark, head, after, before, k, free
        )
        if stamp > STAMPS - largest:
            stamp = _forget(mark)
        _measure_elements(entry, place, length, elements, size, degree, mark, k, stamp)
        done += _bound_degrees(
            entry,
            place,
            length,
            elements,
            size,
            degree,
            host,
            mark,
            after,
            before,
            bucket,
            k,
            stamp,
        )
        largest = max(largest, degree[k])
        stamp = _merge_alike(
            entry,
            place,
            length,
            elements,
            size,
            host,
            mark,
            after,
            before,
            bucket,
            k,
            stamp + largest,
        )
        least = min(
            least,
            _close(
                entry, place, length, elements, size, degree, mark, head, after, before, k, n - done
            ),
        )
        if had_elements:
            free = end if place[k] == NONE else place[k] + length[k]
    return _order(host, pivots[:steps])


@kernel
def _enlist(degree, head, after, before, i, d):
    """Put a variable into the list of a degree."""
    if head[d] != NONE:
        before[head[d]] = i
    after[i] = head[d]
    before[i] = NONE
    head[d] = i
    degree[i] = d


@kernel
def _delist(degree, head, after, before, i):
    """Take a variable from the list of its degree."""
    a, b = after[i], before[i]
    if a != NONE:
        before[a] = b
    if b != NONE:
        after[b] = a
    else:
        head[degree[i]] = a


@kernel
def _squeeze(entry, place, length, used):
    """Move the lists together; the first free entry."""
    for k in range(place.size):
        p = place[k]
        if p != NONE:
            place[k] = entry[p]  # kept here while the list's first entry bears its name
            entry[p] = -k - 1
    free, p = 0, 0
    while p < used:
        k = -entry[p] - 1
        p += 1
        if k >= 0:
            entry[free] = place[k]
            place[k] = free
            free += 1
            for _ in range(length[k] - 1):
                entry[free] = entry[p]
                free += 1
                p += 1
    return free


@kernel
def _gather(entry, place, length, elements, size, degree, mark, head, after, before, k, free):
    """Make variable k an element: all that it is joined to by edges or by elements.

    Those elements are absorbed; its variables leave their degree lists and carry a negative
    size. Returns the end of its list.
    """
    own, cliques = place[k], elements[k]
    first = free if cliques > 0 else own
    end = first
    size[k] = -size[k]
    total = 0
    for s in range(cliques + 1):
        if s < cliques:
            e = entry[own + s]
            lo, hi = place[e], place[e] + length[e]
        else:
            e = k
            lo, hi = own + cliques, own + length[k]
        for p in range(lo, hi):
            i = entry[p]
            if size[i] > 0:
                total += size[i]
                size[i] = -size[i]
                entry[end] = i
                end += 1
                _delist(degree, head, after, before, i)
        if e != k:
            mark[e] = 0
            place[e] = NONE
    degree[k] = total
    place[k] = first
    length[k] = end - first
    return end


@kernel
def _forget(mark):
    """Start the stamps anew."""
    for k in range(mark.size):
        if mark[k] != 0:
            mark[k] = 1
    return 2


@kernel
def _measure_elements(entry, place, length, elements, size, degree, mark, k, stamp):
    """mark[e] − stamp becomes the size of each element e that meets element k, outside of k."""
    for p in range(place[k], place[k] + length[k]):
        i = entry[p]
        nodes = -size[i]
        for q in range(place[i], place[i] + elements[i]):
            e = entry[q]
            if mark[e] >= stamp:
                mark[e] -= nodes
            elif mark[e] != 0:
                mark[e] = degree[e] + stamp - nodes


@kernel
def _bound_degrees(
    entry, place, length, elements, size, degree, host, mark, after, before, bucket, k, stamp
):
    """Prune the lists of element k's variables, bound their degrees, and hash their lists.

    Elements wholly inside k are absorbed; a variable joined to k alone is eliminated with it.
    Returns the number of nodes so eliminated.
    """
    gone = 0
    for p in range(place[k], place[k] + length[k]):
        i = entry[p]
        first = place[i]
        end = first
        bound = 0
        hashed = 0
        for q in range(first, first + elements[i]):
            e = entry[q]
            if mark[e] != 0:
                outside = mark[e] - stamp
                if outside > 0:
                    bound += outside
                    hashed += e
                    entry[end] = e
                    end += 1
                else:
                    mark[e] = 0
                    place[e] = NONE
        middle = end
        for q in range(first + elements[i], first + length[i]):
            j = entry[q]
            if size[j] > 0:
                bound += size[j]
                hashed += j
                entry[end] = j
                end += 1
        if bound == 0:
            gone -= size[i]
            _merge(place, elements, size, host, i, k)
        else:
            degree[i] = min(degree[i], bound)
            entry[end] = entry[middle]
            entry[middle] = entry[first]
            entry[first] = k
            elements[i] = middle - first + 1
            length[i] = end - first + 1
            hashed %= bucket.size
            after[i] = bucket[hashed]
            before[i] = hashed
            bucket[hashed] = i
    degree[k] -= gone
    return gone


@kernel
def _merge(place, elements, size, host, i, into):
    """Variable i is no more; `into` stands for it."""
    host[i] = into
    size[i] = 0
    elements[i] = 0
    place[i] = NONE


@kernel
def _merge_alike(entry, place, length, elements, size, host, mark, after, before, bucket, k, stamp):
    """Merge variables of element k whose lists are the same; the next free stamp."""
    for p in range(place[k], place[k] + length[k]):
        i = entry[p]
        if size[i] == 0:
            continue
        hashed = before[i]
        i = bucket[hashed]
        bucket[hashed] = NONE
        while i != NONE and after[i] != NONE:
            entries, cliques = length[i], elements[i]
            for q in range(place[i] + 1, place[i] + entries):
                mark[entry[q]] = stamp
            kept, j = i, after[i]
            while j != NONE:
                alike = length[j] == entries and elements[j] == cliques
                q = place[j] + 1
                end = place[j] + entries
                while alike and q < end:
                    alike = mark[entry[q]] == stamp
                    q += 1
                if alike:
                    size[i] += size[j]
                    _merge(place, elements, size, host, j, i)
                    after[kept] = after[j]
                else:
                    kept = j
                j = after[j]
            i = after[i]
            stamp += 1
    return stamp


@kernel
def _close(entry, place, length, elements, size, degree, mark, head, after, before, k, left):
    """Put what is left of element k's variables back into degree lists; the least degree."""
    first = place[k]
    end = first
    least = left
    for p in range(first, first + length[k]):
        i = entry[p]
        nodes = -size[i]
        if nodes > 0:
            size[i] = nodes
            bound = min(degree[i] + degree[k] - nodes, left - nodes)
            _enlist(degree, head, after, before, i, bound)
            least = min(least, bound)
            entry[end] = i
            end += 1
    size[k] = 0
    elements[k] = 0
    length[k] = end - first
    if end == first:
        mark[k] = 0
        place[k] = NONE
    return least


@kernel
def _order(host, pivots):
    """Pivots in their order, each followed by the nodes that were merged into it."""
    n = host.size
    rank = np.full(n, NONE, np.int32)
    for q in range(pivots.size):
        rank[pivots[q]] = q
    late = pivots.size
    for i in range(n):
        if host[i] == LATE:
            rank[i] = late
            late += 1
    for i in range(n):
        r = i
        while rank[r] == NONE:
            r = host[r]
        found = rank[r]
        r = i
        while rank[r] == NONE:
            rank[r] = found
            r = host[r]
    place = np.zeros(n + 1, np.int32)
    for i in range(n):
        place[rank[i] + 1] += 1
    for q in range(n):
        place[q + 1] += place[q]
    order = np.empty(n, np.int32)
    for i in range(n):
        order[place[rank[i]]] = i
        place[rank[i]] += 1
    return order
