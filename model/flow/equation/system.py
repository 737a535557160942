"""The flow equation of a case: C dp/dt = −G p + f on pores and wells.

Pores outside the region, inside a well, or reached by no source are not unknowns. A well
at a given rate is one unknown, with storage where it has a wellbore storage, else without;
sides and wells at a given pressure enter through the excess of the rows beside them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.branches import branches, wells_of_nodes
from demflow.model.flow.equation.grounded_field import GroundedField, grounded_field
from demflow.model.flow.equation.local_rock import mobility_around, spacing_around
from demflow.model.flow.equation.sites import InflowSite, Site, WellSite
from demflow.model.flow.equation.well_field import WellField, well_field
from demflow.model.flow.equation.wells import (
    Edges,
    Wells,
    join_wells,
    joints_of,
    pores_of_wells,
    with_skin,
)
from demflow.model.flow.equation.wells_by_traces import cuts_by_wells
from demflow.model.flow.linear.kept import Kept
from demflow.model.network.connectivity import reached
from demflow.model.network.fractures.subdivide import Cuts, cuts_of, joined_cuts, subdivide
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Network
from demflow.model.region import Region, distance_to_rim, named_sides

TINY = float(np.finfo(float).tiny)

# Around a well, a ring of pores this far from its wall tells what it should feel. Pressures that
# are held on it hinder the rock within from taking its own: near by that would cost a few per
# mille. It ends at the rim, but is not nearer than the first of these.
RING_PORES = 5.0, 16.0


class System(NamedTuple):
    """Unknowns 0 … n − 1: active pores, nodes of traces, wells at a rate, those that store first.

    Sources are the fixed pressures (sides, then wells), then the wells at a rate, then the
    unit initial fields.
    """

    domain: np.ndarray  # (pores,) the place of each: a domain d, or node k of the traces as d + k
    n: int  # unknowns
    storage: np.ndarray  # (n,) C = V / K_f, of wells their wellbore storage, m³/Pa
    edge_i: np.ndarray  # (e,)
    edge_j: np.ndarray  # (e,)
    edge_g: np.ndarray  # (e,) m³/(s Pa)
    fixed_node: np.ndarray  # (f,) unknown beside a fixed pressure
    fixed_source: np.ndarray  # (f,) which one
    fixed_g: np.ndarray  # (f,) m³/(s Pa)
    short_a: np.ndarray  # (h,) fixed sources that pipes join with no unknown between
    short_b: np.ndarray  # (h,)
    short_g: np.ndarray  # (h,) m³/(s Pa)
    sides: tuple[str, ...]  # names of the sides at fixed pressure
    pressure_wells: tuple[int, ...]  # positions of the wells at fixed pressure
    rate_wells: tuple[int, ...]  # positions of the wells at a rate
    well_node: np.ndarray  # (rate wells,) unknown of each
    node_of_domain: np.ndarray  # (d + m,) unknown of each place, −1 none
    source_of_domain: np.ndarray  # (d + m,) fixed source whose pressure a place has, −1 none
    isolated: int  # pores inside the region that no source reaches
    initial: np.ndarray  # (fields, n) unit initial fields; none where the start is uniform

    @property
    def fixed_count(self) -> int:
        """Number of fixed pressures, sides and wells."""
        return len(self.sides) + len(self.pressure_wells)

    @property
    def source_count(self) -> int:
        """Number of sources."""
        return self.fixed_count + len(self.rate_wells) + len(self.initial)

    @property
    def pores(self) -> int:
        """Number of unknowns that store fluid: pores, and wells with wellbore storage as they."""
        return self.n - int(np.count_nonzero(self.storage[self.well_node] == 0.0))

    @property
    def excess(self) -> np.ndarray:
        """Conductance of each unknown to fixed pressures, (n,) m³/(s Pa)."""
        found = np.bincount(self.fixed_node, weights=self.fixed_g, minlength=self.n)
        return found.astype(float)

    def reached(self, domains: np.ndarray) -> np.ndarray:
        """Which domains have a pressure that some source moves, as a mask."""
        found: np.ndarray = (self.node_of_domain[domains] >= 0) | (
            self.source_of_domain[domains] >= 0
        )
        return found

    def source(self, index: int) -> np.ndarray:
        """Right-hand side for a unit of one source, (n,): 1 Pa, or 1 m³/s produced.

        That of an initial field u is −G u: what the field moves by itself.
        """
        if index < self.fixed_count:
            ours = self.fixed_source == index
            found = np.bincount(self.fixed_node[ours], self.fixed_g[ours], minlength=self.n)
            return found.astype(float)  # of none at all it counts in whole numbers
        well = index - self.fixed_count
        if well >= len(self.rate_wells):
            return self.net_inflow(self.initial[well - len(self.rate_wells)])
        rhs = np.zeros(self.n)
        rhs[self.well_node[well]] = -1.0
        return rhs

    def net_inflow(self, pressure: np.ndarray) -> np.ndarray:
        """Flow −G p into each unknown at pressures (n,) with zero at the fixed ones, (n,) m³/s."""
        flow = self.edge_g * (pressure[self.edge_j] - pressure[self.edge_i])
        net = np.bincount(self.edge_i, weights=flow, minlength=self.n)
        net -= np.bincount(self.edge_j, weights=flow, minlength=self.n)
        found: np.ndarray = net - self.excess * pressure
        return found


def assemble(
    network: Network,
    apertures: Apertures,
    *,
    region: Region,
    bulk_modulus: float,
    wells: tuple[Site, ...],
    sides: tuple[str, ...],
    at_side: np.ndarray | None = None,
) -> System:
    """Set up the flow equation.

    Pores and nodes of traces are its places. `sides` names the sides at fixed pressure
    (`outer` takes all of them); the others are sealed. A pore in a well shares the well's
    pressure and stores nothing of its own; what joins a well to the pores around gives it the
    pressure of a well in a continuum of the rock there (`wells.join_wells`), and a trace that
    passes a well meets its wall. A side with an inflow is a well at a rate whose wall is the side:
    the pipes across the rim end at its pressure, which is one along the side. A skin S adds
    q μ S / (2π k) to the fall of the well's pressure (van Everdingen 1953, Trans. AIME 198;
    Agarwal, Al-Hussainy & Ramey 1970, SPE J. 10, 279–290), with the permeability of the rock
    around the well.

    In a rock that deforms every pore is an unknown, whether flow reaches it or not. Of its pores
    between walls `at_side` (d,) then says which side holds the pressure of each, −1 none.

    Raises `ModelError` where a conductance or a volume is no number, or negative, or where
    nothing stores fluid.

    Parameters
    ----------
    at_side : (pores,) which side a pore belongs to, or None
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    region : where the case lies, m
    bulk_modulus : of the fluid, Pa
    wells : the wells, then the sides with an inflow
    sides : names of the sides at fixed pressure; `outer` takes all of them
    """
    _check_numbers(network, apertures)
    pressure_wells = tuple(k for k, w in enumerate(wells) if w.fixed_pressure)
    rate_wells = tuple(k for k, w in enumerate(wells) if not w.fixed_pressure)
    storing = np.array([wells[k].storage for k in rate_wells])
    last_empty = np.argsort(storing == 0.0, kind="stable")  # wells that store nothing come last
    order = np.argsort(last_empty)
    drilled = tuple(w for w in wells if isinstance(w, WellSite))
    ends = (*(w.name for w in wells if isinstance(w, InflowSite)), *sides)  # of pipes at the rim
    side_source = sources_of_sides(region, ends)
    rock, cuts = _rock(network, apertures, side_source[network.cut_side], len(drilled))
    placed, joints = _drilled(network, apertures, region, drilled, side_source, rock)
    well_of = np.append(np.full(len(network.x), -1), wells_of_nodes(apertures, drilled))
    for k in reversed(range(len(drilled))):
        well_of[placed.taken[k]] = k

    # Everything that flow can reach is a terminal: places, then the wells, then the sides, those
    # with an inflow first.
    d, w = len(well_of), len(wells)
    inside = np.append(network.inside, np.ones(len(apertures.node_x), dtype=bool))
    terminal = np.where(well_of >= 0, d + well_of, np.where(inside, np.arange(d), -1))
    side = _sides_of_nodes(apertures, side_source)
    terminal[len(network.x) :][side >= 0] = d + len(drilled) + side[side >= 0]
    if at_side is not None:
        stands = np.flatnonzero((at_side >= 0) & (well_of[: len(at_side)] < 0))
        terminal[stands] = d + w + at_side[stands]
    held = np.full(d + w + len(sides), -1)  # the source that fixes a terminal's pressure
    held[d + w :] = np.arange(len(sides))
    held[[d + k for k in pressure_wells]] = len(sides) + np.arange(len(pressure_wells))
    rock = join_wells(rock, network, placed, joints)
    a, b, g = _connections(network, apertures, region, placed, side_source, terminal, rock, cuts)
    a, b = np.where(held[a] >= 0, b, a), np.where(held[a] >= 0, a, b)
    free, link = held[b] < 0, (held[a] < 0) & (held[b] >= 0)
    between = held[a] >= 0

    moved = reached(len(held), a[free], b[free], [*a[link], *(d + k for k in rate_wells)])
    moved |= at_side is not None
    domain = np.flatnonzero((terminal == np.arange(d)) & moved[:d])
    number = np.full(len(held), -1)
    number[domain] = np.arange(len(domain))
    number[[d + k for k in rate_wells]] = len(domain) + order
    free &= (number[a] >= 0) & (number[b] >= 0)
    node_of_domain = np.where(terminal >= 0, number[terminal], -1)
    source_of_domain = np.where(terminal >= 0, held[terminal], -1)
    met = (node_of_domain >= 0) | (source_of_domain >= 0)
    alone = network.inside & ~met[: len(network.x)]
    volume = np.append(apertures.volume, apertures.node_volume)
    return System(
        domain=domain,
        n=len(domain) + len(rate_wells),
        storage=np.append(volume[domain] / bulk_modulus, storing[last_empty]),
        edge_i=number[a[free]],
        edge_j=number[b[free]],
        edge_g=g[free],
        fixed_node=number[a[link]],
        fixed_source=held[b[link]],
        fixed_g=g[link],
        short_a=held[a[between]],
        short_b=held[b[between]],
        short_g=g[between],
        sides=sides,
        pressure_wells=pressure_wells,
        rate_wells=rate_wells,
        well_node=len(domain) + order,
        node_of_domain=node_of_domain,
        source_of_domain=source_of_domain,
        isolated=int(np.count_nonzero(alone)),
        initial=np.empty((0, len(domain) + len(rate_wells))),
    )


def _check_numbers(network: Network, apertures: Apertures) -> None:
    """Raise where the network could give no flow equation, before time is spent."""
    for what, values in (
        ("conductance", apertures.conductance),
        ("conductance at the rim", apertures.cut_conductance),
        ("pore volume", apertures.volume),
        ("conductance of the traces", apertures.branch_conductance),
        ("volume of the traces", apertures.node_volume),
    ):
        wrong = np.flatnonzero(~(np.isfinite(values) & (values >= 0.0)))
        if len(wrong):
            raise ModelError(
                f"the {what} of {len(wrong)} of {len(values)} is negative or no finite number, "
                f"first that of number {wrong[0]}: {values[wrong[0]]}; check apertures and fluid"
            )
    if not np.all(apertures.volume[network.inside] > 0.0):
        empty = np.flatnonzero(network.inside & ~(apertures.volume > 0.0))
        x, y = network.x[empty[0]], network.y[empty[0]]
        raise ModelError(
            f"{len(empty)} pores of the region have no volume, so that nothing stores fluid there, "
            f"first number {empty[0]} at ({x:.4g} m, {y:.4g} m); check the volumes given, or pack "
            "grains that leave pores"
        )


def _drilled(
    network: Network,
    apertures: Apertures,
    region: Region,
    wells: tuple[WellSite, ...],
    side_source: np.ndarray,
    rock: Edges,
) -> tuple[Wells, Edges]:
    """The wells in the rock, and what joins them to the pores and sides around.

    Cases that differ in traces or rates share it; the last few are kept.
    """
    taken = pores_of_wells(network, wells)
    fixed = side_source >= 0

    def make() -> tuple[Wells, Edges]:
        placed = _placed(network, apertures, region, wells, taken, fixed)
        return placed, joints_of(rock, network, placed)

    if not wells:
        return Wells((), [], [], np.zeros(0), np.zeros(0)), rock.only(np.zeros(0, dtype=int))
    read = (
        *(network.x, network.y, network.area, network.inside, network.pipe_from, network.pipe_to),
        *(network.cut, network.cut_inside, network.cut_outside, network.cut_side),
        *(network.cut_fraction, side_source, *taken),
        *(apertures.conductance, apertures.cut_conductance, apertures.on_fracture),
    )
    return _kept_wells.get((*read, region, wells), make)


# What joins wells to the rock takes this many bytes at most, beside the last case's.
KEPT_BYTES = 1 << 24
_kept_wells: Kept[tuple[Wells, Edges]] = Kept(
    KEPT_BYTES, lambda made: sum(array.nbytes for array in (*made[0].taken, *made[1]))
)


def _placed(
    network: Network,
    apertures: Apertures,
    region: Region,
    wells: tuple[WellSite, ...],
    taken: list[np.ndarray],
    fixed: np.ndarray,
) -> Wells:
    """The field that each well would have in uniform rock."""
    fields: list[WellField | GroundedField | None] = []
    mean, apart = np.zeros(len(wells)), np.zeros(len(wells))
    for k, well in enumerate(wells):
        apart[k] = spacing = spacing_around(network, well.at, well.radius)
        mobility = mobility_around(network, apertures, region, well.at, well.radius, spacing)
        mean[k] = np.sqrt(max(np.linalg.det(mobility), 0.0))
        rim = distance_to_rim(region, np.array([well.at]))[0] - well.radius
        reach = well.radius + spacing * float(np.clip(rim / spacing, *RING_PORES))
        if not mean[k]:
            fields.append(None)
            continue
        field = well_field(well.at, well.radius, mobility, region, fixed, reach)
        # beside a rim the wall of a well does not lie on one pressure of a line's field
        alone = np.empty((0, 2))
        beside = len(field.image) > 0
        fields.append(grounded_field(field, alone, alone, region, fixed) if beside else field)
    return Wells(wells, taken, fields, mean, apart)


def _connections(
    network: Network,
    apertures: Apertures,
    region: Region,
    wells: Wells,
    side_source: np.ndarray,
    terminal: np.ndarray,
    joined: Edges,
    cuts: Cuts,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Conductances between terminals: rock and wells `joined`, cut by traces, and their branches.

    `cuts` are those of the rock without wells.
    """
    cuts = cuts.along(joined.way, joined.turned)
    cuts, links = cuts_by_wells(cuts, joined, network, apertures, wells, region, side_source >= 0)
    # nodes of traces are numbered after the pores
    nodes = len(apertures.node_x)
    a, b = (np.where(t >= len(network.x), t + nodes, t) for t in (joined.a, joined.b))
    a, b, g = subdivide(a, b, joined.g, cuts, len(network.x))
    first_well, sides = len(terminal), int(side_source.max(initial=-1)) + 1
    places = np.append(terminal, np.arange(first_well, first_well + len(wells.sites) + sides))
    p, q, along = branches(apertures, wells.sites, len(network.x), first_well)
    p = np.concatenate([a, p, [len(network.x) + link.node for link in links]]).astype(np.int64)
    q = np.concatenate([b, q, [first_well + link.well for link in links]]).astype(np.int64)
    a, b, g = places[p], places[q], np.concatenate([g, along, [link.g for link in links]])
    conducts = (a != b) & (g > 0.0)
    a, b, g = a[conducts], b[conducts], g[conducts]
    for number, well in enumerate(wells.sites):
        if well.skin > 0.0:
            rock = 2.0 * np.pi * wells.mobility[number]
            if rock == 0.0:
                raise ModelError(
                    f"well {well.name} has a skin_factor, which needs a permeability of the rock "
                    "between the well and the rim, but no pipe of the rock conducts there"
                )
            a, b, g = with_skin(a, b, g, first_well + number, rock / well.skin)
    return a, b, g


