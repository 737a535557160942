"""Sides with a given inflow: what continua, dense solutions and held sides say of them."""

import numpy as np
import pytest

from demflow.model.analytic.lattice import SQUARE_POROSITY, square_permeability
from demflow.model.analytic.linear import linear_flux_response, linear_pressure
from demflow.model.controls import sites
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.outcome import ModelError
from demflow.model.region import Rectangle
from demflow.model.scene import Inflow, InflowSide, Probe, SceneError, Trace, Well
from tests.reservoirs import exact_response, reservoir
from tests.rocks import random_graph, square_lattice

MU, K_F, W = 1e-3, 1e9, 1e-5
transient = pytest.mark.parametrize("method", [m for m, s in SOLVERS.items() if s.transient])
REGION = Rectangle(2.0, 1.4)
TRACES = (
    Trace(name="out", start=(-1.1, -0.3), end=(0.5, 0.4), aperture=2e-4),
    Trace(name="in", start=(-0.2, 0.5), end=(0.7, 0.1), aperture=1e-4),
)
ROCK = reservoir(random_graph(1.2, 300, 3), REGION, 2e-5, TRACES)
WELL = Well(name="w", at=(0.4, -0.3), radius=0.1, rate=1e-6, skin_factor=2.0)
STORES = Well(name="s", at=(-0.3, -0.45), radius=0.1, rate=-3e-7, wellbore_storage=1e-10)


def constant(name, inflow):
    return InflowSide(name, ((0.0, -inflow),))


@transient
@pytest.mark.parametrize("sealed", [False, True])
def test_constant_flux_into_a_slab(method, sealed):
    """A lattice, from a half-space to the steady or the pseudo-steady state."""
    radius = 1 / 60
    rock = reservoir(square_lattice(1.1, radius), Rectangle(2.0, 0.2), W)
    k = square_permeability(W, radius)
    diffusivity = k * K_F / (SQUARE_POROSITY * MU)
    times = np.geomspace(1e-2, 2.0, 12) * 4 / diffusivity
    places = np.linspace(-0.9, 0.9, 7)
    probes = tuple(Probe(f"{x}", (float(x), 0.01)) for x in places)
    flux = 1e-6
    seen = rock.observed(
        (constant("left", flux * 0.2),),
        () if sealed else (("right", 0.0),),
        0.0,
        tuple(times),
        method=method,
        probes=probes,
        tolerance=1e-5,
    )

    def expected(x):
        rise = linear_flux_response(x, times, length=2.0, diffusivity=diffusivity, sealed=sealed)
        return flux * MU / k * rise

    np.testing.assert_allclose(seen["boundary_pressure"][-1], expected(0.0), rtol=6e-3)
    inside = np.array([expected(1.0 + x) for x in places])
    size = expected(0.0)[-1]
    np.testing.assert_allclose(seen["probe_pressure"], inside, atol=4e-3 * size)
    np.testing.assert_array_equal(seen["boundary_flow"][-1], flux * 0.2)
    assert seen["mass_balance_error"] < 1e-10


def test_the_closed_form_ends_in_straight_lines_and_begins_as_a_half_space():
    x, length, alpha = np.linspace(0.0, 3.0, 7), 3.0, 0.7
    held = linear_flux_response(x, 200.0, length=length, diffusivity=alpha, sealed=False)
    np.testing.assert_allclose(held, length - x, atol=1e-12)
    late = linear_flux_response(x, 200.0, length=length, diffusivity=alpha, sealed=True)
    parabola = alpha * 200.0 / length + (3 * (length - x) ** 2 - length**2) / (6 * length)
    np.testing.assert_allclose(late, parabola, rtol=1e-12)
    early = linear_flux_response(0.0, 1e-3, length=length, diffusivity=alpha, sealed=True)
    assert early == pytest.approx(2 * np.sqrt(alpha * 1e-3 / np.pi), rel=1e-12)
    # the flux that a held side lets in, superposed in small steps, gives its pressure back
    times = np.linspace(0.0, 4.0, 2001)[1:]
    step = 1e-6
    near = [
        linear_pressure(d, times, length=3.0, diffusivity=alpha, initial=0, first=1.0, second=0)
        for d in (0.0, step)
    ]
    flux = (near[0] - near[1]) / step
    changes = np.diff(flux, prepend=0.0)
    rise = linear_flux_response(
        0.0, 4.0 - times[:-1] + 0.5 * times[0], length=3.0, diffusivity=alpha, sealed=False
    )
    assert float(changes[:-1] @ rise) == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
