"""Wells in the network: which pores they take, and what joins them to the pores around.

The pores that a well takes become one terminal. What leaves it, to pores or to the rim, carries
the flow of a logarithmic field about the well's own axis, and all of it by one common factor more,
so that a well in its rock answers as one in a continuum of the same permeability: within a ring
of pores whose pressures are those of the analytic field, images in a near rim included, the well
has the field's pressure at its wall. With a ring of one pore and the well at the pore's centre
that is the equivalent radius ln r_o = (Σ g ln d − 2π k/μ) / Σ g (Peaceman 1978, SPE J. 18,
183–194, for four equal neighbours). Wells that share a pore or lie in pores side by side are
joined by one conductance more, so that each moves the other as it should.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array

from demflow.model.flow.equation.grounded_field import GroundedField
from demflow.model.flow.equation.sites import WellSite
from demflow.model.flow.equation.well_field import WellField
from demflow.model.flow.linear.factor import analyse, factorise, solve
from demflow.model.network.connectivity import component_labels, reached
from demflow.model.network.domains import domains_at
from demflow.model.outcome import ModelError
from demflow.model.products import Network

# A pore may touch the wellbore; what joins the two is at most its pipe over this part.
WELL_FLOOR = 0.02

# A pore that lies next to the wall counts as this far from it, in the logarithm: the common factor
# makes up for it, and explicit steps stay long.
LEAST_RISE = 0.1

# Where flow leaves a pore of a wide well, the pressure is that at this part of the distance
# between the pores or more (Peaceman 1978).
EQUIVALENT_RADIUS = 0.2

# The flow of one pipe is moved to others by this factor at most, to centre it on the well.
LEAST_TILT = 0.2

# Stars of wells beside one another are tilted less where they would meet too much of each
# other, until pressures over q μ / 2πk are within this of the field's.
TILTS = (1.0, 0.5, 0.0)
GOOD_FIT = 0.05

# Bounds of the common factor, and of the conductance between two wells over 2π k/μ.
FACTORS = (1e-3, 1e3)

# Steps to the factor of one well, and the change of its logarithm that is none.
MOST_STEPS, ROOT_WITHIN = 50, 1e-10


class Edges(NamedTuple):
    """Conductances between terminals: the pores, then the wells, then the sides that keep one."""

    a: np.ndarray  # (e,) a pore, or a well
    b: np.ndarray  # (e,)
    g: np.ndarray  # (e,) m³/(s Pa)
    end: np.ndarray  # (e, 2) m: where b lies, on a side the place where the pipe meets it
    pipe: np.ndarray  # (e,) the pipe along a fracture, −1 in the rock
    way: np.ndarray  # (e,) the edge without wells that it is a part of, −1 none
    turned: np.ndarray  # (e,) bool: that edge runs from b to a

    def only(self, which: np.ndarray) -> Edges:
        """Some of them, by their numbers or a mask (e,)."""
        some = np.flatnonzero(which) if which.dtype == bool else which
        return Edges(*(column[some] for column in self))


class Wells(NamedTuple):
    """The wells of a case in its network."""

    sites: tuple[WellSite, ...]
    taken: list[np.ndarray]  # pores of each
    fields: list[WellField | GroundedField | None]  # None where no rock conducts around it
    mobility: np.ndarray  # (wells,) √det(k/μ) of the rock around each, m²/(Pa s)
    spacing: np.ndarray  # (wells,) of the pores around each, m


class Star(NamedTuple):
    """What leaves one well, and how much of its flow each part would carry."""

    to: np.ndarray  # (s,) terminal
    end: np.ndarray  # (s, 2) m
    most: np.ndarray  # (s,) largest conductance, m³/(s Pa)
    g: np.ndarray  # (s,) m³/(s Pa) before the common factor
    way: np.ndarray  # (s,) as of edges
    turned: np.ndarray  # (s,)


def pores_of_wells(network: Network, wells: tuple[WellSite, ...]) -> list[np.ndarray]:
    """The pores that each well takes: those whose centroid it covers, else the one it lies in.

    Raises `ModelError` where two wells overlap.
    """
    place = np.array([well.at for well in wells]).reshape(-1, 2)
    radius = np.array([well.radius for well in wells])
    first, second = np.triu_indices(len(wells), k=1)
    apart = np.linalg.norm(place[first] - place[second], axis=1)
    for pair in np.flatnonzero(apart <= radius[first] + radius[second]):
        one, other = wells[first[pair]], wells[second[pair]]
        raise ModelError(
            f"wells {one.name} and {other.name} overlap: their axes are {apart[pair]:.4g} m apart, "
            f"their radii {one.radius:.4g} m and {other.radius:.4g} m (with a negative "
            "skin_factor r_w e^(−S)); move them apart, or give them smaller radii"
        )
    taken = []
    for well in wells:
        distance = np.hypot(network.x - well.at[0], network.y - well.at[1])
        within = np.flatnonzero((distance < well.radius) & network.inside)
        taken.append(within if len(within) else domains_at(network, np.array([well.at])))
    return taken


def join_wells(edges: Edges, network: Network, wells: Wells, joints: Edges) -> Edges:
    """Edges between terminals with the wells in place of the pores that they take.

    Parameters
    ----------
    edges : connections between terminals, before
    network : pores and pipes of the matrix
    wells : the wells
    joints : what joins them to what is around, as `joints_of` gives it
    """
    owner = _owners(edges, network, wells)
    rest = edges.only((owner[edges.a] < 0) & (owner[edges.b] < 0))
    return Edges(*(np.concatenate(columns) for columns in zip(rest, joints, strict=True)))


def _owners(edges: Edges, network: Network, wells: Wells) -> np.ndarray:
    """The well that takes each terminal, −1 none."""
    owner = np.full(max(len(network.x), int(edges.b.max(initial=0)) + 1), -1)
    for k in reversed(range(len(wells.sites))):
        owner[wells.taken[k]] = k
    return owner


def joints_of(edges: Edges, network: Network, wells: Wells) -> Edges:
    """What joins the wells to the pores and sides around, and to one another.

    Parameters
    ----------
    edges : connections between terminals without wells
    network : pores and pipes of the matrix
    wells : the wells
    """
    d, owner = len(network.x), _owners(edges, network, wells)
    touching = _both_ways(edges.only((owner[edges.a] >= 0) | (owner[edges.b] >= 0)), network)
    along = touching.only((touching.pipe >= 0) & (owner[touching.a] >= 0))
    parts = [_along_fractures(along, network, wells, owner)]
    touching = touching.only(touching.pipe < 0)
    for group in _groups(touching, wells, d):
        ours = _marked(len(wells.sites) + 1, group.members)[owner]  # the last one is nobody
        from_it = touching.only(ours[touching.a])
        meets_rock = not ours[from_it.b].all()
        if meets_rock and all(wells.fields[k] is not None for k in group.members):
            parts.append(_calibrated(edges, from_it, network, wells, group))
    return Edges(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _marked(count: int, which: np.ndarray | list[int]) -> np.ndarray:
    """A mask (count,) of some numbers."""
    mask = np.zeros(count, dtype=bool)
    mask[which] = True
    return mask


def _both_ways(edges: Edges, network: Network) -> Edges:
    """Every edge from each of its pores."""
    back = edges.only(edges.b < len(network.x))
    place = np.column_stack([network.x[back.a], network.y[back.a]])
    turned = back._replace(a=back.b, b=back.a, end=place, turned=~back.turned)
    return Edges(*(np.concatenate(columns) for columns in zip(edges, turned, strict=True)))


class Group(NamedTuple):
    """Wells whose stars meet, or that share pores or have pores side by side."""

    members: list[int]
    pairs: np.ndarray  # (m, 2) which of the members do so with each other


def _groups(touching: Edges, wells: Wells, pores: int) -> list[Group]:
    """The groups of wells; each well is in one, most often alone."""
    count = len(wells.sites)
    if count == 1:
        return [Group([0], np.empty((0, 2), dtype=np.int64))]
    well = np.repeat(np.arange(count), [len(taken) for taken in wells.taken])
    own = coo_array((np.ones(len(well)), (well, np.concatenate(wells.taken))), (count, pores))
    to_pore = touching.only(touching.b < pores)
    beside = coo_array((np.ones(len(to_pore.a)), (to_pore.a, to_pore.b)), (pores, pores))
    met = (own.tocsr() + own.tocsr() @ beside.tocsr()).astype(bool).astype(np.int64)
    one, other = (met @ met.T).nonzero()
    label = component_labels(count, one, other)
    pairs = np.column_stack([one, other])[one < other]
    groups = []
    for part in np.unique(label):
        members = np.flatnonzero(label == part)
        ours = pairs[np.isin(pairs[:, 0], members)]
        groups.append(Group(members.tolist(), np.searchsorted(members, ours)))
    return groups


def _along_fractures(leaving: Edges, network: Network, wells: Wells, owner: np.ndarray) -> Edges:
    """Pipes along fractures that leave a well, from its wall on."""
    well, other = owner[leaving.a], owner[leaving.b]
    kept = (other != well) & ((other < 0) | (well < other))
    leaving, well, other = leaving.only(kept), well[kept], other[kept]
    g = leaving.g.copy()
    for k in np.unique(well):
        site = wells.sites[k]
        ours = np.flatnonzero(well == k)
        start = np.column_stack([network.x, network.y])[leaving.a[ours]]
        whole = np.linalg.norm(leaving.end[ours] - start, axis=1)
        centre = start if len(wells.taken[k]) == 1 else np.asarray(site.at)
        far = np.linalg.norm(leaving.end[ours] - centre, axis=1)
        g[ours] *= whole / np.maximum(far - site.radius, WELL_FLOOR * whole)
    d = len(network.x)
    return leaving._replace(a=d + well, b=np.where(other < 0, leaving.b, d + other), g=g)


def _calibrated(
    edges: Edges, from_it: Edges, network: Network, wells: Wells, group: Group
) -> Edges:
    """What joins a group of wells to the rock around, and to one another."""
    members, pairs = group
    fields = [field for k in members if (field := wells.fields[k]) is not None]
    unit = 2.0 * np.pi * float(np.mean(wells.mobility[members]))
    pores = np.concatenate([wells.taken[k] for k in members])
    want = np.array([[field.at_points(other.at[None])[0] for field in fields] for other in fields])
    np.fill_diagonal(want, [field.at_wall for field in fields])
    best = np.inf
    for strength in TILTS:
        tried = [_star(from_it, network, wells, k, pores, unit, strength) for k in members]
        around = _surroundings(edges, tried, network, wells, members, unit)
        found, off = _fitted(around, tried, pairs, want)
        if off < best:
            best, stars, factors = off, tried, found
        if off < GOOD_FIT:
            break
    parts = [
        (k, star.to, np.minimum(f * unit * star.g, star.most), star.end, star.way, star.turned)
        for k, star, f in zip(members, stars, factors, strict=False)
    ]
    parts += [
        (
            members[i],
            np.array([len(network.x) + members[j]]),
            np.array([unit * f]),
            fields[j].at[None],
            np.array([-1]),
            np.array([False]),
        )
        for (i, j), f in zip(pairs, factors[len(members) :], strict=True)
    ]
    well, *columns = zip(*parts, strict=True)
    to, g, end, way, turned = (np.concatenate(column) for column in columns)
    a = len(network.x) + np.repeat(well, [len(part) for part in columns[0]])
    return Edges(a, to, g, end, np.full(len(a), -1), way, turned)


def _fitted(
    around: Surroundings, stars: list[Star], pairs: np.ndarray, want: np.ndarray
) -> tuple[np.ndarray, float]:
    """Factors of stars, then of links, that bring the pressures (w, w) closest, and how close."""
    if len(stars) == 1:
        return _fitted_alone(around, stars, pairs, want)
    one, other = pairs.T
    diagonal = np.arange(len(stars))

    def misfit(logarithms: np.ndarray) -> np.ndarray:
        off = _answer(around, stars, pairs, np.exp(logarithms)).pressure - want
        return np.concatenate([np.diag(off), 0.5 * (off[one, other] + off[other, one])])

    def slope(logarithms: np.ndarray) -> np.ndarray:
        change = _slopes(around, stars, pairs, np.exp(logarithms))
        mixed = 0.5 * (change[:, one, other] + change[:, other, one])
        return np.concatenate([change[:, diagonal, diagonal], mixed], axis=1).T

    from scipy.optimize import least_squares  # late: few wells stand beside one another

    start = np.zeros(len(stars) + len(pairs))
    found = least_squares(misfit, start, slope, bounds=tuple(np.log(FACTORS)))
    return np.exp(found.x), float(np.abs(found.fun).max())


def _fitted_alone(
    around: Surroundings, stars: list[Star], pairs: np.ndarray, want: np.ndarray
) -> tuple[np.ndarray, float]:
    """The same of one well, whose pressure rises with its factor: a root between the bounds."""
    low, high = np.log(FACTORS)
    at, off = 0.0, np.inf
    for _ in range(MOST_STEPS):
        found = _answer(around, stars, pairs, np.exp([at]))
        off = float(found.pressure[0, 0] - want[0, 0])
        low, high = (at, high) if off < 0.0 else (low, at)
        slope = float(_slope_of(found, around, 0)[0, 0])
        step = at - off / slope if slope > 0.0 else np.nan
        after = step if low < step < high else 0.5 * (low + high)
        if abs(after - at) <= ROOT_WITHIN:
            break
        at = after
    return np.exp([at]), abs(off)


def _star(
    from_it: Edges,
    network: Network,
    wells: Wells,
    k: int,
    pores: np.ndarray,
    unit: float,
    strength: float,
) -> Star:
    """What leaves one well, with the flow of a logarithmic field centred on its axis.

    A pipe carries g ln(r_j / r_i) of that field; where the well stands in one pore, taken at its
    centre, g. Flows are tilted until the places to which they go have the well's axis as their
    mean, and each becomes a conductance between the pressures of the field at its end and at the
    wall. What goes to other wells, which have some of `pores`, counts in the mean only.
    """
    field, site = wells.fields[k], wells.sites[k]
    assert field is not None
    terminals = max(len(network.x), 1 + int(from_it.b.max(initial=0)))
    mine = _marked(terminals, wells.taken[k])
    ours = mine[from_it.a] & ~mine[from_it.b]
    leaves = from_it.only(ours)
    start = np.column_stack([network.x, network.y])[leaves.a]
    flow = leaves.g.copy()
    if len(wells.taken[k]) > 1:
        between = np.linalg.norm((leaves.end - start) @ field.scale.T, axis=1)
        inner = field.distance(start)
        inner = np.maximum(inner, EQUIVALENT_RADIUS * between)
        flow *= np.log(np.maximum(field.distance(leaves.end) / inner, 1.0 + WELL_FLOOR))
    flow *= _tilt(flow, leaves.end, np.asarray(site.at)) ** strength
    rise = field.at_points(leaves.end) - field.at_wall
    g = flow / np.maximum(rise, LEAST_RISE) / unit
    out = ~_marked(terminals, pores)[leaves.b]
    most = leaves.g[out] / WELL_FLOOR
    return Star(leaves.b[out], leaves.end[out], most, g[out], leaves.way[out], leaves.turned[out])


def _tilt(flow: np.ndarray, end: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Factors of flows, linear in the place, that bring their mean place to the axis."""
    total = flow.sum()
    if total == 0.0:
        return np.ones(len(flow))
    middle = flow @ end / total
    offset = end - middle
    spread = offset.T @ (flow[:, None] * offset) / total
    slope = np.linalg.lstsq(spread, axis - middle, rcond=1e-6)[0]
    found: np.ndarray = np.clip(1.0 + offset @ slope, LEAST_TILT, 1.0 / LEAST_TILT)
    return found


