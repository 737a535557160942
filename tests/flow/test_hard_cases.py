"""Hard cases of flow, each with the outcome that is promised."""

import itertools
import math

import numpy as np
import pytest

from demflow.model.controls import sites
from demflow.model.flow.equation.outputs import outputs
from demflow.model.flow.equation.problem import Problem
from demflow.model.flow.solvers import explicit as explicit_module
from demflow.model.flow.solvers.explicit import paper_step, step_limit
from demflow.model.flow.solvers.registry import SOLVERS, lags
from demflow.model.network.apertures import transmissivity
from demflow.model.outcome import ModelError
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import Probe, Trace, Well
from tests.flow.bounds import OFF
from tests.reservoirs import dense_matrices, exact_response, reservoir
from tests.rocks import random_graph, square_lattice

pytestmark = pytest.mark.slow

R = 0.05
BOX = Rectangle(2.0, 1.4)
LATTICE = square_lattice(1.3, R, (R, R))
SCATTER = random_graph(1.2, 500, 1)
ROCK = reservoir(LATTICE, BOX)
WELL = Well(name="w", at=(0.1, 0.1), radius=0.12, rate=1e-6)
PAIR = ("left", "right")
every = pytest.mark.parametrize("method", SOLVERS)
transient = pytest.mark.parametrize("method", [m for m, s in SOLVERS.items() if s.transient])
LIMIT = step_limit(ROCK.assembled((), PAIR))


def largest_decay(rock, sides):
    """λ_max of C⁻¹G."""
    matrix, storage = dense_matrices(rock.assembled((), sides))
    root = np.sqrt(storage)
    return np.linalg.eigvalsh(matrix / np.outer(root, root))[-1]


@pytest.mark.parametrize("safety", [0.9, 1.0])
def test_explicit_keeps_the_maximum_principle_up_to_its_limit(safety):
    found = ROCK.respond((), PAIR, (2000 * LIMIT,), method="explicit", safety_factor=safety)
    assert found.pressure.min() >= 0
    assert found.pressure.max() <= 1 + 1e-12
    exact = ROCK.respond((), PAIR, (2000 * LIMIT,), method="krylov")
    np.testing.assert_allclose(found.pressure, exact.pressure, atol=1e-3)


def test_explicit_is_still_stable_a_little_beyond_where_pores_differ():
    """One small pore sets the limit; at 1.1 times of it nothing grows."""
    rock = reservoir(SCATTER._replace(radius=0.5 * SCATTER.radius), BOX)
    limit = step_limit(rock.assembled((), PAIR))
    assert 2 / largest_decay(rock, PAIR) > 1.15 * limit
    found = rock.respond((), PAIR, (2000 * limit,), method="explicit", safety_factor=1.1)
    exact = rock.respond((), PAIR, (2000 * limit,), method="krylov")
    np.testing.assert_allclose(found.pressure, exact.pressure, atol=1e-3)


def test_explicit_is_stable_up_to_two_over_the_largest_decay():
    edge = 2 / largest_decay(ROCK, PAIR) / LIMIT
    assert 1 < edge < 1.1  # equal pores on a lattice of two colours: the limit is sharp
    found = ROCK.respond((), PAIR, (3000 * LIMIT,), method="explicit", safety_factor=0.99 * edge)
    exact = ROCK.respond((), PAIR, (3000 * LIMIT,), method="krylov")
    np.testing.assert_allclose(found.pressure, exact.pressure, atol=1e-2)


@pytest.mark.parametrize(
    ("beyond", "steps"),
    [(1.02, 1000), (1.02, 20_000), (1.1, 200), (1.1, 1000), (1.5, 100), (1.5, 20_000)],
)
def test_explicit_beyond_that_is_an_outcome_never_numbers(beyond, steps):
    """Whether it has grown to 1e5, 1e30 or infinity by the last time."""
    factor = beyond * 2 / largest_decay(ROCK, PAIR) / LIMIT
    times = (steps * factor * LIMIT * (1 - 1e-9),)
    with pytest.raises(ModelError, match="safety_factor"):
        ROCK.respond((), PAIR, times, method="explicit", safety_factor=factor)


