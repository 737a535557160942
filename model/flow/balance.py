"""Steady pressure and the flows that go with it, so that every pore balances at any contrast.

The subtraction-free factor gives each pressure to the last digit or two. The flow along a
strong edge is the difference of two pressures that agree in more digits than a double has, so
that pressures alone cannot tell it. Iterative refinement on flows along edges finds the digits
that follow: the pressure is kept as a sum of two doubles p + δ, the flow is
g ((pᵢ − pⱼ) + (δᵢ − δⱼ)), and what does not balance is solved for again. What is left then,
where strong pipes lead nowhere, is drained along the tree of the strongest edges.

Each of these is done only where the balance asks for it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.compile import kernel
from model.flow.factor import Factor, solve
from model.flow.system import System

# Refinement ends where no pore is out of balance by more than this part of the flow through
# it, nor the whole by more than this part of the flow through the whole; a network of like
# apertures is there at once.
PORE_BALANCED = 1e-11
WHOLE_BALANCED = 1e-14
MOST_REFINEMENTS = 4

# Part of the flow through the whole below which a pore counts as stagnant.
STAGNANT = 1e-15

# A unit of pressure across the strongest pipe, times this, is no flow: two doubles end there.
NOTHING = 1e-30


class SteadyFlow(NamedTuple):
    """Response of pressures and flows to a unit of one source."""

    pressure: np.ndarray  # (n,) Pa
    remainder: np.ndarray  # (n,) Pa, whose differences tell the flows of strong edges
    edge: np.ndarray  # (e,) flow from edge_i to edge_j, m³/s
    link: np.ndarray  # (f,) flow from the fixed pressure into fixed_node, m³/s
    imbalance: float  # largest of a pore, over the flow through it or through stagnant ones
    refinements: int

    def inflow(self, system: System, source: int) -> np.ndarray:
        """What each fixed pressure lets in, (fixed,) m³/s."""
        count = system.fixed_count
        total = np.zeros(count)
        np.add.at(total, system.fixed_source, self.link)
        own = np.arange(count) == source
        short = system.short_g * (own[system.short_a].astype(float) - own[system.short_b])
        np.add.at(total, system.short_a, short)
        np.subtract.at(total, system.short_b, short)
        return total


def steady_flow(system: System, factor: Factor, source: int) -> SteadyFlow:
    """Solve G p = f for a unit of one source, `factor` being that of G."""
    of_rate = source >= system.fixed_count
    held = (system.fixed_source == source).astype(float)
    well = system.source(source) if of_rate else np.zeros(system.n)
    strongest = max(system.edge_g.max(initial=0.0), system.fixed_g.max(initial=0.0))
    nothing = 0.0 if of_rate else NOTHING * strongest
    pressure, remainder = solve(factor, system.source(source)), np.zeros(system.n)
    best = np.inf
    for refinements in range(MOST_REFINEMENTS + 1):
        edge, link = _flows(
            system.edge_i,
            system.edge_j,
            system.edge_g,
            system.fixed_node,
            system.fixed_g,
            held,
            pressure,
            remainder,
        )
        net, pore, whole = _balance(system, edge, link, well, nothing)
        asked = max(pore / PORE_BALANCED, whole / WHOLE_BALANCED)
        if asked <= 1.0 or asked > 0.5 * best or refinements == MOST_REFINEMENTS:
            break
        best = asked
        correction = remainder + solve(factor, net)
        refined = pressure + correction
        remainder = correction - (refined - pressure)
        pressure = refined
    if pore > PORE_BALANCED:
        _drain(system, edge, link, net)
        _, pore, _ = _balance(system, edge, link, well, nothing)
    return SteadyFlow(pressure, remainder, edge, link, pore, refinements)


def _balance(
    system: System, edge: np.ndarray, link: np.ndarray, well: np.ndarray, nothing: float
) -> tuple[np.ndarray, float, float]:
    """What stays in each unknown (n,), the worst of it over what passes, and that of the whole."""
    net, through = _nets(system.edge_i, system.edge_j, system.fixed_node, edge, link, well)
    whole = max(np.abs(link).sum() + np.abs(well).sum(), nothing)
    if whole == 0.0:
        return net, 0.0, 0.0
    passes = np.maximum(through, max(STAGNANT * whole, nothing))
    return net, float(np.max(np.abs(net) / passes, initial=0.0)), float(abs(net.sum()) / whole)


def _drain(system: System, edge: np.ndarray, link: np.ndarray, net: np.ndarray) -> None:
    """Lead what stays in each unknown to a fixed pressure, along the strongest edges (in place)."""
    a = np.concatenate([system.edge_i, system.fixed_node])
    b = np.concatenate([system.edge_j, np.full(len(link), system.n)])
    by_strength = np.argsort(-np.concatenate([system.edge_g, system.fixed_g]), kind="stable")
    along = _drained(system.n, a, b, _spanning_tree(system.n + 1, a, b, by_strength), net)
    edge += along[: len(edge)]
    link -= along[len(edge) :]


@kernel
def _flow(g, p, q, dp, dq):
    """Flow along a conductance g between the pressures p + dp and q + dq."""
    return g * ((p - q) + (dp - dq))


@kernel
def _flows(edge_i, edge_j, edge_g, node, link_g, held, pressure, remainder):
    """Flows along edges and links."""
    edge, link = np.empty(edge_g.size), np.empty(link_g.size)
    for f in range(link_g.size):
        link[f] = _flow(link_g[f], held[f], pressure[node[f]], 0.0, remainder[node[f]])
    for e in range(edge_g.size):
        i, j = edge_i[e], edge_j[e]
        edge[e] = _flow(edge_g[e], pressure[i], pressure[j], remainder[i], remainder[j])
    return edge, link


@kernel
def _nets(edge_i, edge_j, node, edge, link, well):
    """What stays in each unknown, and half of all that enters and leaves it."""
    net, through = well.copy(), np.abs(well)
    for f in range(link.size):
        net[node[f]] += link[f]
        through[node[f]] += abs(link[f])
    for e in range(edge.size):
        i, j = edge_i[e], edge_j[e]
        net[i] -= edge[e]
        net[j] += edge[e]
        through[i] += abs(edge[e])
        through[j] += abs(edge[e])
    return net, 0.5 * through


@kernel
def _spanning_tree(n, a, b, by_strength):
    """Edges of the tree of the strongest (Kruskal 1956)."""
    leader = np.arange(n)
    tree = np.empty(n - 1, np.int64)
    count = 0
    for e in by_strength:
        i, j = a[e], b[e]
        while leader[i] != i:
            leader[i] = leader[leader[i]]
            i = leader[i]
        while leader[j] != j:
            leader[j] = leader[leader[j]]
            j = leader[j]
        if i != j:
            leader[i] = j
            tree[count] = e
            count += 1
    return tree[:count]


@kernel
def _drained(root, a, b, tree, net):
    """Flow a → b along each edge that takes what stays in the nodes of a tree to its root."""
    start = np.zeros(root + 2, np.int64)
    for e in tree:
        start[a[e] + 1] += 1
        start[b[e] + 1] += 1
    start = np.cumsum(start)
    fill = start.copy()
    touching = np.empty(2 * tree.size, np.int64)
    for e in tree:
        for node in (a[e], b[e]):
            touching[fill[node]] = e
            fill[node] += 1
    order = np.empty(root + 1, np.int64)
    way = np.full(root + 1, -1, np.int64)  # edge towards the root
    order[0] = root
    tail = 1
    for head in range(root + 1):
        node = order[head]
        for p in range(start[node], start[node + 1]):
            e = touching[p]
            if e != way[node]:
                other = a[e] + b[e] - node
                way[other] = e
                order[tail] = other
                tail += 1
    along = np.zeros(a.size)
    left = np.append(net, 0.0)
    for k in range(root, 0, -1):
        node = order[k]
        e = way[node]
        along[e] = left[node] if a[e] == node else -left[node]
        left[a[e] + b[e] - node] += left[node]
    return along