class Surroundings(NamedTuple):
    """The rock between wells and a ring, as the pores beside the wells feel it.

    Conductances over 2π √det(k/μ). n pores are beside one of w wells.
    """

    held: np.ndarray  # (n, w) pressures by the fields on the ring, without the wells
    spread: np.ndarray  # (n, n) pressures by unit inflows
    number: list[np.ndarray]  # of each well: number of what its star goes to, −1 where held
    fixed: list[np.ndarray]  # of each well: (s, w) pressures of what is held, by each field


def _surroundings(
    edges: Edges,
    stars: list[Star],
    network: Network,
    wells: Wells,
    group: list[int],
    unit: float,
) -> Surroundings:
    """Solve the rock within the ring around a group of wells."""
    d = len(network.x)
    fields = [field for k in group if (field := wells.fields[k]) is not None]
    node = np.full(
        max(d, int(edges.b.max(initial=0)) + 1, *(1 + s.to.max(initial=0) for s in stars)), -1
    )
    near = np.zeros(d, dtype=bool)
    for field in fields:
        dx, dy = network.x - field.at[0], network.y - field.at[1]
        near |= dx * dx + dy * dy < field.reach**2
    for k in group:
        near[wells.taken[k]] = False
    for star in stars:
        near[star.to[star.to < d]] = True
    near &= network.inside
    local = np.flatnonzero(near)
    node[local] = np.arange(len(local))
    taken = np.zeros(len(node), dtype=bool)
    taken[np.concatenate([wells.taken[k] for k in group])] = True
    felt = np.flatnonzero((node[edges.a] >= 0) | (node[edges.b] >= 0))
    rest = edges.only(felt[edges.pipe[felt] < 0])
    rest = rest.only(~taken[rest.a] & ~taken[rest.b])

    a, b = node[rest.a], node[rest.b]
    within, out, back = (a >= 0) & (b >= 0), (a >= 0) & (b < 0), (a < 0) & (b >= 0)
    ends = np.concatenate([a[out], b[back]])
    end_g = np.concatenate([rest.g[out], rest.g[back]]) / unit
    inner = rest.a[back]
    end_place = np.concatenate([rest.end[out], np.column_stack([network.x, network.y])[inner]])
    end_u = np.column_stack([f.at_points(end_place) for f in fields])
    i, j, g = a[within], b[within], rest.g[within] / unit
    held = reached(len(local), i, j, ends[end_g > 0.0])
    excess = np.bincount(ends, weights=end_g, minlength=len(local)) + ~held
    beside = np.unique(np.concatenate([node[star.to] for star in stars]))
    beside = beside[beside >= 0]
    load = np.zeros((len(local), len(fields) + len(beside)))
    np.add.at(
        load, ends, np.column_stack([end_g[:, None] * end_u, np.zeros((len(ends), len(beside)))])
    )
    load[beside, len(fields) + np.arange(len(beside))] = 1.0
    p = solve(factorise(analyse(len(local), i, j), g, excess), load)[beside]
    order = np.full(len(local) + 1, -1)
    order[beside] = np.arange(len(beside))
    return Surroundings(
        held=p[:, : len(fields)],
        spread=p[:, len(fields) :],
        number=[order[node[star.to]] for star in stars],
        fixed=[np.column_stack([f.at_points(star.end) for f in fields]) for star in stars],
    )