def _rock(
    network: Network, apertures: Apertures, rim: np.ndarray, wells: int
) -> tuple[Edges, Cuts]:
    """Connections of the pores without wells and traces, and what will cut them.

    `rim` (b,) is the source at which each pipe across the rim ends, −1 at a sealed side.
    """
    place = np.column_stack([network.x, network.y])
    within = network.inside[network.pipe_from] & network.inside[network.pipe_to]
    pipe = np.flatnonzero(within & (apertures.conductance > 0.0))
    j = network.pipe_to[pipe]
    along = np.where(apertures.on_fracture >= 0, np.arange(len(apertures.on_fracture)), -1)

    k, m, around = _around_sealed_sides(network, apertures, rim < 0)
    inner = network.cut_inside

    cut = np.flatnonzero((rim >= 0) & (apertures.cut_conductance > 0.0))
    outer, part = network.cut_outside[cut], network.cut_fraction[cut]
    end = place[inner[cut]] + part[:, None] * (place[outer] - place[inner[cut]])
    rock = np.full(len(k), -1)
    a = np.concatenate([network.pipe_from[pipe], inner[k], inner[cut]])
    edges = Edges(
        a=a,
        b=np.concatenate([j, inner[m], len(network.x) + wells + rim[cut]]),
        g=np.concatenate([apertures.conductance[pipe], around, apertures.cut_conductance[cut]]),
        end=np.concatenate([place[j], place[inner[m]], end]),
        pipe=np.concatenate([along[pipe], rock, along[network.cut[cut]]]),
        way=np.arange(len(a)),
        turned=np.zeros(len(a), dtype=bool),
    )
    backward = network.inside[network.pipe_to[network.cut]]
    whole = apertures.cut_conductance * network.cut_fraction**2
    share = whole[m] / (whole[k] + whole[m])
    # flow of one pipe that parts into several beyond the side meets a barrier on it but once
    meets = np.where((rim < 0) & (whole > 0.0), whole, 0.0)
    total = np.bincount(network.cut_outside, weights=meets, minlength=len(network.x))
    others = np.bincount(network.cut_outside[meets > 0.0], minlength=len(network.x)) - 2
    once = 1.0 + others[network.cut_outside] * whole / np.maximum(total[network.cut_outside], TINY)
    first = cuts_of(apertures, network.cut[k], backward[k], np.ones(len(k)))
    second = cuts_of(apertures, network.cut[m], backward[m], np.ones(len(m)))
    pores = np.zeros(len(pipe), dtype=bool)
    cuts = (
        cuts_of(apertures, pipe, pores, np.ones(len(pipe))),
        first.scaled(share, (once * whole)[k] * share / around).shifted(len(pipe)),
        second.scaled(1.0 - share, (once * whole)[m] * (1.0 - share) / around)
        .back()
        .shifted(len(pipe)),
        cuts_of(apertures, network.cut[cut], backward[cut], part).shifted(len(pipe) + len(k)),
    )
    return edges, joined_cuts(*cuts)


