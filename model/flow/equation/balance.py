"""Steady pressure and the flows that go with it, so that every pore balances at any contrast.

The subtraction-free factor gives each pressure to the last digit or two. The flow along a
strong edge is the difference of two pressures that agree in more digits than a double has, so
that pressures alone cannot tell it. Iterative refinement on flows along edges finds the digits
that follow: the pressure is kept as a sum of two doubles p + δ, the flow is
g ((pᵢ − pⱼ) + (δᵢ − δⱼ)), and what does not balance is solved for again. What is left then,
where strong pipes lead nowhere, is drained along the tree of the strongest edges.

Each of these is done only where the balance asks for it. A drained network balances whatever
its pressures are, so that what tells how good they are is taken before: `SteadyFlow.misfit`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.compile import Array, kernel
from demflow.model.flow.equation.system import System
from demflow.model.flow.linear.factor import Factor, solve
from demflow.model.network.connectivity import reached

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
    misfit: float  # the same before draining, of the whole too, or the share of a flow drained
    refinements: int
    missing: float  # m³/s, |Σ| of all flows into the unknowns before draining

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
    """Solve G p = f for a unit of one source, `factor` being that of G.

    Parameters
    ----------
    system : the flow equation C dp/dt = −G p + f
    factor : that of G
    source : number of the source that is one
    """
    of_rate = source >= system.fixed_count
    held = (system.fixed_source == source).astype(float)
    well = system.source(source) if of_rate else np.zeros(system.n)
    strongest = max(system.edge_g.max(initial=0.0), system.fixed_g.max(initial=0.0))
    nothing = 0.0 if of_rate else NOTHING * strongest
    start = solve(factor, system.source(source))
    pressure, remainder = _where_nothing_flows(system, source, start), np.zeros(system.n)
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
        found = _balance(system, edge, link, well, nothing)
        asked = max(found.pore / PORE_BALANCED, found.whole / WHOLE_BALANCED)
        if asked <= 1.0 or asked > 0.5 * best or refinements == MOST_REFINEMENTS:
            break
        best = asked
        correction = remainder + solve(factor, found.net)
        refined = pressure + correction
        remainder = correction - (refined - pressure)
        pressure = refined
    misfit, missing = max(found.pore, found.whole), abs(float(found.net.sum()))
    if found.pore > PORE_BALANCED:
        along_edge, along_link = _drain(system, edge, link, found.net)
        found = _balance(system, edge, link, well, nothing)
        least = np.minimum(found.passes[system.edge_i], found.passes[system.edge_j])
        misfit = max(
            misfit,
            np.max(np.abs(along_edge) / least, initial=0.0),
            np.max(np.abs(along_link) / found.passes[system.fixed_node], initial=0.0),
        )
    return SteadyFlow(
        pressure, remainder, edge, link, found.pore, float(misfit), refinements, missing
    )


def _where_nothing_flows(system: System, source: int, pressure: np.ndarray) -> np.ndarray:
    """The pressure (n,) of a unit source, exact where only one fixed pressure is connected.

    What flows there is nothing; a pressure that is right to its last digit would leave a flow
    that nothing but round-off can be compared with.
    """
    if source >= system.fixed_count:
        return pressure
    ours = system.fixed_source == source
    edges = (system.n, system.edge_i, system.edge_j)
    mine = reached(*edges, system.fixed_node[ours])
    others = reached(*edges, system.fixed_node[~ours])
    return np.where(mine, np.where(others, pressure, 1.0), 0.0)


def transient_misfit(
    system: System,
    factor: Factor,
    shift: float,
    source: int,
    pressure: np.ndarray,
    rate: np.ndarray,
) -> float:
    """How far a transient is from C dp/dt + G p = f at one time, relative.

    `factor` is that of G + s C, `shift` its s. The pressure (n,) that goes with the rate (n,)
    of change is p + δ, (G + s C) δ what p leaves in each pore; the larger of max |δ| / max |p|
    and what p + δ, kept in two parts, leaves in all pores over the flow through them: that is
    s C δ where the factor is good, and everything where it is not.

    Parameters
    ----------
    system : the flow equation C dp/dt = −G p + f
    factor : that of G + s C
    shift : s, 1/s
    source : number of the source: fixed pressures and wells
    pressure : (n,) Pa at the time
    rate : (n,) Pa/s, its change then
    """
    of_rate = source >= system.fixed_count
    held = (system.fixed_source == source).astype(float)
    well = system.source(source) if of_rate else np.zeros(system.n)
    well = well - system.storage * rate
    ends = (system.edge_i, system.edge_j)
    links = (system.fixed_node, system.fixed_g, held)
    edge, link = _flows(*ends, system.edge_g, *links, pressure, np.zeros(system.n))
    net, _ = _nets(*ends, system.fixed_node, edge, link, well)
    change = solve(factor, net)
    edge, link = _flows(*ends, system.edge_g, *links, pressure, change)
    net, _ = _nets(*ends, system.fixed_node, edge, link, well)
    through = np.abs(well).sum() + np.abs(link).sum() + shift * system.storage @ np.abs(pressure)
    size = np.abs(pressure).max(initial=0.0)
    moved = np.abs(change).max(initial=0.0) / size if size > 0.0 else 0.0
    return float(max(moved, np.abs(net).sum() / through if through > 0.0 else 0.0))


class Balance(NamedTuple):
    """What stays in the unknowns when flows are summed in each."""

    net: np.ndarray  # (n,) m³/s
    passes: np.ndarray  # (n,) the flow through each, or through a stagnant one
    pore: float  # the worst |net| over what passes
    whole: float  # |Σ net| over the flow through the whole


def _balance(
    system: System, edge: np.ndarray, link: np.ndarray, well: np.ndarray, nothing: float
) -> Balance:
    """Sum flows in each unknown and in the whole."""
    net, through = _nets(system.edge_i, system.edge_j, system.fixed_node, edge, link, well)
    whole = max(np.abs(link).sum() + np.abs(well).sum(), nothing)
    if whole == 0.0:
        return Balance(net, np.ones(system.n), 0.0, 0.0)
    passes = np.maximum(through, max(STAGNANT * whole, nothing))
    pore = float(np.max(np.abs(net) / passes, initial=0.0))
    return Balance(net, passes, pore, float(abs(net.sum()) / whole))


def _drain(
    system: System, edge: np.ndarray, link: np.ndarray, net: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lead what stays in each unknown to a fixed pressure, along the strongest edges (in place).

    What is led along each edge (e,) and into each link (f,).
    """
    a = np.concatenate([system.edge_i, system.fixed_node])
    b = np.concatenate([system.edge_j, np.full(len(link), system.n)])
    by_strength = np.argsort(-np.concatenate([system.edge_g, system.fixed_g]), kind="stable")
    along = _drained(system.n, a, b, _spanning_tree(system.n + 1, a, b, by_strength), net)
    edge += along[: len(edge)]
    link -= along[len(edge) :]
    return along[: len(edge)], along[len(edge) :]


@kernel
def _flow(g: float, p: float, q: float, dp: float, dq: float) -> float:
    """Flow along a conductance g between the pressures p + dp and q + dq."""
    return g * ((p - q) + (dp - dq))


@kernel
def _flows(
    edge_i: Array,
    edge_j: Array,
    edge_g: Array,
    node: Array,
    link_g: Array,
    held: Array,
    pressure: Array,
    remainder: Array,
) -> tuple[Array, Array]:
    """Flows along edges and links."""
    edge, link = np.empty(edge_g.size), np.empty(link_g.size)
    for f in range(link_g.size):
        link[f] = _flow(link_g[f], held[f], pressure[node[f]], 0.0, remainder[node[f]])
    for e in range(edge_g.size):
        i, j = edge_i[e], edge_j[e]
        edge[e] = _flow(edge_g[e], pressure[i], pressure[j], remainder[i], remainder[j])
    return edge, link


@kernel
def _nets(
    edge_i: Array, edge_j: Array, node: Array, edge: Array, link: Array, well: Array
) -> tuple[Array, Array]:
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
def _spanning_tree(n: int, a: Array, b: Array, by_strength: Array) -> Array:
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
def _drained(root: int, a: Array, b: Array, tree: Array, net: Array) -> Array:
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
