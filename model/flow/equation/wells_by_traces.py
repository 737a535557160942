"""Wells beside traces: where what they feel of a trace begins.

A trace cuts the ways of a well to the pores around where they cross it in the plane, seen from
the well's own axis. How near it is felt is then fitted: where traces around keep their pressure, a
well has that of a continuum (`grounded_field`). All cuts of one trace around a well move along
their pipes alike for that, of which the whole stays what it is: traces that conduct nothing change
nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.branches import TOUCHES
from demflow.model.flow.equation.grounded_field import GroundedField, grounded_field
from demflow.model.flow.equation.wells import Edges, Wells
from demflow.model.flow.linear.factor import analyse, factorise, solve
from demflow.model.network.connectivity import reached
from demflow.model.network.fractures.subdivide import NEAREST, Cuts, joined_cuts, subdivide
from demflow.model.network.fractures.walk import TIP_REACH
from demflow.model.products import Apertures, Network
from demflow.model.region import Region

# Traces nearer to a well's wall than this many spacings of the pores are felt as they should be,
# by cuts at most so many further away than the trace; by more of them where these do not do.
NEAR_PORES = 3.0
AROUND_PORES = 1.5, 2.5, 4.0

# How far cuts may be moved at most: as logarithms of factors.
STEPS = 5.0

# Where the rock between is so tight that even that does not do, the well has a link to the trace, a
# conductance over 2π k/μ.
LINKS = 1e-9, 1e3


class Link(NamedTuple):
    """A conductance from a well to a node of a trace."""

    well: int
    node: int
    g: float  # m³/(s Pa)


class Fit(NamedTuple):
    """Cuts around a well as they give it the pressure of a field."""

    cuts: Cuts
    bound: int  # 0, or which end of the range they stand at
    link: Link | None = None  # what the well needs beside that


def cuts_by_wells(
    cuts: Cuts,
    edges: Edges,
    network: Network,
    apertures: Apertures,
    wells: Wells,
    region: Region,
    fixed: np.ndarray,
) -> tuple[Cuts, list[Link]]:
    """Cuts of connections with those around each well where it should feel them, and links.

    Parameters
    ----------
    cuts : of all connections
    edges : the connections, with those of wells
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    wells : the wells
    region : where the case lies, m
    fixed : (sides,) bool, which sides keep a pressure
    """
    lines = np.unique(apertures.branch_line)
    links: list[Link] = []
    if not len(lines):
        return cuts, links
    for k, site in enumerate(wells.sites):
        field, spacing = wells.fields[k], wells.spacing[k]
        away = _distance(apertures, lines, np.asarray(site.at))
        touch = lines[away <= site.radius * (1.0 + TOUCHES)]
        links += [link for line in touch if (link := _lost_tip(apertures, wells, k, line))]
        if field is None:
            continue
        near = lines[away < site.radius + NEAR_PORES * spacing]
        if not len(near):
            continue
        cuts = _seen_from(cuts, edges, network, apertures, wells, k, near)
        if len(touch):
            continue
        start, end = apertures.trace_start[near], apertures.trace_end[near]
        free = field.free if isinstance(field, GroundedField) else field
        grounded = grounded_field(free, start, end, region, fixed)
        for pores in AROUND_PORES:
            reach = away.min() + pores * spacing
            tried = _fitted(cuts, edges, network, apertures, wells, k, near, grounded, reach)
            if tried.bound == 0:
                break
        cuts = tried.cuts
        if tried.link is not None:
            links.append(tried.link)
    return cuts, links


def _lost_tip(apertures: Apertures, wells: Wells, k: int, line: int) -> Link | None:
    """The stretch of a trace from its last node to a well's wall, where the trace ends there.

    A tip that meets no pipe is no node of the trace, unless a well makes it one.
    """
    site, ours = wells.sites[k], np.flatnonzero(apertures.branch_line == line)
    ends = np.stack([apertures.branch_a[ours], apertures.branch_b[ours]])
    place = np.stack([apertures.node_x[ends], apertures.node_y[ends]], axis=-1) - site.at
    step = place[1] - place[0]
    square = np.maximum(
        (step * step).sum(1), np.finfo(float).tiny
    )  # a lost tip ends where it begins
    part = np.clip(-(place[0] * step).sum(1) / square, 0.0, 1.0)
    wall = site.radius * (1.0 + TOUCHES)
    if np.hypot(*(place[0] + part[:, None] * step).T).min() <= wall:
        return None
    away = np.hypot(*np.moveaxis(place, -1, 0))
    side, branch = np.unravel_index(away.argmin(), away.shape)
    carried = apertures.branch_conductance[ours[branch]] * apertures.branch_length[ours[branch]]
    return Link(k, int(ends[side, branch]), float(carried / (away.min() - site.radius)))


def _distance(apertures: Apertures, lines: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Distance of a place from lines, (l,) m."""
    start, step = apertures.trace_start[lines], apertures.trace_end[lines]
    step = step - start
    part = np.clip(((at - start) * step).sum(1) / (step * step).sum(1), 0.0, 1.0)
    found: np.ndarray = np.hypot(*(start + part[:, None] * step - at).T)
    return found


