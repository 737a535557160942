"""The one question that every flow solver answers, and what they share to answer it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.outputs import Records, map_rows
from demflow.model.flow.equation.system import System

# Part of the largest recorded value below which an output's own size no longer counts.
FAINT = 0.1

# Last digits of a pressure that a march of solves may lose.
LOST = 64.0


class Share(NamedTuple):
    """How large what is recorded is, for the part that one source has in the error of a sum."""

    output: np.ndarray  # (sources, l, o) per unit of the source; 0 where it does not count
    field: np.ndarray  # (sources,) Pa per unit of the source, of maps


class Steps(NamedTuple):
    """What is known of the steps that will be summed, of each source."""

    size: np.ndarray  # (sources,) Pa or m³/s, about how large the largest is beside the others'
    number: np.ndarray  # (sources,) how many there are
    shortest: np.ndarray  # (sources,) s, from one to the next; infinite where there is one


class Problem(NamedTuple):
    """Unit step responses of the flow equation at given lags.

    A solver returns `Answer`: for each active source, a step from 0 to 1 at time zero
    with zero pressure change before.
    """

    system: System
    records: Records
    lag: np.ndarray  # (l,) s, increasing, ≥ 0
    active: np.ndarray  # (sources,) bool; the others are left at zero
    domain: np.ndarray  # (m,) domains of the maps, empty where none is asked for
    tolerance: float
    safety_factor: float
    step: float | None = None  # s, what explicit takes for its limit; None: the positivity limit
    check_flows: bool = True  # inflows at fixed pressures are held to the tolerance too
    steps: Steps | None = None  # None: each source is judged by itself
    share: Share | None = None  # what errors are compared with; None: the response itself

    @property
    def active_sources(self) -> list[int]:
        """Positions of the sources that act."""
        return [int(k) for k in np.flatnonzero(self.active)]

    @property
    def flows_count(self) -> bool:
        """Whether inflows at fixed pressures are recorded and held to the tolerance."""
        return self.check_flows and self.records.flow_rows > 0

    def own_well(self, source: int) -> int | None:
        """Output that is the pressure of the well that the source is; None for other sources."""
        well = source - self.system.fixed_count
        return well if 0 <= well < self.records.well_rows else None

    def far(self, source: int) -> bool:
        """Whether anything is held to the tolerance besides the own pressure of a well."""
        counts = self.records.rows.shape[0]
        if not self.check_flows:
            counts -= self.records.flow_rows
        return counts > (self.own_well(source) is not None) or len(self.domain) > 0

    def own_size(self, source: int) -> tuple[float, float]:
        """Pressure (Pa) and flow (m³/s) that a unit of the source is by itself.

        The flow of a fixed pressure is what would fill all pores in the time asked for; one that
        has decayed far below it is not worth a relative error.
        """
        system = self.system
        if source < system.fixed_count:
            return 1.0, float(system.storage.sum() / self.lag[-1]) if self.lag[-1] > 0.0 else 0.0
        if self.own_well(source) is not None:
            return 0.0, 1.0
        field = np.abs(system.initial[source - system.fixed_count - len(system.rate_wells)])
        out = np.bincount(system.fixed_source, weights=system.fixed_g * field[system.fixed_node])
        return float(field.max(initial=0.0)), float(out.max(initial=0.0))

    def scale(self, source: int, output: np.ndarray, at: np.ndarray | None = None) -> np.ndarray:
        """Size (l, o) with which the error of each output is compared; 0 where it does not count.

        The outputs are those at the lags `at` (l,), else at the last ones.

        The well that is the source is compared at every lag with its own pressure change,
        anything else with the largest value that it takes, or where it takes next to none
        with a tenth (`FAINT`) of the largest pressure or flow, the source's own included.
        Where the problem shares the error of sums out between sources, with its `share`.
        """
        if self.share is not None:
            every = self.share.output[source]
            size = every[len(every) - len(output) :].copy() if at is None else every[at]
            if (well := self.own_well(source)) is not None:
                own_size = np.abs(output[:, well]) / np.count_nonzero(self.active)
                size[:, well] = np.maximum(size[:, well], own_size)
            return size
        wells, last = self.records.well_rows, self.records.well_rows + self.records.flow_rows
        every = np.abs(output)
        largest = every.max(axis=0, initial=0.0)
        own_well = self.own_well(source)
        own_pressure, own_flow = self.own_size(source)
        flows, others = largest[wells:last], np.append(largest[:wells], largest[last:])
        least = FAINT * others.max(initial=own_pressure)
        size = np.empty(output.shape)
        size[:] = np.maximum(largest, least)
        size[:, wells:last] = 0.0
        if self.check_flows:
            size[:, wells:last] = np.maximum(flows, FAINT * flows.max(initial=own_flow))
        if own_well is not None:
            size[:, own_well] = every[:, own_well]
        return size


class Answer(NamedTuple):
    """What a solver found."""

    output: np.ndarray  # (sources, l, o)
    cumulative: np.ndarray  # (sources, l, fixed + 1) inflows of fixed pressures, stored volume
    pressure: np.ndarray  # (sources, l, m)
    missing: np.ndarray  # (sources, l) m³ until each lag, out of balance before that was mended
    time_error: float  # relative; NaN of a solver that does not control it
    residual: float  # of the equations that were solved, relative, at its largest
    work: int  # steps or solves, and factors made


def flow_noise(problem: Problem, source: int, output: np.ndarray) -> float:
    """Relative round-off of the inflow (in outputs (l, o)) at the fixed pressure that acts.

    It is a difference of pressures times conductances. A strong pipe to a fixed pressure carries
    little where the rock behind it is tight: the pressures at its ends then agree in all digits
    that a double has.

    Parameters
    ----------
    problem : what is solved
    source : number of the source: fixed pressures and wells
    output : outputs (l, o) for its unit
    """
    later = problem.lag > 0.0
    if not problem.flows_count or source >= problem.system.fixed_count or not later.any():
        return 0.0
    own = problem.records.well_rows + source
    size = problem.scale(source, output[later])[:, own]
    noise = LOST * np.finfo(float).eps * problem.records.direct[source, own]
    return float(np.max(noise / size[size > 0.0], initial=0.0))


def empty_answer(problem: Problem) -> Answer:
    """An answer of zeros, to be filled source by source."""
    sources, lags = problem.system.source_count, len(problem.lag)
    return Answer(
        output=np.zeros((sources, lags, problem.records.rows.shape[0])),
        cumulative=np.zeros((sources, lags, problem.system.fixed_count + 1)),
        pressure=np.zeros((sources, lags, len(problem.domain))),
        missing=np.zeros((sources, lags)),
        time_error=0.0,
        residual=0.0,
        work=0,
    )


def fill_map(problem: Problem, source: int, fields: np.ndarray) -> np.ndarray:
    """Pressure of the mapped domains (l, m) from the unknowns (l, n), for a unit source.

    Parameters
    ----------
    problem : what is solved
    source : number of the source: fixed pressures and wells
    fields : pressures of the unknowns (l, n), Pa
    """
    node, fixed = map_rows(problem.system, problem.domain)
    result = np.zeros((len(fields), len(problem.domain)))
    known = node >= 0
    result[:, known] = fields[:, node[known]]
    result[:, fixed == source] = 1.0
    return result


def fill_maps(
    problem: Problem,
    source: int,
    coefficients: np.ndarray,
    vectors: np.ndarray,
    direct: np.ndarray,
    maps: np.ndarray,
) -> None:
    """Fill maps (l, m) of fields that a basis spans, for a unit source (in place).

    Parameters
    ----------
    problem : what is solved
    source : number of the source: fixed pressures and wells
    coefficients : of the basis at each lag, (l, k)
    vectors : basis as pressures of the unknowns, (n, k)
    direct : what the source adds to each unknown by itself, (n,) Pa
    maps : pressures of the mapped domains, (l, m) Pa
    """
    node, fixed = map_rows(problem.system, problem.domain)
    if len(vectors):  # whole rows, of whatever is no unknown too: to write around those costs more
        np.matmul(coefficients, vectors[node].T, out=maps)
        maps[:, node < 0] = 0.0
        (own,) = np.nonzero((node >= 0) & (direct[node] != 0.0))
        maps[:, own] += direct[node[own]]
    maps[:, fixed == source] = 1.0


def relative_residual(system: System, rhs: np.ndarray, rate: np.ndarray, p: np.ndarray) -> float:
    """Size of C dp/dt + G p − f over that of the flows that meet in each unknown, at one time.

    Parameters
    ----------
    system : the flow equation C dp/dt = −G p + f
    rhs : f (n,), m³/s
    rate : dp/dt (n,), Pa/s
    p : pressure (n,), Pa
    """
    flow = system.edge_g * (p[system.edge_i] - p[system.edge_j])
    net = system.storage * rate - rhs
    net = net + np.bincount(system.edge_i, weights=flow, minlength=system.n)
    net = net - np.bincount(system.edge_j, weights=flow, minlength=system.n)
    net = net + np.bincount(
        system.fixed_node, weights=system.fixed_g * p[system.fixed_node], minlength=system.n
    )
    through = np.abs(rhs).sum()
    return float(np.abs(net).sum() / through) if through > 0 else 0.0
