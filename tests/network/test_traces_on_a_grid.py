"""Fractures open and tight in random packings against a fine grid that shares nothing with them."""

import numpy as np
import pytest

from tests.benchmarks.pressures_of_the_2018_benchmark import CASES, modelled, on_a_grid, rms
from tests.traces_on_a_grid import solved

pytestmark = pytest.mark.usefixtures("packed_once")

NONE = np.empty((0, 4))


def test_a_barrier_across_the_grid_is_in_series():
    """One length of rock and a barrier worth another: half of the drop at the barrier."""
    barrier = np.array([[0.5, -0.1, 0.5, 1.1]])
    grid = solved(61, NONE, 0.0, barrier, 1.0, ("left", "right"), (1.0, 0.0))
    found = grid.at(np.array([[0.25, 0.3], [0.75, 0.8]]))
    np.testing.assert_allclose(found, [0.875, 0.125], atol=1e-9)


def test_an_oblique_trace_from_side_to_side_carries_its_own():
    """A trace along a uniform gradient changes no pressure; one across it has none of its own."""
    along = np.array([[0.0, 0.53, 1.0, 0.53]])
    across = np.array([[0.37, 0.0, 0.37, 1.0]])
    for line in (along, across):
        grid = solved(40, line, 5.0, NONE, 1.0, ("left", "right"), (1.0, 0.0))
        rows = np.linspace(1.0, 0.0, 41)[:, None]
        np.testing.assert_allclose(grid.pressure, np.broadcast_to(rows, (41, 41)), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_pressures_along_lines_of_the_benchmark_s_networks(name):
    """With 2,000 grains within 3 % of the drop; a check tells how far 20,000 come."""
    off = [rms(p, q) for p, q in zip(modelled(name, 5, 2_000), on_a_grid(name, 151), strict=True)]
    assert max(off) < 0.03
