"""The measured error in time."""

import numpy as np
import pytest

from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.flow.solvers.time_error import REFERENCE_METHOD, REFERENCE_TOLERANCE
from demflow.model.region import Rectangle
from demflow.model.scene import Well
from tests.diffusion import relative_error, step_error, well_pressure, well_problem
from tests.reservoirs import exact_response, reservoir
from tests.rocks import square_lattice

ROCK = reservoir(square_lattice(1.3, 0.05, (0.05, 0.05)), Rectangle(2.0, 1.4))
WELL = (Well(name="w", at=(0.1, 0.1), radius=0.12, rate=1.0),)
SYSTEM = ROCK.assembled((), ("left",))
TIMES = tuple(np.geomspace(3, 3e4, 9) * step_limit(SYSTEM))
EXACT = ROCK.respond(WELL, ("left",), TIMES, tolerance=REFERENCE_TOLERANCE)


def error(found, flows=True):
    return step_error(found, EXACT, EXACT.lag, fixed=1, wells=1, flows=flows)


def test_the_reference_is_the_exact_solution():
    """A dense eigen-solution in its place would find the same errors, to its own round-off."""
    system = ROCK.assembled((), ("left",))
    alone = ROCK.respond((), ("left",), TIMES, tolerance=REFERENCE_TOLERANCE)
    dense = exact_response(system, 0, alone.lag)
    node = system.node_of_domain[alone.domain]
    np.testing.assert_allclose(alone.pressure[0], dense[:, node], atol=3 * REFERENCE_TOLERANCE)


@pytest.mark.parametrize("contrast", [5800.0, 1e5])  # at 1e6 dense vectors are 7e-10 off
def test_the_reference_is_exact_for_a_well_beside_a_fracture(contrast):
    problem = well_problem(300, contrast=contrast, decades=5.0, times=21)
    found = SOLVERS[REFERENCE_METHOD].run(problem._replace(tolerance=REFERENCE_TOLERANCE))
    dense = exact_response(problem.system, 1, problem.lag)[:, problem.system.pores]
    assert found.time_error <= REFERENCE_TOLERANCE
    assert relative_error(well_pressure(found), dense) <= 3 * REFERENCE_TOLERANCE


def test_nothing_differs_from_itself():
    assert error(EXACT) == 0.0


@pytest.mark.parametrize("size", [1e-2, 1e-7])
def test_an_error_of_the_well_is_relative_to_its_own_pressure_change(size):
    output = EXACT.output.copy()
    output[1, 1, 0] *= 1 + size  # the first time, at which the change is smallest
    found = EXACT._replace(output=output)
    assert error(found) == pytest.approx(size, rel=1e-6)


def test_flows_count_where_they_are_asked_for():
    output = EXACT.output.copy()
    output[0, -1, 1] += 0.1 * np.abs(output[0, 1:, 1]).max()
    found = EXACT._replace(output=output)
    assert error(found, flows=False) == 0.0
    assert error(found) == pytest.approx(0.1)


def test_what_is_no_number_is_no_small_error():
    pressure = EXACT.pressure.copy()
    pressure[1, -1, 3] = np.nan
    assert error(EXACT._replace(pressure=pressure), flows=False) == np.inf


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_solvers_keep_their_tolerance_by_it(tolerance):
    for method in ("krylov", "implicit"):
        found = ROCK.respond(WELL, ("left",), TIMES, method=method, tolerance=tolerance)
        assert error(found) <= 3 * tolerance
