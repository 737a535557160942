"""Coupled scenes through the public door: what they give, share, and refuse."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from demflow.model.maps import case_maps
from demflow.model.outcome import ModelError
from demflow.model.region import Circle, Rectangle
from demflow.model.scene import (
    Bonds,
    Coupling,
    Fluid,
    Grains,
    InitialField,
    Matrix,
    Probe,
    Scene,
    SceneError,
    Solver,
    Stress,
    Trace,
    Well,
)
from demflow.model.stages import STAGES, run_stages, simulate

pytestmark = pytest.mark.usefixtures("packed_once")

CEMENT = Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9)
SCENE = Scene(
    region=Rectangle(1.6, 1.2),
    grains=Grains(count=192, packing="square", modulus=2e10),
    matrix=Matrix(aperture=2e-5),
    fluid=Fluid(1e-3, 2.2e9),
    bonds=CEMENT,
    wells=(
        Well(name="w", at=(0.3, 0.1), radius=0.02, schedule=((0.0, 1e-6), (20.0, -1e-6))),
        Well(name="v", at=(-0.4, 0.0), radius=0.02, pressure=6e6),
    ),
    boundaries=(("top", 7e6),),
    probes=(Probe("p", (0.0, -0.3)),),
    initial_pressure=7e6,
    coupling=Coupling(method="linear", schedule_yy=((0.0, 1e6), (5.0, 3e5))),
    times=(0.1, 1.0, 10.0, 100.0),
    observe=("well_pressure", "probe_pressure", "boundary_flow", "wall_displacement",
             "effective_stress", "pressure_map"),
)  # fmt: skip


@cache
def seen() -> dict[str, np.ndarray]:
    """What the scene gives, once for all that look at it."""
    return simulate(SCENE)


def changed(**fields):
    return dataclasses.replace(SCENE, **fields)


def coupled(**fields):
    return changed(coupling=dataclasses.replace(SCENE.coupling, **fields))


def test_every_volume_is_accounted_for_and_no_principle_of_rigid_rock_is_claimed():
    assert seen()["mass_balance_error"] <= 1e-12
    assert seen()["residual"] <= 1e-9
    assert seen()["estimated_error"] <= 1e-4
    assert seen()["isolated_domains"] == 0
    assert "range_error" not in seen()  # pressure may leave the range of its sources
    assert "flow_balance_error" not in seen()


def test_the_march_gives_the_same():
    other = simulate(changed(solver=Solver(method="implicit", tolerance=1e-5)))
    for name in ("well_pressure", "probe_pressure", "wall_displacement", "effective_stress"):
        size = np.abs(seen()[name] - seen()[name][..., :1]).max()
        assert np.abs(other[name] - seen()[name]).max() <= 1e-3 * size, name
    assert other["mass_balance_error"] <= 1e-9
    assert str(other["solver_used"]) == "coupled implicit"


def test_rates_loads_and_schedules_are_sums_and_share_one_transient():
    def change(scene):
        found = simulate(scene)
        return found["probe_pressure"] - 7e6, found["wall_displacement"]

    still = changed(wells=(dataclasses.replace(SCENE.wells[0], schedule=((0.0, 0.0),)),
                           dataclasses.replace(SCENE.wells[1], pressure=7e6)))  # fmt: skip
    no_load = changed(coupling=Coupling(method="linear"))
    loaded = change(still)
    flowing = change(no_load)
    for both, one, other in zip(change(SCENE), loaded, flowing, strict=True):
        assert both == pytest.approx(one + other, rel=1e-4, abs=1e-4 * np.abs(both).max())
    (stage,) = (stage for stage in STAGES if stage.name == "consolidate")
    heavier = coupled(schedule_yy=((0.0, 2e6), (5.0, 1e6)))
    assert stage.given(heavier) == stage.given(SCENE)
    assert stage.given(coupled(schedule_yy=((0.0, 2e6), (6.0, 1e6)))) != stage.given(SCENE)


def test_a_load_sinks_the_wall_and_its_bearer_changes_from_fluid_to_grains():
    scene = changed(wells=(), coupling=Coupling(method="linear", held="right", load_yy=1e6),
                    observe=("wall_displacement", "effective_stress", "probe_pressure"),
                    times=tuple(np.geomspace(1e-4, 1e3, 29)))  # fmt: skip
    found = simulate(scene)
    left, right, bottom, top = found["wall_displacement"]
    for wall in (left, right, bottom):
        assert not wall.any()
    assert np.all(np.diff(top) <= 1e-12 * np.abs(top).max())
    assert np.all(top < 0.0)
    _, yy, _ = found["effective_stress"]
    assert yy[-1] == pytest.approx(1e6, rel=1e-6)
    assert yy[0] < 0.9 * yy[-1]
    assert found["probe_pressure"][0, 0] > 7e6
    assert found["probe_pressure"][0, -1] == pytest.approx(7e6, rel=1e-6)


def test_a_stress_stands_below_the_effective_stress_and_closes_pipes_at_walls_too():
    grains = Grains(count=800, porosity=0.17, seed=2, modulus=2e10)
    scene = changed(
        region=Rectangle(1.0, 1.0), grains=grains, stress=Stress(2e7, 1e7), wells=(), probes=(),
        matrix=Matrix(aperture=2e-5, half_stress=1e7), observe=("effective_stress",),
        coupling=Coupling(method="linear", load_yy=1e5),
    )  # fmt: skip
    products = run_stages(scene)
    net, opened, state = products["network"], products["open"], products["stress"]
    found = products["observe"]["effective_stress"]
    assert found[:2, -1] == pytest.approx(state.stress[:2] + np.array([0.0, 1e5]), rel=1e-3)
    at_wall = net.pipe_grain_b >= len(products["pack"].x)
    assert at_wall.sum() > 50
    # a wall presses a grain about as hard as its neighbours do
    closed = opened.aperture / 2e-5
    assert closed[at_wall].mean() == pytest.approx(closed[~at_wall].mean(), rel=0.2)
    press = 1e7 * (1.0 / closed - 1.0) * 2.0 * net.grain_radius[net.pipe_grain_a]
    foot = net.pipe_grain_b[at_wall]
    box = products["pack"].box
    for axis, wall, stress, length in ((1, 3, 1e7, 1.0), (0, 1, 2e7, 1.0)):
        place = (net.grain_x, net.grain_y)[axis]
        on = np.flatnonzero(at_wall)[place[foot] == place.max()]
        assert press[on].sum() == pytest.approx(stress * length, rel=0.05), (axis, wall)
    assert box[1] - box[0] == pytest.approx(1.0, rel=0.03)


def test_maps_and_initial_fields():
    still = {"initial_pressure": InitialField(7e6, (1e4, -2e4)), "wells": (), "probes": (),
             "coupling": Coupling(method="linear"), "times": (1e-6, 1e6),
             "observe": ("pressure_map", "wall_displacement")}  # fmt: skip
    with pytest.raises(SceneError, match="nothing moves the fluid"):
        changed(**still, boundaries=())
    scene = changed(**still)
    products = run_stages(scene)
    maps = case_maps(scene, products)
    held = maps["y"] > maps["y"].max() - 0.06
    linear = 7e6 + 1e4 * maps["x"] - 2e4 * maps["y"]
    first, last = maps["pressure"]
    assert first[~held] == pytest.approx(linear[~held], rel=1e-6)
    assert last == pytest.approx(7e6, rel=1e-6)
    whole = case_maps(SCENE, run_stages(SCENE))
    assert np.isfinite(whole["pressure"]).all()


@pytest.mark.parametrize(
    ("fields", "path", "what"),
    [
        ({"region": Circle(1.0)}, "coupling", "rectangle"),
        ({"bonds": None}, "bonds", "add bonds"),
        ({"grains": Grains(count=192, packing="square")}, "grains.modulus", "modulus"),
        ({"grains": Grains(count=192, packing="periodic", porosity=0.17, modulus=2e10)},
         "grains.packing", "walls"),
        ({"times": ()}, "coupling", "give times"),
        ({"solver": Solver(method="explicit")}, "solver.method", "krylov"),
        ({"coupling": None}, "observe", "add coupling: linear"),
        ({"coupling": Coupling(method="none")}, "observe", "add coupling: linear"),
        ({"initial_pressure": "steady", "boundaries": (("top", 7e6),)}, "initial_pressure",
         "one pressure"),
        ({"observe": ("time_error", "well_pressure")}, "observe", "estimated_error"),
        ({"observe": ("permeability",),
          "fractures": (Trace(name="t", start=(0.0, 0.0), end=(0.3, 0.0), aperture=1e-4),)},
         "observe", "without fractures"),
    ],
)  # fmt: skip
def test_what_does_not_go_with_coupling_is_refused(fields, path, what):
    with pytest.raises(SceneError) as caught:
        changed(**fields)
    assert any(where == path and what in text for where, text in caught.value.problems), (
        caught.value.problems
    )


@pytest.mark.parametrize(
    ("fields", "path"),
    [
        ({"load_yy": 1e6, "schedule_yy": ((0.0, 1e6),)}, "schedule_yy"),
        ({"load_xx": 1e6, "held": "right"}, "load_xx"),
        ({"schedule_xx": ()}, "schedule_xx"),
        ({"schedule_yy": ((2.0, 1e6), (1.0, 0.0))}, "schedule_yy"),
        ({"schedule_yy": ((0.0, float("nan")),)}, "schedule_yy"),
    ],
)
def test_loads_that_cannot_be_are_refused(fields, path):
    with pytest.raises(SceneError) as caught:
        Coupling(method="linear", **fields)
    assert path in [where for where, _ in caught.value.problems]


def test_a_region_that_no_specimen_fills_is_refused():
    grains = Grains(count=30, packing="square", modulus=2e10)
    with pytest.raises(ModelError, match="between walls is"):
        simulate(changed(grains=grains))


def test_a_rock_without_coupling_is_told_apart_in_nothing():
    """Stages read None of what only coupling has, and `none` is as if nothing was said."""
    plain = changed(coupling=None, bonds=None, observe=("well_pressure",), times=(1.0,))
    said = dataclasses.replace(plain, coupling=Coupling(method="none"))
    for stage in STAGES:
        if stage.wanted(plain):
            assert stage.given(plain) == stage.given(said)
            assert stage.given(plain).get("specimen") is None
            assert stage.given(plain).get("walled") is None
            assert stage.given(plain).get("loads") is None
    assert not any(s.name == "consolidate" for s in STAGES if s.wanted(plain))
