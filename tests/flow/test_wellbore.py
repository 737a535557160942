"""Skin and wellbore storage in the network: every solver against dense and Laplace solutions."""

import math

import numpy as np
import pytest

from demflow.model.analytic.wellbore import well_with_storage_and_skin
from demflow.model.controls import sites
from demflow.model.flow.solvers.explicit import step_limit
from demflow.model.flow.solvers.registry import SOLVERS
from demflow.model.outcome import ModelError
from demflow.model.permeability import permeability
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import SceneError, Trace, Well
from tests.flow.bounds import OFF
from tests.reservoirs import exact_response, reservoir
from tests.rocks import hexagonal_lattice, random_graph, square_lattice

every = pytest.mark.parametrize("method", SOLVERS)
transient = pytest.mark.parametrize("method", [m for m, s in SOLVERS.items() if s.transient])
R = 0.05
SCATTERED = random_graph(1.2, 700, 3)
ROCK = reservoir(SCATTERED._replace(radius=0.5 * SCATTERED.radius), Rectangle(2.0, 1.4), 2e-5)
PORE = float(ROCK.assembled((), ("left",)).storage.mean())
WELLS = (
    Well(name="stores", at=(-0.4, 0.2), radius=0.12, rate=1.0, wellbore_storage=30 * PORE),
    Well(name="plain", at=(0.6, -0.3), radius=0.01, rate=1.0, skin_factor=4.0),
    Well(
        name="both", at=(0.5, 0.4), radius=0.1, rate=1.0, skin_factor=2.0, wellbore_storage=5 * PORE
    ),
    Well(name="held", at=(0.1, -0.45), radius=0.06, pressure=1.0, skin_factor=3.0),
)
SIDES = ("left",)


def well(**more):
    return Well(name="w", **{"at": (0.0, 0.0), "radius": 0.12, "rate": 1.0, **more})


@pytest.mark.slow
@transient
def test_agrees_with_a_dense_eigen_solution(method):
    """Wells that store stand between pores and wells that do not, in any order of the scene."""
    system = ROCK.assembled(sites(WELLS), SIDES)
    assert system.pores == len(system.domain) + 2
    assert system.storage[system.well_node].tolist() == [30 * PORE, 0.0, 5 * PORE]
    limit = step_limit(system)
    times = np.geomspace(100, 1e4, 7) * limit
    found = ROCK.respond(WELLS, SIDES, times, method=method, tolerance=1e-9, safety_factor=0.25)
    nodes = system.node_of_domain[found.domain]
    for source in range(system.source_count):
        exact = exact_response(system, source, found.lag)
        for k, node in enumerate(system.well_node):
            scale = np.abs(exact[:, system.well_node]).max()
            np.testing.assert_allclose(
                found.output[source, :, k], exact[:, node], atol=OFF[method].wellbore * scale
            )
        field = found.pressure[source][:, nodes >= 0]
        np.testing.assert_allclose(
            field, exact[:, nodes[nodes >= 0]], atol=OFF[method].wellbore * np.abs(exact).max()
        )


@pytest.mark.slow
@transient
def test_mass_is_kept_with_what_the_wellbores_hold(method):
    limit = step_limit(ROCK.assembled(sites(WELLS), SIDES))
    seen = ROCK.observed(WELLS, (("left", 2.0),), 1.0, (50 * limit, 2000 * limit), method=method)
    assert seen["mass_balance_error"] <= 1e-10


@transient
def test_early_the_wellbore_alone_empties(method):
    """p = q t / C with slope 1, until the rock answers."""
    one = (well(wellbore_storage=1e4 * PORE),)
    limit = step_limit(ROCK.assembled(sites(one), SIDES))
    seen = ROCK.observed(one, (("left", 0.0),), 0.0, (limit, 4 * limit), method=method)
    expected = -np.array([limit, 4 * limit]) / (1e4 * PORE)
    np.testing.assert_allclose(seen["well_pressure"][0], expected, rtol=0.02)


def test_storage_changes_no_steady_state_and_skin_adds_to_it_what_it_should():
    """The fall grows by q S / (2π k/μ), in proportion to S, also where the well is narrow."""
    rock = reservoir(square_lattice(1.3, 0.02, (0.02, 0.02)), Circle(1.0))
    k = 1e-15 / (24 * 0.02) / 1e-3
    for radius in (1e-3, 0.12):
        fall = {}
        for skin in (0.0, 3.0, 50.0):
            for storage in (0.0, 1e-3):
                told = well(radius=radius, skin_factor=skin, wellbore_storage=storage)
                seen = rock.observed((told,), (("outer", 0.0),), method="steady")
                fall[skin, storage] = -seen["well_pressure"][0]
            assert fall[skin, 0.0] == fall[skin, 1e-3]
        added = [fall[skin, 0.0] - fall[0.0, 0.0] for skin in (3.0, 50.0)]
        assert added[1] / added[0] == pytest.approx(50 / 3, rel=1e-9)
        assert added[0] == pytest.approx(3.0 / (2 * math.pi * k), rel=2e-3)