def _seen_from(
    cuts: Cuts,
    edges: Edges,
    network: Network,
    apertures: Apertures,
    wells: Wells,
    k: int,
    lines: np.ndarray,
) -> Cuts:
    """Cuts of what leaves a well where a logarithmic field has them, as parts of the resistance.

    A well in one pore may lie across a trace from the pore's centroid: its ways are cut where they
    cross the trace, at the node of it that is nearest. One of several pores keeps the cuts of
    the pores' pipes.
    """
    site = wells.sites[k]
    at = np.asarray(site.at)
    leaves = (edges.a == len(network.x) + k) & (edges.way >= 0)
    ours = np.flatnonzero(leaves)
    place = np.column_stack([apertures.node_x, apertures.node_y])
    if len(wells.taken[k]) == 1:
        kept = ~leaves[cuts.way] | (cuts.node < 0)
        found = [cuts.only(kept)]
        for line in lines.tolist():
            start, end, nodes = _stretch(apertures, line, wells.spacing[k])
            way = ours[_cross(at, edges.end[ours], start, end)]
            step = edges.end[way] - at
            along = end - start
            part = _det(start - at, along) / _det(step, along)
            meets = at + part[:, None] * step
            nearest = np.linalg.norm(meets[:, None] - place[nodes], axis=2).argmin(axis=1)
            far = _in_logarithm(np.hypot(*(meets - at).T), np.hypot(*step.T), site.radius)
            none = np.zeros(len(way))
            found.append(Cuts(way, far, nodes[nearest], none, none))
        return joined_cuts(*found)
    of_well = np.flatnonzero(leaves[cuts.way] & (cuts.node >= 0))
    here = np.hypot(*(place[cuts.node[of_well]] - at).T)
    far = np.hypot(*(edges.end[cuts.way[of_well]] - at).T)
    fraction = cuts.fraction.copy()
    fraction[of_well] = _in_logarithm(here, far, site.radius)
    return cuts._replace(fraction=fraction)


def _in_logarithm(here: np.ndarray, far: np.ndarray, radius: float) -> np.ndarray:
    """Part of the resistance from a well's wall to `far` that lies before `here`, m."""
    far = np.maximum(far, radius * (1.0 + 1e-9))
    found: np.ndarray = np.log(np.maximum(here, radius) / radius) / np.log(far / radius)
    return np.minimum(found, 1.0)