def test_the_papers_step_is_the_corrected_one_where_apertures_and_grains_are_equal():
    """Eq. 14 with its N, R and w as printed, on a lattice; only pipes cut by the rim differ."""
    domains = np.flatnonzero(ROCK.network.inside)
    found = paper_step(ROCK.network, ROCK.apertures, 1e9, domains)
    volume = ROCK.network.volume[domains[0]]
    written = 24 * 1e-3 * R * volume / (4 * 1e9 * 1e-5**3)
    assert found == pytest.approx(written, rel=1e-9)


def test_the_papers_step_is_no_bound_in_a_fracture():
    """One mean aperture for a pore with narrow and wide pipes: it blows up, and that is told."""
    fracture = Trace(name="f", aperture=1e-3, start=(-0.8, -0.4), end=(0.8, 0.5))
    rock = reservoir(SCATTER._replace(radius=0.5 * SCATTER.radius), BOX, 1e-5, (fracture,))
    domains = np.flatnonzero(rock.network.inside)
    limit = step_limit(rock.assembled((), PAIR))
    assert paper_step(rock.network, rock.apertures, 1e9, domains) > 2.0 * limit
    with pytest.raises(ModelError, match=r"blows up.*fold a step"):
        rock.respond((), PAIR, (1e3 * limit,), method="explicit", step="paper")
    rock.respond((), PAIR, (1e3 * limit,), method="explicit")


@pytest.mark.parametrize("method", ["explicit"])
@pytest.mark.parametrize("steps", [1e10, 1e15, 1e18, 1e30, 1e60])
def test_too_many_steps_are_refused_with_their_number(method, steps):
    with pytest.raises(ModelError, match=r"steps.*krylov"):
        ROCK.respond((), PAIR, (LIMIT, steps * LIMIT), method=method)


def test_the_bound_on_steps_counts_pores_and_sources(monkeypatch):
    monkeypatch.setattr(explicit_module, "MOST_UPDATES", 1e4)
    with pytest.raises(ModelError, match="steps"):
        ROCK.respond((), PAIR, (100 * LIMIT,), method="explicit")


@every
@pytest.mark.parametrize("contrast", [1e3, 1e6, 1e9, 1e12])
def test_a_fracture_of_any_contrast(method, contrast):
    """Pressures bounded, mass kept, and at 1e12 the trace alone decides the flow."""
    packing = SCATTER._replace(radius=0.5 * SCATTER.radius)
    wide = 1e-5 * contrast ** (1 / 3)
    fracture = Trace(name="f", aperture=wide, start=(-1.5, 0.1), end=(1.5, -0.2))
    rock = reservoir(packing, BOX, 1e-5, (fracture,))
    limit = step_limit(rock.assembled((), PAIR))
    times = (10 * limit, 1e4 * limit) if SOLVERS[method].transient else ()
    told = {"times": times, "method": method, "tolerance": 1e-6}
    seen = rock.observed((), (("left", 1.0), ("right", 0.0)), **told)
    assert seen["mass_balance_error"] <= 1e-10
    found = rock.respond((), PAIR, **told)
    assert found.pressure.min() >= -1e-5
    assert found.pressure.max() <= 1 + 1e-5
    if method == "steady" and contrast == 1e12:
        length = np.hypot(*(rock.apertures.trace_end - rock.apertures.trace_start)[0])
        assert seen["boundary_flow"][0] == pytest.approx(
            transmissivity(wide, 1e-3) / length, rel=1e-6
        )
        assert found.residual < 1e-12


