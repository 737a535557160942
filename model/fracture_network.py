"""What the network of a case's fractures is (the *fractures* stage): geometry, without the rock.

Nodes and branches of all conducting traces, their densities, which sides and wells they join,
what they would carry in a sealed rock, and the tensors that Oda and Snow would give them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from demflow.model.compile import kernel
from demflow.model.flow.equation.sites import WellPlace
from demflow.model.flow.linear.factor import analyse, factorise, solve
from demflow.model.network.connectivity import reached
from demflow.model.outcome import ModelError
from demflow.model.products import FractureNetwork
from demflow.model.region import Region, bounding_box, clip_segments, exit_point, named_sides
from demflow.model.scene import Fracture, Line, lines_of
from demflow.model.scene.topology import Topology, topology

Array = np.ndarray


class Graph(NamedTuple):
    """Branches between the nodes of all conducting traces, and the ports at which they end.

    Ports are the sides of the region in their order, then the wells.
    """

    nodes: Topology
    branch_a: Array  # (b,) node
    branch_b: Array  # (b,)
    branch_length: Array  # (b,) m
    branch_line: Array  # (b,) index of the line that it is a part of
    port_node: Array  # (q,) a node that lies at a port
    port: Array  # (q,) that port


def describe(
    *,
    region: Region,
    fractures: tuple[Fracture, ...],
    viscosity: float,
    wells: tuple[WellPlace, ...],
    sides: tuple[str, ...],
) -> FractureNetwork:
    """Describe the network of the fractures that conduct; barriers and mere joints are none.

    Nodes are counted as in Sanderson & Nixon (2015, J. Struct. Geol. 72, 55–66): I where one
    branch ends freely, Y where three meet, X where four or more do; ends at the rim are their
    own kind. Connections per line are 4 (Y + X) / (I + Y). P20, P21 and P22 are number and
    length of traces per area of the region, and P21 times their mean length.

    Parameters
    ----------
    region, fractures, viscosity : parts of the scene.
    wells : where they stand; a trace that passes within its radius meets a well.
    sides : those of fixed pressure, as the scene names them, between which flow is counted.
    """
    lines = [
        line
        for line in lines_of(fractures, region)
        if line.length > 0.0 and conducts(fractures[line.fracture])
    ]
    graph = graph_of(lines, region, wells)
    area = region.area
    length = np.array([line.length for line in lines])
    traces = len({line.trace for line in lines})
    total = float(length.sum())
    degree = graph.nodes.degree
    rim = np.zeros(len(degree), dtype=bool)
    rim[graph.port_node[graph.port < len(region.sides)]] = True
    free, y, x = (degree == 1) & ~rim, degree == 3, degree > 3
    ends = np.count_nonzero(free) + np.count_nonzero(y)
    joined, clusters = _joined(graph, len(region.sides) + len(wells))
    on_backbone = graph.branch_length[_backbone(graph)].sum()
    apertures = np.array([line.aperture or 0.0 for line in lines])
    return FractureNetwork(
        nodes_i=np.asarray(np.count_nonzero(free)),
        nodes_y=np.asarray(np.count_nonzero(y)),
        nodes_x=np.asarray(np.count_nonzero(x)),
        nodes_rim=np.asarray(np.count_nonzero((degree == 1) & rim)),
        traces=np.asarray(traces),
        branches=np.asarray(degree[degree != 2].sum() // 2),  # a bend parts none
        connections=np.asarray(
            4.0 * (np.count_nonzero(y) + np.count_nonzero(x)) / ends if ends else 0.0
        ),
        clusters=np.asarray(clusters),
        p20=np.asarray(traces / area),
        p21=np.asarray(total / area),
        p22=np.asarray(total**2 / (traces * area) if traces else 0.0),
        backbone=np.asarray(on_backbone / total if total else 0.0),
        joined_pairs=np.asarray(np.count_nonzero(joined) // 2),
        well_joined=joined[len(region.sides) :].sum(axis=1),
        side_joined=np.array([_others(joined, region, name) for name in sides], dtype=np.int64),
        conductance=_alone(graph, apertures, viscosity, region, sides, len(wells)),
        oda=_tensor(lines, apertures, length) / area,
        snow=_snow(lines, apertures, region) / area,
    )


def _others(joined: Array, region: Region, side: str) -> int:
    """How many other sides and wells a side of the scene is joined to."""
    own = named_sides(region, side)
    met = np.asarray(joined[own].any(axis=0))
    met[own] = False
    return int(np.count_nonzero(met))


def conducts(fracture: Fracture) -> bool:
    """Whether a fracture lets fluid along it."""
    return fracture.part in ("trace", "chain")


def graph_of(lines: Sequence[Line], region: Region, wells: Sequence[WellPlace]) -> Graph:
    """Nodes and branches of lines, and where they meet sides and wells.

    A line that passes a well is cut at the point nearest to it, which lies in the well.

    Parameters
    ----------
    lines : straight pieces of fractures, m
    region : where the case lies, m
    wells : where wells stand, and how wide they are
    """
    start = np.array([line.start for line in lines]).reshape(-1, 2)
    end = np.array([line.end for line in lines]).reshape(-1, 2)
    owner = np.arange(len(lines))
    at_well: list[tuple[Array, int]] = []
    for number, well in enumerate(wells):
        step = end - start
        along = np.einsum("ij,ij->i", np.asarray(well.at) - start, step)
        fraction = np.clip(along / np.einsum("ij,ij->i", step, step), 0.0, 1.0)
        foot = start + fraction[:, None] * step
        foot[fraction == 1.0] = end[fraction == 1.0]
        hit = np.hypot(*(foot - well.at).T) <= well.radius
        at_well += [(point, number) for point in foot[hit]]
        cut = hit & (fraction > 0.0) & (fraction < 1.0)
        start = np.concatenate([start, foot[cut]])
        owner = np.concatenate([owner, owner[cut]])
        tail = end[cut]
        end = end.copy()
        end[cut] = foot[cut]
        end = np.concatenate([end, tail])
    nodes = topology(start, end)
    line, before, after = nodes.branches
    first = np.flatnonzero(np.concatenate([[True], nodes.line[1:] != nodes.line[:-1]]))
    last = np.concatenate([first[1:], [len(nodes.line)]]) - 1
    # node at each end of a piece, by its coordinates
    ends: dict[tuple[float, float], int] = {}
    for points, places in ((start, first), (end, last)) if len(lines) else ():
        nodes_there = nodes.node[places].tolist()
        ends.update(zip(map(tuple, points.tolist()), nodes_there, strict=True))
    port_node: list[int] = []
    port: list[int] = []
    for one in lines:
        for point, leaves, other in (
            (one.start, one.start_at_rim, one.end),
            (one.end, one.end_at_rim, one.start),
        ):
            if leaves:
                middle, tip = 0.5 * (np.array(point) + other), np.array(point)
                _, side = exit_point(region, middle, tip + 1e-6 * (tip - middle))
                port_node.append(ends[point])
                port.append(int(side[0]))
    for (x, y), number in at_well:
        port_node.append(ends[float(x), float(y)])
        port.append(len(region.sides) + number)
    return Graph(
        nodes,
        nodes.node[before],
        nodes.node[after],
        nodes.along[after] - nodes.along[before],
        owner[line],
        np.array(port_node, dtype=np.int64),
        np.array(port, dtype=np.int64),
    )


def _joined(graph: Graph, ports: int) -> tuple[Array, int]:
    """Which ports the traces alone join, (ports, ports) bool, and how many clusters there are."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(graph.nodes.node_x)
    ones = np.ones(len(graph.branch_a), dtype=np.int8)
    links = coo_array((ones, (graph.branch_a, graph.branch_b)), shape=(n, n))
    clusters, label = connected_components(links, directed=False)
    meets = np.zeros((clusters, ports), dtype=bool)
    meets[label[graph.port_node], graph.port] = True
    joined = (meets.T.astype(int) @ meets.astype(int)) > 0
    np.fill_diagonal(joined, False)
    return joined, int(clusters)


