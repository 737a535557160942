"""Marching chunk by chunk, several steps at a time, is marching step by step."""

import numpy as np
import pytest

from demflow.model.controls import sites
from demflow.model.flow.equation.algebraic import algebraic
from demflow.model.flow.solvers import stencil as module
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.stencil import driven, march, stencil
from demflow.model.region import Rectangle
from demflow.model.scene import Well
from tests.reservoirs import dense_matrices, reservoir
from tests.rocks import random_graph

SCATTER = random_graph(1.2, 900, 1)
ROCK = reservoir(SCATTER._replace(radius=0.5 * SCATTER.radius), Rectangle(2.0, 1.4))
WELLS = (
    Well(name="w", at=(-0.4, 0.1), radius=0.12, rate=1.0),
    Well(name="v", at=(0.5, -0.2), radius=0.02, rate=1.0),
)
SYSTEM = ROCK.assembled(sites(WELLS), ("left", "top"))


def marched(count, chunk, monkeypatch):
    """All unknowns and the integral after some steps of a unit of the first well."""
    monkeypatch.setattr(module, "CHUNK", chunk)
    wells, rhs = algebraic(SYSTEM), SYSTEM.source(SYSTEM.fixed_count)
    rows = stencil(SYSTEM, wells)
    p = np.zeros(SYSTEM.n)
    p[SYSTEM.pores :] = wells.direct(rhs)
    integral = np.zeros(SYSTEM.n)
    moved = driven(rows, rhs, SYSTEM)
    dt = step_limit(SYSTEM)
    p, _ = march(p, p.copy(), integral, count, dt, rows, moved, rhs[SYSTEM.pores :])
    unknowns = np.empty_like(p)
    unknowns[rows.order] = p
    return unknowns, integral, len(rows.start) - 1


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 40])
def test_chunks_and_waves_give_the_same_bits(count, monkeypatch):
    whole, integral, one = marched(count, 10**6, monkeypatch)
    parts, its_integral, several = marched(count, 1, monkeypatch)
    assert one == 1
    assert several > 3
    np.testing.assert_array_equal(parts, whole)
    np.testing.assert_array_equal(its_integral, integral)


def test_a_step_is_forward_euler(monkeypatch):
    """Against the dense matrix, wells balanced after each step."""
    found, _, _ = marched(9, 1, monkeypatch)
    matrix, storage = dense_matrices(SYSTEM)
    m, rhs, dt = SYSTEM.pores, SYSTEM.source(SYSTEM.fixed_count), step_limit(SYSTEM)
    p = np.zeros(SYSTEM.n)
    for step in range(10):
        if step:
            p[:m] += dt * (rhs - matrix @ p)[:m] / storage
        p[m:] = np.linalg.solve(matrix[m:, m:], rhs[m:] - matrix[m:, :m] @ p[:m])
    np.testing.assert_allclose(found, p, rtol=1e-11, atol=1e-13 * np.abs(p).max())


def test_neighbours_and_wells_span_two_chunks_at_most(monkeypatch):
    monkeypatch.setattr(module, "CHUNK", 1)
    rows = stencil(SYSTEM, algebraic(SYSTEM))
    chunk = np.searchsorted(rows.start, np.arange(SYSTEM.pores), side="right") - 1
    assert np.abs(chunk[rows.near] - chunk[:, None]).max() <= 1
    for well in range(len(WELLS)):
        around = chunk[rows.well_pore[rows.well == well]]
        assert rows.well_chunk[well] == around.max()
        assert np.ptp(around) <= 1
