"""The registry of solvers and the *flow* stage that runs one of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from model.flow.choice import (
    Course,
    Forecast,
    course,
    explicit_forecast,
    implicit_forecast,
    krylov_forecast,
    steady_forecast,
)
from model.flow.explicit import explicit, paper_step
from model.flow.implicit import implicit
from model.flow.initial import STARTS, at_rest, decaying, none_at_all, with_linear_fields
from model.flow.krylov import krylov
from model.flow.problem import Answer, Problem
from model.flow.records import outputs
from model.flow.sites import WellSite, change_times, time_since
from model.flow.steady import steady
from model.flow.system import assemble
from model.network.domains import domains_at
from model.outcome import ModelError
from model.products import Apertures, Network, Responses
from model.region import Region
from model.scene import Probe


class FlowSolver(NamedTuple):
    """A way to answer a `Problem`, and what it can do."""

    run: Callable[[Problem], Answer]
    forecast: Callable[[Problem, Course], Forecast]  # its time at the wanted accuracy
    transient: bool  # gives pressure in time; else the steady state alone
    controls_error: bool  # `tolerance` bounds its error in time
    linear_only: bool  # relies on conductances that stay as they are
    schedules: bool  # its responses may be shifted and summed to any schedule of rates
    pressure_wells: bool = True  # wells at a constant pressure


SOLVERS: dict[str, FlowSolver] = {
    "explicit": FlowSolver(
        explicit,
        explicit_forecast,
        transient=True,
        controls_error=False,
        linear_only=False,
        schedules=True,
    ),
    "implicit": FlowSolver(
        implicit,
        implicit_forecast,
        transient=True,
        controls_error=True,
        linear_only=False,
        schedules=True,
    ),
    "krylov": FlowSolver(
        krylov,
        krylov_forecast,
        transient=True,
        controls_error=True,
        linear_only=True,
        schedules=True,
    ),
    "steady": FlowSolver(
        steady,
        steady_forecast,
        transient=False,
        controls_error=True,
        linear_only=False,
        schedules=False,
    ),
}


class Choice(NamedTuple):
    """The solver that runs, why, and the problem as it is put to it."""

    method: str
    reason: str
    problem: Problem


def choose(method: str, problem: Problem) -> Choice:
    """The solver named, or for `auto` the one whose predicted time is least."""
    if method != "auto":
        return Choice(method, "asked for", problem)
    transient = bool(np.isfinite(problem.lag).all())
    able = {name: s for name, s in SOLVERS.items() if s.transient == transient}
    moves = course(problem)
    forecasts = {name: solver.forecast(problem, moves) for name, solver in able.items()}
    best = min(forecasts, key=lambda name: forecasts[name].seconds)
    told = ", ".join(f"{name} {f.seconds:.2g} s" for name, f in forecasts.items())
    size = f"{problem.system.n} unknowns, {len(problem.lag)} lags"
    reason = f"least predicted time at a tolerance of {problem.tolerance:g} with {size}: {told}"
    safety = forecasts[best].safety_factor
    if safety is not None:
        problem = problem._replace(safety_factor=safety, step=None)
    return Choice(best, reason, problem)


def lags(times: tuple[float, ...], wells: tuple[WellSite, ...]) -> np.ndarray:
    """Times since a step at which responses are needed, increasing, s.

    The pressure is wanted at `times` and just before every rate change; the steps are
    those changes and the start. Without times the one lag is infinity.
    """
    if not times:
        return np.array([math.inf])
    changes = change_times(wells)
    wanted = np.concatenate([times, changes])
    lag = time_since(changes[None, :], wanted[:, None])
    return np.unique(lag[lag >= 0.0])


def flow(
    network: Network,
    apertures: Apertures,
    *,
    region: Region,
    bulk_modulus: float,
    wells: tuple[WellSite, ...],
    sides: tuple[str, ...],
    active: tuple[bool, ...],
    probes: tuple[Probe, ...],
    times: tuple[float, ...],
    method: str,
    tolerance: float,
    safety_factor: float,
    record_map: bool,
    step: str = "corrected",
    check_flows: bool = True,
    initial: str = "uniform",
) -> Responses:
    """Responses of the network to a unit step of each source (the *flow* stage).

    The flow equation is linear while apertures stay fixed, so that any rate, schedule or
    boundary pressure is a scaled and shifted sum of these; `model.observe` makes it.

    Parameters
    ----------
    network, apertures : the open network.
    region, bulk_modulus : parts of the scene; K_f in Pa.
    wells : where the wells are and when they change, not how much.
    sides : names of the sides at fixed pressure.
    active : for each source (sides, wells at a pressure, wells at a rate, then the gradients
        along x and y of a start from a gradient), whether it acts.
    probes : points whose pressure is recorded.
    times : output times in s; empty for the steady state.
    method : a name in `SOLVERS`, or `auto` for the one of least predicted time.
    tolerance, safety_factor, step : of the solver, see `model.scene.Solver`.
    record_map : whether the pressure of every domain is kept.
    check_flows : whether the tolerance holds for boundary flows too, which converge more slowly
        than the pressure of a well.
    initial : what the transient starts from: one pressure everywhere (`uniform`), a linear
        field (`gradient`), or the steady state of all fixed pressures (`steady`).

    Raises `ModelError` where the solver cannot answer; its text says what to try.
    """
    _check(bulk_modulus, times, tolerance, safety_factor, method, initial)
    system = assemble(
        network,
        apertures,
        region=region,
        bulk_modulus=bulk_modulus,
        wells=wells,
        sides=sides,
    )
    if initial == "gradient":
        system = with_linear_fields(system, network, wells)
    probe_domains = domains_at(network, np.array([p.at for p in probes]).reshape(-1, 2))
    problem = Problem(
        system=system,
        records=outputs(system, probe_domains),
        lag=lags(times, wells),
        active=np.asarray(active, dtype=bool),
        domain=np.flatnonzero(network.inside) if record_map else np.empty(0, dtype=np.int64),
        tolerance=tolerance,
        safety_factor=safety_factor,
        step=paper_step(network, apertures, bulk_modulus, system.domain)
        if step == "paper"
        else None,
        check_flows=check_flows,
    )
    start = none_at_all(problem)
    if initial == "steady":
        start = at_rest(problem)
        moves = np.arange(system.source_count) >= system.fixed_count
        problem = problem._replace(active=problem.active & moves)
    choice = choose(method, problem)
    answer = SOLVERS[choice.method].run(choice.problem)
    if initial == "gradient":
        answer, start = decaying(problem, answer)
    return Responses(
        lag=problem.lag,
        output=answer.output,
        cumulative=answer.cumulative,
        pressure=answer.pressure,
        domain=problem.domain,
        reached=system.reached(problem.domain),
        time_error=np.asarray(answer.time_error),
        residual=np.asarray(answer.residual),
        work=np.asarray(answer.work),
        probe_reached=system.reached(probe_domains),
        isolated=np.asarray(system.isolated),
        initial_output=start.output,
        initial_cumulative=start.cumulative,
        initial_pressure=start.pressure,
        initial_volume=start.volume,
        solver=np.asarray(choice.method),
        solver_reason=np.asarray(choice.reason),
    )


def _check(
    bulk_modulus: float,
    times: tuple[float, ...],
    tolerance: float,
    safety_factor: float,
    method: str,
    initial: str,
) -> None:
    """Raise `ModelError` for what no solver can be asked, before time is spent."""
    if method != "auto" and method not in SOLVERS:
        raise ModelError(f"there is no solver {method}, only auto, {', '.join(SOLVERS)}")
    if initial not in STARTS:
        raise ModelError(f"there is no start {initial}, only {', '.join(STARTS)}")
    if not 0.0 < bulk_modulus < math.inf:
        raise ModelError(f"a bulk modulus of {bulk_modulus} Pa leaves no storage to flow from")
    if not 0.0 < tolerance < 1.0:
        raise ModelError(f"a tolerance of {tolerance} bounds nothing; it lies between 0 and 1")
    if not 0.0 < safety_factor < math.inf:
        raise ModelError(f"a safety factor of {safety_factor} gives no step")
    given = np.asarray(times, dtype=float)
    if not (np.all(np.isfinite(given)) and np.all(np.diff(given, prepend=0.0) > 0.0)):
        raise ModelError("times are finite and increase, from above zero on")
    if method != "auto" and SOLVERS[method].transient != bool(times):
        what = "needs times" if SOLVERS[method].transient else "has no times"
        raise ModelError(f"solver.method {method} {what}")