@transient
def test_transients_are_those_of_a_dense_solution(method):
    """Two inflows that change, a held side, wells with skin and storage, traces to the rim."""
    limit = step_limit(ROCK.assembled((), ("right",)))
    times = np.geomspace(300, 2e4, 8) * limit
    turn = float(times[3])
    left = InflowSide("left", ((0.0, -2e-6), (turn, 5e-7)))
    top = InflowSide("top", ((0.5 * turn, -4e-7),))
    wells = (WELL, STORES, left, top)
    seen = ROCK.observed(
        wells, (("right", 3.0),), 0.0, tuple(times), method=method, safety_factor=0.2,
        tolerance=1e-7,
    )  # fmt: skip
    system = ROCK.assembled(sites(wells), ("right",))
    steps = [(0, 0.0, 3.0)]
    for k, well in enumerate(wells, 1):
        before = 0.0
        for time, q in well.rate_changes:
            steps.append((k, time, q - before))
            before = q
    exact = np.zeros((len(times), system.n))
    for source, start, size in steps:
        acts = times > start
        exact[acts] += size * exact_response(system, source, times[acts] - start)
    exact = exact[:, system.well_node].T
    scale = np.abs(exact).max(axis=1, keepdims=True)
    found = np.concatenate([seen["well_pressure"], seen["boundary_pressure"][1:]])
    bound = 2e-3 if method == "explicit" else 1e-6
    np.testing.assert_allclose(found / scale, exact / scale, atol=bound)
    assert list(seen["boundary_pressure"][0]) == [3.0] * len(times)
    np.testing.assert_array_equal(
        seen["boundary_flow"][1:],
        [[2e-6] * 4 + [-5e-7] * 4, np.where(times > 0.5 * turn, 4e-7, 0.0)],
    )
    assert seen["mass_balance_error"] < 1e-10


@pytest.mark.parametrize("times", [(), (1e9,)])
def test_what_a_held_side_lets_in_gives_its_pressure_back(times):
    held = ROCK.observed((WELL,), (("right", 3.0), ("left", 8.0)), 0.0, times, tolerance=1e-10,
                         method="krylov" if times else "steady")  # fmt: skip
    inflow = float(np.ravel(held["boundary_flow"][1])[0])
    seen = ROCK.observed((WELL, constant("left", inflow)), (("right", 3.0),), 0.0, times,
                         tolerance=1e-10, method="krylov" if times else "steady")  # fmt: skip
    np.testing.assert_allclose(seen["boundary_pressure"][1], 8.0, rtol=1e-8)
    np.testing.assert_allclose(seen["boundary_flow"], held["boundary_flow"], rtol=1e-8)
    np.testing.assert_allclose(seen["well_pressure"], held["well_pressure"], rtol=1e-8)
    assert seen["mass_balance_error"] < 1e-10


def test_inflows_of_a_closed_rock_fill_its_pores():
    """All that flows in is stored, whatever the way: C Δp = q t at last, and in the mean."""
    t = 1e7
    inflows = (constant("left", 1e-9), constant("bottom", -4e-10))
    seen = ROCK.observed(inflows, (), 0.0, (t,), tolerance=1e-8)
    system = ROCK.assembled(sites(inflows), ())
    mean = 6e-10 * t / system.storage.sum()
    assert mean == pytest.approx(seen["boundary_pressure"].mean(), rel=1e-3)
    assert seen["mass_balance_error"] < 1e-10


def test_a_side_that_nothing_joins_is_told():
    sealed = reservoir(random_graph(1.2, 200, 3), REGION, 0.0, TRACES[1:])
    well = Well(name="w", at=(0.3, 0.27), radius=0.1, rate=1e-6)
    with pytest.raises(ModelError, match="a side with an inflow"):
        sealed.observed((well, constant("left", 1e-6)), (), 0.0, (1.0,))


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"inflow": 1e-6, "flux": 1e-7},
        {"schedule": ()},
        {"schedule": ((1.0, 1e-6), (0.5, 0.0))},
        {"flux": np.nan},
    ],
)
def test_an_inflow_is_given_once_and_in_order(given):
    with pytest.raises(SceneError):
        Inflow(**given)


def test_a_side_whose_inflow_goes_nowhere_is_told():
    wall = Trace(name="wall", start=(0.0, -1.0), end=(0.0, 1.0), transmissibility_multiplier=0.0)
    rock = reservoir(random_graph(1.2, 300, 3), REGION, 2e-5, (wall,))
    with pytest.raises(ModelError, match="a side with an inflow, feeds pores that reach no fixed"):
        rock.observed((constant("left", 1e-6),), (("right", 1e7),), method="steady")