@pytest.mark.parametrize("contrast", [1e3, 1e6, 1e9, 1e12])
def test_a_barrier_of_any_contrast_divides_the_pressure(contrast):
    """All of the drop is across the wall; the leak is its conductance, to many digits."""
    wall = Trace(
        name="wall", transmissibility_multiplier=1 / contrast, start=(0.0, -1.0), end=(0.0, 1.0)
    )
    rock = reservoir(square_lattice(1.3, R, (R / 3, R)), BOX, 1e-5, (wall,))
    seen = rock.observed(
        (),
        (("left", 1.0), ("right", 0.0)),
        method="steady",
        probes=(Probe("before", (-0.3, 0.0)), Probe("after", (0.3, 0.0))),
    )
    pipes = 2.0 / (2 * R)
    rows = len(np.unique(np.round(rock.network.y[rock.network.inside], 9)))
    one = 1e-15 / 12e-3 / (2 * R)
    expected = rows * one / (pipes - 1 + contrast)
    assert seen["boundary_flow"][0] == pytest.approx(expected, rel=1e-12 * contrast**0.5)
    assert seen["probe_pressure"][0] >= 1 - 20 / contrast
    assert seen["probe_pressure"][1] <= 20 / contrast


def test_flow_behind_a_wall_of_1e12_is_right_to_the_last_digits():
    """A well between a wall and sealed sides draws all of its fluid through the wall."""
    wall = Trace(name="wall", transmissibility_multiplier=1e-12, start=(0.0, -1.0), end=(0.0, 1.0))
    rock = reservoir(square_lattice(1.3, R, (R / 3, R)), BOX, 1e-5, (wall,))
    well = (Well(name="w", at=(0.6, 0.0), radius=0.01, rate=1e-20),)
    seen = rock.observed(well, (("left", 0.0),), method="steady")
    rows = len(np.unique(np.round(rock.network.y[rock.network.inside], 9)))
    through = rows * 1e-15 / 12e-3 / (2 * R) * 1e-12
    assert seen["boundary_flow"][0] == pytest.approx(1e-20, rel=1e-12)
    assert seen["well_pressure"][0] == pytest.approx(-1e-20 / through, rel=1e-9)


@transient
@pytest.mark.parametrize("sides", [("left",), ("left", "right")])
def test_what_a_wall_of_1e12_lets_through_is_what_the_pores_lose(method, sides):
    """The volume balances at every time, and the flow at the end is that of the well."""
    wall = Trace(name="wall", transmissibility_multiplier=1e-12, start=(0.0, -1.0), end=(0.0, 1.0))
    rock = reservoir(square_lattice(1.3, 2 * R, (2 * R / 3, 2 * R)), BOX, 1e-5, (wall,))
    well = (Well(name="w", at=(0.6, 0.0), radius=0.01, rate=1.0),)
    last = 20 * LIMIT if method == "explicit" else 1e18 * LIMIT
    times = tuple(np.geomspace(LIMIT, last, 12))
    found = rock.respond(well, sides, times, method=method)
    let_in, stored = found.cumulative[-1, :, :-1], found.cumulative[-1, :, -1]
    gained = let_in.sum(axis=1) - stored
    np.testing.assert_allclose(gained, found.lag, rtol=1e-14, atol=1e-20 * LIMIT)
    if method != "explicit":
        flows = found.output[-1, -1, 1 : 1 + len(sides)]
        assert flows.sum() == pytest.approx(1.0, rel=1e-12)


@every
def test_pores_cut_off_keep_the_initial_pressure_and_are_counted(method):
    """A box of sealed walls around the middle."""
    c = 0.4
    corners = [(-c, -c), (c, -c), (c, c), (-c, c), (-c, -c)]
    walls = tuple(
        Trace(name=f"{k}", transmissibility_multiplier=0.0, start=a, end=b)
        for k, (a, b) in enumerate(itertools.pairwise(corners))
    )
    rock = reservoir(SCATTER, BOX, 1e-5, walls)
    times = (1.0, 1e5) if SOLVERS[method].transient else ()
    found = rock.respond((), ("outer",), times, method=method, tolerance=1e-4)
    net = rock.network
    within = (np.abs(net.x) < c) & (np.abs(net.y) < c) & net.inside
    assert found.isolated == within.sum() > 10
    isolated = within[found.domain]
    assert np.all(found.pressure[0][:, isolated] == 0)
    if not times:
        assert np.all(found.pressure[0][:, ~isolated] == pytest.approx(1.0))


