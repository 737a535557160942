"""Flow problems of any size and contrast: a well in a box of random rock with a fracture."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from demflow.model.controls import sites
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.problem import Answer, Problem
from demflow.model.flow.linear import elimination
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.flow.solvers.time_error import FAINT, Recorded, time_error
from demflow.model.products import Permeability, Responses
from demflow.model.region import Rectangle
from demflow.model.scene import Trace, Well
from tests.reservoirs import reservoir
from tests.rocks import random_graph

DOMAINS_PER_GRAIN = 0.59  # pores in the box over grains of the graph
EXACT = 1e-11  # tolerance of the reference


def well_problem(
    domains: int,
    contrast: float = 5800.0,
    seed: int = 1,
    at: tuple[float, float] = (0.05, 0.02),
    decades: float = 8.0,
    times: int = 81,
    tolerance: float = 1e-4,
) -> Problem:
    """A unit rate from a well; the left side is held. The fracture's pipes conduct `contrast` more.

    Output times start when the pores beside the well respond. Only the well's pressure is
    held to the tolerance.
    """
    packing = random_graph(1.1, round(domains / DOMAINS_PER_GRAIN), seed)
    packing = packing._replace(radius=0.5 * packing.radius)
    matrix = 1e-5
    fracture = Trace(
        name="fracture",
        start=(-0.7, -0.3),
        end=(0.6, 0.5),
        permeability=contrast * matrix**3,
        pore_storage="fracture",
    )
    traces = (fracture,) if contrast > 1.0 else ()
    unit = Permeability(np.eye(2))
    rock = reservoir(packing, Rectangle(2.0, 2.0), matrix, traces, unit_permeability=unit)
    well = Well(name="well", at=at, radius=0.02, rate=1.0)
    system = rock.assembled(sites((well,)), ("left",))
    leaves = system.edge_j >= system.pores
    beside = np.where(leaves, system.edge_i, system.edge_j)[
        leaves | (system.edge_i >= system.pores)
    ]
    through = system.edge_g[leaves | (system.edge_i >= system.pores)].sum()
    first = system.storage[np.unique(beside)].sum() / through
    return Problem(
        system=system,
        records=outputs(system, np.empty(0, dtype=np.int64)),
        lag=first * np.logspace(0.0, decades, times),
        active=np.array([False, True]),
        domain=np.empty(0, dtype=np.int64),
        tolerance=tolerance,
        safety_factor=0.9,
        check_flows=False,
    )


def well_pressure(answer: Answer) -> np.ndarray:
    """Pressure of the well for unit rate (l,), Pa."""
    return answer.output[1, :, 0]


def reference(problem: Problem) -> np.ndarray:
    """The well's pressure to ten digits or more."""
    return well_pressure(SOLVERS["krylov"].run(problem._replace(tolerance=EXACT)))


def relative_error(pressure: np.ndarray, exact: np.ndarray) -> float:
    """Largest relative error of a well's pressure change."""
    return float(np.abs(pressure / exact - 1.0).max())


def step_error(
    found: Answer | Responses,
    exact: Answer | Responses,
    lag: np.ndarray,
    *,
    fixed: int,
    wells: int,
    flows: bool,
) -> float:
    """Error in time of the responses to a unit step of each source, the largest of all.

    As a case with that source alone would be told it; `fixed` and `wells` count the sources.
    """
    worst = 0.0
    for source in range(fixed + wells):
        told, right = (_recorded(answer, source, lag, fixed, wells) for answer in (found, exact))
        # by itself a response is held to a tenth of the largest flow, a well's rate included
        least = FAINT * np.abs(right.flow).max(initial=float(source >= fixed))
        pressure = float(source < fixed)
        error = time_error(told, right, least_pressure=pressure, least_flow=least, flows=flows)
        worst = max(worst, error)
    return worst


def _recorded(
    answer: Answer | Responses, source: int, lag: np.ndarray, fixed: int, wells: int
) -> Recorded:
    later = lag > 0.0
    output = answer.output[source, later].T
    change = np.full((wells, np.count_nonzero(later)), np.nan)
    if fixed <= source < fixed + wells:
        change[source - fixed] = np.abs(output[source - fixed])
    so_far = np.maximum.accumulate(np.nan_to_num(change), axis=1)
    flow = output[wells : wells + fixed]
    pressure = np.delete(output, np.s_[wells : wells + fixed], axis=0)
    return Recorded(change, so_far, flow, pressure, answer.pressure[source, later])


class Timed(NamedTuple):
    """A run, how long it took and how far it was off."""

    tolerance: float
    seconds: float
    error: float

    def __str__(self) -> str:
        return f"tolerance {self.tolerance:.0e}: {self.seconds:.3f} s, error {self.error:.1e}"


def seconds(
    run: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Shortest time of several runs, s; none knows the graph from a run before."""
    best = np.inf
    for _ in range(repeats):
        elimination._kept.clear()
        start = clock()
        run()
        best = min(best, clock() - start)
    return best


def cheapest(
    method: str,
    problem: Problem,
    exact: np.ndarray,
    error: float,
    tolerances: Iterable[float],
    repeats: int = 1,
) -> Timed:
    """The loosest of falling tolerances at which a solver's true error is within `error`."""
    run = SOLVERS[method].run
    for tolerance in tolerances:
        asked = problem._replace(tolerance=tolerance)
        found = relative_error(well_pressure(run(asked)), exact)
        if found <= error:
            return Timed(tolerance, seconds(lambda asked=asked: run(asked), repeats), found)
    raise ValueError(f"{method} does not reach {error:g} at any of the tolerances")
