"""The history of a case: what is superposed is what a march through the schedule gives."""

from typing import NamedTuple

import numpy as np

from demflow.model.controls import Controls, sites
from demflow.model.flow.equation.sites import change_times
from demflow.model.flow.equation.system import System
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.history import History, Volumes, superposed
from demflow.model.network.domains import domains_at
from demflow.model.observe import observe_flow
from demflow.model.region import Rectangle
from demflow.model.scene import Probe, Well
from tests.reservoirs import dense_matrices, reservoir
from tests.rocks import random_graph

GRAPH = random_graph(1.2, 300, 5)
ROCK = reservoir(GRAPH._replace(radius=0.5 * GRAPH.radius), Rectangle(2.0, 1.4), 2e-5)
LIMIT = step_limit(ROCK.assembled((), ("left",)))
START, SIDE, HELD = 3e6, 5e6, 2.5e6
FIXED = np.array([SIDE - START, HELD - START])  # in the order of the sources
WELLS = (
    Well(name="held", at=(0.6, -0.4), radius=0.08, pressure=HELD),
    Well(name="steps", at=(0.1, 0.2), radius=0.1, schedule=((0.0, 2e-6), (900 * LIMIT, -1e-6))),
    Well(name="late", at=(-0.5, -0.3), radius=0.1, schedule=((400 * LIMIT, 1e-6),)),
)
CHANGES = change_times(sites(WELLS))
PROBED = int(domains_at(ROCK.network, np.array([(-0.1, 0.4)]))[0])
PROBES = (Probe("one", (float(ROCK.network.x[PROBED]), float(ROCK.network.y[PROBED]))),)
TIMES = tuple(np.geomspace(100, 1e4, 25) * LIMIT)
CONTROLS = Controls(START, START, (SIDE,), WELLS, TIMES, True)


class Moment(NamedTuple):
    pressure: np.ndarray  # (n,) Pa above the start, of all unknowns
    passed: np.ndarray  # (n,) its integral in time, Pa s
    rates: np.ndarray  # (2,) m³/s, those that led to it
    produced: np.ndarray  # (2,) m³ by each well at a rate, those that inject below zero
    moved: float  # m³, by both


def marched(system: System) -> dict[float, Moment]:
    """From change to change by the dense exponential of the whole case; nothing superposed."""
    matrix, storage = dense_matrices(system)
    m, root = system.pores, np.sqrt(storage)
    shut = np.linalg.inv(matrix[m:, m:])
    reduced = matrix[:m, :m] - matrix[:m, m:] @ shut @ matrix[m:, :m]
    decay, modes = np.linalg.eigh(reduced / np.outer(root, root))
    sources = np.array([system.source(k) for k in range(4)])
    state, now = np.zeros(m), 0.0
    last = Moment(np.zeros(system.n), np.zeros(system.n), np.zeros(2), np.zeros(2), 0.0)
    moments = {}
    for then in np.unique([*TIMES, *CHANGES]):
        rates = np.array(
            [next((q for t, q in w.rate_changes[::-1] if t <= now), 0.0) for w in WELLS[1:]]
        )
        put, span = np.concatenate([FIXED, rates]) @ sources, then - now
        force = modes.T @ ((put[:m] - matrix[:m, m:] @ shut @ put[m:]) / root)
        later = state * np.exp(-decay * span) - force * np.expm1(-decay * span) / decay
        inside = modes @ later / root
        passed = modes @ ((force * span + state - later) / decay) / root
        last = Moment(
            np.append(inside, shut @ (put[m:] - matrix[m:, :m] @ inside)),
            last.passed + np.append(passed, shut @ (put[m:] * span - matrix[m:, :m] @ passed)),
            rates,
            last.produced + rates * span,
            last.moved + np.abs(rates).sum() * span,
        )
        if then == 0.0:  # before it, nothing has acted
            last = last._replace(pressure=np.zeros(system.n))
        moments[then], state, now = last, later, then
    return moments


def history_of(system: System, moments: dict[float, Moment], like: History) -> History:
    """The history that a march has recorded; `like` says how well the flow was solved."""
    _, storage = dense_matrices(system)
    rows = [moments[t] for t in TIMES]

    def let_in(pressure: np.ndarray, end: np.ndarray) -> list[float]:
        own = [system.fixed_source == k for k in range(2)]
        return [
            system.fixed_g[o] @ (end[k] - pressure[system.fixed_node[o]]) for k, o in enumerate(own)
        ]

    def wells(times) -> np.ndarray:
        found = np.array([moments[t].pressure[system.well_node] for t in times]).T
        return np.concatenate([np.full((1, len(times)), HELD), START + found])

    flows = np.array([let_in(row.pressure, FIXED) for row in rows]).T
    volumes = np.array([let_in(row.passed, FIXED * t) for row, t in zip(rows, TIMES, strict=True)])
    stored = np.array([storage @ row.pressure[: system.pores] for row in rows])
    moved = np.abs(volumes).sum(axis=1) + np.abs(stored) + [row.moved for row in rows]
    produced = np.array([row.produced.sum() for row in rows])
    node = system.node_of_domain[PROBED]
    return History(
        times=np.array(TIMES),
        well_pressure=wells(TIMES),
        well_rate=np.concatenate([-flows[1:], np.array([row.rates for row in rows]).T]),
        boundary_flow=flows[:1],
        boundary_pressure=like.boundary_pressure,
        probe_pressure=START + np.array([[row.pressure[node] for row in rows]]),
        change_times=CHANGES,
        pressure_at_changes=wells(CHANGES),
        volumes=Volumes(stored, volumes, produced, moved),
        solved=like.solved,
        probe_place=like.probe_place,
    )


def test_a_march_through_the_schedule_records_what_is_superposed():
    """Pressures, rates, flows and volumes; and all that is observed of the two agrees."""
    responses = ROCK.respond(WELLS, ("left",), TIMES, tolerance=1e-10, probes=PROBES)
    found = superposed(responses, CONTROLS)
    system = ROCK.assembled(sites(WELLS), ("left",))
    exact = history_of(system, marched(system), like=found)
    for name in ("times", "change_times"):
        np.testing.assert_array_equal(getattr(found, name), getattr(exact, name))
    flow, volume = np.abs(exact.well_rate).max(), exact.volumes.moved.max()
    for name, error in (
        ("well_pressure", 1e-7 * START),
        ("pressure_at_changes", 1e-7 * START),
        ("probe_pressure", 1e-7 * START),
        ("boundary_flow", 1e-6 * flow),
        ("well_rate", 1e-6 * flow),
    ):
        np.testing.assert_allclose(getattr(found, name), getattr(exact, name), atol=error, rtol=0)
    for mine, own in zip(found.volumes[:3], exact.volumes[:3], strict=True):
        np.testing.assert_allclose(mine, own, atol=1e-6 * volume, rtol=0)
    # each step of a rate moves a volume of its own
    assert np.all(found.volumes.moved >= (1 - 1e-6) * exact.volumes.moved)
    seen, right = observe_flow(found, CONTROLS), observe_flow(exact, CONTROLS)
    assert set(seen) == set(right)
    assert right["mass_balance_error"] < 1e-9
    for name in ("pressure_change", "pressure_derivative"):
        np.testing.assert_allclose(seen[name], right[name], atol=1e-6 * START, rtol=0)
