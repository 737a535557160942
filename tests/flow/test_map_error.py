"""Tolerance of maps: an error counts against the map, whatever the wells do."""

import numpy as np
import pytest

from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.registry import SOLVERS
from tests.diffusion import well_problem

CONTROLLED = [name for name, s in SOLVERS.items() if s.transient and s.controls_error]


@pytest.mark.slow
@pytest.mark.parametrize("method", CONTROLLED)
@pytest.mark.parametrize("source", [0, 1], ids=["side", "well"])
@pytest.mark.parametrize("first", [3.0, 100.0])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-7])
def test_maps_keep_the_tolerance_before_much_has_moved(tolerance, first, source, method):
    """A well that stores nothing drops at once, far more than the pores around it at first."""
    plain = well_problem(600, seed=1)
    problem = plain._replace(
        lag=first * step_limit(plain.system) * np.geomspace(1.0, 10.0, 11),
        active=np.arange(2) == source,
        domain=plain.system.domain,
        tolerance=tolerance,
    )
    run = SOLVERS[method].run
    found, exact = (
        run(p).pressure[source] for p in (problem, problem._replace(tolerance=1e-3 * tolerance))
    )
    assert np.abs(found - exact).max() <= 3.0 * tolerance * np.abs(exact).max()
