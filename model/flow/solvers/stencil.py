"""The network as an explicit step reads it, and the step itself.

A step reads every pore, its first four neighbours and their conductances in the order of
memory: pores are numbered by reverse Cuthill–McKee, rows have one width and no branch. Large
networks are marched several steps at a time, chunk by chunk: a step of a chunk needs the step
before of its two neighbours only, so the chunks of a wave stay in the cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from demflow.model.compile import Array, kernel
from demflow.model.flow.equation.algebraic import Algebraic
from demflow.model.flow.equation.system import System

WIDTH = 4  # neighbours of a pore that its row holds; most pores of a packing have no more
CHUNK = 4096  # pores that are advanced together, or more where neighbours lie further apart
WAVE = 16  # steps that go through the chunks behind one another; even


class Stencil(NamedTuple):
    """The flow equation as a step reads it, with pores renumbered; wells follow the pores.

    Weights are g_ij / C_i in 1/s. Entries of the ragged lists belong to the chunk of their
    pore, those of a well to the chunk of its last pore; `…_start` (chunks + 1,) part them.
    """

    order: np.ndarray  # (n,) the unknown that stands at each place
    start: np.ndarray  # (chunks + 1,) first place of each chunk
    near: np.ndarray  # (pores, WIDTH) uint32: places of the first neighbours, itself where none
    near_weight: np.ndarray  # (pores, WIDTH)
    row: np.ndarray  # (m,) uint32: further neighbours and wells, one entry each
    column: np.ndarray  # (m,) uint32
    weight: np.ndarray  # (m,)
    row_start: np.ndarray
    rim_unknown: np.ndarray  # (u,) unknowns beside a fixed pressure, wells included
    rim_place: np.ndarray  # (u,) their places
    rim_start: np.ndarray
    well: np.ndarray  # (e,) well of each of the wells' pipes
    well_pore: np.ndarray  # (e,) place of the pore at its other end
    well_g: np.ndarray  # (e,) m³/(s Pa)
    well_start: np.ndarray
    well_chunk: np.ndarray  # (w,) chunk after which each well balances
    inverse: np.ndarray  # (w, w) K_ww⁻¹


class Driven(NamedTuple):
    """The pores that a source or a fixed pressure acts on; no other has a term of its own."""

    place: np.ndarray  # (f,)
    weight: np.ndarray  # (f,) excess of the row over C_i, 1/s
    source: np.ndarray  # (f,) Pa/s
    start: np.ndarray  # (chunks + 1,) first entry of each chunk


def stencil(system: System, wells: Algebraic) -> Stencil:
    """Renumber the pores so that neighbours lie close together, and split their rows."""
    n, pores = system.n, system.pores
    i = np.concatenate([system.edge_i, system.edge_j])
    j = np.concatenate([system.edge_j, system.edge_i])
    g = np.concatenate([system.edge_g, system.edge_g])
    order = _order(i, j, n, pores)
    place = np.empty(n, dtype=np.int64)
    place[order] = np.arange(n)
    leaves = i < pores
    i, j, g = place[i[leaves]], place[j[leaves]], g[leaves]
    by_row = np.lexsort((j, i))
    i, j, g = i[by_row], j[by_row], g[by_row]
    storage = system.storage[order[:pores]]
    weight = g / storage[i]
    position = np.arange(len(i)) - np.searchsorted(i, i)
    first = (position < WIDTH) & (j < pores)
    near = np.repeat(np.arange(pores, dtype=np.uint32)[:, None], WIDTH, axis=1)
    near_weight = np.zeros((pores, WIDTH))
    near[i[first], position[first]] = j[first]
    near_weight[i[first], position[first]] = weight[first]

    excess = system.excess
    at_well = np.flatnonzero(j >= pores)
    last = np.full(n - pores, -1)
    np.maximum.at(last, j[at_well] - pores, i[at_well])
    start = _chunks(i, j, pores, wells, bool(excess[pores:].any()))
    well_chunk = np.maximum(np.searchsorted(start, last, side="right") - 1, 0)
    at_well = at_well[np.argsort(well_chunk[j[at_well] - pores], kind="stable")]
    rim = np.flatnonzero(excess > 0.0)
    rim = rim[np.argsort(place[rim])]
    row = i[~first]
    return Stencil(
        order=order,
        start=start,
        near=near,
        near_weight=near_weight,
        row=row.astype(np.uint32),
        column=j[~first].astype(np.uint32),
        weight=weight[~first],
        row_start=np.searchsorted(row, start),
        rim_unknown=rim,
        rim_place=place[rim],
        rim_start=_parts(place[rim], start),
        well=j[at_well] - pores,
        well_pore=i[at_well],
        well_g=g[at_well],
        well_start=np.searchsorted(well_chunk[j[at_well] - pores], np.arange(len(start))),
        well_chunk=well_chunk,
        inverse=np.ascontiguousarray(wells.inverse),
    )


def driven(rows: Stencil, rhs: np.ndarray, system: System) -> Driven:
    """Pick the pores beside a fixed pressure and, for an initial field, all that it moves.

    Parameters
    ----------
    rows : the pores by their neighbours
    rhs : f (n,), m³/s
    system : the flow equation C dp/dt = −G p + f
    """
    order = rows.order[: system.pores]
    place = np.flatnonzero((system.excess[order] > 0.0) | (rhs[order] != 0.0))
    unknown = order[place]
    storage = system.storage[unknown]
    weight, source = system.excess[unknown] / storage, rhs[unknown] / storage
    return Driven(place, weight, source, np.searchsorted(place, rows.start))


def _order(i: np.ndarray, j: np.ndarray, n: int, pores: int) -> np.ndarray:
    """Unknowns in the order of their places; the pores of a well count as neighbours."""
    if not pores:
        return np.arange(n)
    within = (i < pores) & (j < pores)
    at_well = (i < pores) & (j >= pores)
    hub = np.zeros(n, dtype=np.int64)
    hub[j[at_well]] = i[at_well]  # one pore of each well, for all of its pores
    a = np.concatenate([i[within], i[at_well], hub[j[at_well]]])
    b = np.concatenate([j[within], hub[j[at_well]], i[at_well]])
    graph = csr_array((np.ones(len(a)), (a, b)), shape=(pores, pores))
    banded = reverse_cuthill_mckee(graph, symmetric_mode=True)
    return np.concatenate([banded, np.arange(pores, n)]).astype(np.int64)


def _chunks(i: np.ndarray, j: np.ndarray, pores: int, wells: Algebraic, held: bool) -> np.ndarray:
    """First place of each chunk: neighbours, and the pores of a well, span two at most.

    All pores are one chunk where wells touch one another or a fixed pressure (`held`), since
    these balance only when everything around them has been advanced.
    """
    inverse = wells.inverse
    if held or np.any(inverse != np.diag(np.diag(inverse))):
        return np.array([0, pores])
    inner = j < pores
    span = int(np.max(np.abs(i[inner] - j[inner]), initial=0))
    for well in range(len(inverse)):
        around = i[j == pores + well]
        span = max(span, int(np.ptp(around)) if len(around) else 0)
    return np.append(np.arange(0, max(pores, 1), max(CHUNK, span + 1)), pores)


def _parts(places: np.ndarray, start: np.ndarray) -> np.ndarray:
    """First of some sorted places in each chunk; what lies behind the pores is in the last."""
    parts = np.searchsorted(places, start)
    parts[-1] = len(places)
    return parts


@kernel
def march(
    p: Array,
    q: Array,
    integral: Array,
    count: int,
    dt: float,
    s: Stencil,
    driven: Driven,
    well_source: Array,
) -> tuple[Array, Array]:
    """Advance p (n,) by `count` steps, with q (n,) as scratch; returns both, p first.

    `integral` gathers ∫ p dt of the unknowns of the rim, as Euler sees it.

    Parameters
    ----------
    p : pressure (n,), Pa
    q : scratch (n,)
    integral : ∫ p dt of the unknowns of the rim, which is added to
    count : steps
    dt : time step, s
    s : weights and neighbours of each pore
    driven : pores beside a fixed pressure
    well_source : f of the wells, (w,) m³/s
    """
    chunks = s.start.size - 1
    for done in range(0, count, WAVE):
        steps = min(WAVE, count - done)
        for front in range(chunks + steps - 1):
            for step in range(max(0, front - chunks + 1), min(steps, front + 1)):
                if step % 2 == 0:
                    _advance(p, q, integral, dt, s, driven, well_source, front - step)
                else:
                    _advance(q, p, integral, dt, s, driven, well_source, front - step)
    if count % 2 == 0:
        return p, q
    return q, p


@kernel
def _advance(
    p: Array,
    q: Array,
    integral: Array,
    dt: float,
    s: Stencil,
    driven: Driven,
    well_source: Array,
    chunk: int,
) -> None:
    """Put one step of a chunk into q, and of the wells whose last pores it holds."""
    pores = s.near.shape[0]
    for k in range(s.rim_start[chunk], s.rim_start[chunk + 1]):
        integral[s.rim_unknown[k]] += dt * p[s.rim_place[k]]
    for k in range(s.start[chunk], s.start[chunk + 1]):
        i = np.uint64(k)  # a signed index would be checked against zero, as would a list's
        x = p[i]
        left = s.near_weight[i, 0] * (p[s.near[i, 0]] - x)
        left += s.near_weight[i, 1] * (p[s.near[i, 1]] - x)
        right = s.near_weight[i, 2] * (p[s.near[i, 2]] - x)
        right += s.near_weight[i, 3] * (p[s.near[i, 3]] - x)
        q[i] = x + dt * (left + right)
    for entry in range(s.row_start[chunk], s.row_start[chunk + 1]):
        e = np.uint64(entry)
        i = s.row[e]
        q[i] += dt * s.weight[e] * (p[s.column[e]] - p[i])
    for k in range(driven.start[chunk], driven.start[chunk + 1]):
        i = driven.place[k]
        q[i] += dt * (driven.source[k] - driven.weight[k] * p[i])
    # wells have no storage: they balance at once
    for w in range(well_source.size):
        if s.well_chunk[w] == chunk:
            q[pores + w] = 0.0
            for v in range(well_source.size):
                q[pores + w] += s.inverse[w, v] * well_source[v]
    for k in range(s.well_start[chunk], s.well_start[chunk + 1]):
        flow = s.well_g[k] * q[s.well_pore[k]]
        for w in range(well_source.size):
            if s.well_chunk[w] == chunk:
                q[pores + w] += s.inverse[w, s.well[k]] * flow
