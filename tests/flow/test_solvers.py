"""Every solver of the registry against dense eigen-solutions and the laws of diffusion."""

import functools
import math

import numpy as np
import pytest

from demflow.model.controls import sites
from demflow.model.flow.equation.probes import between_pores
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.registry import SOLVERS, flow
from demflow.model.outcome import ModelError
from demflow.model.products import Permeability
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import Probe, Trace, Well
from tests.flow.bounds import OFF
from tests.reservoirs import dense_matrices, exact_response, reservoir
from tests.rocks import packing_of, random_graph

pytestmark = pytest.mark.slow

REGION = Rectangle(2.0, 1.4)
SCATTERED = random_graph(1.2, 1000, 3)
# grains of half the size leave every pore room, so that no sliver rules the explicit step
PACKING = SCATTERED._replace(radius=0.5 * SCATTERED.radius)
FRACTURES = (
    Trace(name="open", permeability=3e-5**3, start=(-0.6, -0.3), end=(0.7, 0.25)),
    Trace(name="wall", transmissibility_multiplier=0.05, start=(0.1, 0.6), end=(0.6, -0.5)),
)
UNIT = Permeability(np.eye(2))  # a medium whose pipes have an aperture w has k = w³
ROCK = reservoir(PACKING, REGION, 2e-5, FRACTURES, unit_permeability=UNIT)
PRODUCER = Well(name="producer", at=(-0.4, 0.2), radius=0.12, rate=1e-6)
INJECTOR = Well(name="injector", at=(0.6, -0.3), radius=0.01, rate=-1e-6)
HELD = Well(name="held", at=(0.1, 0.45), radius=0.06, pressure=2e5)
WELLS = (PRODUCER, INJECTOR, HELD)
SIDES = ("left", "top")
PROBES = (Probe("one", (0.3, 0.2)), Probe("in a well", (-0.4, 0.2)))
SYSTEM = ROCK.assembled(sites(WELLS), SIDES)
AROUND = between_pores(
    ROCK.network, ROCK.apertures, REGION, SYSTEM, np.array([p.at for p in PROBES])
)
LIMIT = step_limit(SYSTEM)
TIMES = tuple(np.geomspace(3.0, 3e4, 15) * LIMIT)
LATE = 1e7 * LIMIT

every = pytest.mark.parametrize("method", SOLVERS)
transient = pytest.mark.parametrize("method", [m for m, s in SOLVERS.items() if s.transient])


def times_for(method, times=TIMES):
    return times if SOLVERS[method].transient else ()


def respond(method, wells=WELLS, sides=SIDES, times=TIMES, rock=ROCK, **more):
    more.setdefault("probes", PROBES)
    return rock.respond(wells, sides, times_for(method, times), method=method, **more)


@functools.cache
def responded(method, **more):
    """The same of the rock, for several laws."""
    return respond(method, **more)


@functools.cache
def of_rock(method, viscosity=1e-3, bulk_modulus=1e9, aperture=2e-5, time=1.0):
    """What two wells do in a rock without fractures, at as many times the usual times."""
    rock = reservoir(PACKING, REGION, aperture, (), viscosity, bulk_modulus)
    times = tuple(t * time for t in TIMES)
    return respond(method, (PRODUCER, INJECTOR), ("left",), times, rock=rock)


def test_every_solver_states_its_error_here():
    assert set(OFF) == set(SOLVERS)


