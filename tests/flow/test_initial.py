"""Starts other than one pressure everywhere: a linear field, and the state of rest."""

import numpy as np
import pytest

from demflow.model.controls import Controls, active_sources, controls_of, sites
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.initial import STARTS
from demflow.model.flow.solvers.registry import SOLVERS, flow
from demflow.model.history import superposed, superposed_map
from demflow.model.observe import observe_flow
from demflow.model.outcome import ModelError
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import (
    Fluid,
    Grains,
    InitialField,
    Matrix,
    Probe,
    Scene,
    SceneError,
    Solver,
    Trace,
    Well,
)
from tests.flow.bounds import OFF
from tests.reservoirs import dense_matrices, reservoir
from tests.rocks import random_graph, square_lattice

transient = pytest.mark.parametrize("method", [m for m, s in SOLVERS.items() if s.transient])
REGION = Rectangle(2.0, 1.4)
SCATTERED = random_graph(1.2, 500, 3)
ROCK = reservoir(SCATTERED._replace(radius=0.5 * SCATTERED.radius), REGION, 2e-5)
LIMIT = step_limit(ROCK.assembled((), ("left",)))
SHUT = Well(name="shut", at=(0.3, 0.2), radius=0.15, rate=0.0)
STORES = Well(name="stores", at=(-0.4, -0.2), radius=0.1, rate=0.0, wellbore_storage=1e-10)
HELD = Well(name="held", at=(0.5, -0.4), radius=0.08, pressure=0.0)
PROBES = (Probe("one", (-0.1, 0.4)),)
GRADIENT = (3e5, -1e5)


def controls(wells, boundaries, times, start, gradient=(0.0, 0.0), reference=0.0):
    pressures = tuple(p for _, p in boundaries)
    return Controls(reference, reference, pressures, wells, times, True, start, gradient)


def run(asked, sides, rock=ROCK, region=REGION, method="krylov", tolerance=1e-7, probes=PROBES):
    """The flow stage and what is observed, as `model.stages` wires them."""
    fields = 2 if asked.start == "gradient" else 0
    responses = flow(
        rock.network,
        rock.apertures,
        region=region,
        bulk_modulus=rock.bulk_modulus,
        wells=sites(asked.wells),
        sides=sides,
        active=(True,) * (len(sides) + len(asked.wells) + fields),
        probes=probes,
        times=asked.times,
        method=method,
        tolerance=tolerance,
        safety_factor=0.5,
        record_map=True,
        initial=asked.start,
    )
    history = superposed(responses, asked)
    return observe_flow(history, asked), superposed_map(responses, asked), responses


@pytest.mark.slow
@transient
@pytest.mark.parametrize("sides", [("left",), ()])
def test_a_linear_field_decays_as_the_eigen_solution_says(method, sides):
    """Between a held side and wells that are shut, store, or keep a pressure; and sealed."""
    wells = (SHUT, STORES, HELD) if sides else (SHUT, STORES)
    times = tuple(np.geomspace(200, 2e4, 6) * LIMIT)
    asked = controls(wells, tuple((s, 0.0) for s in sides), times, "gradient", GRADIENT)
    seen, maps, responses = run(asked, sides, method=method)
    system = ROCK.assembled(sites(wells), sides)
    matrix, storage = dense_matrices(system)
    m, root = system.pores, np.sqrt(storage)
    x = np.append(ROCK.network.x[system.domain], [0.0, 0.0])
    y = np.append(ROCK.network.y[system.domain], [0.0, 0.0])
    x[system.well_node], y[system.well_node] = (0.3, -0.4), (0.2, -0.2)
    start = GRADIENT[0] * x + GRADIENT[1] * y
    shut = np.linalg.inv(matrix[m:, m:])
    reduced = matrix[:m, :m] - matrix[:m, m:] @ shut @ matrix[m:, :m]
    decay, modes = np.linalg.eigh(reduced / np.outer(root, root))
    weight = modes.T @ (root * start[:m])
    exact = np.exp(-np.outer(times, decay)) * weight @ modes.T / root
    exact = np.column_stack([exact, -exact @ matrix[:m, m:] @ shut.T])
    error = OFF[method].initial * np.abs(start).max()
    node = system.node_of_domain[responses.domain]
    np.testing.assert_allclose(maps[:, node >= 0], exact[:, node[node >= 0]], atol=error)
    np.testing.assert_allclose(seen["well_pressure"][:2], exact[:, system.well_node].T, atol=error)
    assert seen["mass_balance_error"] <= 1e-10
    assert np.abs(exact[0]).max() > 0.2 * np.abs(start).max()
    if sides:  # what leaves by the side and by the well that keeps its pressure
        flow_in = -(
            exact
            @ np.bincount(
                system.fixed_node[system.fixed_source == 0],
                weights=system.fixed_g[system.fixed_source == 0],
                minlength=system.n,
            )
        )
        scale = np.abs(flow_in).max()
        np.testing.assert_allclose(
            seen["boundary_flow"][0], flow_in, atol=100 * OFF[method].initial * scale
        )
    else:  # sealed: all comes to the mean
        late, _, _ = run(controls(wells, (), (1e8 * LIMIT,), "gradient", GRADIENT), ())
        mean = storage @ start[:m] / storage.sum()
        np.testing.assert_allclose(late["well_pressure"][:, 0], mean, rtol=1e-6)


