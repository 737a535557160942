"""Laws of diffusion on any graph, for every solver of the registry.

Graphs, conductances over six decades, storages and wells are drawn at random, straight into
the flow equation, so that nothing of geometry helps.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.problem import Answer, Problem
from demflow.model.flow.equation.system import System
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.registry import SOLVERS
from tests.flow.bounds import OFF
from tests.reservoirs import dense_matrices

pytestmark = pytest.mark.slow

every = pytest.mark.parametrize("method", SOLVERS)
transient = pytest.mark.parametrize("method", [m for m, s in SOLVERS.items() if s.transient])
LAGS = np.geomspace(100.0, 3000.0, 5)  # in units of the explicit step
TOLERANCE = 1e-8
# all laws see the same graphs, so that each is solved once for all of them
few = settings(max_examples=15)
cases = given(drawn=st.tuples(st.integers(0, 10**6), st.integers(3, 40), st.booleans()))
same = seed(2)


def graph(number: int, n: int, stores: bool = False, held: int = 2) -> System:
    """A connected graph of pores, `held` fixed pressures, and two wells, one of which may store."""
    rng = np.random.default_rng(number)
    i = np.concatenate([np.arange(1, n), rng.integers(0, n, n)])
    j = np.concatenate([[rng.integers(0, k) for k in range(1, n)], rng.integers(0, n, n)])
    i, j = i[i != j], j[i != j]
    wells = np.array([n, n + 1])
    beside = rng.choice(n, (2, 2))
    i = np.concatenate([i, np.repeat(wells, 2)]).astype(np.int64)
    j = np.concatenate([j, beside.ravel()]).astype(np.int64)
    storage = 10 ** rng.uniform(-1, 1, n + 2)
    storage[n:] = [3.0 if stores else 0.0, 0.0]
    return System(
        domain=np.arange(n),
        n=n + 2,
        storage=storage,
        edge_i=i,
        edge_j=j,
        edge_g=10 ** rng.uniform(-3, 3, len(i)),
        fixed_node=rng.integers(0, n, 2 * held),
        fixed_source=np.tile(np.arange(held), 2),
        fixed_g=10 ** rng.uniform(-2, 2, 2 * held),
        short_a=np.empty(0, dtype=np.int64),
        short_b=np.empty(0, dtype=np.int64),
        short_g=np.empty(0),
        sides=tuple(f"side {k}" for k in range(held)),
        pressure_wells=(),
        rate_wells=(0, 1),
        well_node=wells,
        node_of_domain=np.arange(n),
        source_of_domain=np.full(n, -1),
        isolated=0,
        initial=np.empty((0, n + 2)),
    )


def respond(method: str, system: System, lag: np.ndarray | None = None) -> Answer:
    """Step responses of every source."""
    if not SOLVERS[method].transient:
        lag = np.array([math.inf])
    elif lag is None:
        lag = LAGS * step_limit(system)
    return SOLVERS[method].run(
        Problem(
            system=system,
            records=outputs(system, np.empty(0, dtype=np.int64)),
            lag=lag,
            active=np.ones(system.source_count, dtype=bool),
            domain=np.arange(len(system.domain)),
            tolerance=TOLERANCE,
            safety_factor=0.5,
        )
    )


@cache
def answered(method: str, drawn: tuple[int, int, bool]) -> Answer:
    """Step responses of the graph that was drawn."""
    return respond(method, graph(*drawn))


def largest(values: np.ndarray) -> np.ndarray:
    """Largest magnitude for each source."""
    return np.abs(values).max(axis=(1, 2), keepdims=True)


@every
@same
@cases
@few
def test_no_pressure_leaves_the_range_of_what_drives_it(method, drawn):
    found = answered(method, drawn)
    slack = 1e-12 if method == "explicit" else OFF[method].laws
    assert found.pressure[:2].min() >= -slack
    assert found.pressure[:2].sum(axis=0).max() <= 1 + 2 * slack
    assert np.all(found.pressure[2:] <= slack * largest(found.pressure[2:]))


@every
@same
@cases
@few
def test_pressures_come_to_their_steady_state_from_one_side(method, drawn):
    found, rest = answered(method, drawn), answered("steady", drawn)
    scale = largest(rest.pressure)
    way = np.abs(found.pressure) / scale
    assert np.all(np.diff(way, axis=1) >= -OFF["krylov"].laws)
    assert np.all(way <= np.abs(rest.pressure) / scale + OFF["krylov"].laws)


@every
@same
@cases
@few
def test_observer_and_well_may_be_swapped(method, drawn):
    found = answered(method, drawn)
    scale = np.abs(found.output[2, :, 0]).max()
    np.testing.assert_allclose(
        found.output[2, :, 1], found.output[3, :, 0], atol=OFF["krylov"].laws * scale
    )
    # what a side's pressure does to a well is the share of the well's rate that the side feeds
    shares, raised = found.output[2:, :, 2:4], found.output[:2, :, :2]
    np.testing.assert_allclose(shares, raised.transpose(2, 1, 0), atol=20 * OFF["krylov"].laws)


@every
@same
@cases
@few
def test_numbers_of_domains_do_not_matter(method, drawn):
    system, n = graph(*drawn), drawn[1]
    place = np.append(np.random.default_rng(drawn[0] + 1).permutation(n), [n, n + 1])
    order = np.random.default_rng(drawn[0] + 2).permutation(len(system.edge_i))
    storage = np.empty(n + 2)
    storage[place] = system.storage
    other = system._replace(
        storage=storage,
        edge_i=place[system.edge_j][order],  # the direction of an edge is of no meaning either
        edge_j=place[system.edge_i][order],
        edge_g=system.edge_g[order],
        fixed_node=place[system.fixed_node],
    )
    lag = LAGS * step_limit(system)
    one, two = answered(method, drawn), respond(method, other, lag)
    np.testing.assert_allclose(
        two.pressure[:, :, place[:n]] / largest(one.pressure),
        one.pressure / largest(one.pressure),
        atol=OFF["krylov"].laws,
    )


@every
@same
@cases
@few
def test_time_and_pressure_scale_with_storage_and_conductance(method, drawn):
    """C ↦ a C, G ↦ b G: the same at times a/b, rates' pressures over b (compressibility, 1/μ)."""
    system = graph(*drawn)
    a, b = 7.0, 0.03
    other = system._replace(
        storage=a * system.storage, edge_g=b * system.edge_g, fixed_g=b * system.fixed_g
    )
    lag = LAGS * step_limit(system)
    one, two = answered(method, drawn), respond(method, other, lag * a / b)
    scale = largest(one.pressure)
    np.testing.assert_allclose(two.pressure[:2], one.pressure[:2], atol=OFF["krylov"].laws)
    np.testing.assert_allclose(
        b * two.pressure[2:] / scale[2:], one.pressure[2:] / scale[2:], atol=OFF["krylov"].laws
    )


