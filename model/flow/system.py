"""The flow equation of a case: C dp/dt = −G p + f on pores and wells.

Pores outside the region, inside a well, or reached by no source are not unknowns. A well
at a given rate is one unknown without storage; sides and wells at a given pressure enter
through the excess of the rows beside them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from model.network.connectivity import reached
from model.network.domains import domains_at
from model.outcome import ModelError
from model.products import Apertures, Network
from model.region import Region

# Peaceman (1978): on a regular grid the pressure of a well block is that at 0.2 of the
# distance between its neighbours; a pore near the well's centre is taken to stand there.
EQUIVALENT_RADIUS = 0.2

# A pore may touch the wellbore; its logarithmic distance keeps this part of the pipe's.
WELL_FLOOR = 0.02


class WellSite(NamedTuple):
    """What the flow stage knows of a well: not its rate."""

    name: str
    at: tuple[float, float]  # m
    radius: float  # m
    fixed_pressure: bool
    change_times: tuple[float, ...]  # s, when its rate changes


class System(NamedTuple):
    """Unknowns 0 … n − 1: first the active pores, then the wells at a rate.

    Sources are the fixed pressures (sides, then wells), then the wells at a rate.
    """

    domain: np.ndarray  # (pores,) the domain of each unknown pore
    n: int  # unknowns
    storage: np.ndarray  # (n,) C = V / K_f, zero for wells, m³/Pa
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
    node_of_domain: np.ndarray  # (d,) unknown of each domain, −1 none
    source_of_domain: np.ndarray  # (d,) fixed source whose pressure a domain has, −1 none
    isolated: int  # pores inside the region that no source reaches

    @property
    def fixed_count(self) -> int:
        """Number of fixed pressures, sides and wells."""
        return len(self.sides) + len(self.pressure_wells)

    @property
    def source_count(self) -> int:
        """Number of sources."""
        return self.fixed_count + len(self.rate_wells)

    @property
    def pores(self) -> int:
        """Number of unknown pores."""
        return len(self.domain)

    @property
    def excess(self) -> np.ndarray:
        """Conductance of each unknown to fixed pressures, (n,) m³/(s Pa)."""
        return np.bincount(self.fixed_node, weights=self.fixed_g, minlength=self.n)

    def reached(self, domains: np.ndarray) -> np.ndarray:
        """Which domains have a pressure that some source moves, as a mask."""
        return (self.node_of_domain[domains] >= 0) | (self.source_of_domain[domains] >= 0)

    def source(self, index: int) -> np.ndarray:
        """Right-hand side for a unit of one source: 1 Pa, or 1 m³/s produced, (n,)."""
        if index < self.fixed_count:
            ours = self.fixed_source == index
            return np.bincount(self.fixed_node[ours], weights=self.fixed_g[ours], minlength=self.n)
        rhs = np.zeros(self.n)
        rhs[self.pores + index - self.fixed_count] = -1.0
        return rhs


def assemble(
    network: Network,
    apertures: Apertures,
    *,
    region: Region,
    bulk_modulus: float,
    wells: tuple[WellSite, ...],
    sides: tuple[str, ...],
) -> System:
    """Set up the flow equation.

    `sides` names the sides at fixed pressure (`outer` takes all of them); the others are
    sealed. A pore in a well shares the well's pressure and stores nothing; a pipe that
    leaves a well carries g ln(r_j / r_i) / ln(r_j / r_w), which is exact for the
    logarithmic profile around it.
    """
    pressure_wells = tuple(k for k, w in enumerate(wells) if w.fixed_pressure)
    rate_wells = tuple(k for k, w in enumerate(wells) if not w.fixed_pressure)
    well_of = _wells_of_domains(network, wells)

    # Everything that flow can reach is a terminal: the pores, then the wells, then the sides.
    d, w = len(network.x), len(wells)
    terminal = np.where(well_of >= 0, d + well_of, np.where(network.inside, np.arange(d), -1))
    held = np.full(d + w + len(sides), -1)  # the source that fixes a terminal's pressure
    held[d + w :] = np.arange(len(sides))
    held[[d + k for k in pressure_wells]] = len(sides) + np.arange(len(pressure_wells))
    a, b, g = _connections(network, apertures, region, wells, sides, well_of, terminal)
    a, b = np.where(held[a] >= 0, b, a), np.where(held[a] >= 0, a, b)
    free, link = held[b] < 0, (held[a] < 0) & (held[b] >= 0)
    between = held[a] >= 0

    moved = reached(len(held), a[free], b[free], [*a[link], *(d + k for k in rate_wells)])
    domain = np.flatnonzero((terminal == np.arange(d)) & moved[:d])
    number = np.full(len(held), -1)
    number[domain] = np.arange(len(domain))
    number[[d + k for k in rate_wells]] = len(domain) + np.arange(len(rate_wells))
    free &= (number[a] >= 0) & (number[b] >= 0)
    node_of_domain = np.where(terminal >= 0, number[terminal], -1)
    source_of_domain = np.where(terminal >= 0, held[terminal], -1)
    alone = network.inside & (node_of_domain < 0) & (source_of_domain < 0)
    return System(
        domain=domain,
        n=len(domain) + len(rate_wells),
        storage=np.append(apertures.volume[domain] / bulk_modulus, np.zeros(len(rate_wells))),
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
        node_of_domain=node_of_domain,
        source_of_domain=source_of_domain,
        isolated=int(np.count_nonzero(alone)),
    )


def _connections(
    network: Network,
    apertures: Apertures,
    region: Region,
    wells: tuple[WellSite, ...],
    sides: tuple[str, ...],
    well_of: np.ndarray,
    terminal: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Conductances between terminals: pipes, cut pipes to the sides, rock along sealed sides."""
    side_source = _sources_of_sides(region, sides)
    rim = side_source[network.cut_side]
    at_side = (rim >= 0) & (apertures.cut_conductance > 0.0)
    i, j, g = _pipes(network, apertures, wells, well_of)
    k, m, around = _around_sealed_sides(network, apertures, rim < 0)
    a = np.concatenate([terminal[i], terminal[k], terminal[network.cut_inside[at_side]]])
    b = np.concatenate([terminal[j], terminal[m], len(network.x) + len(wells) + rim[at_side]])
    g = np.concatenate([g, around, apertures.cut_conductance[at_side]])
    return a[a != b], b[a != b], g[a != b]


