"""Permeability of a network under three kinds of conditions along its rim, by steady solves.

A linear pressure along the whole rim gives the largest of the three, sealed sides the smallest
where the bar lies along an axis of the rock, and a rim at which the rock repeats itself lies
between: on even rock they agree, on fractured rock they differ by factors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from demflow.model.flow.linear.factor import Symbolic, analyse, factorise, solve
from demflow.model.network.apertures import uniform
from demflow.model.network.connectivity import reached
from demflow.model.network.domains import cut_pipes, cut_places
from demflow.model.network.fractures.subdivide import cuts_of, subdivide
from demflow.model.outcome import ModelError
from demflow.model.products import (
    Apertures,
    BarPermeability,
    Network,
    PeriodicPermeability,
    Permeability,
)
from demflow.model.region import Rectangle, contains

LEFT, RIGHT, BOTTOM, TOP = (
    Rectangle(1.0, 1.0).sides.index(s) for s in ("left", "right", "bottom", "top")
)
OFF_WALLS = 3.0  # mean diameters from the walls where the permeability of the rock is measured


def permeability(network: Network, apertures: Apertures, *, viscosity: float) -> np.ndarray:
    """Permeability tensor (2, 2) in m² of the region.

    Pressure p = −x, then p = −y, is imposed along the whole rim, also where traces leave it, so
    that the mean gradient is exactly −1 along either axis and k = μ D / A (Hill's lemma) with the
    dissipation D_ab = Σ g Δp_a Δp_b of everything up to the rim. The area is that of the same
    pipes and parts of pipes, a tensor that is A times the identity but for the pores that the rim
    cuts: see `_spanned`. Symmetric, positive, and exact wherever pressure is linear. Wells are
    left out. Of a network between walls it is that of the rock some pores away from them.

    Raises `ModelError` where no pipe conducts.

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    viscosity : of the fluid, Pa s
    """
    return LinearRim(network, apertures).measured(apertures, viscosity=viscosity)


def bar_permeability(
    network: Network, apertures: Apertures, *, region: Rectangle, viscosity: float
) -> np.ndarray:
    """Permeability (2,) in m² of the region as a bar in a laboratory, along x and along y.

    The two sides across the flow keep a pressure each, the other two are sealed, and
    k = μ Q L / (A Δp) of the flow Q from one to the other. In rock whose pressure is not linear
    (fractures, anisotropy across the bar) it lies below the tensor of a linear pressure. It is 0
    where nothing leads from side to side.

    Raises `ModelError` where that is so both ways.

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    region : where the case lies, m
    viscosity : of the fluid, Pa s
    """
    return Bar(network, apertures, region=region).measured(apertures, viscosity=viscosity)


def periodic_permeability(
    network: Network, apertures: Apertures, *, viscosity: float
) -> np.ndarray:
    """Permeability tensor (2, 2) in m² of rock that is endless copies of the region side by side.

    The pressure falls by one pascal a metre from copy to copy and is else the same in each; what
    leaves through a side comes in through the opposite one (Durlofsky 1991, Water Resour. Res. 27,
    699–708). A packing does not fit to its own copy: each place where something leaves is joined to
    the nearest one on the opposite side, and one without an opposite side is an end. So a fracture
    that meets no other there goes on in the matrix only. k = μ D / A as in `permeability`, than
    which it is never larger: the linear pressure is one of those among which this dissipates least.
    For rectangles.

    Raises `ModelError` where no pipe conducts.

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    viscosity : of the fluid, Pa s
    """
    return Repeated(network, apertures).measured(apertures, viscosity=viscosity)


class LinearRim:
    """All of `permeability` but the numbers, found once for networks that differ in branches.

    They differ in how well branches of traces conduct, and in nothing else; the same ones do.
    """

    def __init__(self, network: Network, apertures: Apertures) -> None:
        """Of one of the networks. Raises `ModelError` where no pipe of them conducts."""
        network, apertures = _core(network, apertures)
        self.joined = _joined(network, apertures, np.zeros(len(network.cut), dtype=bool))
        held = self.joined.side[:, 0] >= 0
        self.balance = _balance(self.joined, held)
        self.scale = _over_area(network)

    def measured(self, apertures: Apertures, *, viscosity: float) -> np.ndarray:
        """Permeability tensor (2, 2) in m² of any of the networks.

        Parameters
        ----------
        apertures : how far it is open
        viscosity : of the fluid, Pa s
        """
        joined, g = self.joined, self.joined.conductance(apertures)
        p = self.balance.pressures(g, -joined.place)
        return _dissipated(p[joined.a] - p[joined.b], g, viscosity, self.scale)


class Bar:
    """All of `bar_permeability` but the numbers, as `LinearRim` is of `permeability`."""

    def __init__(self, network: Network, apertures: Apertures, *, region: Rectangle) -> None:
        """Of one of the networks. Raises `ModelError` where they carry no flow either way."""
        sides, self.shape = region.sides, region.width / region.height
        self.ways: dict[int, tuple[_Joined, np.ndarray, _Balance]] = {}
        for axis, ends in enumerate((("left", "right"), ("bottom", "top"))):
            first, second = (sides.index(name) for name in ends)
            joined = _joined(network, apertures, ~np.isin(network.cut_side, (first, second)))
            begins = (joined.side == first).any(axis=1)
            held = begins | (joined.side == second).any(axis=1)
            found = reached(len(held), joined.a, joined.b, np.flatnonzero(begins))
            if found[held & ~begins].any():
                self.ways[axis] = joined, begins, _balance(joined, held)
        if not self.ways:
            raise ModelError(
                "no flow goes from side to side, so there is no bar_permeability; give the matrix "
                "an aperture"
            )

    def measured(self, apertures: Apertures, *, viscosity: float) -> np.ndarray:
        """Permeability (2,) in m² of any of the networks along x and along y.

        Parameters
        ----------
        apertures : how far it is open
        viscosity : of the fluid, Pa s
        """
        found = np.zeros(2)
        for axis, (joined, begins, balance) in self.ways.items():
            a, b, g = joined.a, joined.b, joined.conductance(apertures)
            p = balance.pressures(g, begins[:, None].astype(float))[:, 0]
            q = g * (p[a] - p[b])
            found[axis] = viscosity * (q[begins[a]].sum() - q[begins[b]].sum())
        return np.asarray(found * (self.shape, 1.0 / self.shape))


class Repeated:
    """All of `periodic_permeability` but the numbers, as `LinearRim` is of `permeability`."""

    def __init__(self, network: Network, apertures: Apertures) -> None:
        """Of one of the networks. Raises `ModelError` where no pipe of them conducts."""
        network, apertures = _core(network, apertures)
        self.joined = joined = _joined(network, apertures, np.zeros(len(network.cut), dtype=bool))
        _moved(joined, joined.side[:, 0] >= 0)  # refuses what does not conduct
        number = _repeated(joined)
        self.a, self.b = a, b = number[joined.a], number[joined.b]
        self.fall = joined.place[joined.b] - joined.place[joined.a]  # of p = −x and p = −y
        n = int(max(a.max(), b.max())) + 1
        part = connected_components(coo_array((joined.g, (a, b)), (n, n)), directed=False)[1]
        self.held = np.zeros(n, dtype=bool)
        self.held[np.unique(part, return_index=True)[1]] = True  # each part has its own level
        free = np.cumsum(~self.held) - 1
        self.between = ~self.held[a] & ~self.held[b] & (a != b)
        i, j = free[a[self.between]], free[b[self.between]]
        self.symbolic = analyse(int((~self.held).sum()), i, j)
        self.scale = _over_area(network)

    def measured(self, apertures: Apertures, *, viscosity: float) -> np.ndarray:
        """Permeability tensor (2, 2) in m² of any of the networks.

        Parameters
        ----------
        apertures : how far it is open
        viscosity : of the fluid, Pa s
        """
        g = self.joined.conductance(apertures)
        return _dissipated(self.fall + self._periodic(g), g, viscosity, self.scale)

    def _periodic(self, g: np.ndarray) -> np.ndarray:
        """What a periodic pressure adds to the falls (e, 2) of connections so that all balance."""
        a, b, held = self.a, self.b, self.held
        loads = np.zeros((len(held), self.fall.shape[1]))
        np.add.at(loads, a, -g[:, None] * self.fall)
        np.add.at(loads, b, g[:, None] * self.fall)
        excess = np.zeros(len(held))
        np.add.at(excess, a, np.where(held[b], g, 0.0))
        np.add.at(excess, b, np.where(held[a], g, 0.0))
        p = np.zeros_like(loads)
        p[~held] = solve(factorise(self.symbolic, g[self.between], excess[~held]), loads[~held])
        return np.asarray(p[a] - p[b])


def _dissipated(drop: np.ndarray, g: np.ndarray, viscosity: float, scale: np.ndarray) -> np.ndarray:
    """Permeability (2, 2) by what connections dissipate at drops (e, 2) of unit gradients."""
    tensor = scale @ (viscosity * (drop.T @ (g[:, None] * drop))) @ scale
    return np.asarray(0.5 * (tensor + tensor.T))


def _over_area(network: Network) -> np.ndarray:
    """What a dissipation is taken times from both sides: 1 / √ of the area that pipes span."""
    values, axes = np.linalg.eigh(_spanned(network))
    return np.asarray((axes / np.sqrt(values)) @ axes.T)


def _repeated(joined: _Joined) -> np.ndarray:
    """Numbers (n,) of the places, the same for those that are one when the region repeats."""
    used = np.zeros(len(joined.place), dtype=bool)
    used[joined.a] = used[joined.b] = True
    pairs: list[np.ndarray] = []
    for low, high, along in ((LEFT, RIGHT, 1), (BOTTOM, TOP, 0)):
        both = [np.flatnonzero(used & (joined.side[:, 0] == side)) for side in (low, high)]
        if not all(map(len, both)):
            continue
        for one, other in (both, both[::-1]):
            order = other[np.argsort(joined.place[other, along])]
            at = joined.place[order, along]
            nearest = np.searchsorted(0.5 * (at[1:] + at[:-1]), joined.place[one, along])
            pairs.append(np.column_stack([one, order[nearest]]))
    i, j = np.concatenate(pairs).T if pairs else np.empty((2, 0), dtype=int)
    shape = (len(used), len(used))
    found: np.ndarray = connected_components(coo_array((np.ones(len(i)), (i, j)), shape))[1]
    return found


class _Joined(NamedTuple):
    """What joins places: pores, then nodes of traces, then one on the rim for each cut pipe."""

    place: np.ndarray  # (n, 2) m
    side: np.ndarray  # (n, 2) sides of the region on which each lies, −1 none
    a: np.ndarray  # (e,)
    b: np.ndarray  # (e,)
    g: np.ndarray  # (e,) m³/(s Pa)
    branch: np.ndarray  # branches of traces that are the last of the connections

    def conductance(self, apertures: Apertures) -> np.ndarray:
        """That of the connections (e,), m³/(s Pa), where branches conduct as in `apertures`."""
        rest = self.g[: len(self.g) - len(self.branch)]
        return np.concatenate([rest, apertures.branch_conductance[self.branch]])


def _joined(network: Network, apertures: Apertures, sealed: np.ndarray) -> _Joined:
    """All that conducts, up to the rim; a pipe that crosses a sealed side ends beyond it.

    The part of it that lies inside joins the pore beyond, which joins nothing but these.
    `sealed` (b,) says it of each cut pipe.
    """
    d, m = len(network.x), len(apertures.node_x)
    within = (
        network.inside[network.pipe_from]
        & network.inside[network.pipe_to]
        & (apertures.conductance > 0.0)
    )
    pipe, cut = np.flatnonzero(within), np.flatnonzero(apertures.cut_conductance > 0.0)
    t, inner, outer = network.cut_fraction, network.cut_inside, network.cut_outside
    pores = np.column_stack([network.x, network.y])
    nodes = np.column_stack([apertures.node_x, apertures.node_y])
    at_rim = pores[inner] + t[:, None] * (pores[outer] - pores[inner])
    rim = np.where(sealed, outer, d + m + np.arange(len(inner)))
    lies_on = np.column_stack([network.cut_side, np.full(len(inner), -1)])
    across = network.cut[cut]
    cuts = cuts_of(
        apertures,
        np.append(pipe, across),
        np.append(np.zeros(len(pipe), dtype=bool), network.inside[network.pipe_to[across]]),
        np.append(np.ones(len(pipe)), np.where(sealed, 1.0, t)[cut]),
    )
    part = np.where(sealed, t * t, 1.0)
    a, b, g = subdivide(
        np.append(network.pipe_from[pipe], inner[cut]),
        np.append(network.pipe_to[pipe], rim[cut]),
        np.append(apertures.conductance[pipe], (part * apertures.cut_conductance)[cut]),
        cuts,
        d,
    )
    a = np.append(a, d + apertures.branch_a)
    b = np.append(b, d + apertures.branch_b)
    g = np.append(g, apertures.branch_conductance)
    conducts = (a != b) & (g > 0.0)
    branch = np.flatnonzero(conducts[len(a) - len(apertures.branch_a) :])
    side = np.concatenate([np.full((d, 2), -1), apertures.node_side.reshape(m, 2), lies_on])
    place = np.concatenate([pores, nodes, at_rim])
    return _Joined(place, side, a[conducts], b[conducts], g[conducts], branch)


def _moved(joined: _Joined, held: np.ndarray) -> np.ndarray:
    """Which places (n,) the pressures of the held ones reach.

    Raises `ModelError` where they reach no other: parts that they do not carry nothing.
    """
    moved = reached(len(held), joined.a, joined.b, np.flatnonzero(held))
    if not np.any(moved[joined.a] & ~held[joined.a]):
        raise ModelError(
            "no conducting pipe reaches the rim, so there is no permeability to measure; give the "
            "matrix an aperture"
        )
    return moved


def _core(network: Network, apertures: Apertures) -> tuple[Network, Apertures]:
    """A network between walls, whose own rim lets nothing through, cut some pores inside of it."""
    corners = network.grain_radius == 0.0
    if not corners.any():
        return network, apertures
    size = np.array([np.ptp(network.grain_x), np.ptp(network.grain_y)])
    off = np.minimum(OFF_WALLS * 2.0 * network.grain_radius[~corners].mean(), 0.25 * size)
    middle_x = network.grain_x.min() + 0.5 * size[0]
    middle_y = network.grain_y.min() + 0.5 * size[1]
    core = Rectangle(*(size - 2.0 * off).tolist())
    x, y = network.x - middle_x, network.y - middle_y
    inside = contains(core, np.column_stack([x, y])) & network.inside
    cut, inner, outer = cut_pipes(inside, network.pipe_from, network.pipe_to)
    side, fraction = cut_places(core, x, y, inner, outer)
    at_hole = np.isin(cut, network.cut)
    fraction[at_hole] = network.cut_fraction[0] if at_hole.any() else 1.0
    cored = network._replace(
        inside=inside, cut=cut, cut_inside=inner, cut_outside=outer, cut_side=side,
        cut_fraction=fraction,
    )  # fmt: skip
    return cored, apertures._replace(cut_conductance=apertures.conductance[cut] / fraction)


class _Balance(NamedTuple):
    """Where pressures balance connections (e,), some places held: all of it but the numbers."""

    symbolic: Symbolic
    held: np.ndarray  # (n,)
    free: np.ndarray  # (f,) places whose pressure is found
    between: np.ndarray  # connections of free places
    # from either end of the connections: free places, those connections, the held places beyond
    links: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def pressures(self, g: np.ndarray, imposed: np.ndarray) -> np.ndarray:
        """Pressures (n, k) that balance connections (e,), as imposed at the places held."""
        count, several = len(self.free), range(imposed.shape[1])
        excess, rhs = np.zeros(count), np.zeros((count, len(several)))
        for node, link, beyond in self.links:
            excess += np.bincount(node, weights=g[link], minlength=count)
            for k in several:
                load = g[link] * imposed[beyond, k]
                rhs[:, k] += np.bincount(node, weights=load, minlength=count)
        p = np.where(self.held[:, None], imposed, 0.0)
        p[self.free] = solve(factorise(self.symbolic, g[self.between], excess), rhs)
        return p


def _balance(joined: _Joined, held: np.ndarray) -> _Balance:
    """How what is joined balances where the places (n,) are held.

    Raises `ModelError` where their pressures reach no other.
    """
    free = np.flatnonzero(_moved(joined, held) & ~held)
    number = np.full(len(held), -1)
    number[free] = np.arange(len(free))
    i, j = number[joined.a], number[joined.b]
    between = np.flatnonzero((i >= 0) & (j >= 0))
    links = []
    for one, other in ((i, joined.b), (j, joined.a)):
        link = np.flatnonzero((one >= 0) & held[other])
        links.append((one[link], link, other[link]))
    symbolic = analyse(len(free), i[between], j[between])
    return _Balance(symbolic, held, free, between, tuple(links))


def _spanned(network: Network) -> np.ndarray:
    """Area (2, 2) of the rock that the pipes up to the rim span, m².

    Σ Δ ⊗ N over pipes, Δ from centroid to centroid and N the edge between their polygons turned
    outwards, is A times the identity for polygons that tile A; of a pipe that the rim cuts the
    part inside counts. On lattices it is the dissipation of a linear pressure but for a factor,
    however the rim cuts them.
    """
    i, j = network.pipe_from, network.pipe_to
    a, b = network.pipe_grain_a, network.pipe_grain_b
    part = (network.inside[i] & network.inside[j]).astype(float)
    part[network.cut] = network.cut_fraction
    step = np.column_stack([network.x[j] - network.x[i], network.y[j] - network.y[i]])
    edge = np.column_stack(
        [network.grain_y[b] - network.grain_y[a], network.grain_x[a] - network.grain_x[b]]
    )
    outwards = np.where(np.einsum("ij,ij->i", step, edge) < 0.0, -part, part)
    area = step.T @ (outwards[:, None] * edge)
    return np.asarray(0.5 * (area + area.T))


def unit_permeability(network: Network) -> np.ndarray:
    """Permeability of the network for an aperture of 1 m everywhere, (2, 2), m² per m³.

    Since k ∝ w³, the permeability at any uniform aperture w is w³ times this.
    """
    return permeability(network, uniform(network, 1.0, 1.0), viscosity=1.0)


def calibrate(network: Network) -> Permeability:
    """Permeability of the network at an aperture of 1 m (the *calibrate* stage)."""
    return Permeability(unit_permeability(network))


def measure(network: Network, apertures: Apertures, *, viscosity: float) -> Permeability:
    """Permeability of the open network (the *measure* stage).

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    viscosity : of the fluid, Pa s
    """
    return Permeability(permeability(network, apertures, viscosity=viscosity))


def measure_bar(
    network: Network, apertures: Apertures, *, region: Rectangle, viscosity: float
) -> BarPermeability:
    """Permeability of the open network as a bar with sealed sides (the *measure_bar* stage).

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    region : where the case lies, m
    viscosity : of the fluid, Pa s
    """
    return BarPermeability(bar_permeability(network, apertures, region=region, viscosity=viscosity))


def measure_periodic(
    network: Network, apertures: Apertures, *, viscosity: float
) -> PeriodicPermeability:
    """Permeability of the open network where it repeats itself (the *measure_periodic* stage).

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    viscosity : of the fluid, Pa s
    """
    return PeriodicPermeability(periodic_permeability(network, apertures, viscosity=viscosity))
