"""Order of elimination that keeps the factor of a graph's matrix sparse.

Approximate minimum degree on the quotient graph (Amestoy, Davis & Duff 1996, SIAM J. Matrix
Anal. Appl. 17, 886–905). Eliminating a node makes its neighbours a clique; the clique is kept
as one list of its members, an *element*, so that the graph never grows. Nodes with the same
neighbours are eliminated together. The node with the least bound on its degree goes next.

The symbols of the paper, and what they are here:

    variable i, supervariable **i**
        a node i that is not eliminated yet, alone or with those merged into it
    pivot p, element e
        node k that is eliminated; from then on its list is that of an element
    A_i
        the list of i behind its elements: neighbours by edges that no element covers
    E_i
        the first ELEMENTS entries of the list of i: the elements that it belongs to
    L_e
        the list of element e, LENGTH entries from PLACE on: the variables of the clique
    L_p = (A_p ∪ ⋃ L_e over e in E_p) ∖ p
        `_gather`
    |**i**|
        SIZE: nodes that i stands for; negative while i lies in the element being made
    |L_e|, and d̄_i, a bound on the external degree
        DEGREE, of an element and of a variable
    w(e) = |L_e ∖ L_p|
        MARK less the stamp, by `_measure_elements` (algorithm 2)
    d̄_i = min(n − k, d̄_i before + |L_p ∖ **i**|, |A_i ∖ **i**| + |L_p ∖ **i**| + Σ |L_e ∖ L_p|)
        the second and third less |L_p ∖ **i**| by `_bound_degrees`; that and the first by `_close`
    aggressive absorption
        an element with w(e) = 0 goes into p, in `_bound_degrees`
    mass elimination
        a variable with nothing beyond L_p goes with p, in `_bound_degrees`
    indistinguishable variables, hash(i)
        `_merge_alike`, among those of one `bucket`
    parent in the assembly tree
        `host`

Nodes are numbered breadth first before: neighbours then lie near each other in memory, which
on networks of a million pores saves more time than the numbering takes.
"""

from __future__ import annotations

import numpy as np

from demflow.model.compile import Array, kernel
from demflow.model.flow.linear.graph import Graph, breadth_first, renumbered

# A node with more than this times √n neighbours is eliminated last: it would be scanned too
# often. (A well that touches very many pores.)
DENSE = 10.0

STAMPS = 2_000_000_000  # marks start anew before 32 bits run out

# What is known of each node stands together, so that one look brings it into the cache: where
# its list begins and how long it is, how many elements lead it, how many nodes it stands for
# (0: merged, below 0: in the element being made), a bound on its degree, an element's size
# outside another, and its neighbours in the list of its degree.
PLACE, LENGTH, ELEMENTS, SIZE, DEGREE, MARK, AFTER, BEFORE = range(8)
FIELDS = 8

NONE = -1
LATE = -2  # `host` of the nodes that are eliminated last


def minimum_degree(graph: Graph, room: float = 1.25) -> np.ndarray:
    """Nodes of a graph in an order of approximately least degree, (n,) int32.

    `room` is the memory for lists over that of the graph.
    """
    n = len(graph.start) - 1
    nearby = breadth_first(graph)
    start, neighbour = renumbered(graph, nearby)
    entry = np.empty(int(room * len(neighbour)) + n + 1, dtype=np.int32)
    entry[: len(neighbour)] = neighbour
    found: np.ndarray = nearby[_eliminate(start, entry)]
    return found


