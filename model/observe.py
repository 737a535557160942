"""What a study asks of one case (the *observe* stage), from the products of the other stages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from demflow.model.controls import Controls, Terminal
from demflow.model.flow.equation.local_rock import spacing_around
from demflow.model.history import (
    History,
    Solved,
    Volumes,
    kept_pressures,
    marched,
    pressures_at_changes,
    superposed,
    superposed_error,
    superposed_record,
    until,
)
from demflow.model.products import (
    Apertures,
    BarPermeability,
    FractureNetwork,
    Moduli,
    Network,
    Packing,
    PeriodicPermeability,
    Permeability,
    Responses,
    StrengthTest,
    StressState,
)
from demflow.model.quantities import STOPPED
from demflow.model.region import Region, contains
from demflow.model.scene import MEASURED_BY_A_TEST, OF_BREAKING
from demflow.model.transient import (
    bourdet_derivative,
    flow_periods,
    log_time,
    pressure_change,
)

if TYPE_CHECKING:
    from demflow.model.coupling.consolidation import Consolidation
    from demflow.model.coupling.following import Followed
    from demflow.model.coupling.fracture import Fracturing

IN_TIME = ("well_pressure", "well_rate", "boundary_flow", "boundary_pressure", "probe_pressure")
NETWORK = (
    *("nodes_i", "nodes_y", "nodes_x", "nodes_rim", "traces", "branches", "clusters"),
    *("p20", "p21", "p22", "backbone"),
)
# what the flow gives only where the observable is asked for that it belongs to
ASKED_FOR_BY = {
    "well_pressure": "well_pressure",
    "well_rate": "well_pressure",
    "well_limited": "well_pressure",
    "pressure_change": "well_pressure",
    "pressure_derivative": "well_pressure",
    "boundary_flow": "boundary_flow",
    "boundary_pressure": "boundary_pressure",
    "probe_pressure": "probe_pressure",
    "probe_place_x": "probe_pressure",
    "probe_place_y": "probe_pressure",
}
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
    traces: FractureNetwork | None,
    moduli: Moduli | None = None,
    consolidated: Consolidation | None = None,
    fractured: Fracturing | None = None,
    followed: Followed | None = None,
    bar: BarPermeability | None = None,
    periodic: PeriodicPermeability | None = None,
    *,
    region: Region,
    controls: Controls,
    wanted: tuple[str, ...],
    loads: tuple[tuple[tuple[float, float], ...], ...] | None = None,
    coupled: tuple[str, str] | None = None,
) -> dict[str, np.ndarray]:
    """Everything that a study asks of one case, under its names in `model.quantities.CASE`.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    stress : grains in equilibrium under the stress
    tested : the test to failure
    network : pores and pipes of the matrix
    apertures : how far they are open, and traces with nodes of their own
    permeability : of the open network
    responses : step responses of the flow
    reference : the same with far smaller errors in time
    traces : the network of the fractures
    moduli : elastic constants
    fractured : a march through breaking bonds
    consolidated : responses of a coupled rock, linear
    followed : what one did whose apertures followed its forces
    bar : permeability of the open network as a bar
    periodic : that where the region repeats itself
    region : where the case lies, m
    controls : rates and pressures of the case in time
    wanted : names of what is observed
    loads : changes of the stress on walls (s, Pa) of a coupled rock
    coupled : how fluid and rock are coupled, and why
    """
    from demflow.model.mechanics.specimen.measures import packing_quality

    grains = contains(region, np.column_stack([packing.x, packing.y]))
    found = {
        "porosity": packing.porosity,
        **packing_quality(packing),
        "grain_count": np.asarray(np.count_nonzero(grains)),
        "floaters": packing.floaters,
    }
    if network is not None and apertures is not None:
        found |= _pores(network, apertures, stress)
        if "well_pressure" in wanted:
            found["pores_per_well"] = _pores_per_well(network, controls)
    if tested is not None:
        found |= {name: getattr(tested, name) for name in MEASURED_BY_A_TEST if name in wanted}
        found |= {name: getattr(tested, name) for name in CONFINEMENT}
    if stress is not None:
        found |= _stressed(stress, region, wanted)
    found |= _overlap(stress, tested)
    if moduli is not None:
        found |= _elastic(moduli)
    conducts: dict[str, tuple[np.ndarray] | None] = {
        "permeability": permeability,
        "bar_permeability": bar,
        "periodic_permeability": periodic,
    }
    found |= {name: one[0] for name, one in conducts.items() if one is not None}
    if traces is not None:
        found |= _described(traces)
    history, strained = _coupled(
        consolidated, followed, fractured, stress, controls, loads or (), wanted, coupled
    )
    found |= strained
    if history is not None:
        found |= flowed(history, traces, controls, wanted)
    if responses is not None:
        found |= flowed(superposed(responses, controls), traces, controls, wanted)
        if reference is not None:
            flows = "boundary_flow" in wanted
            found |= superposed_error(responses, reference, controls, flows=flows)
    return {name: np.asarray(value) for name, value in found.items()}


def _pores(
    network: Network, apertures: Apertures, stress: StressState | None
) -> dict[str, np.ndarray]:
    """Pores and their pipes."""
    return {
        "porosity": network.porosity,
        "matrix_aperture": apertures.matrix_aperture,
        "domain_count": np.asarray(np.count_nonzero(network.inside)),
        "floaters": network.floaters,
        "slivers": network.slivers,
        "smallest_pore": smallest_pore(apertures, network.inside),
        "idle_traces": np.asarray(np.count_nonzero(apertures.trace_acts == 0)),
        "parted_pipes": _parted(network, stress),
    }


def _pores_per_well(network: Network, controls: Controls) -> np.ndarray:
    """Diameter of each well over the spacing of the pores around it, (wells,)."""
    wells = controls.drilled
    spacing = [spacing_around(network, well.at, well.radius) for well in wells]
    return np.array([2.0 * w.radius / h for w, h in zip(wells, spacing, strict=True)])


def _stressed(
    stress: StressState, region: Region, wanted: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """How grains stand under the stress."""
    found = {
        "stress_achieved": stress.stress,
        "unbalanced_ratio": stress.unbalanced_ratio,
        "broken_bonds": stress.broken_bonds,
        "static_solver": stress.static,
        "mechanical_steps": stress.steps,
        "tension_cracks": np.asarray(np.count_nonzero(stress.crack_mode == 1)),
        "shear_cracks": np.asarray(np.count_nonzero(stress.crack_mode == 2)),
        "joint_contacts": np.asarray(np.count_nonzero(~np.isnan(stress.joint_gap))),
        "idle_joints": stress.idle_joints,
    }
    return found | _chains(stress, region) if "force_chains" in wanted else found


def _overlap(stress: StressState | None, tested: StrengthTest | None) -> dict[str, np.ndarray]:
    """Largest overlap of grains that bear a load."""
    told = [state.largest_overlap for state in (stress, tested) if state is not None]
    return {"loaded_overlap": np.max(told)} if told else {}


def _elastic(moduli: Moduli) -> dict[str, np.ndarray]:
    """Elastic constants of the slice, and of the rock whose slice in plane strain shows them."""
    from demflow.model.mechanics.static.moduli import in_plane_strain

    youngs_modulus, poissons_ratio = float(moduli.youngs_modulus), float(moduli.poissons_ratio)
    rock_modulus, rock_ratio = in_plane_strain(youngs_modulus, poissons_ratio)
    return {
        "elastic_youngs_modulus": moduli.youngs_modulus,
        "elastic_poissons_ratio": moduli.poissons_ratio,
        "rock_youngs_modulus": np.asarray(rock_modulus),
        "rock_poissons_ratio": np.asarray(rock_ratio),
    }


def _chains(stress: StressState, region: Region) -> dict[str, np.ndarray]:
    """How contacts carry the stress, and what of it the region itself bears."""
    from demflow.model.mechanics.specimen.measures import force_chains, mean_stress

    forces = (stress.normal_force, stress.shear_force)
    contacts = (stress.x, stress.y, stress.contact_a, stress.contact_b, *forces)
    chain, tensor = force_chains(*contacts), mean_stress(region, *contacts)
    pressed = np.maximum(stress.normal_force, 0.0)
    return {
        "force_chains": np.asarray(chain.max(initial=-1) + 1),
        "chained_force_share": np.asarray(pressed[chain >= 0].sum() / max(pressed.sum(), 1e-300)),
        "region_stress": np.array([tensor[0, 0], tensor[1, 1], tensor[0, 1]]),
    }


def _coupled(
    consolidated: Consolidation | None,
    followed: Followed | None,
    fractured: Fracturing | None,
    stress: StressState | None,
    controls: Controls,
    loads: tuple[tuple[tuple[float, float], ...], ...],
    wanted: tuple[str, ...],
    coupled: tuple[str, str] | None,
) -> tuple[History | None, dict[str, np.ndarray]]:
    """The flow of a coupled rock, whichever way it was found, and what its grains did."""
    if fractured is not None:
        return marched(fractured, controls), _fractured(fractured, controls, wanted)
    names = ("coupling_used", "coupling_reason")
    found = dict(zip(names, map(np.asarray, coupled), strict=True)) if coupled is not None else {}
    if consolidated is not None:
        found |= _strained(consolidated, stress, controls, loads, wanted)
        return superposed(consolidated.flow, controls, loads), found
    if followed is not None and stress is not None:
        found |= _closed(followed, stress, len(controls.times), wanted)
        return _marched(followed, controls), found
    return None, found


def _strained(
    consolidated: Consolidation,
    stress: StressState | None,
    controls: Controls,
    loads: tuple[tuple[tuple[float, float], ...], ...],
    wanted: tuple[str, ...],
) -> dict[str, np.ndarray]:
    """How far the walls went, and the effective stress, in time."""
    found = {}
    if "wall_displacement" in wanted:
        found["wall_displacement"] = superposed_record(
            consolidated.wall, consolidated.initial_wall, consolidated.flow.lag, controls, loads
        )
    if "effective_stress" in wanted:
        change = superposed_record(
            consolidated.stress, consolidated.initial_stress, consolidated.flow.lag, controls, loads
        )
        before = np.zeros(3) if stress is None else stress.stress
        found["effective_stress"] = before[:, None] + change
    return found


def _fractured(
    fractured: Fracturing, controls: Controls, wanted: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """What broke, how far the crack went and what that took."""
    from demflow.model.coupling.skeleton import SLID

    kept, events = fractured.records, fractured.events
    found = {
        "event_time": events.time,
        "event_x": events.x,
        "event_y": events.y,
        "event_mode": events.mode.astype(float),
        "event_energy": events.energy,
        "event_pore": events.pore.astype(float),
        "broken_bonds": np.asarray(np.count_nonzero(events.mode != SLID)),
        "tension_cracks": np.asarray(np.count_nonzero(events.mode == 1)),
        "shear_cracks": np.asarray(np.count_nonzero(events.mode == 2)),
    }
    if stopped := str(fractured.state.stopped):
        found[STOPPED] = np.asarray(stopped)
    if "well_pressure" in wanted and np.isfinite(fractured.highest).all():
        found["highest_well_pressure"] = fractured.highest
    if not len(events.time):
        found = {name: array for name, array in found.items() if not name.startswith("event_")}
    if set(wanted) & set(OF_BREAKING):
        found |= {
            "loose_grains": fractured.loose,
            "unbalanced_ratio": fractured.off,
            "breaking_factorisations": fractured.factored,
            "breaking_solves": fractured.solved,
        }
        last = kept.energies[-1] if len(kept.energies) else np.zeros(6)
        names = ("work_put_in", "viscous_loss", "slip_loss", "energy_set_free")
        found |= dict(zip(names, np.asarray(last[:4]), strict=True))
        largest = np.abs(kept.energies[:, 0]).max() if len(kept.energies) else 0.0
        scale = 1.0 / largest if largest > 0.0 else 0.0
        found["energy_imbalance"] = np.asarray(scale * last[4])
        found["energy_jerks"] = np.asarray(scale * last[5])
    in_time = {"crack_length": kept.crack_length}
    if "injected_volume" in wanted:
        injected = kept.injected + kept.let_in[:, len(controls.side_pressures) :].sum(axis=-1)
        in_time |= {"injected_volume": injected, "leaked_volume": kept.leaked}
    if "joint_slip" in wanted:
        slips = ("joint_slip", "largest_joint_slip", "slid_joint_share")
        in_time |= dict(zip(slips, kept.slip.T, strict=True))
        found["slide_events"] = np.asarray(np.count_nonzero(events.mode == SLID))
    if "permeability_in_time" in wanted:
        in_time["permeability_in_time"] = kept.permeability
        found["permeability_at_start"] = fractured.permeability
    for name, array in in_time.items():
        if name != "crack_length" or name in wanted:
            found[name] = until(array, len(controls.times))
    return found


def _closed(
    followed: Followed, stress: StressState, times: int, wanted: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """What a rock whose apertures followed its forces did besides its flow."""
    kept = followed.records
    found = {
        "wall_displacement": until(kept.wall, times).T,
        "effective_stress": stress.stress[:, None] + until(kept.stress, times).T,
    }
    found = {name: value for name, value in found.items() if name in wanted}
    if found:
        found["kept_conductance"] = until(kept.kept_conductance, times)
    if stopped := str(followed.standing.stopped):
        found[STOPPED] = np.asarray(stopped)
    return found


def _marched(followed: Followed, controls: Controls) -> History:
    """The history of a rock whose apertures followed its forces; NaN after an early end."""
    kept, t, now = followed.records, len(controls.times), followed.standing
    rows = {name: until(getattr(kept, name), t).T for name in kept._fields}
    at_changes = pressures_at_changes(followed.at_changes, followed.change_time, controls)
    return History(
        times=np.asarray(controls.times),
        well_pressure=rows["well_pressure"],
        well_rate=rows["well_rate"],
        boundary_flow=rows["boundary_flow"],
        boundary_pressure=kept_pressures(controls, t),
        probe_pressure=rows["probe_pressure"],
        change_times=at_changes[0],
        pressure_at_changes=at_changes[1],
        volumes=Volumes(kept.stored, kept.let_in, kept.produced, kept.moved),
        probe_place=followed.probe_place,
        solved=Solved(
            residual=followed.residual,
            range_error=None,
            estimated_error=np.asarray(now.error),
            tolerance_met=np.asarray(float(not now.stopped)),
            isolated_domains=np.asarray(0),
            flow_balance_error=None,
            solver_used=np.asarray("coupled implicit"),
            solver_reason=np.asarray(
                f"apertures follow forces: {now.steps} steps, {now.factors} factors"
            ),
        ),
    )


def _described(traces: FractureNetwork) -> dict[str, np.ndarray]:
    """What the network of the fractures is, under the names of the dataset."""
    places = {"well_joined": traces.well_joined, "boundary_joined": traces.side_joined}
    return {
        **{f"network_{name}": getattr(traces, name) for name in NETWORK},
        **{name: joined for name, joined in places.items() if len(joined)},
        "connections_per_line": traces.connections,
        "joined_pairs": traces.joined_pairs,
        "fracture_flow_share": np.asarray(np.nan),  # until pressures are known
        "oda_permeability": traces.oda,
        "snow_permeability": traces.snow,
    }


def _share(traces: FractureNetwork, found: dict[str, np.ndarray], controls: Controls) -> np.ndarray:
    """Part of what flows in that fractures would carry alone, at the last time."""

    def last(name: str) -> np.ndarray:
        return found[name][:, -1] if controls.transient else found[name]

    pressure = np.concatenate([last("boundary_pressure"), last("well_pressure")])
    alone = np.maximum(traces.conductance @ pressure, 0.0).sum()
    inflow = np.concatenate([last("boundary_flow"), -last("well_rate")])
    moved = np.maximum(inflow, 0.0).sum()
    return np.asarray(alone / moved if moved > 0.0 else np.nan)


def smallest_pore(apertures: Apertures, inside: np.ndarray) -> np.ndarray:
    """The smallest volume that stores, of a pore or a piece of a fracture, over the mean pore's."""
    pores = apertures.volume[inside]
    return np.asarray(np.append(pores, apertures.node_volume).min() / pores.mean())