@every
def test_agrees_with_a_dense_eigen_solution(method):
    """Over 300 pores with a fracture and a wall; every pore, well, flow and probe."""
    found = responded(method, tolerance=1e-10, safety_factor=0.5)
    # the explicit scheme needs a few hundred steps to forget its first ones
    settled = (found.lag >= 100 * LIMIT) | (method != "explicit")
    assert 300 < SYSTEM.pores < 600
    matrix, _ = dense_matrices(SYSTEM)
    for source in range(SYSTEM.source_count):
        if SOLVERS[method].transient:
            exact = exact_response(SYSTEM, source, found.lag)
        else:
            exact = np.linalg.solve(matrix, SYSTEM.source(source))[None]
        scale = np.abs(exact).max()
        exact, output = exact[settled], found.output[source][settled]
        pressure = found.pressure[source][settled]
        node = SYSTEM.node_of_domain[found.domain]
        known = node >= 0
        np.testing.assert_allclose(
            pressure[:, known], exact[:, node[known]], atol=OFF[method].response * scale
        )
        # wells at a rate come first among the outputs
        wells = exact[:, SYSTEM.pores :]
        np.testing.assert_allclose(output[:, :2], wells, atol=OFF[method].response * scale)
        # then the inflows: what the fixed pressures push through their links
        for k in range(SYSTEM.fixed_count):
            ours = SYSTEM.fixed_source == k
            own = 1.0 if source == k else 0.0
            flow = (own - exact[:, SYSTEM.fixed_node[ours]]) @ SYSTEM.fixed_g[ours]
            size = SYSTEM.fixed_g[ours].sum() * scale
            np.testing.assert_allclose(output[:, 2 + k], flow, atol=OFF[method].response * size)
        # and probes: between the pores around the point, or the well in which it lies
        around = SYSTEM.node_of_domain[AROUND.domain[AROUND.probe == 0]]
        parts = AROUND.part[AROUND.probe == 0]
        np.testing.assert_allclose(
            output[:, -2], exact[:, around] @ parts, atol=OFF[method].response * scale
        )
        np.testing.assert_allclose(output[:, -1], output[:, 0], atol=1e-12 * scale)


def test_the_krylov_error_estimate_bounds_the_error():
    for tolerance in (1e-2, 1e-4, 1e-6):
        found = respond("krylov", tolerance=tolerance)
        assert 0.0 < found.time_error <= tolerance
        for source in (3, 4):
            exact = exact_response(SYSTEM, source, found.lag)[:, SYSTEM.pores :]
            own = source - SYSTEM.fixed_count
            error = np.abs(found.output[source][:, own] / exact[:, own] - 1)
            assert error.max() <= found.time_error


def test_the_explicit_scheme_is_of_first_order():
    """Halving the step halves the error, within a tenth of the order."""
    times = (600 * LIMIT,)
    exact = exact_response(SYSTEM, 3, np.array(times))
    errors = []
    for safety in (0.8, 0.4, 0.2, 0.1):
        found = respond("explicit", times=times, safety_factor=safety)
        node = SYSTEM.node_of_domain[found.domain]
        known = node >= 0
        errors.append(np.abs(found.pressure[3][-1, known] - exact[0, node[known]]).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.1)


def test_the_explicit_step_keeps_what_it_says():
    """min C / Σ g over the pores, written out."""
    matrix, storage = dense_matrices(SYSTEM)
    pores = np.arange(SYSTEM.pores)
    assert pytest.approx(np.min(storage / matrix[pores, pores]), rel=1e-12) == LIMIT


@transient
def test_late_transients_are_steady(method):
    if method == "explicit":
        late = respond(method, times=(2e5 * LIMIT,))
    else:
        late = respond(method, times=(*TIMES, LATE))
    steady = responded("steady")
    scale = np.abs(steady.pressure).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(late.pressure[:, -1:] / scale, steady.pressure / scale, atol=1e-6)
    flows = np.abs(steady.output).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(late.output[:, -1:] / flows, steady.output / flows, atol=1e-6)


@every
def test_mass_is_kept_to_round_off(method):
    for boundaries in ((("left", 3e5), ("top", 1e5)), (("outer", 1e5),), ()):
        if not boundaries and not SOLVERS[method].transient:
            continue
        seen = ROCK.observed(
            WELLS, boundaries, 1.5e5, times_for(method), method=method, tolerance=1e-3
        )
        assert seen["mass_balance_error"] <= 1e-10
        assert seen["residual"] >= 0


@every
def test_pressures_stay_between_those_that_drive_them(method):
    """A unit step of a fixed pressure keeps 0 ≤ p ≤ 1, and production never raises a pressure."""
    slack = OFF[method].beyond
    found = respond(method, tolerance=1e-7)
    for source in range(3):
        assert found.pressure[source].min() >= -slack
        assert found.pressure[source].max() <= 1 + slack
    total = found.pressure[:3].sum(axis=0)
    assert total.max() <= 1 + 3 * slack
    for source in (3, 4):
        assert found.pressure[source].max() <= slack * np.abs(found.pressure[source]).max()