@kernel
def _eliminate(start: Array, entry: Array) -> Array:
    """Eliminate all nodes; the order."""
    n = start.size - 1
    node = np.empty((n, FIELDS), np.int32)
    host = np.full(n, NONE, np.int32)
    head, bucket = np.full(n, NONE, np.int32), np.full(n, NONE, np.int32)
    free = start[n]
    pivots = np.empty(n, np.int32)
    done, steps, least, largest = 0, 0, 0, 0
    dense = max(16, int(DENSE * np.sqrt(n)))
    for i in range(n):
        node[i, PLACE] = start[i]
        node[i, LENGTH] = node[i, DEGREE] = start[i + 1] - start[i]
        node[i, ELEMENTS] = 0
        node[i, SIZE] = node[i, MARK] = 1
        node[i, AFTER] = node[i, BEFORE] = NONE
        if node[i, LENGTH] == 0:
            node[i, PLACE] = NONE
        if node[i, DEGREE] > dense:
            node[i, SIZE] = 0
            node[i, PLACE] = NONE
            host[i] = LATE
            done += 1
        else:
            _enlist(node, head, i, node[i, DEGREE])
    stamp = 2
    while done < n:
        while head[least] == NONE:
            least += 1
        k = head[least]
        _delist(node, head, k)
        pivots[steps] = k
        steps += 1
        done += node[k, SIZE]
        had_elements = node[k, ELEMENTS] > 0
        if had_elements and free + least >= entry.size:
            free = _squeeze(entry, node, free)
        end = _gather(entry, node, head, k, free)
        if stamp > STAMPS - largest:
            stamp = _forget(node)
        _measure_elements(entry, node, k, stamp)
        done += _bound_degrees(entry, node, host, bucket, k, stamp)
        largest = max(largest, node[k, DEGREE])
        stamp = _merge_alike(entry, node, host, bucket, k, stamp + largest)
        least = min(least, _close(entry, node, head, k, n - done))
        if had_elements:
            free = end if node[k, PLACE] == NONE else node[k, PLACE] + node[k, LENGTH]
    return _order(host, pivots[:steps])


@kernel
def _enlist(node: Array, head: Array, i: int, d: int) -> None:
    """Put a variable into the list of a degree."""
    if head[d] != NONE:
        node[head[d], BEFORE] = i
    node[i, AFTER] = head[d]
    node[i, BEFORE] = NONE
    head[d] = i
    node[i, DEGREE] = d


@kernel
def _delist(node: Array, head: Array, i: int) -> None:
    """Take a variable from the list of its degree."""
    a, b = node[i, AFTER], node[i, BEFORE]
    if a != NONE:
        node[a, BEFORE] = b
    if b != NONE:
        node[b, AFTER] = a
    else:
        head[node[i, DEGREE]] = a


@kernel
def _squeeze(entry: Array, node: Array, used: int) -> int:
    """Move the lists together; the first free entry."""
    for k in range(len(node)):
        p = node[k, PLACE]
        if p != NONE:
            node[k, PLACE] = entry[p]  # kept here while the list's first entry bears its name
            entry[p] = -k - 1
    free, p = 0, 0
    while p < used:
        k = -entry[p] - 1
        p += 1
        if k >= 0:
            entry[free] = node[k, PLACE]
            node[k, PLACE] = free
            free += 1
            for _ in range(node[k, LENGTH] - 1):
                entry[free] = entry[p]
                free += 1
                p += 1
    return free


@kernel
def _gather(entry: Array, node: Array, head: Array, k: int, free: int) -> int:
    """Make variable k an element: all that it is joined to by edges or by elements.

    Those elements are absorbed; its variables leave their degree lists and carry a negative
    size. Returns the end of its list.
    """
    own, cliques = node[k, PLACE], node[k, ELEMENTS]
    first = free if cliques > 0 else own
    end = first
    node[k, SIZE] = -node[k, SIZE]
    total = 0
    for s in range(cliques + 1):
        if s < cliques:
            e = entry[own + s]
            lo, hi = node[e, PLACE], node[e, PLACE] + node[e, LENGTH]
        else:
            e = k
            lo, hi = own + cliques, own + node[k, LENGTH]
        for p in range(lo, hi):
            i = entry[p]
            if node[i, SIZE] > 0:
                total += node[i, SIZE]
                node[i, SIZE] = -node[i, SIZE]
                entry[end] = i
                end += 1
                _delist(node, head, i)
        if e != k:
            node[e, MARK] = 0
            node[e, PLACE] = NONE
    node[k, DEGREE] = total
    node[k, PLACE] = first
    node[k, LENGTH] = end - first
    return end


@kernel
def _forget(node: Array) -> int:
    """Start the stamps anew."""
    for k in range(len(node)):
        if node[k, MARK] != 0:
            node[k, MARK] = 1
    return 2


@kernel
def _measure_elements(entry: Array, node: Array, k: int, stamp: int) -> None:
    """The mark of each element that meets element k becomes stamp + its size outside of k."""
    for p in range(node[k, PLACE], node[k, PLACE] + node[k, LENGTH]):
        i = entry[p]
        nodes = -node[i, SIZE]
        for q in range(node[i, PLACE], node[i, PLACE] + node[i, ELEMENTS]):
            e = entry[q]
            if node[e, MARK] >= stamp:
                node[e, MARK] -= nodes
            elif node[e, MARK] != 0:
                node[e, MARK] = node[e, DEGREE] + stamp - nodes