def _backbone(graph: Graph) -> Array:
    """Branches that lie on a way between two different ports that repeats no node, (b,) bool.

    All ports hang on one more node; a branch lies on such a way where it is in one biconnected
    component with an edge to that node and to another (Tarjan 1972, SIAM J. Comput. 1, 146–160).
    """
    n, b = len(graph.nodes.node_x), len(graph.branch_a)
    met = np.unique(np.stack([graph.port_node, graph.port]), axis=1)
    ports = np.unique(met[1])
    root = n + (int(ports.max()) + 1 if len(ports) else 0)
    a = np.concatenate([graph.branch_a, met[0], n + ports])
    c = np.concatenate([graph.branch_b, n + met[1], np.full(len(ports), root)])
    nodes = root + 1
    label = _components(root, *_around(nodes, a, c))
    at_root = label[b + met.shape[1] :]
    between, edges = np.unique(at_root, return_counts=True)
    return np.isin(label[:b], between[(edges > 1) & (between >= 0)])


def _around(n: int, a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Edges at each of n nodes: where they start (n + 1,), the node beyond and the edge (2 e,)."""
    node, beyond = np.concatenate([a, b]), np.concatenate([b, a])
    edge = np.tile(np.arange(len(a)), 2)
    order = np.argsort(node, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(node, minlength=n))])
    return start, beyond[order], edge[order]


@kernel
def _components(root: int, start: Array, beyond: Array, edge: Array) -> Array:
    """Biconnected component of each edge that hangs together with a node, −1 of the others.

    Depth first from the root: `low` is the least order that a node's descendants reach by one
    edge back; where that is not above the node itself, the edges met since then are a component.
    """
    n, e = len(start) - 1, len(edge) // 2
    order, low, came = np.full(n, -1), np.full(n, -1), np.full(n, -1)
    above, way = np.full(n, -1), start[:-1].copy()
    label, kept = np.full(e, -1), np.empty(e, np.int64)
    used = np.zeros(e, np.bool_)
    order[root] = low[root] = 0
    visited, top, components, node = 1, 0, 0, root
    while node >= 0:
        if way[node] < start[node + 1]:
            k = way[node]
            way[node] += 1
            if used[edge[k]]:
                continue
            used[edge[k]] = True
            kept[top] = edge[k]
            top += 1
            other = beyond[k]
            if order[other] >= 0:
                low[node] = min(low[node], order[other])
                continue
            order[other] = low[other] = visited
            visited += 1
            above[other], came[other] = node, edge[k]
            node = other
            continue
        parent = above[node]
        if parent >= 0:
            low[parent] = min(low[parent], low[node])
            if low[node] >= order[parent]:
                while True:
                    top -= 1
                    label[kept[top]] = components
                    if kept[top] == came[node]:
                        break
                components += 1
        node = parent
    return label


def _alone(
    graph: Graph,
    apertures: Array,
    viscosity: float,
    region: Region,
    sides: tuple[str, ...],
    wells: int,
) -> Array:
    """Flow into each port (sides of fixed pressure, then wells) by unit pressure at each.

    (ports, ports) in m³/(s Pa): what the fractures given by an aperture, T = w³ / (12 μ), carry
    where the rock is sealed. Rows add up to zero.
    """
    number = np.full(len(region.sides) + wells, -1)
    for k, name in enumerate(sides):
        number[named_sides(region, name)] = k
    number[len(region.sides) :] = len(sides) + np.arange(wells)
    ports = len(sides) + wells
    node_port = np.full(len(graph.nodes.node_x), -1)
    open_port = number[graph.port] >= 0
    node_port[graph.port_node[open_port]] = number[graph.port[open_port]]
    g = apertures[graph.branch_line] ** 3 / (12.0 * viscosity * graph.branch_length)
    conducting = g > 0.0
    i, j, g = graph.branch_a[conducting], graph.branch_b[conducting], g[conducting]
    flow = np.zeros((ports, ports))
    held = reached(len(node_port), i, j, np.flatnonzero(node_port >= 0))
    inner = held & (node_port < 0)
    index = np.full(len(node_port), -1)
    index[inner] = np.arange(np.count_nonzero(inner))
    both = inner[i] & inner[j]
    edges: list[tuple[Array, Array, Array]] = []  # port, inner node, conductance
    for p, q in ((i, j), (j, i)):
        rim = (node_port[p] >= 0) & inner[q]
        edges.append((node_port[p[rim]], index[q[rim]], g[rim]))
    port, node, to_port = (np.concatenate(column) for column in zip(*edges, strict=True))
    direct = (node_port[i] >= 0) & (node_port[j] >= 0)
    for p, q, c in zip(node_port[i[direct]], node_port[j[direct]], g[direct], strict=True):
        flow[p, q] -= c
        flow[q, p] -= c
    n = int(np.count_nonzero(inner))
    if n:
        excess = np.bincount(node, weights=to_port, minlength=n)
        rhs = np.zeros((n, ports))
        np.add.at(rhs, (node, port), to_port)
        factor = factorise(analyse(n, index[i[both]], index[j[both]]), g[both], excess)
        pressure = solve(factor, rhs)
        for k in range(ports):
            flow[k] -= to_port[port == k] @ pressure[node[port == k]]
    np.fill_diagonal(flow, 0.0)
    np.fill_diagonal(flow, -flow.sum(axis=1))
    if not np.isfinite(flow).all():
        raise ModelError("the flow along the fractures alone is no number; check their apertures")
    return flow


def _tensor(lines: Sequence[Line], apertures: Array, length: Array) -> Array:
    """Σ w³ ℓ t ⊗ t / 12 over straight pieces, (2, 2) m⁴ (Oda 1985, Géotechnique 35, 483–495)."""
    along = np.array([np.subtract(line.end, line.start) for line in lines]).reshape(-1, 2)
    unit = along / np.hypot(*along.T)[:, None]
    found: Array = np.einsum("k,ki,kj->ij", apertures**3 * length / 12.0, unit, unit)
    return found


def _snow(lines: Sequence[Line], apertures: Array, region: Region) -> Array:
    """Oda's sum with each trace extended through the whole region.

    Snow (1965, thesis, Berkeley) takes fractures as parallel plates without end. Of a bent trace
    the plate runs from end to end.
    """
    _, first, trace = np.unique(
        [line.trace for line in lines], return_index=True, return_inverse=True
    )
    last = np.zeros(len(first), dtype=np.int64)
    np.maximum.at(last, trace.reshape(-1), np.arange(len(lines)))
    start = np.array([lines[k].start for k in first.tolist()]).reshape(-1, 2)
    end = np.array([lines[k].end for k in last.tolist()]).reshape(-1, 2)
    span = np.hypot(*(end - start).T)
    unit = (end - start) / np.where(span > 0.0, span, np.inf)[:, None]
    middle = 0.5 * (start + end)
    xmin, xmax, ymin, ymax = bounding_box(region)
    reach = 1.1 * float(np.hypot(xmax - xmin, ymax - ymin))
    plate, s0, s1 = clip_segments(region, middle - reach * unit, middle + reach * unit)
    chord = 2.0 * reach * np.bincount(plate, s1 - s0, minlength=len(first))
    weight = apertures[first] ** 3 * chord / 12.0
    found: Array = np.einsum("k,ki,kj->ij", weight, unit, unit)
    return found