@every
def test_responses_grow_in_time(method):
    found = responded(method)
    scale = np.abs(found.pressure).max(axis=(1, 2), keepdims=True)
    assert np.all(np.diff(np.abs(found.pressure), axis=1) >= -1e-7 * scale)


@every
def test_wells_are_reciprocal(method):
    """What one well's rate does to another's pressure, the other's does to the one."""
    found = respond(method, tolerance=1e-10, sides=("left",))
    first, second = found.output[2, :, 1], found.output[3, :, 0]
    scale = np.abs(found.output[2, :, 0]).max()
    np.testing.assert_allclose(first, second, atol=1e-9 * scale)
    assert np.abs(first).max() > 1e-4 * scale


@every
def test_boundaries_and_wells_are_reciprocal(method):
    """A boundary's pressure at a well is the share of the well's rate that the boundary feeds."""
    found = responded(method, tolerance=1e-10, safety_factor=0.5)
    np.testing.assert_allclose(found.output[0, :, 0], found.output[3, :, 2], atol=1e-9)
    np.testing.assert_allclose(found.output[1, :, 1], found.output[4, :, 3], atol=1e-9)


@every
def test_sources_superpose(method):
    """All at once is the sum of each alone, wells at a pressure being held meanwhile."""
    told = {"times": times_for(method), "method": method, "tolerance": 1e-8}
    both = ROCK.observed(WELLS, (("left", 3e5), ("top", 1e5)), 1e5, **told)
    quiet = (
        Well(name="producer", at=PRODUCER.at, radius=PRODUCER.radius, rate=0.0),
        Well(name="injector", at=INJECTOR.at, radius=INJECTOR.radius, rate=0.0),
        Well(name="held", at=HELD.at, radius=HELD.radius, pressure=1e5),
    )
    change = np.zeros_like(both["well_pressure"])
    for k, well in enumerate(WELLS):
        alone = (*quiet[:k], well, *quiet[k + 1 :])
        seen = ROCK.observed(alone, (("left", 1e5), ("top", 1e5)), 1e5, **told)
        change += seen["well_pressure"] - 1e5
    seen = ROCK.observed(quiet, (("left", 3e5), ("top", 1e5)), 1e5, **told)
    change += seen["well_pressure"] - 1e5
    np.testing.assert_allclose(both["well_pressure"] - 1e5, change, atol=1e-6 * 2e5)
    assert np.abs(change).max() > 1e5


@every
@pytest.mark.parametrize(
    ("thing", "factor", "pressure", "time"),
    [
        ("viscosity", 10.0, 10.0, 10.0),
        ("bulk_modulus", 4.0, 1.0, 0.25),
        ("aperture", 2.0, 1 / 8, 1 / 8),
    ],
)
def test_scales_as_the_equation_says(method, thing, factor, pressure, time):
    """Time goes with μ / (K_f w³), the drawdown of a rate with μ / w³."""
    base = {"aperture": 2e-5, "viscosity": 1e-3, "bulk_modulus": 1e9}
    one = of_rock(method)
    two = of_rock(method, **{thing: base[thing] * factor}, time=time)
    np.testing.assert_allclose(two.pressure[0], one.pressure[0], atol=1e-7)
    for source in (1, 2):
        scale = np.abs(one.pressure[source]).max()
        np.testing.assert_allclose(
            two.pressure[source] / pressure, one.pressure[source], atol=1e-7 * scale
        )


@every
def test_names_of_grains_do_not_matter(method):
    rng = np.random.default_rng(1)
    place = rng.permutation(len(PACKING.x))
    back = np.argsort(place)
    pairs = np.column_stack([place[PACKING.contact_a], place[PACKING.contact_b]])
    renamed = packing_of(PACKING.x[back], PACKING.y[back], PACKING.radius[back], pairs)
    other = reservoir(renamed, REGION, 2e-5)
    plain = reservoir(PACKING, REGION, 2e-5)
    one, two = (respond(method, rock=rock).output for rock in (plain, other))
    flows = np.array([False, False, True, True, True, False, False])
    for kind in (flows, ~flows):
        scale = np.abs(one[:, :, kind]).max(axis=(1, 2), keepdims=True)
        np.testing.assert_allclose(one[:, :, kind] / scale, two[:, :, kind] / scale, atol=1e-8)