@pytest.mark.parametrize("seed", [1, 2])
def test_skin_adds_its_multiple_of_the_radial_unit(seed):
    """Δp_skin = q S / (2π k/μ) with the measured permeability, at a rate and at a pressure."""
    rock = reservoir(random_graph(1.1, 4000, seed), Circle(1.0))
    k = 0.5 * np.trace(permeability(rock.network, rock.apertures, viscosity=1e-3)) / 1e-3
    rim = (("outer", 0.0),)
    plain, hurt = (
        -rock.observed((well(skin_factor=s),), rim, method="steady")["well_pressure"][0]
        for s in (0.0, 5.0)
    )
    assert hurt - plain == pytest.approx(5.0 / (2 * math.pi * k), rel=0.1)
    held = Well(name="w", at=(0.0, 0.0), radius=0.12, pressure=-1.0, skin_factor=5.0)
    taken = rock.observed((held,), rim, method="steady")["well_rate"][0]
    assert taken == pytest.approx(1.0 / hurt, rel=1e-10)


@pytest.mark.slow
@every
def test_a_skin_leaves_the_field_around_the_well_as_it_was(method):
    """Only the well's own pressure feels it: all that it takes passes the skin."""
    limit = step_limit(ROCK.assembled((), SIDES))
    times = (300 * limit, 3000 * limit) if SOLVERS[method].transient else ()
    plain, hurt = (
        ROCK.respond((well(skin_factor=s),), SIDES, times, method=method) for s in (0.0, 7.0)
    )
    covered = np.hypot(ROCK.network.x, ROCK.network.y)[plain.domain] < 0.12
    scale = np.abs(plain.pressure[1]).max()
    np.testing.assert_allclose(
        hurt.pressure[1][:, ~covered], plain.pressure[1][:, ~covered], atol=1e-7 * scale
    )
    added = hurt.output[1, 1:, 0] - plain.output[1, 1:, 0]
    assert np.all(added < -0.1 * scale)
    np.testing.assert_allclose(added, added[-1:].repeat(len(added)), rtol=1e-6)


def test_a_stimulated_well_is_a_wider_one():
    rock = reservoir(hexagonal_lattice(1.1, 1 / 40), Circle(1.0))
    rim = (("outer", 0.0),)
    stimulated = well(radius=0.1, skin_factor=-math.log(2.0))
    assert stimulated.effective_radius == pytest.approx(0.2)
    one, two = (
        rock.observed((w,), rim, 0.0, (1.0, 100.0))["well_pressure"]
        for w in (stimulated, well(radius=stimulated.effective_radius))
    )
    np.testing.assert_array_equal(one, two)


@pytest.mark.slow
@pytest.mark.parametrize(("skin", "C_D"), [(0.0, 20.0), (5.0, 20.0), (5.0, 300.0), (20.0, 2.0)])
def test_follows_the_laplace_space_solution(skin, C_D):
    """van Everdingen & Hurst with storage and skin, rim at constant pressure, over six decades."""
    packing = hexagonal_lattice(1.1, 1 / 70)
    rock = reservoir(packing._replace(radius=packing.radius), Circle(1.0))
    radius, viscosity = 0.1, 1e-3
    k = 0.5 * np.trace(permeability(rock.network, rock.apertures, viscosity=viscosity))
    c = 1 / rock.bulk_modulus
    unit = rock.network.porosity * viscosity * c * radius**2 / k  # s for t_D = 1
    storage = C_D * 2 * math.pi * rock.network.porosity * c * radius**2
    told = well(radius=radius, skin_factor=skin, wellbore_storage=storage)
    t_D = np.geomspace(0.05, 1e4, 25)
    seen = rock.observed((told,), (("outer", 0.0),), 0.0, tuple(t_D * unit), tolerance=1e-7)
    p_D = -seen["well_pressure"][0] * 2 * math.pi * k / viscosity
    expected = well_with_storage_and_skin(t_D, C_D, skin, R_De=10.0)
    np.testing.assert_allclose(p_D, expected, rtol=0.01)


@every
def test_a_skin_that_no_pipe_of_the_rock_could_feel_is_refused(method):
    trace = (Trace(name="t", aperture=1e-4, start=(-1.5, 0.01), end=(1.5, 0.01)),)
    rock = reservoir(random_graph(1.3, 400, 2), Rectangle(2.0, 1.4), 0.0, trace)
    told = (Well(name="w", at=(0.2, 0.01), radius=0.1, rate=1e-11, skin_factor=1.0),)
    times = (1.0,) if SOLVERS[method].transient else ()
    with pytest.raises(ModelError, match="skin_factor"):
        rock.observed(told, (("left", 0.0),), times=times, method=method)


def test_a_well_at_a_pressure_has_no_use_for_storage():
    with pytest.raises(SceneError, match="wellbore_storage"):
        Well(name="w", at=(0.0, 0.0), radius=0.1, pressure=1.0, wellbore_storage=1e-9)
