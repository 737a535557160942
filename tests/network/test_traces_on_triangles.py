"""Triangles that follow traces against closed forms and a grid that does not follow them."""

import numpy as np
import pytest

from tests.traces_on_a_grid import solved
from tests.traces_on_triangles import flow

OBLIQUE = np.array([[0.2, 0.3, 0.7, 0.8], [0.3, 0.7, 0.8, 0.35], [0.55, 0.1, 0.55, 0.9]])


def test_rock_alone_and_traces_along_the_flow_conduct_side_by_side():
    """3 wide and 2 high: 2/3; with traces of transmissivity 5 from side to side 5/3 each more."""
    along = np.array([[0.0, 0.4, 3.0, 0.4], [0.0, 1.3, 3.0, 1.3]])
    across = np.array([[1.1, 0.0, 1.1, 2.0]])
    args = (0.05, 0.3, 0.3)
    assert flow(3.0, 2.0, np.empty((0, 4)), 5.0, *args) == pytest.approx(2 / 3, rel=1e-12)
    assert flow(3.0, 2.0, along, 5.0, *args) == pytest.approx(4.0, rel=1e-12)
    assert flow(3.0, 2.0, across, 5.0, *args) == pytest.approx(2 / 3, rel=1e-12)
    crossing = np.concatenate([along, across])
    assert flow(3.0, 2.0, crossing, 5.0, *args) == pytest.approx(4.0, rel=1e-12)


def test_finer_triangles_dissipate_less_and_settle():
    """Flow falls towards the true one, the singular tips included."""
    every = [flow(1.0, 1.0, OBLIQUE, 4.0, h, 0.3, 0.1) for h in (0.04, 0.01, 0.0025)]
    assert every[0] > every[1] > every[2]
    assert every[0] - every[1] > 2.0 * (every[1] - every[2])
    assert every[1] == pytest.approx(every[2], rel=2e-3)


def test_squares_that_do_not_follow_the_traces_tend_to_the_same():
    """First order: twice the finer less the coarser."""
    found = []
    for n in (101, 201):
        held = ("left", "right")
        p = solved(n, OBLIQUE, 4.0, np.empty((0, 4)), 0.0, held, (1.0, 0.0)).pressure
        share = np.ones(n + 1)
        share[[0, -1]] = 0.5
        found.append(float((p[0] - p[1]) @ share))
    triangles = flow(1.0, 1.0, OBLIQUE, 4.0, 0.002, 0.2, 0.05)
    assert 2.0 * found[1] - found[0] == pytest.approx(triangles, rel=5e-3)