@kernel
def _bound_degrees(
    entry: Array, node: Array, host: Array, bucket: Array, k: int, stamp: int
) -> int:
    """Prune the lists of element k's variables, bound their degrees, and hash their lists.

    Elements wholly inside k are absorbed; a variable joined to k alone is eliminated with it.
    Returns the number of nodes so eliminated.
    """
    gone = 0
    for p in range(node[k, PLACE], node[k, PLACE] + node[k, LENGTH]):
        i = entry[p]
        first = node[i, PLACE]
        end = first
        bound = 0
        hashed = 0
        for q in range(first, first + node[i, ELEMENTS]):
            e = entry[q]
            if node[e, MARK] != 0:
                outside = node[e, MARK] - stamp
                if outside > 0:
                    bound += outside
                    hashed += e
                    entry[end] = e
                    end += 1
                else:
                    node[e, MARK] = 0
                    node[e, PLACE] = NONE
        middle = end
        for q in range(first + node[i, ELEMENTS], first + node[i, LENGTH]):
            j = entry[q]
            if node[j, SIZE] > 0:
                bound += node[j, SIZE]
                hashed += j
                entry[end] = j
                end += 1
        if bound == 0:
            gone -= node[i, SIZE]
            _merge(node, host, i, k)
        else:
            node[i, DEGREE] = min(node[i, DEGREE], bound)
            entry[end] = entry[middle]
            entry[middle] = entry[first]
            entry[first] = k
            node[i, ELEMENTS] = middle - first + 1
            node[i, LENGTH] = end - first + 1
            hashed %= bucket.size
            node[i, AFTER] = bucket[hashed]
            node[i, BEFORE] = hashed
            bucket[hashed] = i
    node[k, DEGREE] -= gone
    return gone


@kernel
def _merge(node: Array, host: Array, i: int, into: int) -> None:
    """Variable i is no more; `into` stands for it."""
    host[i] = into
    node[i, SIZE] = 0
    node[i, ELEMENTS] = 0
    node[i, PLACE] = NONE


@kernel
def _merge_alike(entry: Array, node: Array, host: Array, bucket: Array, k: int, stamp: int) -> int:
    """Merge variables of element k whose lists are the same; the next free stamp."""
    for p in range(node[k, PLACE], node[k, PLACE] + node[k, LENGTH]):
        i = entry[p]
        if node[i, SIZE] == 0:
            continue
        hashed = node[i, BEFORE]
        i = bucket[hashed]
        bucket[hashed] = NONE
        while i != NONE and node[i, AFTER] != NONE:
            entries, cliques = node[i, LENGTH], node[i, ELEMENTS]
            for q in range(node[i, PLACE] + 1, node[i, PLACE] + entries):
                node[entry[q], MARK] = stamp
            kept, j = i, node[i, AFTER]
            while j != NONE:
                alike = node[j, LENGTH] == entries and node[j, ELEMENTS] == cliques
                q = node[j, PLACE] + 1
                end = node[j, PLACE] + entries
                while alike and q < end:
                    alike = node[entry[q], MARK] == stamp
                    q += 1
                if alike:
                    node[i, SIZE] += node[j, SIZE]
                    _merge(node, host, j, i)
                    node[kept, AFTER] = node[j, AFTER]
                else:
                    kept = j
                j = node[j, AFTER]
            i = node[i, AFTER]
            stamp += 1
    return stamp


@kernel
def _close(entry: Array, node: Array, head: Array, k: int, left: int) -> int:
    """Put what is left of element k's variables back into degree lists; the least degree."""
    first = node[k, PLACE]
    end = first
    least = left
    for p in range(first, first + node[k, LENGTH]):
        i = entry[p]
        nodes = -node[i, SIZE]
        if nodes > 0:
            node[i, SIZE] = nodes
            bound = min(node[i, DEGREE] + node[k, DEGREE] - nodes, left - nodes)
            _enlist(node, head, i, bound)
            least = min(least, bound)
            entry[end] = i
            end += 1
    node[k, SIZE] = 0
    node[k, ELEMENTS] = 0
    node[k, LENGTH] = end - first
    if end == first:
        node[k, MARK] = 0
        node[k, PLACE] = NONE
    return least


@kernel
def _order(host: Array, pivots: Array) -> Array:
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