@every
@same
@cases
@few
def test_wells_at_one_place_add_their_rates(method, drawn):
    """Superposition: a load is the sum of its parts, here a well's of the pores beside it.

    The second well stores nothing, so that a rate of it is a rate of its neighbours, shared by
    their conductances, and a fall of its own pressure.
    """
    system, n = graph(*drawn), drawn[1]
    found = answered(method, drawn)
    at_well = system.edge_i == n + 1
    g, beside = system.edge_g[at_well], system.edge_j[at_well]
    pressure = found.pressure[:, :, beside] @ g / g.sum()
    pressure[3] -= 1.0 / g.sum()
    scale = np.abs(found.output[:, :, 1]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(
        pressure / scale, found.output[:, :, 1] / scale, atol=OFF["krylov"].laws
    )


@transient
@same
@cases
@few
def test_agrees_with_the_matrix_exponential(method, drawn):
    """p = (1 − e^(−C⁻¹G t)) G⁻¹f, by scipy's dense expm of the pores without the wells."""
    system, n = graph(*drawn), drawn[1]
    found = answered(method, drawn)
    matrix, storage = dense_matrices(system)
    m = system.pores
    shut = np.linalg.inv(matrix[m:, m:])
    reduced = matrix[:m, :m] - matrix[:m, m:] @ shut @ matrix[m:, :m]
    for source in range(system.source_count):
        rhs = system.source(source)
        rest = np.linalg.solve(reduced, rhs[:m] - matrix[:m, m:] @ (shut @ rhs[m:]))
        for k, t in enumerate(LAGS * step_limit(system)):
            p = rest - expm(-reduced * t / storage[:, None]) @ rest
            scale = np.abs(rest).max()
            np.testing.assert_allclose(
                found.pressure[source, k], p[:n], atol=OFF[method].laws * scale
            )


@cache
def by_scipy(seed: int, source: int):
    """A network with a well that stores, one that does not, and no outlet: by `solve_ivp`.

    Radau, 1e-9; the network, its lags, the pressures of what stores, and those of the other well.
    """
    system = graph(seed, 25, stores=True, held=0)
    lag = LAGS * step_limit(system)
    matrix, storage = dense_matrices(system)
    m = system.pores
    shut = np.linalg.inv(matrix[m:, m:])
    reduced = (matrix[:m, :m] - matrix[:m, m:] @ shut @ matrix[m:, :m]) / storage[:, None]
    rhs = system.source(source)
    load = (rhs[:m] - matrix[:m, m:] @ (shut @ rhs[m:])) / storage
    peer = solve_ivp(
        lambda _t, p: load - reduced @ p,
        (0.0, lag[-1]),
        np.zeros(m),
        method="Radau",
        t_eval=lag,
        rtol=1e-9,
        atol=1e-9 * lag[-1] / storage.sum(),
        jac=-reduced,
    )
    p = peer.y.T
    return system, lag, p, (rhs[m:] - p @ matrix[:m, m:]) @ shut.T


@pytest.mark.parametrize("seed", range(3))
@transient
def test_agrees_with_scipy_s_integrator(method, seed):
    system, lag, *_ = by_scipy(seed, 0)
    found = respond(method, system, lag)
    for source in range(2):
        _, _, p, wells = by_scipy(seed, source)
        scale = np.abs(p).max()
        np.testing.assert_allclose(found.pressure[source], p[:, :25], atol=OFF[method].laws * scale)
        own = p[:, 25] if source == 0 else wells[:, 0]
        np.testing.assert_allclose(
            found.output[source, :, source], own, atol=OFF[method].laws * scale
        )