def _det(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    found: np.ndarray = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return found


def _cross(at: np.ndarray, end: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Which segments from a place to `end` (n, 2) cross that from p to q."""
    sides = (_det(q - p, end - p) > 0.0) != (_det(q - p, at - p) > 0.0)
    found: np.ndarray = sides & ((_det(end - at, p - at) > 0.0) != (_det(end - at, q - at) > 0.0))
    return found


def _stretch(
    apertures: Apertures, line: int, spacing: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends of a trace with the reach of its tips, and its nodes."""
    start, end = apertures.trace_start[line], apertures.trace_end[line]
    ours = apertures.branch_line == line
    nodes = np.unique(np.concatenate([apertures.branch_a[ours], apertures.branch_b[ours]]))
    meets = np.concatenate([apertures.branch_a, apertures.branch_b])
    along = (end - start) / np.hypot(*(end - start))
    at = (np.column_stack([apertures.node_x, apertures.node_y])[nodes] - start) @ along
    more = []
    for node in (nodes[at.argmin()], nodes[at.argmax()]):
        tip = np.count_nonzero(meets == node) == 1 and (apertures.node_side[node] < 0).all()
        more.append(TIP_REACH * spacing if tip else 0.0)
    return start - more[0] * along, end + more[1] * along, nodes


class Around(NamedTuple):
    """The rock within a ring around a well whose traces keep their pressure, as the well feels it.

    t pores lie at the ends of ways of which something may change: those of the well, and those
    whose cuts may be moved. Conductances are over 2π √det(k/μ).
    """

    held: np.ndarray  # (t,) pressures without the ways
    spread: np.ndarray  # (t, t) pressures by unit inflows
    anchor: np.ndarray  # (t,) conductance to zero pressure that these have and the rock has not
    one: np.ndarray  # (w,) pore at the one end of each way, t for the well
    other: np.ndarray  # (w,) at the other, −1 where the pressure is known
    g: np.ndarray  # (w,)
    known: np.ndarray  # (w,) that pressure

    def well(self, cuts: Cuts, link: float) -> float:
        """Pressure of the well at a unit rate, the ways cut by grounded traces."""
        t = len(self.held)
        first = t + 1 + len(self.g)  # after the well and the ends whose pressure is known
        end = np.where(self.other < 0, t + 1 + np.arange(len(self.g)), self.other)
        a, b, g = subdivide(
            self.one, end, self.g, cuts._replace(node=np.zeros_like(cuts.way)), first
        )
        value = np.append(np.zeros(t + 1), np.append(self.known, 0.0))
        matrix, load = np.zeros((t + 1, t + 1)), np.zeros(t + 1)
        for p, q in ((a, b), (b, a)):
            ours = p <= t
            np.add.at(matrix, (p[ours], p[ours]), g[ours])
            free = ours & (q <= t)
            np.add.at(matrix, (p[free], q[free]), -g[free])
            np.add.at(load, p[ours], g[ours] * value[q[ours]])
        load[t] -= 1.0
        matrix[t, t] += link
        matrix[np.arange(t), np.arange(t)] -= self.anchor
        matrix[:t] = self.spread @ matrix[:t]
        matrix[np.arange(t), np.arange(t)] += 1.0
        load[:t] = self.held + self.spread @ load[:t]
        return float(np.linalg.solve(matrix, load)[t])


def _fitted(
    cuts: Cuts,
    edges: Edges,
    network: Network,
    apertures: Apertures,
    wells: Wells,
    k: int,
    lines: np.ndarray,
    field: GroundedField,
    reach: float,
) -> Fit:
    """Cuts by traces around a well moved until it has the pressure of the field.

    Those whose nodes are nearer than `reach`, m, are met nearer to the well along their ways, or
    from further away beside them.
    """
    at = np.asarray(wells.sites[k].at)
    on = np.isin(apertures.branch_line, lines)
    grounds = np.zeros(len(apertures.node_x), dtype=bool)
    grounds[np.concatenate([apertures.branch_a[on], apertures.branch_b[on]])] = True
    ours = (cuts.node >= 0) & grounds[cuts.node]
    away = np.hypot(apertures.node_x[cuts.node] - at[0], apertures.node_y[cuts.node] - at[1])
    moved = np.flatnonzero(ours & (away < reach))
    if not len(moved):
        return Fit(cuts, 1)
    place = np.concatenate(
        [np.column_stack([network.x, network.y]), [site.at for site in wells.sites]]
    )
    way = cuts.way[moved]
    begins = np.linalg.norm(place[edges.a[way]] - at, axis=1)
    ahead = begins <= np.linalg.norm(edges.end[way] - at, axis=1)

    def by(step: float) -> Cuts:
        t = np.clip(cuts.fraction[moved], NEAREST, 1.0 - NEAREST)
        t = np.where(ahead, t, 1.0 - t)
        odds = np.exp(min(step, 0.0))
        t = odds * t / (1.0 - t + odds * t)
        fraction, spur = cuts.fraction.copy(), cuts.spur.copy()
        fraction[moved] = np.where(ahead, t, 1.0 - t)
        spur[moved] = 0.25 * np.expm1(max(step, 0.0))
        return cuts._replace(fraction=fraction, spur=spur)

    star = np.flatnonzero(edges.a == len(network.x) + k)
    around, ways = _around(
        edges, place, network, wells, k, field, np.union1d(star, way), cuts.only(ours)
    )
    number = np.full(len(edges.a), -1)
    number[ways] = np.arange(len(ways))
    involved = np.flatnonzero(ours & (number[cuts.way] >= 0))

    def misfit(step: float, link: float = 0.0) -> float:
        found = by(step).only(involved)
        return around.well(found._replace(way=number[found.way]), link) - field.at_wall

    from scipy.optimize import brentq  # late: few wells stand beside traces

    if misfit(STEPS) > 0.0:
        return Fit(by(STEPS), 1)
    if misfit(-STEPS) > 0.0:
        return Fit(by(brentq(misfit, -STEPS, STEPS, xtol=1e-3)), 0)
    low, high = np.log(LINKS)
    if misfit(-STEPS, LINKS[1]) > 0.0:
        high = brentq(lambda found: misfit(-STEPS, np.exp(found)), low, high, xtol=1e-3)
    unit = 2.0 * np.pi * wells.mobility[k]
    node = cuts.node[moved[away[moved].argmin()]]
    return Fit(by(-STEPS), -1, Link(k, int(node), unit * float(np.exp(high))))


def _around(
    edges: Edges,
    place: np.ndarray,
    network: Network,
    wells: Wells,
    k: int,
    field: GroundedField,
    ways: np.ndarray,
    cuts: Cuts,
) -> tuple[Around, np.ndarray]:
    """Solve the rock within the ring around a well, but for some ways; those of them within."""
    d, at = len(network.x), np.asarray(wells.sites[k].at)
    near = np.zeros(max(len(place), 1 + int(max(edges.a.max(), edges.b.max()))), dtype=bool)
    dx, dy = network.x - at[0], network.y - at[1]
    near[:d] = network.inside & (dx * dx + dy * dy < field.free.reach**2)
    to = edges.b[edges.a == d + k]
    near[to[to < d]] = True
    near[np.concatenate(wells.taken)] = False
    n = int(near.sum())
    node = np.full(len(near), -1)
    node[near] = np.arange(n)
    node[d + k] = n
    kept = np.flatnonzero((node[edges.a] >= 0) | (node[edges.b] >= 0))
    a, b = node[edges.a[kept]], node[edges.b[kept]]
    turned = a < 0  # then the end whose pressure is known comes second all the same
    beyond = np.where(turned[:, None], place[edges.a[kept]], edges.end[kept])
    known = np.where((a < 0) | (b < 0), field.at_points(beyond), 0.0)
    g = edges.g[kept] / (2.0 * np.pi * wells.mobility[k])
    apart = np.isin(kept, ways)

    number = np.full(len(edges.a), -1)
    number[kept[~apart]] = np.arange(np.count_nonzero(~apart))
    rest = cuts.only(number[cuts.way] >= 0)
    rest = rest._replace(way=number[rest.way], node=np.zeros(len(rest.way), dtype=np.int64))
    outer = n + 1 + np.arange(len(kept))
    p, q = np.where(a < 0, outer, a)[~apart], np.where(b < 0, outer, b)[~apart]
    ground = n + 1 + len(kept)
    p, q, h = subdivide(p, q, g[~apart], rest, ground)
    value = np.concatenate([np.zeros(n + 1), known, [0.0]])
    free = (p < n) & (q < n)
    excess, load = np.zeros(n), np.zeros(n)
    for one, other in ((p, q), (q, p)):
        ends = (one < n) & (other > n)
        excess += np.bincount(one[ends], h[ends], n)
        load += np.bincount(one[ends], (h * value[np.minimum(other, ground)])[ends], n)
    pore = np.unique(np.concatenate([a[apart], b[apart]]))
    pore = pore[(pore >= 0) & (pore < n)]
    # a pore that the ways alone join to the rest has one unit to the ground here, none in the end
    anchor = ~reached(n, p[free], q[free], np.flatnonzero(excess > 0.0))[pore]
    excess[pore] += anchor
    excess += ~reached(n, p[free], q[free], np.flatnonzero(excess > 0.0))
    unit = np.zeros((n, 1 + len(pore)))
    unit[:, 0] = load
    unit[pore, 1 + np.arange(len(pore))] = 1.0
    factor = factorise(analyse(n, p[free], q[free]), h[free], excess)
    pressure = solve(factor, unit)[pore]
    order = np.full(n + 2, -1)  # the last for what is known
    order[pore] = np.arange(len(pore))
    order[n] = len(pore)
    one, other = a[apart], b[apart]
    return Around(
        held=pressure[:, 0],
        spread=pressure[:, 1:],
        anchor=anchor.astype(float),
        one=order[np.where(turned[apart], other, one)],
        other=order[np.where(turned[apart], -1, other)],
        g=g[apart],
        known=known[apart],
    ), kept[apart]