@every
def test_turned_rocks_answer_alike(method):
    angle = 0.8
    x = math.cos(angle) * PACKING.x - math.sin(angle) * PACKING.y
    y = math.sin(angle) * PACKING.x + math.cos(angle) * PACKING.y
    at = (0.2 * math.cos(angle), 0.2 * math.sin(angle))
    here = reservoir(PACKING, Circle(0.8), 2e-5)
    there = reservoir(PACKING._replace(x=x, y=y), Circle(0.8), 2e-5)
    one = respond(
        method,
        (Well(name="w", at=(0.2, 0.0), radius=0.1, rate=1.0),),
        ("outer",),
        rock=here,
        probes=(),
    )
    two = respond(
        method, (Well(name="w", at=at, radius=0.1, rate=1.0),), ("outer",), rock=there, probes=()
    )
    np.testing.assert_allclose(two.output[1, :, 0], one.output[1, :, 0], rtol=1e-7)
    np.testing.assert_allclose(two.output[1, :, 1], one.output[1, :, 1], atol=1e-8)


@every
def test_same_question_same_bits(method):
    one, two = responded(method), respond(method)
    for name, value in one._asdict().items():
        np.testing.assert_array_equal(value, getattr(two, name), err_msg=name)


@every
def test_idle_sources_are_left_at_zero_and_change_nothing(method):
    responses = flow(
        ROCK.network,
        ROCK.apertures,
        region=REGION,
        bulk_modulus=1e9,
        wells=sites(WELLS),
        sides=SIDES,
        active=(False, True, False, True, False),
        probes=PROBES,
        times=times_for(method),
        method=method,
        tolerance=1e-9,
        safety_factor=0.9,
        record_map=True,
    )
    full = responded(method)
    assert not responses.output[[0, 2, 4]].any()
    for source in (1, 3):
        # what the others do tells how well each has to be known, where that is controlled
        off = np.abs(responses.output[source] - full.output[source])
        allowed = 2e-9 if SOLVERS[method].controls_error and SOLVERS[method].transient else 0.0
        assert np.all(off <= allowed * np.abs(full.output[source]).max(axis=0))
    assert responses.domain.tolist() == np.flatnonzero(ROCK.network.inside).tolist()


def test_maps_are_made_only_where_asked_for():
    found = respond("krylov", record_map=False, tolerance=1e-12)
    assert found.pressure.shape == (5, len(found.lag), 0)
    np.testing.assert_allclose(
        found.output, respond("krylov", tolerance=1e-12).output, rtol=1e-4, atol=1e-8
    )


@every
def test_without_any_fixed_pressure_the_mean_falls_steadily(method):
    """Pseudo-steady state: dp/dt = −q / ΣC everywhere; no steady state exists."""
    rock = reservoir(PACKING, Rectangle(0.8, 0.6), 2e-5)
    well = (Well(name="w", at=(0.1, 0.1), radius=0.1, rate=1.0),)
    if not SOLVERS[method].transient:
        with pytest.raises(ModelError, match="no steady state"):
            rock.respond(well, (), (), method=method)
        return
    system = rock.assembled(sites(well), ())
    late = 1e5 * step_limit(system)
    found = rock.respond(well, (), (0.5 * late, 0.75 * late, late), method=method)
    total = system.storage.sum()
    node = system.node_of_domain[found.domain]
    pores = (node >= 0) & (node < system.pores)
    mean = found.pressure[0][:, pores] @ system.storage[node[pores]] / total
    np.testing.assert_allclose(mean, -found.lag / total, rtol=1e-9)
    slope = np.diff(found.pressure[0][1:, node >= 0], axis=0) / np.diff(found.lag[1:])[:, None]
    np.testing.assert_allclose(slope, -1 / total, rtol=1e-4)
