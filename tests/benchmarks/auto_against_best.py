"""`auto` is never much slower than the best single choice that delivers the tolerance.

Small and large networks, windows of one to eight decades that start early or late, loose and
tight tolerances, one rate, a schedule, and a side at constant pressure; short windows also with
maps or probes, which are held to the tolerance everywhere. A single choice counts where its true
error is within the tolerance; explicit runs at its default step.
"""

from __future__ import annotations

import itertools
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.model.controls import sites
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.problem import Answer, Problem
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.forecast import course
from demflow.model.flow.solvers.registry import SOLVERS, lags, solve
from demflow.model.scene import Well
from tests.benchmarks.result import Result
from tests.diffusion import seconds, step_error, well_problem

SLOWER = 1.5
DOMAINS = (1_000, 8_000, 40_000)
WINDOWS = ((3.0, 1.0), (100.0, 1.0), (100.0, 3.0), (3.0, 6.0), (1e4, 4.0))  # steps, decades
TOLERANCES = (1e-2, 1e-4, 1e-7)
KINDS = ("rate", "schedule", "pressure")
FIELDS = ("map", "probes")  # of a rate's window, looked at in the smaller networks' short windows
TIMES = 31
MOST_TURNS, ENOUGH = 20, 0.3  # turns of each problem, fewer once this much time is spent, s
PATIENCE = 2.0  # s: a solver predicted to take longer than this and ten times the best is left out


class Row(NamedTuple):
    """One problem: what each solver took, and what auto did."""

    name: str
    took: dict[str, float]  # s, of those that delivered
    chosen: str
    auto: float  # s
    error: float  # of auto, over the tolerance


def case(plain: Problem, kind: str, first: float, decades: float, tolerance: float) -> Problem:
    """A problem whose times start after `first` explicit steps."""
    times = first * step_limit(plain.system) * np.logspace(0.0, decades, TIMES)
    if kind == "schedule":
        shut_in = Well(
            name="w", at=(0.0, 0.0), radius=1.0, schedule=((0.0, 1.0), (times[TIMES // 2], 0.0))
        )
        times = lags(tuple(times), sites((shut_in,)))
    pores = plain.system.domain
    if kind == "map":
        plain = plain._replace(domain=pores)
    if kind == "probes":
        plain = plain._replace(records=outputs(plain.system, pores[:: len(pores) // 20]))
    acts = np.array([kind == "pressure", kind != "pressure"])
    return plain._replace(lag=times, active=acts, tolerance=tolerance, check_flows=acts[0])


def relative_error(problem: Problem, found: Answer, exact: Answer) -> float:
    """Error of what is recorded, as a study would be told it."""
    return step_error(found, exact, problem.lag, fixed=1, wells=1, flows=problem.check_flows)


def measure(name: str, problem: Problem) -> Row:
    """Run every solver that may be the best, and auto, in turn."""
    exact = SOLVERS["krylov"].run(problem._replace(tolerance=1e-10))
    moves = course(problem)
    forecasts = {m: s.forecast(problem, moves).seconds for m, s in SOLVERS.items() if s.transient}
    choice, chosen = solve("auto", problem)
    error = relative_error(problem, chosen, exact) / problem.tolerance
    runs: dict[str, Callable[[], object]] = {}
    for method, forecast in forecasts.items():
        if forecast > max(PATIENCE, 10.0 * min(forecasts.values())):
            continue
        run = SOLVERS[method].run
        if relative_error(problem, run(problem), exact) <= problem.tolerance:
            runs[method] = lambda run=run: run(problem)

    def auto() -> object:
        return solve("auto", problem)

    took = typical(runs | {"auto": auto})
    own = took.pop("auto")
    return Row(name, took, choice.method, own, error)


def typical(runs: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median processor time of each, taken in turns; all of them run on one thread.

    Not the shortest: a virtual machine's clock of processor time jumps now and then, and once
    gave a tenth of what is possible.
    """
    took: dict[str, list[float]] = {name: [] for name in runs}
    start = time.process_time()
    turns = 0
    while turns < 3 or (turns < MOST_TURNS and time.process_time() < start + ENOUGH):
        for name, run in runs.items():
            took[name].append(seconds(run, 1, time.process_time))
        turns += 1
    return {name: statistics.median(each) for name, each in took.items()}


def rows() -> list[Row]:
    """All problems of the set."""
    found = []
    for domains in DOMAINS:
        plain = well_problem(domains)
        asked = list(itertools.product(WINDOWS, TOLERANCES, KINDS))
        if domains < DOMAINS[-1]:
            asked += itertools.product(WINDOWS[:2], TOLERANCES, FIELDS)
        for (first, decades), tolerance, kind in asked:
            name = f"{domains} domains, {kind}, from {first:g} steps {decades:g} decades"
            problem = case(plain, kind, first, decades, tolerance)
            found.append(measure(f"{name}, {tolerance:.0e}", problem))
    return found


def run() -> Result:
    """Largest ratio of auto's time to that of the best single choice."""
    found = rows()
    slower = max(row.auto / min(row.took.values(), default=np.inf) for row in found)
    errors = [row.error for row in found]
    lines = [
        f"{row.name}: auto takes {row.chosen}, {1e3 * row.auto:.1f} ms, error {row.error:.2g} of "
        f"the tolerance; " + ", ".join(f"{m} {1e3 * s:.1f} ms" for m, s in row.took.items())
        for row in found
    ]
    chosen = {m: sum(row.chosen == m for row in found) for m in SOLVERS}
    lines.append(f"taken: {', '.join(f'{m} {k} times' for m, k in chosen.items() if k)}")
    return Result(
        f"{slower:.2f} times the best at most over {len(found)} problems, "
        f"error at most {max(errors):.2g} of the tolerance",
        f"≤ {SLOWER:g} times",
        bool(slower <= SLOWER and max(errors) <= 3.0),
        "\n".join(lines),
    )
