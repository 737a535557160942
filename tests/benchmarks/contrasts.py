"""Rock with a fracture or a barrier of any contrast across it, and an independent reference."""

from __future__ import annotations

import numpy as np

from demflow.model.flow.equation.system import System
from demflow.model.network.apertures import open_pipes
from demflow.model.network.domains import network
from demflow.model.network.fractures.walk import walk
from demflow.model.products import Network
from demflow.model.region import Rectangle
from demflow.model.scene import Matrix, Trace, Well, flow_lines
from tests.diffusion import DOMAINS_PER_GRAIN
from tests.reservoirs import Reservoir
from tests.rocks import random_graph

REGION = Rectangle(2.0, 2.0)
WELL = Well(name="well", at=(0.05, 0.02), radius=0.02, rate=1e-6)
SIDES = (("left", 2e6), ("right", 1e6))


def pores(domains: int, seed: int = 1) -> Network:
    """Random plane pores in a box, about so many of them."""
    packing = random_graph(1.1, round(domains / DOMAINS_PER_GRAIN), seed)
    return network(packing._replace(radius=0.5 * packing.radius), region=REGION)


def cut(rock: Network, kind: str, contrast: float) -> Reservoir:
    """The pores with a fracture through the well, or a barrier beside it."""
    matrix = 1e-5
    if kind == "fracture":
        line = Trace(
            name=kind,
            start=(-0.7, -0.3),
            end=(0.6, 0.5),
            aperture=matrix * contrast ** (1 / 3),
        )
    else:
        line = Trace(
            name=kind, start=(0.4, -1.0), end=(0.6, 1.0), transmissibility_multiplier=1 / contrast
        )
    walked = walk(rock, region=REGION, lines=flow_lines((line,), REGION))
    opened = open_pipes(
        rock,
        walked,
        None,
        None,
        region=REGION,
        matrix=Matrix(aperture=matrix),
        fractures=(line,),
        viscosity=1e-3,
    )
    return Reservoir(REGION, rock, opened, 1e9)


def reference(system: System, rhs: np.ndarray) -> np.ndarray:
    """Pressure (n,) in extended precision: dense Gauss elimination without subtraction.

    Pores are eliminated as they are numbered, their edges and excesses in `longdouble`.
    """
    n = system.n
    edge = np.zeros((n, n), dtype=np.longdouble)
    np.add.at(edge, (system.edge_i, system.edge_j), system.edge_g)
    edge = edge + edge.T
    excess = np.zeros(n, dtype=np.longdouble)
    np.add.at(excess, system.fixed_node, system.fixed_g)
    x = rhs.astype(np.longdouble)
    pivot = np.empty(n, dtype=np.longdouble)
    for k in range(n):
        later = np.flatnonzero(edge[k, k + 1 :]) + k + 1
        pivot[k] = excess[k] + edge[k, later].sum()
        part = edge[k, later] / pivot[k]
        excess[later] += part * excess[k]
        x[later] += part * x[k]
        edge[np.ix_(later, later)] += np.outer(part, edge[k, later])
        edge[later, later] = 0.0
    for k in range(n - 1, -1, -1):
        x[k] = (x[k] + edge[k, k + 1 :] @ x[k + 1 :]) / pivot[k]
    return x


def residual(
    system: System, source: int, p: np.ndarray, rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What does not balance in each unknown (n,), and half of what enters and leaves it (n,).

    From flows along edges, which the two parts of a pressure alone give, in extended precision.
    The flow from a fixed pressure is that of a difference, too: in the right side of a linear
    system it is rounded before it is taken.
    """
    held = (system.fixed_source == source).astype(np.longdouble)
    well = system.source(source) if source >= system.fixed_count else np.zeros(system.n)
    p, rest = p.astype(np.longdouble), rest.astype(np.longdouble)
    i, j = system.edge_i, system.edge_j
    flow = system.edge_g * ((p[i] - p[j]) + (rest[i] - rest[j]))
    net = well.astype(np.longdouble)
    np.subtract.at(net, i, flow)
    np.add.at(net, j, flow)
    node = system.fixed_node
    link = system.fixed_g * ((held - p[node]) - rest[node])
    np.add.at(net, node, link)
    through = np.abs(well).astype(np.longdouble)
    np.add.at(through, node, np.abs(link))
    np.add.at(through, i, np.abs(flow))
    np.add.at(through, j, np.abs(flow))
    return net, through / 2