def _wells_of_domains(network: Network, wells: tuple[WellSite, ...]) -> np.ndarray:
    """The well in which each domain lies, −1 outside of all."""
    well_of = np.full(len(network.x), -1)
    for k, well in enumerate(wells):
        distance = np.hypot(network.x - well.at[0], network.y - well.at[1])
        within = (distance < well.radius) & network.inside
        if not within.any():
            within = np.zeros(len(network.x), dtype=bool)
            within[domains_at(network, np.array([well.at]))] = True
        shared = well_of[within & (well_of >= 0)]
        if len(shared):
            raise ModelError(
                f"wells {wells[shared[0]].name} and {well.name} lie in one pore; move them apart, "
                "or raise grains.count"
            )
        well_of[within] = k
    return well_of


def _pipes(
    network: Network, apertures: Apertures, wells: tuple[WellSite, ...], well_of: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Conducting pipes between domains inside the region, placed at the wells' walls."""
    i, j = network.pipe_from, network.pipe_to
    conducts = network.inside[i] & network.inside[j] & (apertures.conductance > 0.0)
    pipe = np.flatnonzero(conducts)
    i, j, g = i[pipe], j[pipe], apertures.conductance[pipe].copy()
    for k, well in enumerate(wells):
        for inner, outer, place_outer in (
            (i, j, apertures.pipe_trace_to[pipe]),
            (j, i, apertures.pipe_trace_from[pipe]),
        ):
            leaves = np.flatnonzero((well_of[inner] == k) & (well_of[outer] < 0))
            on_trace = ~np.isnan(place_outer[leaves])
            ours = leaves[~on_trace]
            g[ours] *= _well_factor(network, well, inner[ours], outer[ours])
            ours = leaves[on_trace]
            g[ours] = _trace_at_well(apertures, well, pipe[ours], place_outer[ours], g[ours])
    return i, j, g


def _around_sealed_sides(
    network: Network, apertures: Apertures, sealed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges that stand for the pores cut by a sealed side.

    Simply dropping the pipes that cross a sealed side narrows the region by some 0.4 of a
    pore on each side. A pipe keeps the part t of its conductance that lies inside instead,
    so that a pressure gradient along the side meets its full share of rock, and the pore
    beyond, which then joins only pores inside, is eliminated: g_i g_k / Σ g between each
    two of its neighbours.
    """
    fraction = network.cut_fraction[sealed]
    conductance = apertures.cut_conductance[sealed] * fraction**2
    conducts = conductance > 0.0
    inner = network.cut_inside[sealed][conducts]
    outer = network.cut_outside[sealed][conducts]
    conductance = conductance[conducts]
    order = np.argsort(outer, kind="stable")
    inner, outer, conductance = inner[order], outer[order], conductance[order]
    _, first, count = np.unique(outer, return_index=True, return_counts=True)
    total = np.repeat(np.add.reduceat(conductance, first) if len(first) else first, count)
    pairs = []
    for step in range(1, int(count.max(initial=1))):
        # neighbours of one pore follow each other in the list
        first_of = np.flatnonzero(outer[step:] == outer[:-step])
        pairs.append(np.column_stack([first_of, first_of + step]))
    k, m = np.concatenate([np.empty((0, 2), dtype=np.int64), *pairs]).T
    return inner[k], inner[m], conductance[k] * conductance[m] / total[k]


def _well_factor(
    network: Network, well: WellSite, inner: np.ndarray, outer: np.ndarray
) -> np.ndarray:
    """Logarithmic correction ln(r_j / r_i) / ln(r_j / r_w) of pipes that leave a well."""
    x0, y0 = well.at
    r_in = np.hypot(network.x[inner] - x0, network.y[inner] - y0)
    r_out = np.hypot(network.x[outer] - x0, network.y[outer] - y0)
    between = np.hypot(network.x[inner] - network.x[outer], network.y[inner] - network.y[outer])
    r_in = np.maximum(r_in, EQUIVALENT_RADIUS * between)
    whole = np.log(np.maximum(r_out, 1.001 * r_in) / r_in)
    return whole / np.maximum(np.log(r_out / well.radius), WELL_FLOOR * whole)


def _trace_at_well(
    apertures: Apertures,
    well: WellSite,
    pipe: np.ndarray,
    place: np.ndarray,
    conductance: np.ndarray,
) -> np.ndarray:
    """Conductance T / (distance along the trace from the well's wall) of calibrated pipes."""
    result = conductance.copy()
    for k, p in enumerate(pipe):
        trace = apertures.on_fracture[p]
        start, end = apertures.trace_start[trace], apertures.trace_end[trace]
        along = (end - start) / np.hypot(*(end - start))
        offset = start - np.asarray(well.at)
        half = offset @ along
        square = half * half - offset @ offset + well.radius**2
        if square <= 0.0:
            continue
        whole = abs(apertures.pipe_trace_to[p] - apertures.pipe_trace_from[p])
        distance = max(abs(place[k] + half) - np.sqrt(square), WELL_FLOOR * whole)
        result[k] = apertures.trace_transmissivity[trace] / distance
    return result


def _sources_of_sides(region: Region, sides: tuple[str, ...]) -> np.ndarray:
    """The source that fixes each side of the region, −1 where it is sealed."""
    source = np.full(len(region.sides), -1)
    for order, name in enumerate(sides):
        if name == "outer":
            source[:] = order
        else:
            source[region.sides.index(name)] = order
    return source


def without_outlet(system: System) -> bool:
    """Whether some unknown is connected to no fixed pressure, so that no steady state exists."""
    held = reached(system.n, system.edge_i, system.edge_j, system.fixed_node)
    return not bool(held.all())
