"""Wells whose pressure has limits or a schedule, and groups of wells with a common rate."""

import numpy as np
import pytest

from demflow.model.controls import Controls, sites, step_sizes
from demflow.model.history import superposed, superposed_map
from demflow.model.limited import settled
from demflow.model.outcome import ModelError
from demflow.model.region import Rectangle
from demflow.model.scene import Fluid, Grains, Inflow, Matrix, Scene, SceneError, Well
from demflow.model.stages import simulate
from tests.controlled import Exact, Limited
from tests.reservoirs import reservoir
from tests.rocks import random_graph

START, RATE = 1e7, 1e-6
ROCK = reservoir(random_graph(1.2, 400, 3), Rectangle(2.0, 2.0))
TIMES = tuple(np.geomspace(1e-2, 1e3, 21))
LIMIT = 9.72e6


def producer(**told):
    return Well(name="a", at=(0.1, 0.05), radius=0.1, **told)


def injector(**told):
    return Well(name="b", at=(-0.5, -0.35), radius=0.1, **told)


def controls(wells, left, times=TIMES):
    return Controls(START, START, (left,), wells, times, bool(times))


def both(wells, left=START):
    """What the model and the event-exact solution say: pressures, rates and switches."""
    responses = ROCK.respond(wells, ("left",), TIMES, tolerance=1e-7)
    told = controls(wells, left)
    history = superposed(responses, told)
    limits = [
        Limited(
            w.rate_changes,
            -np.inf if w.least_pressure is None else w.least_pressure,
            np.inf if w.largest_pressure is None else w.largest_pressure,
        )
        for w in wells
    ]
    system = ROCK.assembled(sites(wells), ("left",))
    exact = Exact(system, np.array([left]), START, limits).run(TIMES)
    return history, settled(responses, told, step_sizes(told)).switches, exact


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wells", "left"),
    [
        ((producer(rate=RATE, least_pressure=LIMIT),), START),
        ((producer(rate=RATE, least_pressure=LIMIT),), 1.22 * START),
        (
            (
                producer(
                    schedule=((0, RATE), (5.0, 0.2 * RATE), (20.0, 2 * RATE), (100.0, 0.0)),
                    least_pressure=LIMIT,
                ),
                injector(schedule=((0, 0), (3.0, -1.5 * RATE)), largest_pressure=1.014e7),
            ),
            START,
        ),
        (
            (
                producer(rate=RATE, least_pressure=9.9e6),
                injector(schedule=((0, 2 * RATE), (40.0, -0.5 * RATE))),
            ),
            START,
        ),
    ],
    ids=["takes over", "gives back by itself", "two wells", "shut by the other"],
)
def test_limits_take_over_and_give_back_when_the_exact_solution_does(wells, left):
    history, switches, (pressure, rate, exact) = both(wells, left)
    # where a rate comes back slowly, its error is one of the time many times as large
    np.testing.assert_allclose(switches, exact, rtol=1e-3)
    np.testing.assert_allclose(switches[0], exact[0], rtol=1e-6)
    assert len(exact) >= 1
    np.testing.assert_allclose(
        history.well_pressure, pressure, atol=1e-4 * np.abs(pressure - START).max()
    )
    np.testing.assert_allclose(history.well_rate, rate, atol=1e-4 * np.abs(rate).max())
    books = history.volumes
    off = books.stored - books.let_in.sum(axis=1) + books.produced
    assert np.abs(off).max() <= 1e-7 * books.moved.max()


def test_a_limit_that_is_never_met_changes_nothing():
    free = ROCK.respond((producer(rate=RATE),), ("left",), TIMES)
    told = (producer(rate=RATE, least_pressure=1e6),)
    bounded = ROCK.respond(told, ("left",), TIMES)
    plain = superposed(free, controls((producer(rate=RATE),), START))
    limited = superposed(bounded, controls(told, START))
    assert not limited.limited.any()
    np.testing.assert_allclose(limited.well_pressure, plain.well_pressure, rtol=1e-8)
    np.testing.assert_array_equal(limited.well_rate, plain.well_rate)


