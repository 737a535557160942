"""What a study asks of one case (the *observe* stage), from the products of the other stages."""

from __future__ import annotations

import math

import numpy as np

from demflow.model.controls import Controls, sites, started, step_sizes, superpose
from demflow.model.flow.equation.sites import change_times, time_since
from demflow.model.flow.solvers.time_error import time_error
from demflow.model.products import (
    Apertures,
    Network,
    Packing,
    Permeability,
    Responses,
    StrengthTest,
    StressState,
)
from demflow.model.region import Region, contains
from demflow.model.scene import MEASURED_BY_A_TEST
from demflow.model.transient import bourdet_derivative, flow_periods, pressure_change

CONFINEMENT = ("confining_stress_achieved", "confining_deviation", "confinement_held")


def observe(
    packing: Packing,
    stress: StressState | None,
    tested: StrengthTest | None,
    network: Network | None,
    apertures: Apertures | None,
    permeability: Permeability | None,
    responses: Responses | None,
    reference: Responses | None,
    *,
    region: Region,
    told: Controls,
    wanted: tuple[str, ...],
) -> dict[str, np.ndarray]:
    """Everything that a study asks of one case, under its names in `model.quantities.CASE`."""
    from demflow.model.mechanics.specimen.measures import packing_quality

    grains = contains(region, np.column_stack([packing.x, packing.y]))
    found = {
        "porosity": packing.porosity,
        **packing_quality(packing),
        "grain_count": np.asarray(np.count_nonzero(grains)),
        "floaters": packing.floaters,
    }
    if network is not None and apertures is not None:
        found |= {
            "porosity": network.porosity,
            "matrix_aperture": apertures.matrix_aperture,
            "domain_count": np.asarray(np.count_nonzero(network.inside)),
            "floaters": network.floaters,
            "slivers": network.slivers,
            "smallest_pore": _smallest(apertures.volume[network.inside]),
            "idle_traces": np.asarray(np.count_nonzero(apertures.trace_acts == 0)),
            "parted_pipes": _parted(network, stress),
        }
    if tested is not None:
        found |= {name: getattr(tested, name) for name in MEASURED_BY_A_TEST if name in wanted}
        found |= {name: getattr(tested, name) for name in CONFINEMENT}
    if stress is not None:
        found["stress_achieved"] = stress.stress
        found["unbalanced_ratio"] = stress.unbalanced_ratio
        found["broken_bonds"] = stress.broken_bonds
        found["static_solver"] = stress.static
        found["mechanical_steps"] = stress.steps
        found["tension_cracks"] = np.asarray(np.count_nonzero(stress.crack_mode == 1))
        found["shear_cracks"] = np.asarray(np.count_nonzero(stress.crack_mode == 2))
        found["joint_contacts"] = np.asarray(np.count_nonzero(~np.isnan(stress.joint_gap)))
        found["idle_joints"] = stress.idle_joints
    if permeability is not None:
        found["permeability"] = permeability.tensor
    if responses is not None:
        found |= observe_flow(responses, told)
        for name, needs in (
            ("well_pressure", ("well_pressure", "well_rate")),
            ("well_pressure", ("pressure_change", "pressure_derivative")),
            ("boundary_flow", ("boundary_flow",)),
            ("probe_pressure", ("probe_pressure",)),
        ):
            if name not in wanted:
                for key in needs:
                    found.pop(key, None)
    if responses is not None and reference is not None:
        found["reference_error"] = reference.time_error
        held = sum(well.pressure is not None for well in told.wells)
        found["time_error"] = np.asarray(
            time_error(
                responses,
                reference,
                fixed=len(told.side_pressures) + held,
                wells=len(told.wells) - held,
                flows="boundary_flow" in wanted or held > 0,
            )
        )
    return {name: np.asarray(value) for name, value in found.items()}


def _smallest(volume: np.ndarray) -> np.ndarray:
    """The smallest of some volumes over their mean."""
    return np.asarray(volume.min() / volume.mean())


def _parted(network: Network, stress: StressState | None) -> np.ndarray:
    """Number of pipes of the region whose grains have parted under the stress."""
    if stress is None:
        return np.asarray(0)
    from demflow.model.network.apertures import pipe_gaps

    inside = network.inside[network.pipe_from] | network.inside[network.pipe_to]
    return np.asarray(np.count_nonzero(inside & (pipe_gaps(network, stress) > 0.0)))


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