@every
def test_a_sealed_rock_has_every_pore_cut_off(method):
    """No pipe conducts: the boundary moves nothing, and a well is told so."""
    rock = reservoir(LATTICE, BOX, 0.0)
    times = (1.0, 10.0) if SOLVERS[method].transient else ()
    seen = rock.observed((), (("left", 1.0), ("right", 0.0)), times=times, method=method)
    assert not seen["boundary_flow"].any()
    assert seen["isolated_domains"] == rock.network.inside.sum()
    with pytest.raises(ModelError, match="well"):
        rock.observed((WELL,), (("left", 1.0),), times=times, method=method)


@every
def test_a_region_of_a_single_pore(method):
    """One pore between four rims: p = 1 − exp(−t Σg/C), at once in the steady state."""
    rock = reservoir(square_lattice(0.5, R, (R, R)), Rectangle(0.08, 0.08))
    assert rock.network.inside.sum() == 1
    system = rock.assembled((), ("outer",))
    assert system.pores == 1
    decay = system.excess[0] / system.storage[0]
    times = (0.1 / decay, 2 / decay) if SOLVERS[method].transient else ()
    found = rock.respond((), ("outer",), times, method=method, safety_factor=1e-3)
    expected = -np.expm1(-decay * found.lag)
    np.testing.assert_allclose(found.pressure[0, :, 0], expected, atol=1e-3)


@every
@pytest.mark.parametrize("control", [{"rate": 1e-6}, {"pressure": -3.0}])
def test_a_region_all_within_its_well(method, control):
    """Without any pore left the well meets the rim at once, by the logarithm of a square's radius.

    The conformal radius of a square about its centre is 0.5394 of its side.
    """
    rock = reservoir(square_lattice(0.5, R, (R, R)), Rectangle(0.08, 0.08))
    times = (1.0, 10.0) if SOLVERS[method].transient else ()
    through = []
    for radius in (1e-4, 0.01):
        well = (Well(name="w", at=(0.0, 0.0), radius=radius, **control),)
        seen = rock.observed(well, (("outer", 0.0),), times=times, method=method)
        rate, pressure = np.ravel(seen["well_rate"])[-1], np.ravel(seen["well_pressure"])[-1]
        through.append(-rate / pressure * math.log(0.5394 * 0.08 / radius))
    assert through[0] == pytest.approx(through[1], rel=0.01)
    assert through[0] == pytest.approx(rock.apertures.cut_conductance.sum(), rel=0.3)


@every
def test_a_well_inside_one_single_pore(method):
    """Its drawdown is finite, reciprocal to the rim, and grows with the logarithm of its radius."""
    times = (1.0, 1e4) if SOLVERS[method].transient else ()
    drawdown = []
    for radius in (1e-2, 1e-3, 1e-4):
        well = (Well(name="w", at=(0.101, 0.099), radius=radius, rate=1e-6),)
        seen = ROCK.observed(well, (("outer", 0.0),), times=times, method=method)
        drawdown.append(-np.ravel(seen["well_pressure"])[-1])
    steps = np.diff(drawdown)
    assert steps[0] > 0
    assert steps[1] == pytest.approx(steps[0], rel=1e-3)


@transient
def test_slivers_slow_explicit_down_and_change_nothing_else(method):
    """Three pores of 1e-6 of the mean volume."""
    net = ROCK.network
    volume = net.volume.copy()
    volume[np.flatnonzero(net.inside)[[20, 77, 140]]] *= 1e-6
    rock = ROCK._replace(apertures=ROCK.apertures._replace(volume=volume))
    times = (0.5 * LIMIT,)
    found = rock.respond((), PAIR, times, method=method, tolerance=1e-8, safety_factor=0.5)
    system = rock.assembled((), PAIR)
    exact = exact_response(system, 0, found.lag)
    node = system.node_of_domain[found.domain]
    np.testing.assert_allclose(found.pressure[0], exact[:, node], atol=1e-5)