def _parted(network: Network, stress: StressState | None) -> np.ndarray:
    """Number of pipes of the region whose grains have parted under the stress."""
    if stress is None:
        return np.asarray(0)
    from demflow.model.network.apertures import pipe_contacts, pipe_gaps, with_feet

    stress = with_feet(network, stress)
    assert stress is not None
    inside = network.inside[network.pipe_from] | network.inside[network.pipe_to]
    gap = pipe_gaps(network, stress, pipe_contacts(network, stress))
    return np.asarray(np.count_nonzero(inside & (gap > 0.0)))


def observe_flow(history: History, controls: Controls) -> dict[str, np.ndarray]:
    """Well pressures and rates, boundary flows, probes and the balance of one case.

    A steady study has no time dimension.
    """
    found = {name: getattr(history, name) for name in IN_TIME}
    if not controls.transient:
        found = {name: array[:, 0] for name, array in found.items()}
    if len(history.probe_place):
        found["probe_place_x"], found["probe_place_y"] = history.probe_place.T
    volumes = history.volumes
    books = volumes.stored - volumes.let_in.sum(axis=1) + volumes.produced
    found["mass_balance_error"] = np.asarray(_over_moved(books, volumes))
    found["mass_imbalance"] = np.asarray(_over_moved(np.abs(books) + volumes.missing, volumes))
    found |= {name: v for name, v in history.solved._asdict().items() if v is not None}
    if history.limited is not None:
        found["well_limited"] = history.limited if controls.transient else history.limited[:, 0]
    return found | _changes(history, controls) if controls.transient else found