class Answer(NamedTuple):
    """Pressures of w wells when each in turn takes what its field does, and what moves them."""

    pressure: np.ndarray  # (w, w) of each well (row), by each field (column)
    flow: list[np.ndarray]  # of each well: (s, w) flow along its star, outward
    by_well: np.ndarray  # (w, w) pressure of each well by a unit inflow at each well
    by_pore: np.ndarray  # (w, n + 1) by one at each pore beside a well, 0 at what is held


def _answer(
    around: Surroundings, stars: list[Star], pairs: np.ndarray, factors: np.ndarray
) -> Answer:
    """Solve wells, stars and rock with the given factors of the stars, then of the links."""
    n, w = around.held.shape
    to_pores, rhs, between = np.zeros((w, n + 1)), -np.eye(w), np.zeros((w, w))
    stars_g = [factor * star.g for star, factor in zip(stars, factors, strict=False)]
    for k, g in enumerate(stars_g):
        np.add.at(to_pores[k], around.number[k], g)
        between[k, k] += g.sum()
        rhs[k] += (g * (around.number[k] < 0)) @ around.fixed[k]
    to_pores[:, n] = 0.0  # what is held, numbered −1
    for (k, m), link in zip(pairs, factors[w:], strict=True):
        between[[k, m], [k, m]] += link
        between[[k, m], [m, k]] -= link
    to_pores = to_pores[:, :n]
    loaded = np.eye(n) + around.spread * to_pores.sum(axis=0)
    known = np.column_stack([around.held, around.spread @ to_pores.T, around.spread])
    known = np.linalg.solve(loaded, known)
    by_well = np.linalg.inv(between - to_pores @ known[:, w : 2 * w])
    pressure = by_well @ (rhs + to_pores @ known[:, :w])
    pores = np.zeros((n + 1, w))  # the last for what is held
    pores[:n] = known[:, :w] + known[:, w : 2 * w] @ pressure
    flow = []
    for k, g in enumerate(stars_g):
        pore = around.number[k][:, None] >= 0
        flow.append(
            g[:, None] * (pressure[k] - np.where(pore, pores[around.number[k]], around.fixed[k]))
        )
    by_pore = np.column_stack([by_well @ (to_pores @ known[:, 2 * w :]), np.zeros(w)])
    return Answer(pressure, flow, by_well, by_pore)


