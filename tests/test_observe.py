"""From responses to observations: signs, scaling, schedules, what a case reports."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.model.controls import Controls, controls_of, sites, step_sizes
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.history import superpose, superposed
from demflow.model.observe import observe_flow
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import Fluid, Grains, Matrix, Probe, Scene, Solver, Well
from tests.reservoirs import reservoir
from tests.rocks import square_lattice

R = 0.05
ROCK = reservoir(square_lattice(1.2, R, (R, R)), Circle(0.93))
TIMES = tuple(np.geomspace(1, 1e6, 31) * step_limit(ROCK.assembled((), ("outer",))))
START = 7e6


def producer(**control):
    return Well(name="w", at=(0.0, 0.0), radius=0.12, **(control or {"rate": 2e-6}))


def observed(*wells, rim=START, times=TIMES, **more):
    return ROCK.observed(wells, (("outer", rim),), START, times, tolerance=1e-8, **more)


def test_production_lowers_the_pressure_and_draws_fluid_in():
    seen = observed(producer())
    assert np.all(np.diff(seen["well_pressure"][0]) < 1e-3)
    assert seen["well_pressure"][0, 0] < START
    # nothing flows back, but for the error that the solver may make
    assert np.all(seen["boundary_flow"] >= -1e-9 * 2e-6)
    # at the steady state the boundary feeds the well
    assert seen["boundary_flow"][0, -1] == pytest.approx(2e-6, rel=1e-6)
    np.testing.assert_array_equal(seen["well_rate"], np.full((1, len(TIMES)), 2e-6))


def test_injection_is_the_mirror_image():
    out, into = observed(producer(rate=2e-6)), observed(producer(rate=-2e-6))
    np.testing.assert_allclose(
        into["well_pressure"] - START, START - out["well_pressure"], rtol=1e-9
    )
    np.testing.assert_allclose(into["boundary_flow"], -out["boundary_flow"], atol=1e-20)
    np.testing.assert_allclose(into["pressure_change"], out["pressure_change"], rtol=1e-6)


def test_changes_are_positive_and_their_derivative_is_bourdet_s():
    seen = observed(producer())
    np.testing.assert_allclose(
        seen["pressure_change"][0], START - seen["well_pressure"][0], rtol=1e-6
    )
    derivative = seen["pressure_derivative"][0]
    plain = np.gradient(seen["pressure_change"][0], np.log(TIMES))
    assert np.all(derivative[1:-1] > -1e-6 * plain.max())
    assert np.max(np.abs(derivative[1:-1] - plain[1:-1])) < 0.2 * plain.max()


def test_a_well_at_a_pressure_reports_the_rate_it_takes():
    seen = observed(producer(pressure=6e6))
    assert np.all(seen["well_pressure"] == 6e6)
    assert np.all(np.diff(seen["well_rate"][0]) <= 1e-15)
    assert seen["well_rate"][0, -1] > 0
    assert seen["boundary_flow"][0, -1] == pytest.approx(seen["well_rate"][0, -1], rel=1e-6)
    assert np.all(np.isnan(seen["pressure_change"]))
    assert np.all(np.isnan(seen["pressure_derivative"]))
    assert np.all(observed(producer(pressure=8e6))["well_rate"][0, -1] < 0)


def test_rate_and_pressure_are_two_views_of_one_steady_state():
    seen = ROCK.observed((producer(),), (("outer", START),), method="steady")
    back = ROCK.observed(
        (producer(pressure=float(seen["well_pressure"][0])),), (("outer", START),), method="steady"
    )
    assert back["well_rate"][0] == pytest.approx(2e-6, rel=1e-9)
    assert seen["boundary_flow"][0] == pytest.approx(2e-6, rel=1e-9)
    assert seen["well_pressure"].shape == back["well_rate"].shape == (1,)
    assert seen["mass_balance_error"] <= 1e-12
    assert "pressure_change" not in seen


@given(rate=st.floats(1e-12, 1.0), start=st.floats(-1e8, 1e8))
@settings(max_examples=20)
def test_pressure_is_linear_in_the_rate_whatever_the_start(rate, start):
    responses = RESPONSES
    controls = Controls(start, start, (start,), (producer(rate=rate),), TIMES, True)
    seen = observe_flow(superposed(responses, controls), controls)
    expected = start + rate * responses.output[1, 1:, 0]
    np.testing.assert_allclose(seen["well_pressure"][0], expected, rtol=1e-12)


RESPONSES = ROCK.respond((producer(),), ("outer",), TIMES)


def test_a_build_up_returns_what_the_drawdown_took():
    """Δp restarts at the shut-in, is positive there too, and the rate is that before it."""
    stop = TIMES[15]
    well = producer(schedule=((0.0, 2e-6), (stop, 0.0)))
    times = tuple(sorted({*TIMES[:20], *(stop + np.array(TIMES[:25]))}))
    seen = observed(well, times=times)
    at = np.array(times)
    lowest = int(np.argmin(seen["well_pressure"][0]))
    assert at[lowest] == pytest.approx(stop)
    change, rate = seen["pressure_change"][0], seen["well_rate"][0]
    np.testing.assert_array_equal(rate, np.where(at <= stop, 2e-6, 0.0))
    low = seen["well_pressure"][0, lowest]
    np.testing.assert_allclose(
        change[at > stop], seen["well_pressure"][0, at > stop] - low, atol=1e-3
    )
    assert np.all(change > 0)
    assert seen["well_pressure"][0, -1] <= START + 1e-3
    assert seen["mass_balance_error"] <= 1e-10


def test_a_well_that_starts_late_is_silent_before():
    begin = TIMES[10]
    late = observed(producer(schedule=((begin, 2e-6),)), times=TIMES)
    early = np.array(TIMES) <= begin
    np.testing.assert_array_equal(late["well_pressure"][0, early], START)
    np.testing.assert_array_equal(late["well_rate"][0, early], 0)
    assert np.all(np.isnan(late["pressure_change"][0, early]))
    assert np.all(late["pressure_change"][0, ~early] > 0)


def test_a_shut_well_observes_its_neighbour():
    shut = Well(name="shut", at=(0.4, 0.0), radius=0.08, rate=0.0)
    seen = observed(producer(), shut)
    # an interference test: the change since its neighbour began to flow
    np.testing.assert_array_equal(seen["pressure_change"][1], START - seen["well_pressure"][1])
    rises = np.diff(seen["pressure_change"][1])
    assert np.all(rises >= 0)
    assert np.all(seen["pressure_derivative"][1][1:-1][rises[1:] > 0] > 0)
    assert seen["well_pressure"][1, -1] < START - 1.0
    np.testing.assert_array_equal(seen["well_rate"][1], 0)


def test_probes_lie_between_the_well_and_the_rim():
    line = tuple(Probe(f"{x}", (x, 0.0)) for x in (0.0, 0.2, 0.4, 0.6, 0.8))
    seen = observed(producer(), probes=line)
    final = seen["probe_pressure"][:, -1]
    assert final[0] == pytest.approx(seen["well_pressure"][0, -1])
    assert np.all(np.diff(final) > 0)
    assert final[-1] < START


def test_steps_act_after_their_time_and_at_infinity_all_do():
    responses = np.arange(6.0).reshape(1, 6, 1)
    lag = np.arange(6.0)
    steps = [[(0.0, 2.0), (3.0, -1.0)]]
    at = np.array([0.0, 1.0, 3.0, 4.0, 5.0])
    found = superpose(responses, lag, steps, at)
    np.testing.assert_array_equal(found[:, 0], [0, 2, 6, 8 - 1, 10 - 2])
    for_ever = superpose(np.full((1, 1, 1), 5.0), np.array([np.inf]), steps, np.array([np.inf]))
    np.testing.assert_array_equal(for_ever, [[5.0]])


def scene(**more):
    given = {
        "region": Circle(14.0),
        "grains": Grains(count=100, packing="square"),
        "matrix": Matrix(aperture=1e-5),
        "fluid": Fluid(1e-3, 1e9),
        "observe": ("well_pressure",),
        "wells": (producer(),),
        "boundaries": (("outer", 5e6),),
        "initial_pressure": 7e6,
        "times": (1.0, 10.0),
    }
    return Scene(**{**given, **more})


def test_changes_count_from_the_start_or_from_a_fixed_pressure():
    assert controls_of(scene()).reference == 7e6
    assert controls_of(scene(times=(), initial_pressure=None)).reference == 5e6
    assert controls_of(scene(times=())).times == ()
    controls = controls_of(scene(times=(), solver=Solver(method="steady")))
    assert not controls.transient
    assert controls.times == ()


def test_sizes_of_steps_follow_the_order_of_the_sources():
    held = Well(name="h", at=(5.0, 5.0), radius=0.5, pressure=6e6)
    scheduled = Well(name="s", at=(-5.0, 5.0), radius=0.5, schedule=((2.0, 3.0), (4.0, 1.0)))
    controls = controls_of(scene(wells=(producer(), held, scheduled)))
    assert step_sizes(controls) == [
        [(0.0, -2e6)],
        [(0.0, -1e6)],
        [(0.0, 2e-6)],
        [(2.0, 3.0), (4.0, -2.0)],
    ]


def test_flow_is_not_told_how_much_a_well_produces():
    """What the sweep shares between rates must not depend on them."""
    assert sites((producer(rate=1.0),)) == sites((producer(rate=-7.0),))
    assert sites((producer(pressure=1.0),)) == sites((producer(pressure=2.0),))
    assert sites((producer(rate=1.0),)) != sites((producer(pressure=1.0),))


def test_an_imbalance_is_reported():
    """The error that is stored is large when the books do not close."""
    controls = Controls(START, START, (START,), (producer(),), TIMES, True)
    cooked = RESPONSES._replace(cumulative=RESPONSES.cumulative * 1.01)
    assert observe_flow(superposed(RESPONSES, controls), controls)["mass_balance_error"] < 1e-12
    assert observe_flow(superposed(cooked, controls), controls)["mass_balance_error"] > 1e-3
    steady = ROCK.respond((producer(),), ("outer",), (), method="steady")
    controls = Controls(START, START, (START,), (producer(),), (), False)
    cooked = steady._replace(output=steady.output * 1.01)
    assert observe_flow(superposed(steady, controls), controls)["mass_balance_error"] < 1e-12
    assert observe_flow(superposed(cooked, controls), controls)[
        "mass_balance_error"
    ] == pytest.approx(0.01 / 2.01, rel=1e-6)


def test_nothing_moves_where_everything_is_at_rest():
    seen = observed(producer(rate=0.0))
    np.testing.assert_array_equal(seen["well_pressure"], START)
    assert not seen["boundary_flow"].any()
    assert seen["mass_balance_error"] == 0
    assert math.isfinite(float(seen["residual"]))


def test_a_probe_that_no_source_reaches_keeps_the_initial_pressure():
    rock = reservoir(square_lattice(1.2, 0.05), Rectangle(1.0, 1.0), 0.0)
    probe = (Probe("cut off", (0.2, 0.2)),)
    seen = rock.observed(
        (), (("left", 5e6), ("right", 1e6)), initial_pressure=3e6, method="steady", probes=probe
    )
    assert seen["probe_pressure"][0] == 3e6


def test_explicit_claims_no_error_in_time_that_it_did_not_measure():
    assert np.isnan(ROCK.respond((), ("outer",), (1e-3,), method="explicit").time_error)


def test_range_error_is_the_largest_excursion_of_a_unit_response():
    """Nothing where all lies in range; the excursion itself where one value is moved out."""
    controls = Controls(START, START, (START,), (producer(),), TIMES, True)
    sound = float(observe_flow(superposed(RESPONSES, controls), controls)["range_error"])
    assert 0.0 <= sound < 1e-3
    for name, place, value, expected in (
        ("pressure", (0, -1, 0), 1.25, 0.25),
        ("pressure", (0, -1, 0), -0.125, 0.125),
        ("output", (0, -1, 0), 1.5, 0.5),
    ):
        array = getattr(RESPONSES, name).copy()
        array[place] = value
        seen = observe_flow(superposed(RESPONSES._replace(**{name: array}), controls), controls)[
            "range_error"
        ]
        assert seen == pytest.approx(expected, rel=1e-3)
