"""The registry of solvers and the *flow* stage that runs one of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.probes import Probes, between_pores
from demflow.model.flow.equation.problem import Answer, Problem, Steps
from demflow.model.flow.equation.sites import (
    FIRST_LAG,
    LAGS_A_DECADE,
    Site,
    change_times,
    time_since,
)
from demflow.model.flow.equation.system import assemble
from demflow.model.flow.solvers.explicit import explicit, paper_step
from demflow.model.flow.solvers.forecast import (
    Course,
    Forecast,
    course,
    euler_error,
    explicit_forecast,
    implicit_forecast,
    krylov_forecast,
    steady_forecast,
)
from demflow.model.flow.solvers.implicit import implicit
from demflow.model.flow.solvers.initial import (
    STARTS,
    Initial,
    at_rest,
    decaying,
    none_at_all,
    with_linear_fields,
)
from demflow.model.flow.solvers.krylov import krylov
from demflow.model.flow.solvers.steady import steady
from demflow.model.memory import foresee
from demflow.model.outcome import ModelError
from demflow.model.products import Apertures, Network, Responses
from demflow.model.region import Region
from demflow.model.scene import LEAST_TOLERANCE, Probe
from demflow.model.threads import one_blas_thread


class FlowSolver(NamedTuple):
    """A way to answer a `Problem`, and what it can do.

    What all of them can do is no field: they take wells at a rate and at a constant pressure,
    and conductances that stay as they are, so that flow is linear and any schedule of rates is
    a sum of shifted unit responses. The steady state has no times, hence no schedule.
    """

    run: Callable[[Problem], Answer]
    forecast: Callable[[Problem, Course], Forecast]  # its time at the wanted accuracy
    transient: bool  # gives pressure in time; else the steady state alone
    controls_error: bool  # estimates its error in time, which `tolerance` bounds


SOLVERS: dict[str, FlowSolver] = {
    "explicit": FlowSolver(explicit, explicit_forecast, transient=True, controls_error=False),
    "implicit": FlowSolver(implicit, implicit_forecast, transient=True, controls_error=True),
    "krylov": FlowSolver(krylov, krylov_forecast, transient=True, controls_error=True),
    "steady": FlowSolver(steady, steady_forecast, transient=False, controls_error=True),
}


class Choice(NamedTuple):
    """The solver that runs, why, and the problem as it is put to it."""

    method: str
    reason: str
    problem: Problem
    proven: bool = True  # else its answer counts only where `euler_error` finds it good enough


def choices(method: str, problem: Problem) -> list[Choice]:
    """The solver named, or for `auto` all that can answer, that of least predicted time first."""
    if method != "auto":
        return [Choice(method, "asked for", problem)]
    transient = bool(np.isfinite(problem.lag).all())
    able = {name: s for name, s in SOLVERS.items() if s.transient == transient}
    moves = course(problem)
    forecasts = {name: solver.forecast(problem, moves) for name, solver in able.items()}
    predicted = ", ".join(f"{name} {f.seconds:.2g} s" for name, f in forecasts.items())
    size = f"{problem.system.n} unknowns, {len(problem.lag)} lags"
    reason = (
        f"least predicted time at a tolerance of {problem.tolerance:g} with {size}: {predicted}"
    )
    found = []
    for name, forecast in sorted(forecasts.items(), key=lambda item: item[1].seconds):
        put = problem
        if forecast.safety_factor is not None:
            put = problem._replace(safety_factor=forecast.safety_factor, step=None)
        if math.isfinite(forecast.seconds):
            found.append(Choice(name, reason, put, forecast.proven))
    return found


def choose(method: str, problem: Problem) -> Choice:
    """The solver named, or for `auto` the one whose predicted time is least."""
    return choices(method, problem)[0]


def solve(method: str, problem: Problem) -> tuple[Choice, Answer]:
    """The answer of the solver chosen; where `auto` chose one that fails, that of the next.

    Raises `ModelError` where none can answer: what the first one said.
    """
    ranked, tolerance = choices(method, problem), problem.tolerance
    failed: list[str] = []
    first: ModelError | None = None
    for choice in ranked:
        try:
            answer = SOLVERS[choice.method].run(choice.problem)
            if not choice.proven and (error := euler_error(choice.problem, answer)) > tolerance:
                raise ModelError(f"its answer shows a relative error of {error:.2g}")
        except ModelError as error:
            first = first or error
            failed.append(f"; {choice.method} failed: {error}")
        else:
            return choice._replace(reason=choice.reason + "".join(failed)), answer
    raise first or ModelError("no solver can answer; name one as solver.method")


def lags(times: tuple[float, ...], wells: tuple[Site, ...], *, fine: bool = False) -> np.ndarray:
    """Times since a step at which responses are needed, increasing, s.

    The pressure is wanted at `times` and just before every rate change; the steps are
    those changes and the start. Without times the one lag is infinity. `fine`: steps may come at
    any time, and responses are needed between these too.

    Parameters
    ----------
    times : of the outputs, s
    wells : the wells
    fine : whether more of them are taken
    """
    if not times:
        return np.array([math.inf])
    changes = change_times(wells)
    wanted = np.concatenate([times, changes])
    lag = time_since(changes[None, :], wanted[:, None])
    lag = np.unique(lag[lag >= 0.0])
    if fine:
        later = lag[lag > 0.0]
        first, last = FIRST_LAG * later[0], later[-1]
        count = 2 + int(LAGS_A_DECADE * math.log10(last / first))
        # those asked for stay, and no other is so near that a curve through both bends
        between = np.geomspace(first, last, count)
        near = np.searchsorted(later, between)
        above = later[np.minimum(near, len(later) - 1)] / between
        below = between / later[np.maximum(near - 1, 0)]
        far = np.minimum(np.abs(np.log(above)), np.abs(np.log(below)))
        far = far > 0.3 * math.log(between[1] / between[0])
        lag = np.unique(np.concatenate([lag, between[far]]))
    return lag


def flow(
    network: Network,
    apertures: Apertures,
    *,
    region: Region,
    bulk_modulus: float | None,
    wells: tuple[Site, ...],
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
    decades: tuple[int, ...] | None = None,
    fine: bool = False,
    storativity: float | None = None,
) -> Responses:
    """Responses of the network to a unit step of each source (the *flow* stage).

    The flow equation is linear while apertures stay fixed, so that any rate, schedule or
    boundary pressure is a scaled and shifted sum of these; `model.history` makes it.

    Parameters
    ----------
    network, apertures : the open network; conductances in m³/(s Pa), volumes in m³, for unit depth.
    region : part of the scene.
    bulk_modulus : K_f of the fluid, Pa; None where the rock's storage is given as a whole.
    wells : where the wells are (m) and when they change (s), not how much; then the sides with
        an inflow, which act as wells at a rate.
    sides : names of the sides at fixed pressure.
    active : for each source (sides, wells at a pressure, wells at a rate, then the gradients
        along x and y of a start from a gradient), whether it acts.
    probes : points whose pressure is recorded.
    times : output times in s; empty for the steady state.
    method : a name in `SOLVERS`, or `auto` for the one of least predicted time.
    tolerance, safety_factor, step : of the solver, see `model.scene.Solver`.
    record_map : whether the pressure of every domain inside the region is kept.
    check_flows : whether the tolerance holds for boundary flows too, which converge more slowly
        than the pressure of a well.
    initial : what the transient starts from: one pressure everywhere (`uniform`), a linear
        field (`gradient`), or the steady state of all fixed pressures (`steady`).
    decades : powers of ten of how large a step of each source is, Pa or m³/s, beside one another;
        the tolerance holds for their sum. None: of one source; of several, that each response is
        held to the tolerance by itself.
    fine : whether steps may come at any time, because rates are found on the responses.
    storativity : fluid that a unit volume of rock gives per pressure fall, 1/Pa; in place of the
        bulk modulus, which follows from it and the volume of all pores of the region.

    Returns
    -------
    `Responses` of s sources (as in `active`; without the gradients, which are initial fields) at
    l lags (s), increasing: o recorded outputs (s, l, o), first the pressure of each well at a
    rate (Pa), then the inflow of each fixed pressure (m³/s), then the pressure of each probe;
    volumes (s, l, fixed + 1) in m³; maps (s, l, domains). All are per unit of the source:
    1 Pa of a fixed pressure, 1 m³/s produced by a well.

    Raises `ModelError` where the solver cannot answer; its text says what to try. `OutOfMemory`
    where the answer would not fit.
    """
    bulk_modulus = _modulus(network, bulk_modulus, storativity)
    _check(bulk_modulus, times, tolerance, safety_factor, method, step, initial)
    posed = pose(
        network,
        apertures,
        region=region,
        bulk_modulus=bulk_modulus,
        wells=wells,
        sides=sides,
        active=active,
        probes=probes,
        times=times,
        tolerance=tolerance,
        check_flows=check_flows,
        decades=decades,
        initial=initial,
        record_map=record_map,
        fine=fine,
    )
    problem = posed.problem._replace(safety_factor=safety_factor)
    if step == "paper":
        own = problem.system.domain
        problem = problem._replace(step=paper_step(network, apertures, bulk_modulus, own))
    _foresee(problem)
    start = none_at_all(problem)
    if initial == "steady":
        start = at_rest(problem)
        moves = np.arange(problem.system.source_count) >= problem.system.fixed_count
        problem = problem._replace(active=problem.active & moves)
    with one_blas_thread():
        choice, answer = solve(method, problem)
    _check_finite(answer, choice.method)
    met = answer.time_error <= tolerance if SOLVERS[choice.method].controls_error else math.nan
    if initial == "gradient":
        answer, start = decaying(problem, answer)
    return responses_of(posed._replace(problem=problem), answer, start, met, choice)


class Posed(NamedTuple):
    """A problem, and what of the probes is to be told beside its answer."""

    problem: Problem
    probed: Probes


def pose(
    network: Network,
    apertures: Apertures,
    *,
    region: Region,
    bulk_modulus: float,
    wells: tuple[Site, ...],
    sides: tuple[str, ...],
    active: tuple[bool, ...],
    probes: tuple[Probe, ...],
    times: tuple[float, ...],
    tolerance: float,
    check_flows: bool,
    decades: tuple[int, ...] | None,
    initial: str = "uniform",
    record_map: bool = False,
    fine: bool = False,
) -> Posed:
    """The flow equation of a case and what is asked of it; all as `flow` takes it.

    Parameters
    ----------
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    region : where the case lies, m
    bulk_modulus : of the fluid, Pa
    wells : the wells
    sides : names of the sides at fixed pressure
    active : which sources act, (sources,) bool
    probes : where pressures are recorded
    times : of the outputs, s
    tolerance : relative error in time
    check_flows : whether boundary flows are held to it
    decades : of the steps of sources
    initial : what a transient starts from
    record_map : whether fields are kept
    fine : whether more lags are taken
    """
    system = assemble(
        network,
        apertures,
        region=region,
        bulk_modulus=bulk_modulus,
        wells=wells,
        sides=sides,
    )
    if initial == "gradient":
        system = with_linear_fields(system, network, apertures, wells)
    points = np.array([p.at for p in probes]).reshape(-1, 2)
    probed = between_pores(network, apertures, region, system, points)
    problem = Problem(
        system=system,
        records=outputs(system, probed),
        lag=lags(times, wells, fine=fine),
        active=np.asarray(active, dtype=bool),
        domain=_mapped(network, apertures) if record_map else np.empty(0, dtype=np.int64),
        tolerance=tolerance,
        safety_factor=1.0,
        check_flows=check_flows,
        steps=_steps(wells, len(sides), initial, decades)
        if decades is not None or sum(active) < 2
        else None,
    )
    return Posed(problem, probed)


def responses_of(
    posed: Posed, answer: Answer, start: Initial, met: float, choice: Choice
) -> Responses:
    """What the *flow* stage returns, from what a solver has answered.

    Parameters
    ----------
    posed : the problem and what belongs to it
    answer : what the solver gives
    start : initial fields
    met : tolerance that was met
    choice : which solver, and why
    """
    problem, system = posed.problem, posed.problem.system
    return Responses(
        lag=problem.lag,
        output=answer.output,
        cumulative=answer.cumulative,
        pressure=answer.pressure,
        missing=answer.missing,
        least_flow=np.array([problem.own_size(k)[1] for k in range(len(answer.output))]),
        domain=problem.domain,
        reached=system.reached(problem.domain),
        time_error=np.asarray(answer.time_error),
        tolerance_met=np.asarray(float(met)),
        residual=np.asarray(answer.residual),
        work=np.asarray(answer.work),
        probe_reached=system.reached(posed.probed.own),
        probe_place=posed.probed.place,
        isolated=np.asarray(system.isolated),
        initial_output=start.output,
        initial_cumulative=start.cumulative,
        initial_pressure=start.pressure,
        initial_volume=start.volume,
        initial_missing=start.missing,
        solver=np.asarray(choice.method),
        solver_reason=np.asarray(choice.reason),
    )


def _modulus(network: Network, bulk_modulus: float | None, storativity: float | None) -> float:
    """The bulk modulus with which the pores store what the rock as a whole does, Pa."""
    if storativity is None:
        return math.nan if bulk_modulus is None else bulk_modulus
    return float(network.porosity) / storativity


def _mapped(network: Network, apertures: Apertures) -> np.ndarray:
    """Places whose pressure maps hold: domains inside the region, then the nodes of traces."""
    nodes = len(network.x) + np.arange(len(apertures.node_x))
    return np.append(np.flatnonzero(network.inside), nodes)


def _steps(
    wells: tuple[Site, ...], sides: int, initial: str, decades: tuple[int, ...] | None
) -> Steps:
    """What is known of the steps of every source."""
    changes = [np.array(well.change_times) for well in wells if not well.fixed_pressure]
    fields = 2 if initial == "gradient" else 0
    kept = [np.unique((0.0, *well.change_times)) for well in wells if well.fixed_pressure]
    each = [*[np.zeros(1)] * sides, *kept, *changes, *[np.zeros(1)] * fields]
    size = np.ones(len(each))
    if decades is not None:
        size = 10.0 ** np.asarray(decades, dtype=float)
    return Steps(
        size,
        np.array([max(1.0, len(times)) for times in each]),
        np.array([np.diff(times).min(initial=np.inf) for times in each]),
    )


def _foresee(problem: Problem) -> None:
    """Raise `OutOfMemory` where the answer would not fit, before it is begun."""
    sources, lags = problem.system.source_count, len(problem.lag)
    recorded = problem.records.rows.shape[0] + problem.records.flow_rows + 1
    maps, field = len(problem.domain), problem.system.n if len(problem.domain) else 0
    foresee(
        f"the responses of {sources} sources at {lags} lags with maps of {maps} pores",
        np.dtype(float).itemsize * lags * (sources * (recorded + maps) + field),
        "ask for fewer times, changes of rate (every two make a lag) or maps",
    )


def _check_finite(answer: Answer, method: str) -> None:
    """Raise `ModelError` where a solver gave what is no number."""
    for what in ("output", "cumulative", "pressure", "residual"):
        values = np.asarray(getattr(answer, what))
        # what is no number makes no sum; a sum may be too large for one
        if not (np.isfinite(values.sum()) or np.isfinite(values).all()):
            raise ModelError(
                f"{method} gave a {what} that is no finite number; look for apertures or volumes "
                "that lie too far apart, or use another solver.method"
            )


def _check(
    bulk_modulus: float,
    times: tuple[float, ...],
    tolerance: float,
    safety_factor: float,
    method: str,
    step: str,
    initial: str,
) -> None:
    """Raise `ModelError` for what no solver can be asked, before time is spent."""
    if method != "auto" and method not in SOLVERS:
        raise ModelError(f"there is no solver {method}, only auto, {', '.join(SOLVERS)}")
    if initial not in STARTS:
        raise ModelError(f"there is no start {initial}, only {', '.join(STARTS)}")
    if not 0.0 < bulk_modulus < math.inf:
        raise ModelError(
            f"a bulk modulus of {bulk_modulus:g} Pa leaves no storage to flow from; give a finite "
            "fluid.bulk_modulus above 0 Pa (water has 2.2e9), or no times for the steady state"
        )
    if not LEAST_TOLERANCE <= tolerance < 1.0:
        raise ModelError(
            f"no solver keeps a tolerance of {tolerance:g}; give a solver.tolerance between "
            f"{LEAST_TOLERANCE:g}, below which round-off rules, and 1"
        )
    if not 0.0 < safety_factor < math.inf:
        raise ModelError(
            f"a safety factor of {safety_factor:g} gives no step; give a solver.safety_factor "
            "above 0, of which up to 1 is always stable"
        )
    if step == "paper" and method != "explicit":
        raise ModelError(
            f"step paper is that of solver.method explicit, not of {method}; ask for explicit, or "
            "leave solver.step out"
        )
    given = np.asarray(times, dtype=float)
    wrong = np.flatnonzero(~(np.isfinite(given) & (np.diff(given, prepend=0.0) > 0.0)))
    if len(wrong):
        raise ModelError(
            f"times are finite and increase, from above zero on, but number {wrong[0]} is "
            f"{given[wrong[0]]:g} s; put them in order, each once"
        )
    if method != "auto" and SOLVERS[method].transient != bool(times):
        what = "needs times; give some, or take steady for the state at rest"
        if not SOLVERS[method].transient:
            what = "has no times; leave them out, or take auto for a transient"
        raise ModelError(f"solver.method {method} {what}")