def test_output_times_over_fourteen_decades():
    times = tuple(np.geomspace(1e-6, 1e8, 71) * LIMIT)
    found = ROCK.respond((WELL,), ("left",), times, method="krylov", tolerance=1e-7)
    system = ROCK.assembled(sites((WELL,)), ("left",))
    exact = exact_response(system, 1, found.lag)[:, -1]
    np.testing.assert_allclose(found.output[1, :, 0], exact, rtol=1e-6)
    steady = ROCK.respond((WELL,), ("left",), (), method="steady")
    assert found.output[1, -1, 0] == pytest.approx(steady.output[1, 0, 0], rel=1e-9)


@pytest.mark.parametrize("last", [10.0, 100.0])
def test_times_so_early_that_nothing_has_arrived(last):
    """The boundary and a probe far away still read nothing; that costs no further cycles."""
    fine = reservoir(square_lattice(1.1, 0.025), Rectangle(2.0, 2.0))
    system = fine.assembled(sites((WELL,)), ("left",))
    found = fine.respond(
        (WELL,),
        ("left",),
        tuple(np.geomspace(0.1, last, 5) * step_limit(system)),
        tolerance=1e-4,
        record_map=False,
        probes=(Probe("far", (0.7, -0.7)),),
    )
    exact = exact_response(system, 1, found.lag)[:, -1]
    np.testing.assert_allclose(found.output[1, :, 0], exact, rtol=3e-4)
    assert np.abs(found.output[1, :, 1]).max() < 1e-3
    assert found.work < 60


@transient
def test_a_schedule_is_the_sum_of_its_steps(method):
    """Jumps, an injection and a shut-in, from the dense step response by hand."""
    schedule = ((0.0, 1e-6), (40.0, 3e-6), (41.0, -1e-6), (300.0, 0.0))
    times = (1.0, 40.0, 40.5, 41.0, 60.0, 299.0, 300.0, 301.0, 500.0, 3000.0)
    schedule = tuple((t * LIMIT, q) for t, q in schedule)
    times = tuple(t * LIMIT for t in times)
    well = Well(name="w", at=WELL.at, radius=WELL.radius, schedule=schedule)
    seen = ROCK.observed(
        (well,), (("left", 2.0),), 2.0, times, method=method, tolerance=1e-9, safety_factor=0.02
    )
    system = ROCK.assembled(sites((WELL,)), ("left",))
    expected = np.full(len(times), 2.0)
    before = 0.0
    for start, rate in schedule:
        since = np.array(times) - start
        response = exact_response(system, 1, np.maximum(since, 0.0))[:, -1]
        expected += (rate - before) * np.where(since > 0, response, 0.0)
        before = rate
    scale = np.abs(expected - 2.0).max()
    np.testing.assert_allclose(
        seen["well_pressure"][0], expected, atol=OFF[method].schedule * scale
    )
    rates = [1e-6, 1e-6, 3e-6, 3e-6, -1e-6, -1e-6, -1e-6, 0, 0, 0]
    np.testing.assert_array_equal(seen["well_rate"][0], rates)
    assert seen["mass_balance_error"] <= 1e-10


def test_lags_are_all_times_since_any_change():
    well = Well(name="w", at=(0, 0), radius=0.1, schedule=((0.0, 1.0), (10.0, 2.0), (25.0, 0.0)))
    other = Well(name="v", at=(0, 0), radius=0.1, schedule=((5.0, 1.0),))
    found = lags((7.0, 30.0), sites((well, other)))
    wanted = {7.0, 30.0, 0.0, 5.0, 10.0, 25.0}
    changes = {0.0, 5.0, 10.0, 25.0}
    expected = sorted({t - c for t in wanted for c in changes if t >= c})
    np.testing.assert_array_equal(found, expected)
    assert lags((), sites((well,))).tolist() == [math.inf]