def _slopes(
    around: Surroundings, stars: list[Star], pairs: np.ndarray, factors: np.ndarray
) -> np.ndarray:
    """Changes of `Answer.pressure` by the logarithm of each factor, (factors, w, w).

    More conductance where q flows acts as q taken at one end and given at the other.
    """
    found = _answer(around, stars, pairs, factors)
    w = len(stars)
    change = np.empty((len(factors), w, w))
    for k in range(w):
        change[k] = _slope_of(found, around, k)
    for at, ((k, m), link) in enumerate(zip(pairs, factors[w:], strict=True), start=w):
        flow = link * (found.pressure[k] - found.pressure[m])
        change[at] = np.outer(found.by_well[:, m] - found.by_well[:, k], flow)
    return change


def _slope_of(found: Answer, around: Surroundings, k: int) -> np.ndarray:
    """Changes of pressures (w, w) by the logarithm of the factor of one star."""
    change = (found.by_pore[:, around.number[k]] - found.by_well[:, [k]]) @ found.flow[k]
    return np.asarray(change)


def with_skin(
    a: np.ndarray, b: np.ndarray, g: np.ndarray, well: int, skin_conductance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Connections between terminals with a resistance in series with all that a well takes.

    What takes fluid is then the wall, whose pressure is eliminated: with Σ the sum of the
    conductances g_j that meet there and of the skin's, g_i g_j / Σ joins each two neighbours
    and g_j g_skin / Σ each of them and the well.

    Parameters
    ----------
    a : first terminals, (k,)
    b : second terminals, (k,)
    g : conductances, (k,) m³/(s Pa)
    well : terminal of the well
    skin_conductance : of the skin, m³/(s Pa)
    """
    ours = (a == well) | (b == well)
    neighbour, which = np.unique(np.where(a == well, b, a)[ours], return_inverse=True)
    meets = np.bincount(which, weights=g[ours])
    total = meets.sum() + skin_conductance
    first, second = np.triu_indices(len(neighbour), k=1)
    return (
        np.concatenate([a[~ours], neighbour[first], neighbour]),
        np.concatenate([b[~ours], neighbour[second], np.full(len(neighbour), well)]),
        np.concatenate(
            [g[~ours], meets[first] * meets[second] / total, meets * skin_conductance / total]
        ),
    )
