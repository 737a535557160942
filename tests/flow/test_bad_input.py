"""What no solver can answer is said before time is spent, with what to do instead."""

import math

import numpy as np
import pytest

from demflow.model.controls import sites
from demflow.model.flow.solvers.registry import SOLVERS, flow
from demflow.model.outcome import ModelError
from demflow.model.region import Rectangle
from demflow.model.scene import Solver, Trace, Well
from tests.reservoirs import reservoir
from tests.rocks import random_graph

REGION = Rectangle(2.0, 1.4)
ROCK = reservoir(random_graph(1.2, 200, 3), REGION, 2e-5)
WELL = Well(name="w", at=(0.3, 0.2), radius=0.1, rate=1.0)
every = pytest.mark.parametrize("method", SOLVERS)


def ask(rock=ROCK, wells=(WELL,), sides=("left",), **more):
    given = {"bulk_modulus": rock.bulk_modulus, "method": "krylov", "times": (1.0, 2.0)} | more
    if not SOLVERS.get(given["method"], SOLVERS["krylov"]).transient and "times" not in more:
        given["times"] = ()
    return flow(
        rock.network,
        rock.apertures,
        region=REGION,
        wells=sites(wells),
        sides=sides,
        active=(True,) * (len(sides) + len(wells)),
        probes=(),
        tolerance=given.pop("tolerance", 1e-4),
        safety_factor=given.pop("safety_factor", 0.9),
        record_map=False,
        **given,
    )


@every
@pytest.mark.parametrize("name", ["conductance", "cut_conductance", "volume"])
@pytest.mark.parametrize("value", [math.nan, -1.0, math.inf])
def test_a_network_of_wrong_numbers(method, name, value):
    wrong = getattr(ROCK.apertures, name).copy()
    wrong[3] = value
    rock = ROCK._replace(apertures=ROCK.apertures._replace(**{name: wrong}))
    with pytest.raises(ModelError, match=r"number 3.*apertures"):
        ask(rock, method=method)


@every
def test_a_network_without_any_storage(method):
    nothing = ROCK.apertures._replace(volume=np.zeros_like(ROCK.apertures.volume))
    with pytest.raises(ModelError, match="stores fluid"):
        ask(ROCK._replace(apertures=nothing), method=method)
    with pytest.raises(ModelError, match="bulk modulus"):
        ask(method=method, bulk_modulus=math.inf)


@every
@pytest.mark.parametrize("tolerance", [0.0, 2.0, 1.0, -1e-4, math.nan, 1e-16])
def test_a_tolerance_that_no_solver_keeps(method, tolerance):
    with pytest.raises(ModelError, match="tolerance"):
        ask(method=method, tolerance=tolerance)
    with pytest.raises(ValueError, match="tolerance"):
        Solver(tolerance=tolerance)


@pytest.mark.parametrize(
    "times", [(2.0, 1.0), (1.0, 1.0), (0.0, 1.0), (-1.0, 1.0), (1.0, math.nan), (1.0, math.inf)]
)
def test_times_that_do_not_increase(times):
    with pytest.raises(ModelError, match=r"times.*number [01] is"):
        ask(times=times)


@pytest.mark.parametrize("method", [m for m in SOLVERS if m != "explicit"])
def test_the_paper_s_step_of_another_solver_than_explicit(method):
    with pytest.raises(ValueError, match="paper is a step of method explicit"):
        Solver(method=method, step="paper")
    assert Solver(method="explicit", step="paper").step == "paper"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"method": "magic"}, "no solver magic, only .*krylov"),
        ({"method": "steady", "times": (1.0,)}, "steady has no times; leave them out"),
        ({"method": "krylov", "times": ()}, "krylov needs times; give some"),
        ({"safety_factor": 0.0}, "safety factor.*solver.safety_factor"),
        ({"bulk_modulus": 0.0}, "bulk modulus.*fluid.bulk_modulus"),
        ({"method": "auto", "step": "paper"}, "solver.method explicit, not of auto"),
        ({"safety_factor": math.nan}, "safety factor"),
    ],
)
def test_questions_that_contradict_themselves(more, message):
    with pytest.raises(ModelError, match=message):
        ask(**more)


@every
def test_a_well_in_a_part_that_touches_no_fixed_pressure(method):
    """Steady: an error that says so. Transient: its mean falls without end, in balance."""
    wall = (Trace(name="wall", transmissibility_multiplier=0.0, start=(0.0, -1.0), end=(0.0, 1.0)),)
    rock = reservoir(random_graph(1.2, 200, 3), REGION, 2e-5, wall)
    if not SOLVERS[method].transient:
        with pytest.raises(ModelError, match=r"no steady state.*boundary pressure"):
            ask(rock, method=method)
        return
    system = rock.assembled(sites((WELL,)), ("left",))
    right = rock.network.x[system.domain] > 0
    assert 0 < right.sum() < system.pores
    late = 3.0 * system.storage.sum() / system.edge_g.mean()
    found = ask(rock, method=method, times=(late, 2 * late))
    slope = np.diff(found.output[1, -2:, 0]) / late
    assert slope[0] == pytest.approx(-1 / system.storage[: system.pores][right].sum(), rel=1e-3)