def test_at_a_limit_the_map_is_that_of_a_well_at_that_pressure():
    """Far above what the rock gives, the rate asked for is no matter: the limit holds at once."""
    wells = (producer(rate=1.0, least_pressure=9e6),)
    found = superposed_map(ROCK.respond(wells, ("left",), TIMES), controls(wells, START))
    held = (producer(pressure=9e6),)
    known = superposed_map(ROCK.respond(held, ("left",), TIMES), controls(held, START))
    np.testing.assert_allclose(found[5:], known[5:], atol=2e-4 * 1e6)


def test_a_steady_well_has_the_lower_of_both_rates():
    sides = (("left", 1.1 * START), ("right", START))
    free = ROCK.observed((producer(rate=RATE),), sides, method="steady")
    lowest = float(free["well_pressure"][0])
    for limit, limited in ((lowest - 1e4, 0.0), (lowest + 1e4, 1.0)):
        wells = (producer(rate=RATE, least_pressure=limit),)
        found = ROCK.observed(wells, sides, method="steady")
        assert found["well_limited"][0] == limited
        assert found["well_pressure"][0] == pytest.approx(max(limit, lowest), rel=1e-9)
        held = ROCK.observed((producer(pressure=max(limit, lowest)),), sides, method="steady")
        assert found["well_rate"][0] == pytest.approx(held["well_rate"][0], rel=1e-7)


def test_a_well_that_could_only_turn_round_is_shut():
    wells = (producer(rate=RATE, least_pressure=1.5 * START),)
    history = superposed(ROCK.respond(wells, ("left",), TIMES), controls(wells, START))
    np.testing.assert_array_equal(history.well_rate, 0.0)
    np.testing.assert_allclose(history.well_pressure, START, rtol=1e-12)
    assert history.limited.all()


@pytest.mark.slow
def test_a_group_has_one_pressure_and_the_sum_of_the_rates():
    wells = (producer(rate=RATE, group="g"), injector(rate=0.0, group="g"))
    responses = ROCK.respond(wells, ("left",), TIMES, tolerance=1e-8)
    history = superposed(responses, controls(wells, START))
    drop = START - history.well_pressure
    np.testing.assert_allclose(drop[0], drop[1], rtol=1e-9)
    np.testing.assert_allclose(history.well_rate.sum(axis=0), RATE, rtol=1e-9)
    assert np.all(history.well_rate[1] > 0.0)
    steady = ROCK.observed(wells, (("left", START),), method="steady")
    assert steady["well_pressure"][0] == pytest.approx(steady["well_pressure"][1], rel=1e-12)
    assert steady["well_rate"].sum() == pytest.approx(RATE, rel=1e-12)


@pytest.mark.slow
def test_a_group_shares_its_rate_whichever_of_its_wells_is_asked_for_it():
    def answered(*rates):
        wells = tuple(
            Well(name=f"w{k}", at=(4.0 * k - 5.0, 1.0), radius=0.1, rate=rate, group="g")
            for k, rate in enumerate(rates)
        )
        seen = simulate(
            Scene(
                region=Rectangle(20.0, 16.0),
                grains=Grains(count=300, porosity=0.17),
                matrix=Matrix(permeability=1e-13),
                fluid=Fluid(1e-3, 2e9),
                wells=wells,
                boundaries=(("left", START), ("top", Inflow(inflow=2e-6))),
                initial_pressure=START,
                times=tuple(np.geomspace(1.0, 1e5, 6)),
                observe=("well_pressure", "boundary_flow"),
            )
        )
        assert seen["mass_balance_error"] < 1e-9
        return seen

    even, one = answered(RATE, RATE, RATE), answered(0.0, 3.0 * RATE, 0.0)
    for name in ("well_pressure", "well_rate", "boundary_flow"):
        np.testing.assert_allclose(one[name], even[name], rtol=1e-9, atol=1e-15)
    assert np.all(one["well_rate"] > 0.0)
    crossing = answered(0.0, 0.0, 0.0)  # from the side with the inflow to the one at a pressure
    np.testing.assert_allclose(crossing["well_rate"].sum(axis=0), 0.0, atol=1e-15)
    assert np.ptp(crossing["well_pressure"], axis=0).max() < 1e-6 * START
    assert np.abs(crossing["well_rate"][:, -1]).max() > 0.01 * RATE