def flowed(
    history: History, traces: FractureNetwork | None, controls: Controls, wanted: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """What is observed of the flow, and what is asked for of what depends on it.

    Parameters
    ----------
    history : pressures and flows in time
    traces : the network of the fractures
    controls : rates and pressures of the case in time
    wanted : names of what is observed
    """
    found = observe_flow(history, controls) | _lowest(history)
    if traces is not None:
        found["fracture_flow_share"] = _share(traces, found, controls)
    return {k: v for k, v in found.items() if ASKED_FOR_BY.get(k) in (None, *wanted)}


def _lowest(history: History) -> dict[str, np.ndarray]:
    """The lowest pressure that is recorded or held, and whether no liquid bears it.

    Extremes lie at sources, by the maximum principle.
    """
    told = (history.well_pressure, history.probe_pressure, history.boundary_pressure)
    every = np.concatenate([pressure.ravel() for pressure in told])
    known = every[~np.isnan(every)]  # a probe that nothing reaches has no steady pressure
    if not known.size:
        return {}
    lowest = known.min()
    return {"lowest_pressure": lowest, "negative_pressure": np.asarray(float(lowest < 0.0))}


def _changes(history: History, controls: Controls) -> dict[str, np.ndarray]:
    """Pressure changes since the last change of each well's rate, and their derivatives."""
    times, pressure = history.times, history.well_pressure
    change, derivative = np.full_like(pressure, np.nan), np.full_like(pressure, np.nan)
    for k, well in enumerate(controls.drilled):
        if not well.held:
            felt = _felt_changes(controls.wells, k)
            starts, sign = flow_periods(felt)
            before = history.pressure_at_changes[k, np.searchsorted(history.change_times, starts)]
            change[k] = pressure_change(times, pressure[k], starts, before, sign)
            x = log_time(times, felt)
            derivative[k] = bourdet_derivative(times, change[k], starts, x=x)
    return {"pressure_change": change, "pressure_derivative": derivative}


def _felt_changes(wells: tuple[Terminal, ...], number: int) -> tuple[tuple[float, float], ...]:
    """Rate changes by which a well's pressure change is counted, as (s, m³/s).

    Its own; of one that never flows, which observes the others, those of their rates in sum.
    """
    own = wells[number].rate_changes
    if any(rate != 0.0 for _, rate in own):
        return own
    others = [well.rate_changes for well in wells if not well.held]
    times = sorted({time for changes in others for time, _ in changes})

    def rate_at(time: float, changes: tuple[tuple[float, float], ...]) -> float:
        return next((rate for start, rate in reversed(changes) if start <= time), 0.0)

    return tuple((time, sum(rate_at(time, changes) for changes in others)) for time in times)


def _over_moved(volume: np.ndarray, volumes: Volumes) -> float:
    """Largest of some volumes over the volume moved; 0 where nothing moves."""
    counts = volumes.moved != 0.0  # what is not a number counts
    return float(np.max(np.abs(volume)[counts] / volumes.moved[counts], initial=0.0))
