"""Measures of the balance: before it is mended, from flows alone, and where nothing flows."""

import numpy as np
import pytest

from demflow.model.controls import Controls
from demflow.model.flow.solvers import implicit as implicit_module
from demflow.model.flow.solvers import krylov as krylov_module
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.history import superposed, superposed_error
from demflow.model.observe import observe_flow
from demflow.model.region import Rectangle
from demflow.model.scene import Trace, Well
from tests.reservoirs import reservoir
from tests.rocks import random_graph

GRAPH = random_graph(1.2, 500, 7)
PACKING = GRAPH._replace(radius=0.5 * GRAPH.radius)
REGION = Rectangle(2.0, 1.4)
ROCK = reservoir(PACKING, REGION, 2e-5)
WELL = (Well(name="w", at=(0.1, 0.2), radius=0.1, rate=1e-6),)
SIDES = (("left", 3e5),)
TIMES = tuple(np.geomspace(10.0, 1e5, 21) * step_limit(ROCK.assembled((), ("left",))))
CONTROLS = Controls(1e5, 1e5, (3e5,), WELL, TIMES, True)


@pytest.mark.parametrize("method", ["explicit", "implicit", "krylov"])
def test_volume_balances_before_anything_is_mended(method):
    seen = ROCK.observed(WELL, SIDES, 1e5, TIMES, method=method, tolerance=1e-3)
    assert seen["mass_imbalance"] <= 1e-10
    assert seen["flow_balance_error"] <= 3e-3


def test_a_solve_that_loses_volume_is_told_although_it_is_mended(monkeypatch):
    """A factor that is off by a millionth: the books are put right, what was missing is told."""
    exact = implicit_module.Ladder.factor

    def lossy(ladder, rung):
        factor = exact(ladder, rung)
        return factor._replace(pivot=factor.pivot / (1.0 + 1e-6))

    monkeypatch.setattr(implicit_module.Ladder, "factor", lossy)
    seen = ROCK.observed(WELL, SIDES, 1e5, TIMES, method="implicit", tolerance=1e-3)
    assert seen["mass_balance_error"] <= 1e-10
    assert seen["mass_imbalance"] >= 1e-6


def test_a_projection_that_loses_volume_is_told_although_it_is_mended(monkeypatch):
    exact = krylov_module.Subspace.close

    def lossy(space, noise):
        basis = exact(space, noise)
        return basis._replace(modes=basis.modes._replace(load=basis.modes.load * (1.0 + 1e-5)))

    monkeypatch.setattr(krylov_module.Subspace, "close", lossy)
    seen = ROCK.observed(WELL, SIDES, 1e5, TIMES, method="krylov", tolerance=1e-3)
    assert seen["mass_imbalance"] >= 1e-6


def test_recorded_flows_tell_stored_volume_that_is_wrong():
    """Bookkeeping that balances by itself does not hide it."""
    responses = ROCK.respond(WELL, ("left",), TIMES, tolerance=1e-6)
    sound = observe_flow(superposed(responses, CONTROLS), CONTROLS)
    assert sound["flow_balance_error"] <= 1e-6
    cumulative = responses.cumulative.copy()
    cumulative[0, 5:] *= 1.05  # what is stored and what was let in alike
    wrong = observe_flow(superposed(responses._replace(cumulative=cumulative), CONTROLS), CONTROLS)
    assert wrong["mass_balance_error"] <= 1e-10
    assert wrong["flow_balance_error"] >= 0.005


def test_nothing_flows_through_a_sealed_wall_and_nothing_is_out_of_balance():
    """Each side has its own pressure up to the wall; no measure compares round-off with itself."""
    wall = Trace(name="wall", start=(0.0, -0.8), end=(0.0, 0.8), transmissibility_multiplier=0.0)
    rock = reservoir(PACKING, REGION, 2e-5, (wall,))
    seen = rock.observed((), (("left", 3e5), ("right", 1e5)), 2e5, method="steady")
    assert seen["mass_balance_error"] == seen["mass_imbalance"] == 0.0
    assert seen["residual"] == 0.0
    np.testing.assert_array_equal(seen["boundary_flow"], 0.0)


def test_an_error_in_time_is_small_where_the_flow_has_died_away():
    """Times long after a side has filled the rock: what flows still is round-off, not an error."""
    late = tuple(np.geomspace(1e7, 1e9, 5) * step_limit(ROCK.assembled((), ("left",))))
    controls = Controls(1e5, 1e5, (3e5,), (), late, True)
    found, exact = (
        ROCK.respond((), ("left",), late, tolerance=tolerance) for tolerance in (1e-4, 1e-10)
    )
    assert superposed_error(found, exact, controls, flows=True)["time_error"] <= 1e-4
