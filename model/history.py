"""What one case did in time, whichever way it was found; what is observed is read from this.

Where flow is linear, every schedule of rates and pressures is a sum of shifted and scaled
responses to unit steps, and its history is made here by superposing them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from demflow.model.controls import Controls, Steps, at_rates, sites, step_sizes
from demflow.model.flow.equation.sites import change_times, time_since
from demflow.model.flow.solvers.time_error import FAINT, FAINT_FLOW, Recorded, time_error
from demflow.model.limited import interpolating, settled
from demflow.model.products import Responses
from demflow.model.transient import flow_periods, pressure_change

if TYPE_CHECKING:
    from demflow.model.coupling.fracture import Fracturing

Array = np.ndarray
Loads = tuple[tuple[tuple[float, float], ...], ...]  # on each wall: time (s), new stress (Pa)


class Volumes(NamedTuple):
    """Fluid that went where since the start, at t times; k counts sides and wells at a pressure.

    In m³ for unit depth; of a steady state in m³/s, where nothing is stored.
    """

    stored: Array  # (t,) in the pores
    let_in: Array  # (t, k) by what keeps its pressure
    produced: Array  # (t,) by the wells at a rate
    moved: Array  # (t,) all of these without their signs, of rates that of every step of them
    missing: Array | float = 0.0  # (t,) at most out of balance, before a solver mended that


class Solved(NamedTuple):
    """How the flow was solved, and how well, by the names in `model.quantities.CASE`."""

    residual: Array  # ()
    range_error: Array | None  # (); None where no maximum principle holds
    estimated_error: Array  # () NaN without an estimate
    tolerance_met: Array  # () 1 or 0, NaN without an estimate
    isolated_domains: Array  # ()
    solver_used: Array  # () word
    solver_reason: Array  # () words
    flow_balance_error: Array | float | None = 0.0  # (); None where flows rise and fall


class History(NamedTuple):
    """Pressures, rates, flows and volumes of one case at t times.

    w wells, b sides at a pressure or, behind them, with an inflow, p probes, c times at which some
    rate changes.
    """

    times: Array  # (t,) s; a steady state has one, infinity
    well_pressure: Array  # (w, t) Pa
    well_rate: Array  # (w, t) m³/s for unit depth, positive for production
    boundary_flow: Array  # (b, t) m³/s for unit depth, positive into the region
    boundary_pressure: Array  # (b, t) Pa
    probe_pressure: Array  # (p, t) Pa
    change_times: Array  # (c,) s, increasing
    pressure_at_changes: Array  # (w, c) Pa: the wells' just before each of these
    volumes: Volumes
    solved: Solved
    probe_place: Array = np.empty((0, 2))  # (p, 2) m: where those pressures are, if known
    limited: Array | None = None  # (w, t) 1 where a limit of pressure acts, 0 where a rate does


def kept_pressures(controls: Controls, times: int) -> Array:
    """Pressures of the sides that keep one, (b, t) Pa.

    Parameters
    ----------
    controls : of the case
    times : how many there are
    """
    return np.repeat(np.array(controls.side_pressures, dtype=float)[:, None], times, axis=1)


def marched(fractured: Fracturing, controls: Controls) -> History:
    """The history of a march through breaking bonds; NaN after it came to an early end."""
    kept, t, sides = fractured.records, len(controls.times), len(controls.side_pressures)
    rows = {name: until(getattr(kept, name), t) for name in kept._fields}
    put_in = np.abs(kept.injected) + np.abs(kept.let_in).sum(axis=1)
    # what is stored before anything enters is rounding, held against what moves later
    most = float((np.abs(kept.stored) + put_in).max(initial=0.0)) if np.any(put_in > 0.0) else 0.0
    moved = np.where(put_in > 0.0, np.abs(kept.stored) + put_in, most)
    changes, before = pressures_at_changes(fractured.at_changes, fractured.change_time, controls)
    return History(
        times=np.asarray(controls.times),
        well_pressure=rows["well_pressure"].reshape(t, -1).T,
        well_rate=rows["well_rate"].reshape(t, -1).T,
        boundary_flow=rows["side_flow"].reshape(t, -1)[:, :sides].T,
        boundary_pressure=kept_pressures(controls, t),
        probe_pressure=rows["probe_pressure"].reshape(t, -1).T,
        change_times=changes,
        pressure_at_changes=before,
        volumes=Volumes(
            stored=kept.stored,
            let_in=kept.let_in,
            produced=-kept.injected,
            moved=moved,
            missing=fractured.unbalanced * moved,
        ),
        solved=Solved(
            residual=fractured.off,
            range_error=None,
            estimated_error=np.asarray(np.nan),
            tolerance_met=np.asarray(np.nan),
            isolated_domains=np.asarray(0),
            solver_used=np.array("breaking"),
            solver_reason=np.array("bonds break one by one, each located in time"),
            flow_balance_error=None,
        ),
        probe_place=fractured.probe_place,
    )


def pressures_at_changes(
    recorded: Array, recorded_time: Array, controls: Controls
) -> tuple[Array, Array]:
    """Times (c,) s at which rates change, and the wells' pressures (w, c) just before, if known.

    Parameters
    ----------
    recorded : pressures of the wells that a march recorded, (k, w) Pa
    recorded_time : when, (k,) s
    controls : of the case
    """
    changes = change_times(sites(controls.wells))
    before = np.full((len(controls.wells), len(changes)), np.nan)
    before[:, 0] = controls.initial
    known = np.searchsorted(changes, recorded_time)
    if len(known):
        before[:, known] = recorded.T
    return changes, before


def until(recorded: Array, times: int) -> Array:
    """What was recorded (r, …), and NaN up to a number of times."""
    rest = np.full((times - len(recorded), *recorded.shape[1:]), np.nan)
    return np.concatenate([recorded, rest]) if len(rest) else recorded


def superposed(responses: Responses, controls: Controls, loads: Loads | None = None) -> History:
    """The history of a case whose flow is linear, from its responses to unit steps.

    `loads` are the changes of stress on the walls of a coupled rock, whose responses come last;
    there pressures and flows of a response may rise and fall.

    Parameters
    ----------
    responses : step responses of all sources
    controls : rates and pressures of the case in time
    loads : what wells with limits do, or None
    """
    found = settled(responses, controls, _given(controls, loads))
    steps = _given(controls, loads) if found is None else found.steps
    times, changes = _times(controls), change_times(sites(controls.wells))
    output = _output(responses, controls, steps, times)
    wells, sides = controls.wells, len(controls.side_pressures)
    at_rate = at_rates(wells)
    held = [k for k, w in enumerate(wells) if w.held]

    def pressures(found: Array, at: Array) -> Array:
        """Of all wells, (w, times), from recorded outputs (times, o)."""
        pressure = np.empty((len(wells), len(found)))
        pressure[at_rate] = controls.reference + found[:, : len(at_rate)].T
        for k in held:
            pressure[k] = _acting(wells[k].pressure_changes, at)
        return pressure

    flows = output[:, len(at_rate) : len(at_rate) + sides + len(held)].T
    rate = np.empty((len(wells), len(times)))
    rate[held] = -flows[sides:]
    for k in at_rate:
        rate[k] = _acting(((-math.inf, 0.0), *wells[k].rate_changes), times)
    pressure = pressures(output, times)
    if found is not None:
        rate = np.where(np.isnan(found.rate), rate, found.rate)
        pressure = np.where(np.isnan(found.pressure), pressure, found.pressure)
    probes = controls.reference + output[:, len(at_rate) + sides + len(held) :].T
    probes[~responses.probe_reached] = controls.initial
    before = _output(responses, controls, steps, changes) if controls.transient else output[:0]
    drilled = len(controls.drilled)  # behind the wells are the sides with an inflow
    kept = kept_pressures(controls, len(times))
    return History(
        times=times,
        well_pressure=pressure[:drilled],
        well_rate=rate[:drilled],
        boundary_flow=np.concatenate([flows[:sides], -rate[drilled:]]),
        boundary_pressure=np.concatenate([kept, pressure[drilled:]]),
        probe_pressure=probes,
        change_times=changes[: len(before)],
        pressure_at_changes=pressures(before, changes[: len(before)])[:drilled],
        volumes=(
            _volumes(responses, controls, steps, times)
            if controls.transient
            else _rates(flows, rate[at_rate], _missing(responses, controls, steps, times))
        ),
        probe_place=responses.probe_place,
        limited=None if found is None else found.limited[:drilled],
        solved=Solved(
            residual=responses.residual,
            range_error=(np.asarray(_out_of_range(responses, controls)) if loads is None else None),
            estimated_error=responses.time_error,
            tolerance_met=responses.tolerance_met,
            isolated_domains=responses.isolated,
            flow_balance_error=(
                np.asarray(_unexplained(responses, controls)) if loads is None else None
            ),
            solver_used=responses.solver,
            solver_reason=responses.solver_reason,
        ),
    )


def superposed_record(
    responses: Array, initial: Array, lag: Array, controls: Controls, loads: Loads
) -> Array:
    """Something recorded of a coupled rock, (k, t), from responses (sources, l, k), fields so.

    Parameters
    ----------
    responses : (sources, l, o) for a unit each
    initial : what is left of the initial fields
    lag : (l,) s
    controls : rates and pressures of the case in time
    loads : what wells with limits do, or None
    """
    times = _times(controls)
    found = superpose(responses, lag, step_sizes(controls) + _load_steps(loads), times)
    found += started(initial, lag, controls.initial_weights, times)
    return np.asarray(found.T)


def superposed_map(responses: Responses, controls: Controls, loads: Loads | None = None) -> Array:
    """Pressure (t, m) in Pa of the domains of the responses; (1, m) for a steady study.

    Domains that no source reaches keep the initial pressure; NaN where none is given.

    Parameters
    ----------
    responses : step responses of all sources
    controls : rates and pressures of the case in time
    loads : what wells with limits do, or None
    """
    times = _times(controls)
    steps = _steps(responses, controls, loads)
    change = superpose(responses.pressure, responses.lag, steps, times)
    change += started(responses.initial_pressure, responses.lag, controls.initial_weights, times)
    return np.where(responses.reached, controls.reference + change, controls.initial)


def superposed_error(
    responses: Responses, reference: Responses, controls: Controls, *, flows: bool
) -> dict[str, Array]:
    """Errors in time of what is recorded and of the reference that it is held against.

    `flows` says whether inflows at fixed pressures count. By their names in
    `model.quantities.CASE`.

    Parameters
    ----------
    responses : step responses of all sources
    reference : the same, with far smaller errors in time
    controls : rates and pressures of the case in time
    flows : whether inflows at fixed pressures count
    """
    held = sum(well.held for well in controls.wells)
    sizes = [max((abs(q) for _, q in changes), default=0.0) for changes in step_sizes(controls)]
    fixed = len(controls.fixed_pressures)
    through = np.array(sizes) * responses.least_flow  # rates, and what would fill all pores
    error = time_error(
        recorded(responses, controls),
        recorded(reference, controls),
        least_pressure=max(sizes[:fixed], default=0.0),
        least_flow=np.maximum(FAINT_FLOW * through.max(initial=0.0), FAINT * through[:fixed]),
        flows=flows or held > 0,
    )
    return {"reference_error": reference.time_error, "time_error": np.asarray(error)}


def recorded(responses: Responses, controls: Controls) -> Recorded:
    """What counts of the responses of one case that is a transient."""
    steps, times = _steps(responses, controls), _times(controls)
    output = _output(responses, controls, steps, times).T
    at_rate = [well for well in controls.wells if not well.held]
    wells, flows = len(at_rate), len(controls.fixed_pressures)
    change = np.full((wells, len(times)), np.nan)
    so_far = np.zeros_like(change)
    for k, well in enumerate(at_rate):
        start, sign = flow_periods(well.rate_changes)
        before = _output(responses, controls, steps, start)[:, k] if len(start) else start
        change[k] = pressure_change(times, output[k], start, before, sign)
        for period in np.split(np.arange(len(times)), np.searchsorted(times, start, side="right")):
            so_far[k, period] = np.maximum.accumulate(np.abs(np.nan_to_num(change[k, period])))
    field = superpose(responses.pressure, responses.lag, steps, times)
    weights = controls.initial_weights
    field += started(responses.initial_pressure, responses.lag, weights, times)
    probes = output[wells + flows :][responses.probe_reached]
    pressure = np.concatenate([output[:wells], probes])
    return Recorded(change, so_far, output[wells : wells + flows], pressure, field)


def _given(controls: Controls, loads: Loads | None = None) -> Steps:
    """The steps of every source that are asked for."""
    return step_sizes(controls) + _load_steps(loads or ())


def _steps(responses: Responses, controls: Controls, loads: Loads | None = None) -> Steps:
    """The steps of every source, those of wells whose rates are found among them."""
    given = _given(controls, loads)
    found = settled(responses, controls, given)
    return given if found is None else found.steps


def _acting(changes: tuple[tuple[float, float], ...], at: Array) -> Array:
    """What has led to the state at each time: a change acts after its time, the first always."""
    starts = np.array([time for time, _ in changes])
    acted = time_since(starts[:, None], at[None, :]) > 0.0
    values = np.array([value for _, value in changes])
    return np.asarray(values[np.maximum(np.count_nonzero(acted, axis=0) - 1, 0)])


def superpose(
    responses: Array, lag: Array, steps: Steps, at: Array, *, volumes: bool = False
) -> Array:
    """Sum of shifted and scaled step responses (sources, l, …) at the times `at` (t,).

    A step acts after its time, not at it. At infinity (a steady study) every step acts. Steps at
    times for which no response is kept (see `model.limited`) take it from those around.

    Parameters
    ----------
    responses : (sources, l, …) for a unit each
    lag : (l,) s since the step
    steps : sizes and times of the steps of each source
    at : times (t,), s
    volumes : whether the responses are volumes since the step
    """
    total = np.zeros((len(at), *responses.shape[2:]))
    for source, changes in enumerate(steps):
        found = _kept(lag, changes, at)
        if found is None:
            weights = interpolating(lag, changes, at, volumes=volumes)
            total += np.tensordot(weights, responses[source], 1)
            continue
        for size, acts, place in found:
            total[acts] += size * responses[source, place]
    return total


def _kept(
    lag: Array, changes: list[tuple[float, float]], at: Array
) -> list[tuple[float, Array, Array]] | None:
    """Of each step its size, the times (t,) bool after it and the places of the lags since it.

    None where no response is kept for one of these.
    """
    found = []
    for time, size in changes:
        if size == 0.0:
            continue
        since = time_since(time, at) if math.isfinite(at[0]) else at
        acts = since > 0.0
        wanted = since[acts]
        place = np.searchsorted(lag, wanted)
        near = np.minimum(place, len(lag) - 1)
        if math.isfinite(lag[-1]) and not np.array_equal(lag[near], wanted):
            return None
        found.append((size, acts, place))
    return found


def started(fields: Array, lag: Array, weights: tuple[float, ...], at: Array) -> Array | float:
    """What is left at the times `at` (t,) of the initial fields (fields, l or 1, …), (t, …).

    Parameters
    ----------
    fields : what is left of each initial field, (fields, l or 1, …)
    lag : (l,) s
    weights : of the fields, (fields,)
    at : times (t,), s
    """
    total: Array | float = 0.0
    for field, weight in zip(fields, weights, strict=True):
        total = total + weight * (field if len(field) == 1 else field[np.searchsorted(lag, at)])
    return total


def _load_steps(loads: Loads) -> Steps:
    """Steps (s, Pa) of the stress on each wall that is loaded."""
    return [
        [
            (t, new - old)
            for (t, new), old in zip(changes, [0.0, *(s for _, s in changes)], strict=False)
        ]
        for changes in loads
    ]


def _times(controls: Controls) -> Array:
    return np.asarray(controls.times) if controls.transient else np.array([math.inf])


def _output(responses: Responses, controls: Controls, steps: Steps, at: Array) -> Array:
    """Recorded outputs (t, o): what the start left and what the steps did."""
    changes = superpose(responses.output, responses.lag, steps, at)
    return changes + started(responses.initial_output, responses.lag, controls.initial_weights, at)


def _volumes(responses: Responses, controls: Controls, steps: Steps, times: Array) -> Volumes:
    """Volumes at the times of a transient."""
    weights = controls.initial_weights
    volumes = superpose(responses.cumulative, responses.lag, steps, times, volumes=True)
    volumes += started(responses.initial_cumulative, responses.lag, weights, times)
    let_in, stored = volumes[:, :-1], volumes[:, -1]
    produced = np.zeros(len(times))
    moved = np.abs(let_in).sum(axis=1) + np.abs(stored)
    moved += np.abs(weights) @ responses.initial_volume
    fixed = len(controls.fixed_pressures)
    at_rate = sum(not well.held for well in controls.wells)
    for changes in steps[fixed : fixed + at_rate]:
        for time, size in changes:
            volume = size * np.maximum(times - time, 0.0)
            produced += volume
            moved += np.abs(volume)
    return Volumes(stored, let_in, produced, moved, _missing(responses, controls, steps, times))


def _missing(responses: Responses, controls: Controls, steps: Steps, times: Array) -> Array:
    """What is missing at most at some times (t,), all of it taken for one sign."""
    sizes = [[(time, abs(size)) for time, size in changes] for changes in steps]
    weights = tuple(abs(weight) for weight in controls.initial_weights)
    missing = superpose(responses.missing, responses.lag, sizes, times)
    return missing + started(responses.initial_missing, responses.lag, weights, times)


def _rates(flows: Array, produced: Array, missing: Array) -> Volumes:
    """Volumes of a steady state each second: flows (k, 1) let in, rates (w, 1) produced."""
    moved = np.abs(flows).sum() + np.abs(produced).sum()
    produced_at_once = np.array([produced.sum()])
    return Volumes(np.zeros(1), flows.T, produced_at_once, np.array([moved]), missing)


def _unexplained(responses: Responses, controls: Controls) -> float:
    """Largest part of the volume moved that recorded flows do not explain, of unit responses.

    Flows of a response to a step rise or fall all the time, so that from one lag to the next each
    lets in between its two values times the time between: what is stored meanwhile has to lie
    within the sum of these. No solver's own bookkeeping enters.
    """
    lag = responses.lag
    span = np.diff(lag)
    if not controls.transient or not len(span):
        return 0.0
    fixed = len(controls.fixed_pressures)
    wells = len(controls.wells) - (fixed - len(controls.side_pressures))
    worst = 0.0
    for source in range(fixed + wells):
        if not responses.output[source].any():
            continue  # it idles: its response was not computed
        flow = responses.output[source, :, wells : wells + fixed]
        taken = 0.0 if source < fixed else 1.0
        ends = np.stack([flow[:-1], flow[1:]])
        least = ends.min(axis=0).sum(axis=1) - taken
        most = ends.max(axis=0).sum(axis=1) - taken
        stored = responses.cumulative[source, :, -1]
        gain = np.diff(stored)
        beyond = np.maximum(np.maximum(least * span - gain, gain - most * span), 0.0)
        moved = np.abs(stored) + np.abs(responses.cumulative[source, :, :-1]).sum(axis=1)
        moved = (moved + taken * lag)[1:]
        counts = moved != 0.0
        worst = max(worst, float(np.max(beyond[counts] / moved[counts], initial=0.0)))
    return worst


def _out_of_range(responses: Responses, controls: Controls) -> float:
    """Largest excursion of the recorded unit responses from the range of the maximum principle.

    A fixed pressure that rises by 1 Pa keeps every pressure between 0 and 1 Pa, lets fluid in,
    and none in elsewhere. A well that produces 1 m³/s raises no pressure and draws between 0
    and 1 m³/s from each fixed one. Flows count over the largest of the source, and pressures
    by a well likewise. A start in the steady state of fixed pressures has their ranges.
    """
    fixed = len(controls.fixed_pressures)
    wells = len(controls.wells) - (fixed - len(controls.side_pressures))
    responded = [(k, responses.output[k], responses.pressure[k]) for k in range(fixed + wells)]
    if controls.start == "steady":
        initial = zip(responses.initial_output, responses.initial_pressure, strict=True)
        responded += [(k, output, field) for k, (output, field) in enumerate(initial)]
    worst = [0.0]
    for source, output, field in responded:
        low, high = _extremes(output[:, :wells], output[:, wells + fixed :], field)
        flows = output[:, wells : wells + fixed]
        if source < fixed:
            worst += [-low, high - 1.0]
            low, _ = _extremes(flows[:, source])
            _, high = _extremes(np.delete(flows, source, axis=1))
            if (size := np.abs(flows).max(initial=0.0)) != 0.0:
                worst += [-low / size, high / size]
        else:
            if (size := np.max([-low, high])) != 0.0:
                worst.append(high / size)
            low, high = _extremes(flows)
            worst += [-low, high - 1.0]
    return abs(float(np.max(worst)))


def _extremes(*values: Array) -> tuple[float, float]:
    """Least and largest of arrays and of zero; what is not a number stays."""
    least = np.min([np.min(v, initial=0.0) for v in values])
    return float(least), float(np.max([np.max(v, initial=0.0) for v in values]))