@pytest.mark.slow
@pytest.mark.parametrize("times", [(1e5,), (40.0, 7e3), tuple(np.geomspace(3.0, 2e5, 9))])
def test_volumes_balance_where_a_limit_decides_the_rate(times):
    told = ((0.0, 3.0 * RATE), (137.0, 2.2 * RATE), (911.0, 2.9 * RATE))
    seen = simulate(
        Scene(
            region=Rectangle(20.0, 16.0),
            grains=Grains(count=150, porosity=0.17),
            matrix=Matrix(permeability=1e-13),
            fluid=Fluid(1e-3, 2e9),
            wells=(producer(schedule=told, least_pressure=9.98e6),),
            boundaries=(("left", START),),
            initial_pressure=START,
            times=times,
            observe=("well_pressure",),
        )
    )
    assert seen["well_limited"][0, -1] == 1.0
    assert seen["mass_balance_error"] < 1e-12


@pytest.mark.slow
def test_a_group_has_the_narrowest_limits_of_its_wells():
    wells = (
        producer(rate=RATE, group="g", least_pressure=9e6),
        injector(rate=RATE, group="g", least_pressure=9.8e6),
    )
    history = superposed(ROCK.respond(wells, ("left",), TIMES), controls(wells, START))
    assert history.well_pressure.min() == 9.8e6
    late = history.limited[0] == 1.0
    assert late.any()
    assert np.all(history.well_rate.sum(axis=0)[late] < 2.0 * RATE)


def test_pressures_by_a_schedule_superpose():
    def rates(*pressures):
        well = producer(pressure_schedule=tuple(zip((0.0, 2.0, 30.0), pressures, strict=True)))
        responses = ROCK.respond((well,), ("left",), TIMES)
        return superposed(responses, controls((well,), START))

    found = rates(9e6, 9.5e6, 8e6)
    expected = np.array([9e6 if t <= 2.0 else 9.5e6 if t <= 30.0 else 8e6 for t in TIMES])
    np.testing.assert_array_equal(found.well_pressure[0], expected)
    same = (producer(pressure=9e6),)
    constant = superposed(ROCK.respond(same, ("left",), TIMES), controls(same, START))
    np.testing.assert_allclose(rates(9e6, 9e6, 9e6).well_rate, constant.well_rate, rtol=1e-7)
    early = np.array(TIMES) <= 2.0
    np.testing.assert_allclose(found.well_rate[0][early], constant.well_rate[0][early], rtol=1e-7)
    both_at_once = rates(8.9e6, 9.2e6, 7e6).well_rate  # their changes from the start add up
    np.testing.assert_allclose(
        found.well_rate + rates(9.9e6, 9.7e6, 9e6).well_rate, both_at_once, rtol=1e-7
    )
    books = found.volumes
    assert np.abs(books.stored - books.let_in.sum(axis=1)).max() <= 1e-9 * books.moved.max()


def test_limits_without_end_are_told(monkeypatch):
    monkeypatch.setattr("demflow.model.limited.MOST_SWITCHES", 0)
    wells = (producer(rate=RATE, least_pressure=LIMIT),)
    with pytest.raises(ModelError, match="took over and gave back"):
        superposed(ROCK.respond(wells, ("left",), TIMES), controls(wells, START))


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"pressure": 1e6, "least_pressure": 1e5}, "no rate to limit"),
        ({"pressure_schedule": ((0.0, 1e6),), "group": "g"}, "no rate to limit"),
        ({"rate": 1.0, "least_pressure": 2e6, "largest_pressure": 1e6}, "not below the largest"),
        ({"pressure_schedule": ((1.0, 1e6),)}, "begin at 0 s"),
        ({"pressure_schedule": ((0.0, 1e6), (0.0, 2e6))}, "times must increase"),
        ({"rate": 1.0, "pressure_schedule": ((0.0, 1e6),)}, "exactly one of"),
    ],
)
def test_what_contradicts_itself_is_refused(told, words):
    with pytest.raises(SceneError, match=words):
        producer(**told)