def _around_sealed_sides(
    network: Network, apertures: Apertures, sealed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges that stand for the pores cut by a sealed side, between pipes across the rim.

    Simply dropping the pipes that cross a sealed side narrows the region by some 0.4 of a
    pore on each side. A pipe keeps the part t of its conductance that lies inside instead,
    so that a pressure gradient along the side meets its full share of rock, and the pore
    beyond, which then joins only pores inside, is eliminated: g_i g_k / Σ g between each
    two of its neighbours. Returns positions of two pipes among those across the rim, (k,)
    each, and the conductance of the way from one to the other.
    """
    conductance = apertures.cut_conductance * network.cut_fraction**2
    crossing = np.flatnonzero(sealed & (conductance > 0.0))
    crossing = crossing[np.argsort(network.cut_outside[crossing], kind="stable")]
    outer, conductance = network.cut_outside[crossing], conductance[crossing]
    _, first, count = np.unique(outer, return_index=True, return_counts=True)
    total = np.repeat(np.add.reduceat(conductance, first) if len(first) else first, count)
    pairs = []
    for step in range(1, int(count.max(initial=1))):
        # neighbours of one pore follow each other in the list
        first_of = np.flatnonzero(outer[step:] == outer[:-step])
        pairs.append(np.column_stack([first_of, first_of + step]))
    k, m = np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs]).T
    return crossing[k], crossing[m], conductance[k] * conductance[m] / total[k]


def _sides_of_nodes(apertures: Apertures, source: np.ndarray) -> np.ndarray:
    """The source that fixes each node where a trace leaves the region, (m,), −1 where none does.

    At a corner of a sealed and a fixed side the trace meets the fixed one.
    """
    side = apertures.node_side
    one, other = (np.where(side[:, k] >= 0, source[side[:, k]], -1) for k in (0, 1))
    return np.where(one >= 0, one, other)


def sources_of_sides(region: Region, sides: tuple[str, ...]) -> np.ndarray:
    """The source that fixes each side of the region, −1 where it is sealed."""
    source = np.full(len(region.sides), -1)
    for order, name in enumerate(sides):
        source[named_sides(region, name)] = order
    return source


def without_outlet(system: System) -> bool:
    """Whether some unknown is connected to no fixed pressure, so that no steady state exists."""
    held = reached(system.n, system.edge_i, system.edge_j, system.fixed_node)
    return not bool(held.all())