def test_changes_that_round_off_parts_from_a_time_cost_nothing():
    """0.1 + 0.2 is not 0.3: the response between them is not worth twenty decades of poles."""
    well = Well(name="w", at=WELL.at, radius=0.12, schedule=((0.0, 1e-6), (0.3, 0.0)))
    plain = ROCK.respond((well,), ("left",), (0.3, 100.0), tolerance=1e-6)
    off = ROCK.respond((well,), ("left",), (0.1 + 0.2, 100.0), tolerance=1e-6)
    assert off.work <= 1.5 * plain.work


def test_krylov_says_so_when_it_does_not_converge(monkeypatch):
    from demflow.model.flow.solvers import krylov as krylov_module

    monkeypatch.setattr(krylov_module, "MOST_VECTORS", 4)
    with pytest.raises(ModelError, match="tolerance"):
        ROCK.respond((WELL,), ("left",), (1.0, 1e4), method="krylov", tolerance=1e-9)


def test_krylov_goes_as_far_as_round_off_allows_and_says_how_far():
    """Fifteen decades between the decay rates hide digits that were asked for."""
    wall = Trace(name="wall", transmissibility_multiplier=1e-12, start=(0.0, -1.0), end=(0.0, 1.0))
    rock = reservoir(SCATTER, BOX, 1e-5, (wall,))
    system = rock.assembled(
        sites((Well(name="w", at=(0.6, 0.0), radius=0.05, rate=1.0),)), ("left",)
    )
    problem = Problem(
        system=system,
        records=outputs(system, np.empty(0, dtype=np.int64)),
        lag=step_limit(system) * np.logspace(0.0, 18.0, 37),
        active=np.array([False, True]),
        domain=np.empty(0, dtype=np.int64),
        tolerance=1e-11,
        safety_factor=0.9,
        check_flows=False,
    )
    found = SOLVERS["krylov"].run(problem)
    assert problem.tolerance < found.time_error < 1e-7
    steady = SOLVERS["steady"].run(problem._replace(lag=np.array([np.inf])))
    exact = steady.output[1, -1, 0]
    assert found.output[1, -1, 0] == pytest.approx(exact, rel=found.time_error)


@every
def test_a_part_without_outlet_beside_one_with(method):
    """A wall seals a well off from the boundary: no steady state, but a transient."""
    wall = (Trace(name="w", transmissibility_multiplier=0.0, start=(0.0, -1.0), end=(0.0, 1.0)),)
    rock = reservoir(SCATTER, BOX, 1e-5, wall)
    well = (Well(name="w", at=(0.5, 0.0), radius=0.1, rate=1e-9),)
    if not SOLVERS[method].transient:
        with pytest.raises(ModelError, match="no steady state"):
            rock.observed(well, (("left", 0.0),), method=method)
        return
    system = rock.assembled(sites(well), ("left",))
    times = (20 * step_limit(system), 2e3 * step_limit(system))
    seen = rock.observed(well, (("left", 0.0),), 0.0, times, method=method, tolerance=1e-6)
    assert seen["mass_balance_error"] <= 1e-10
    assert np.all(np.abs(seen["boundary_flow"]) <= 1e-12)


@transient
def test_a_circle_cut_from_a_packing_with_everything_in_it(method):
    """Wells, fractures, a wall and a set at once: finite, balanced."""
    rock = reservoir(
        SCATTER._replace(radius=0.6 * SCATTER.radius),
        Circle(0.9),
        1e-5,
        (
            Trace(name="a", aperture=3e-5, start=(-0.4, -0.4), end=(0.5, 0.6)),
            Trace(name="b", transmissibility_multiplier=0.1, start=(-0.3, 0.5), end=(0.4, -0.6)),
        ),
    )
    wells = (
        Well(name="p", at=(-0.4, -0.4), radius=0.1, rate=1e-9),
        Well(name="i", at=(0.5, 0.5), radius=1e-3, pressure=4e5),
    )
    seen = rock.observed(wells, (("outer", 1e5),), 1e5, (1e-3, 1.0, 10.0), method=method)
    assert seen["mass_balance_error"] <= 1e-10
    assert all(np.all(np.isfinite(seen[k])) for k in ("well_pressure", "well_rate"))
