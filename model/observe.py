"""From responses to what a study asks for (the *observe* stage): scale, shift and sum."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from model.flow.sites import WellSite, change_times, time_since
from model.products import Responses
from model.scene import InitialField, Scene, Well
from model.transient import bourdet_derivative, flow_periods, pressure_change


class Controls(NamedTuple):
    """How much: the part of a scene that scales responses, in the order of the sources."""

    reference: float  # Pa, the pressure from which changes count
    initial: float  # Pa, of pores that no source reaches; NaN where none is one for all
    side_pressures: tuple[float, ...]  # Pa, of the sides at fixed pressure
    wells: tuple[Well, ...]
    times: tuple[float, ...]  # s
    transient: bool
    start: str = "uniform"  # or gradient, steady: see `model.flow.solvers.flow`
    gradient: tuple[float, float] = (0.0, 0.0)  # Pa/m, of a start from a gradient

    @property
    def fixed_pressures(self) -> tuple[float, ...]:
        """Pressures of the sides and wells that keep one, in the order of the sources, Pa."""
        return (*self.side_pressures, *(w.pressure for w in self.wells if w.pressure is not None))

    @property
    def initial_weights(self) -> tuple[float, ...]:
        """How much of each unit initial field the start holds."""
        if self.start == "gradient":
            return self.gradient
        if self.start == "steady":
            return tuple(p - self.reference for p in self.fixed_pressures)
        return ()


def sites(wells: tuple[Well, ...]) -> tuple[WellSite, ...]:
    """What the flow stage may know of the wells: all but how much they produce."""
    return tuple(
        WellSite(
            name=w.name,
            at=w.at,
            radius=w.effective_radius,
            fixed_pressure=w.pressure is not None,
            change_times=tuple(t for t, _ in w.rate_changes),
            skin=max(w.skin_factor, 0.0),
            storage=w.wellbore_storage,
        )
        for w in wells
    )


def controls(scene: Scene) -> Controls:
    """The controls of a scene."""
    transient = scene.method != "steady"
    uniform = scene.uniform_pressure
    field = scene.initial_pressure
    held = [p for _, p in scene.boundaries]
    held += [w.pressure for w in scene.wells if w.pressure is not None]
    reference = held[0] if held else 0.0
    gradient = (0.0, 0.0)
    if transient and uniform is not None:
        reference = uniform
    elif transient and isinstance(field, InitialField):
        reference, gradient = field.at_origin, field.gradient
    return Controls(
        reference,
        math.nan if uniform is None else uniform,
        tuple(p for _, p in scene.boundaries),
        scene.wells,
        scene.times if transient else (),
        transient,
        scene.start,
        gradient,
    )


def active_sources(scene: Scene) -> tuple[bool, ...]:
    """Which sources act at all, in their order, as `model.flow.solvers.flow` takes them."""
    told = controls(scene)
    rates = [any(q != 0.0 for _, q in w.rate_changes) for w in told.wells if w.pressure is None]
    fields = [g != 0.0 for g in told.gradient] if told.start == "gradient" else []
    return (*(p != told.reference for p in told.fixed_pressures), *rates, *fields)


def step_sizes(told: Controls) -> list[list[tuple[float, float]]]:
    """Steps (time in s, size) of every source: Pa for a fixed pressure, m³/s for a rate."""
    steps = [[(0.0, pressure - told.reference)] for pressure in told.fixed_pressures]
    if told.start == "steady":  # they have acted for ever
        steps = [[] for _ in steps]
    for well in told.wells:
        if well.pressure is None:
            rates = [0.0, *(q for _, q in well.rate_changes)]
            steps.append(
                [(t, new - old) for (t, new), old in zip(well.rate_changes, rates, strict=False)]
            )
    return steps


def superpose(
    responses: np.ndarray, lag: np.ndarray, steps: list[list[tuple[float, float]]], at: np.ndarray
) -> np.ndarray:
    """Sum of shifted and scaled step responses (sources, l, …) at the times `at` (t,).

    A step acts after its time, not at it. At infinity (a steady study) every step acts.
    """
    total = np.zeros((len(at), *responses.shape[2:]))
    for source, changes in enumerate(steps):
        for time, size in changes:
            if size == 0.0:
                continue
            since = time_since(time, at) if math.isfinite(at[0]) else at
            acts = since > 0.0
            total[acts] += size * responses[source, np.searchsorted(lag, since[acts])]
    return total


def started(
    fields: np.ndarray, lag: np.ndarray, weights: tuple[float, ...], at: np.ndarray
) -> np.ndarray | float:
    """What is left at the times `at` (t,) of the initial fields (fields, l or 1, …), (t, …)."""
    total: np.ndarray | float = 0.0
    for field, weight in zip(fields, weights, strict=True):
        total = total + weight * (field if len(field) == 1 else field[np.searchsorted(lag, at)])
    return total


def observe_flow(responses: Responses, told: Controls) -> dict[str, np.ndarray]:
    """Well pressures and rates, boundary flows, probes and the balance of one case.

    A steady study has no time dimension.
    """
    steps = step_sizes(told)
    changes = change_times(sites(told.wells))
    times = np.asarray(told.times) if told.transient else np.array([math.inf])
    output = _output(responses, told, steps, times)
    rate_wells = [k for k, w in enumerate(told.wells) if w.pressure is None]
    pressure_wells = [k for k, w in enumerate(told.wells) if w.pressure is not None]
    sides, wells = len(told.side_pressures), len(told.wells)

    pressure = np.empty((wells, len(times)))
    rate = np.empty((wells, len(times)))
    pressure[rate_wells] = told.reference + output[:, : len(rate_wells)].T
    for k in pressure_wells:
        pressure[k] = told.wells[k].pressure
    flows = output[:, len(rate_wells) : len(rate_wells) + sides + len(pressure_wells)].T
    rate[pressure_wells] = -flows[sides:]
    for k in rate_wells:
        starts = np.array([t for t, _ in told.wells[k].rate_changes])
        rates = np.array([0.0, *(q for _, q in told.wells[k].rate_changes)])
        # the rate that led to the pressure at a time: a change acts after its time
        acted = time_since(starts[:, None], times[None, :]) > 0.0
        rate[k] = rates[np.count_nonzero(acted, axis=0)]
    probes = told.reference + output[:, len(rate_wells) + sides + len(pressure_wells) :].T
    probes[~responses.probe_reached] = told.initial
    found = {
        "well_pressure": pressure,
        "well_rate": rate,
        "boundary_flow": flows[:sides],
        "probe_pressure": probes,
        "mass_balance_error": np.asarray(_imbalance(responses, told, steps, times, rate, flows)),
        "residual": responses.residual,
        "range_error": np.asarray(_out_of_range(responses, told)),
        "estimated_error": responses.time_error,
        "tolerance_met": responses.tolerance_met,
        "isolated_domains": responses.isolated,
        "solver_used": responses.solver,
        "solver_reason": responses.solver_reason,
    }
    if not told.transient:
        for name in ("well_pressure", "well_rate", "boundary_flow", "probe_pressure"):
            found[name] = found[name][:, 0]
        return found
    at_changes = _output(responses, told, steps, changes)
    change = np.full_like(pressure, np.nan)
    derivative = np.full_like(pressure, np.nan)
    for order, k in enumerate(rate_wells):
        starts, sign = flow_periods(told.wells[k].rate_changes)
        before = told.reference + at_changes[np.searchsorted(changes, starts), order]
        change[k] = pressure_change(times, pressure[k], starts, before, sign)
        derivative[k] = bourdet_derivative(times, change[k], starts)
    found["pressure_change"] = change
    found["pressure_derivative"] = derivative
    return found


def pressure_map(responses: Responses, told: Controls) -> np.ndarray:
    """Pressure (t, m) in Pa of the domains of the responses; (1, m) for a steady study.

    Domains that no source reaches keep the initial pressure; NaN where none is given.
    """
    times = np.asarray(told.times) if told.transient else np.array([math.inf])
    change = superpose(responses.pressure, responses.lag, step_sizes(told), times)
    change += started(responses.initial_pressure, responses.lag, told.initial_weights, times)
    return np.where(responses.reached, told.reference + change, told.initial)


def _output(
    responses: Responses, told: Controls, steps: list[list[tuple[float, float]]], at: np.ndarray
) -> np.ndarray:
    """Recorded outputs (t, o): what the start left and what the steps did."""
    changes = superpose(responses.output, responses.lag, steps, at)
    return changes + started(responses.initial_output, responses.lag, told.initial_weights, at)


def _imbalance(
    responses: Responses,
    told: Controls,
    steps: list[list[tuple[float, float]]],
    times: np.ndarray,
    rate: np.ndarray,
    flows: np.ndarray,
) -> float:
    """Largest imbalance over the volume moved: in time, or of the steady rates."""
    fixed_wells = sum(w.pressure is not None for w in told.wells)
    if not told.transient:
        produced = np.array([rate[k, 0] for k, w in enumerate(told.wells) if w.pressure is None])
        moved = np.abs(flows).sum() + np.abs(produced).sum()
        return float(abs(flows.sum() - produced.sum()) / moved) if moved != 0.0 else 0.0
    volumes = superpose(responses.cumulative, responses.lag, steps, times)
    volumes += started(responses.initial_cumulative, responses.lag, told.initial_weights, times)
    let_in, stored = volumes[:, :-1], volumes[:, -1]
    produced = np.zeros(len(times))
    moved = np.abs(let_in).sum(axis=1) + np.abs(stored)
    moved += np.abs(told.initial_weights) @ responses.initial_volume
    for source_steps in steps[len(told.side_pressures) + fixed_wells :]:
        for time, size in source_steps:
            volume = size * np.maximum(times - time, 0.0)
            produced += volume
            moved += np.abs(volume)
    error = np.abs(stored - let_in.sum(axis=1) + produced)
    counts = moved != 0.0  # what is not a number counts
    return float(np.max(error[counts] / moved[counts], initial=0.0))


def _out_of_range(responses: Responses, told: Controls) -> float:
    """Largest excursion of the recorded unit responses from the range of the maximum principle.

    A fixed pressure that rises by 1 Pa keeps every pressure between 0 and 1 Pa, lets fluid in,
    and none in elsewhere. A well that produces 1 m³/s raises no pressure and draws between 0
    and 1 m³/s from each fixed one. Flows count over the largest of the source, and pressures
    by a well likewise. A start in the steady state of fixed pressures has their ranges.
    """
    fixed = len(told.fixed_pressures)
    wells = len(told.wells) - (fixed - len(told.side_pressures))
    responded = [(k, responses.output[k], responses.pressure[k]) for k in range(fixed + wells)]
    if told.start == "steady":
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


def _extremes(*values: np.ndarray) -> tuple[float, float]:
    """Least and largest of arrays and of zero; what is not a number stays."""
    least = np.min([np.min(v, initial=0.0) for v in values])
    return float(least), float(np.max([np.max(v, initial=0.0) for v in values]))