def test_a_field_that_its_boundaries_hold_stays():
    """On a square lattice a linear pressure is at rest between its own values."""
    rock = reservoir(square_lattice(1.3, 0.05, (0.05, 0.05)), REGION)
    asked = controls((), (("left", 1e5), ("right", 5e5)), (1.0, 1e4), "gradient", (2e5, 0.0), 3e5)
    seen, maps, responses = run(asked, ("left", "right"), rock)
    expected = 3e5 + 2e5 * rock.network.x[responses.domain]
    np.testing.assert_allclose(maps, np.stack([expected] * 2), rtol=1e-6)
    np.testing.assert_allclose(seen["boundary_flow"].sum(axis=0), 0.0, atol=1e-12)


@transient
def test_from_rest_a_well_changes_what_it_would_change_anywhere(method):
    """Between two pressures: the change is that from a uniform start, and before it nothing."""
    begin, late = 50 * LIMIT, 2000 * LIMIT
    well = Well(name="w", at=(0.3, 0.2), radius=0.15, schedule=((begin, 2e-6), (8 * begin, -1e-6)))
    times = (0.5 * begin, begin, 4 * begin, 20 * begin, late)
    wells, rim = (well, HELD), (("left", 4e5), ("top", 1e5))
    seen, maps, _ = run(controls(wells, rim, times, "steady"), ("left", "top"), method=method)
    rest = ROCK.observed(
        (Well(name="w", at=well.at, radius=well.radius, rate=0.0), HELD),
        rim,
        method="steady",
        probes=PROBES,
    )
    level = (("left", 0.0), ("top", 0.0))
    plain = ROCK.observed(
        wells, level, 0.0, times, method=method, probes=PROBES, tolerance=1e-7, safety_factor=0.5
    )
    scale = np.abs(plain["well_pressure"]).max() + 4e5
    for name in ("well_pressure", "probe_pressure", "boundary_flow", "well_rate"):
        size = scale if "pressure" in name else np.abs(rest["boundary_flow"]).max()
        expected = plain[name] + rest[name][:, None]
        if name == "well_rate":
            expected[0] = plain[name][0]
        if name == "well_pressure":
            expected[1] = 0.0
        np.testing.assert_allclose(seen[name], expected, atol=3e-6 * size, err_msg=name)
    np.testing.assert_array_equal(maps[0], maps[1])
    assert seen["mass_balance_error"] <= 1e-10
    np.testing.assert_allclose(
        seen["pressure_change"][0, 2:], plain["pressure_change"][0, 2:], atol=3e-6 * scale
    )
    assert np.all(np.isnan(seen["pressure_change"][0, :2]))


def test_no_rest_where_a_well_is_cut_off_from_every_pressure():
    wall = (Trace(name="wall", transmissibility_multiplier=0.0, start=(0.0, -1.0), end=(0.0, 1.0)),)
    rock = reservoir(SCATTERED, REGION, 2e-5, wall)
    asked = controls((SHUT,), (("left", 1.0),), (1.0,), "steady")
    with pytest.raises(ModelError, match="initial_pressure"):
        run(asked, ("left",), rock, probes=())


def scene(**more):
    given = {
        "region": Circle(14.0),
        "grains": Grains(count=100, packing="square"),
        "matrix": Matrix(aperture=1e-5),
        "fluid": Fluid(1e-3, 1e9),
        "observe": ("well_pressure",),
        "wells": (Well(name="w", at=(0.0, 0.0), radius=1.0, rate=1e-6),),
        "boundaries": (("outer", 5e6),),
        "initial_pressure": 7e6,
        "times": (1.0, 10.0),
    }
    return Scene(**{**given, **more})


def test_controls_and_sources_follow_the_start():
    field = InitialField(pressure=5e6, gradient=(0.0, -1e4), at=(3.0, 2.0))
    one = scene(initial_pressure=field)
    assert (one.start, one.uniform_pressure) == ("gradient", None)
    assert controls_of(one).reference == 5e6 + 2e4
    assert controls_of(one).initial_weights == (0.0, -1e4)
    assert active_sources(one) == (True, True, False, True)
    rest = scene(initial_pressure="steady")
    assert rest.start == "steady"
    assert controls_of(rest).initial_weights == (0.0,)
    assert active_sources(rest) == (False, True)
    assert scene().start == "uniform"
    assert scene(times=(), initial_pressure=None).start == "uniform"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"initial_pressure": "stedy"}, "neither a pressure nor steady"),
        ({"initial_pressure": "steady", "boundaries": ()}, "no steady state to start from"),
        (
            {
                "initial_pressure": "steady",
                "wells": (Well(name="w", at=(0.0, 0.0), radius=1.0, pressure=1e6),),
            },
            "nothing changes",
        ),
        ({"initial_pressure": "steady", "times": ()}, "starts from nothing"),
        (
            {
                "initial_pressure": InitialField(1.0, (1.0, 0.0)),
                "times": (),
                "solver": Solver(method="steady"),
            },
            "starts from nothing",
        ),
    ],
)
def test_starts_that_mean_nothing_are_refused(more, message):
    with pytest.raises(SceneError, match=message):
        scene(**more)


def test_every_start_is_known_to_the_flow_stage():
    assert set(STARTS) == {"uniform", "gradient", "steady"}
    asked = controls((SHUT,), (("left", 1.0),), (1.0,), "uniform")._replace(start="sometimes")
    with pytest.raises(ModelError, match="no start"):
        run(asked, ("left",))
