"""Probes between pores: the parts that pores and sides have in the pressure at a point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.system import System, sources_of_sides
from demflow.model.network.domains import domains_at
from demflow.model.products import Apertures, Network
from demflow.model.region import Region

# A neighbour whose pipe conducts less than this part of the middle one lies behind something.
BEHIND = 0.05

# Weight of the place and of the sum of the parts, over that of the distances.
EXACTLY = 1e3


class Probes(NamedTuple):
    """Pressure of a probe: the sum of `part` times that of each domain or source, parts in [0, 1].

    The parts of a probe sum to one. `domain` is −1 for a side, `source` for a pore.
    """

    points: int
    probe: np.ndarray  # (k,)
    domain: np.ndarray  # (k,)
    source: np.ndarray  # (k,)
    part: np.ndarray  # (k,)
    place: np.ndarray  # (points, 2) m: where that pressure is, the mean place of the parts
    own: np.ndarray  # (points,) domain in which each lies


def at_pores(domains: np.ndarray) -> Probes:
    """Probes that take the pressure of one domain each."""
    count = len(domains)
    none = np.full(count, -1)
    place = np.full((count, 2), np.nan)
    return Probes(count, np.arange(count), domains, none, np.ones(count), place, domains)


def between_pores(
    network: Network,
    apertures: Apertures,
    region: Region,
    system: System,
    points: np.ndarray,
) -> Probes:
    """Probes at points (n, 2) m, linear between the pores and the sides at a pressure around.

    A pressure linear in space is met exactly wherever the pore in which a point lies and those
    within two pipes of it surround the point; else, as beside a sealed side, at the place nearest
    to it that they surround. Parts are positive, so that no pressure is exceeded, and nearest
    pores have most. Pores behind a barrier do not count, nor the one in which a point lies where
    its centroid is across a barrier. Inside a well it is the well's pressure.

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    region : where the case lies, m
    system : the flow equation C dp/dt = −G p + f
    points : (n, 2) m
    """
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    own = domains_at(network, points)
    if not len(points):
        return at_pores(own)
    pore = np.zeros(len(network.x), dtype=bool)
    pore[system.domain[system.domain < len(pore)]] = True
    walls = np.bincount(
        apertures.cross_pipe, apertures.cross_resistance, minlength=len(network.pipe_from)
    )
    conductance = apertures.conductance / (1.0 + apertures.conductance * walls)
    between = pore[network.pipe_from] & pore[network.pipe_to] & (conductance > 0.0)
    one, other = network.pipe_from[between], network.pipe_to[between]
    g = conductance[between]
    side = sources_of_sides(region, system.sides)[network.cut_side]
    held = (side >= 0) & (apertures.cut_conductance > 0.0) & pore[network.cut_inside]
    inner, outer = network.cut_inside[held], network.cut_outside[held]
    place = np.column_stack([network.x, network.y])
    fraction = network.cut_fraction[held]
    rim = place[inner] + fraction[:, None] * (place[outer] - place[inner])
    d = len(place)
    beside = _Beside(
        start=np.concatenate([one, other, inner]),
        end=np.concatenate([other, one, d + np.arange(len(inner))]),
        conductance=np.concatenate([g, g, apertures.cut_conductance[held] * fraction]),
        count=d,
    )
    place = np.concatenate([place, rim])
    domain = np.concatenate([np.arange(d), np.full(len(rim), -1)])
    source = np.concatenate([np.full(d, -1), side[held]])

    walls_start, walls_end = _barriers(apertures)
    parts = []
    for number, (point, i) in enumerate(zip(points, own, strict=True)):
        first = beside.of(i)
        around = [beside.of(k) for k in first[first < d]]
        near = np.unique(np.concatenate([[i], first, *around])).astype(np.int64)
        if _hidden(point, place[near], walls_start, walls_end).any():
            first = beside.all_of(i)
            around = [beside.all_of(k) for k in first[first < d]]
            wide = np.unique(np.concatenate([[i], first, *around])).astype(np.int64)
            seen = wide[~_hidden(point, place[wide], walls_start, walls_end)]
            near = seen if len(seen) else near
        part = _parts(place[near], point)
        used = part > 0.0
        whose = np.full(np.count_nonzero(used), number)
        near, part = near[used], part[used]
        parts.append((whose, domain[near], source[near], part, part @ place[near]))
    columns = list(zip(*parts, strict=True))
    probe, domain, source, part = (np.concatenate(column) for column in columns[:4])
    return Probes(len(points), probe, domain, source, part, np.array(columns[4]), own)


class _Beside:
    """What lies beyond the pipes of each pore, and behind no barrier."""

    def __init__(
        self, start: np.ndarray, end: np.ndarray, conductance: np.ndarray, count: int
    ) -> None:
        order = np.argsort(start, kind="stable")
        self._end, self._conductance = end[order], conductance[order]
        self._first = np.searchsorted(start[order], np.arange(count + 1))

    def all_of(self, pore: int) -> np.ndarray:
        """The same whatever is between."""
        return self._end[self._first[pore] : self._first[pore + 1]]

    def of(self, pore: int) -> np.ndarray:
        """Numbers of pores, and from `count` on of places on the rim."""
        ours = slice(self._first[pore], self._first[pore + 1])
        g = self._conductance[ours]
        return self._end[ours][g >= BEHIND * np.median(g)] if len(g) else self._end[ours]


def _barriers(apertures: Apertures) -> tuple[np.ndarray, np.ndarray]:
    """Ends (b, 2), (b, 2) m of the lines that neither have nodes nor run along pipes."""
    wall = np.ones(len(apertures.trace_start), dtype=bool)
    wall[apertures.branch_line] = False
    wall[apertures.on_fracture[apertures.on_fracture >= 0]] = False
    return apertures.trace_start[wall], apertures.trace_end[wall]


def _hidden(
    point: np.ndarray, places: np.ndarray, start: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Which of places (n, 2) a line hides from a point, (n,) bool."""

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        one, other = q - p, r - p
        found: np.ndarray = one[..., 0] * other[..., 1] > one[..., 1] * other[..., 0]
        return found

    to = places[:, None]
    apart = side(start, end, point) != side(start, end, to)
    across = side(point, to, start) != side(point, to, end)
    found: np.ndarray = (apart & across).any(axis=1)
    return found


def _parts(places: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Parts ≥ 0 of sum one of the places (n, 2), whose mean comes as near to the point as can be.

    Of those that meet it, the ones with the least Σ part² d², d the distance from the point.
    """
    offset = places - point
    distance = np.linalg.norm(offset, axis=1)
    size = distance.max()
    if size == 0.0 or len(places) == 1:
        found: np.ndarray = np.eye(len(places))[0]
        return found
    rows = np.vstack(
        [EXACTLY * offset.T / size, EXACTLY**2 * np.ones(len(places)), np.diag(distance / size)]
    )
    from scipy.optimize import nnls  # late: it takes long to import, and few cases have probes

    part = nnls(rows, np.concatenate([[0.0, 0.0, EXACTLY**2], np.zeros(len(places))]))[0]
    return np.asarray(part / part.sum())
