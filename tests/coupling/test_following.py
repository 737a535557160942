"""Apertures that follow forces: against the rule told beforehand, and against linear rock."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import quad

from demflow.model.coupling import following, told
from demflow.model.region import Rectangle
from demflow.model.scene import (
    Bonds,
    Coupling,
    Fluid,
    Grains,
    Matrix,
    Probe,
    Scene,
    SceneError,
    Solver,
    Stress,
    Well,
    one_way_ratio,
)
from demflow.model.stages import STAGES, run_stages, simulate

pytestmark = pytest.mark.usefixtures("packed_once")

STRESS, START = 1e7, 5e7
SCENE = Scene(
    region=Rectangle(1.0, 1.0),
    grains=Grains(count=300, porosity=0.17, seed=1, modulus=2e10),
    matrix=Matrix(aperture=2e-5, half_stress=STRESS),
    fluid=Fluid(1e-3, 2.2e9),
    bonds=Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9),
    stress=Stress(STRESS, STRESS),
    boundaries=(("left", START), ("right", START - 0.3 * STRESS)),
    initial_pressure=START,
    coupling=Coupling(method="apertures"),
    times=(0.1, 1.0, 1e4),
    solver=Solver(tolerance=1e-3),
    observe=("boundary_flow", "wall_displacement", "effective_stress"),
)


def changed(**fields):
    return dataclasses.replace(SCENE, **fields)


@pytest.mark.parametrize(("a", "x"), [(0.5, 0.1), (0.9, 1.0), (0.3, 1e-9), (0.5, 3e-6)])
def test_the_rule_is_the_integral(a, x):
    exact = quad(lambda s: (1.0 + a * s) ** -3, 0.0, x)[0] / x
    assert one_way_ratio(a, x) == pytest.approx(exact, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("x", [0.1, 0.6])
def test_steady_flow_falls_behind_by_the_rule(x):
    sides = (("left", START), ("right", START - x * STRESS))
    products = run_stages(changed(boundaries=sides))
    found, state = products["observe"], products["stress"]
    linear = simulate(changed(boundaries=sides, coupling=Coupling(method="linear")))
    ratio = found["boundary_flow"][:, -1] / linear["boundary_flow"][:, -1]
    pressed = state.normal_force[state.normal_force > 0.0].mean()
    half = STRESS * 2.0 * products["pack"].radius.mean()
    rule = one_way_ratio(pressed / (pressed + half), x)
    assert ratio == pytest.approx(rule, abs=0.015)
    # and by what is told beforehand, from the stress alone
    assert ratio == pytest.approx(changed(boundaries=sides).reckoned.ratio, abs=0.02)
    assert found["mass_balance_error"] <= 1e-9
    assert 0.3 < found["kept_conductance"][-1] < 1.0


@pytest.mark.slow
def test_where_no_force_closes_a_pipe_it_is_the_linear_rock():
    stiff = Matrix(aperture=2e-5, half_stress=1e15, gap_factor=0.0)
    wells = (Well(name="w", at=(0.1, 0.0), radius=0.02, schedule=((0.0, 1e-6), (5.0, 0.0))),
             Well(name="v", at=(-0.2, 0.2), radius=0.02, pressure=START - 1e6))  # fmt: skip
    scene = changed(
        matrix=stiff, wells=wells, probes=(Probe("p", (0.0, -0.2)),), times=(0.3, 3.0, 30.0),
        coupling=Coupling(method="apertures", schedule_yy=((0.0, 1e6), (1.0, 0.0))),
        observe=(*SCENE.observe, "well_pressure", "probe_pressure", "pressure_map"),
        solver=Solver(tolerance=1e-4),
    )  # fmt: skip
    linear = dataclasses.replace(
        scene, coupling=dataclasses.replace(scene.coupling, method="linear")
    )
    products, others = run_stages(scene), run_stages(linear)
    found, other = products["observe"], others["observe"]
    for name in ("well_pressure", "probe_pressure", "wall_displacement", "effective_stress",
                 "boundary_flow", "well_rate", "pressure_change"):  # fmt: skip
        wanted = other[name]
        size = np.nanmax(np.abs(wanted - (START if name.endswith("_pressure") else 0.0)))
        np.testing.assert_allclose(found[name], wanted, atol=5e-3 * size, err_msg=name)
    assert found["mass_balance_error"] <= 1e-9
    assert found["kept_conductance"] == pytest.approx(1.0, abs=1e-6)
    assert str(found["coupling_used"]) == "apertures"
    maps = products["follow"].records.pressure
    assert maps.shape == (3, len(products["network"].x))
    assert np.isfinite(maps).all()


def marched(scene, monkeypatch, outputs):
    """What a scene gives whose legs end after so many outputs."""
    monkeypatch.setattr(told, "LEG", outputs)
    return run_stages(scene)


@pytest.mark.slow
def test_legs_end_at_changes_and_after_outputs_and_change_no_more_than_steps_do(monkeypatch):
    wells = (Well(name="w", at=(0.1, 0.0), radius=0.02, schedule=((0.0, 1e-6), (5.0, 0.0))),)
    scene = changed(
        wells=wells, times=(0.3, 1.0, 3.0, 10.0, 30.0), boundaries=(("right", START),),
        coupling=Coupling(method="apertures", schedule_yy=((0.0, 1e6), (2.0, 0.0))),
        observe=(*SCENE.observe, "well_pressure"), solver=Solver(tolerance=1e-3),
    )  # fmt: skip
    legs = told.stretches(scene)
    assert [(leg.start, leg.end) for leg in legs] == [(0.0, 2.0), (2.0, 5.0), (5.0, 30.0)]
    assert [leg.loads for leg in legs] == [(0.0, 1e6), (0.0, 0.0), (0.0, 0.0)]
    assert [leg.rates for leg in legs] == [(1e-6,), (1e-6,), (0.0,)]
    assert [leg.changes for leg in legs] == [False, True, False]
    whole, parted = marched(scene, monkeypatch, 10), marched(scene, monkeypatch, 1)
    assert len(told.stretches(scene)) == 5
    for name in scene.observe:
        one, other = whole["observe"][name], parted["observe"][name]
        size = np.nanmax(np.abs(one - (START if name == "well_pressure" else 0.0)))
        np.testing.assert_allclose(other, one, atol=2e-3 * size, err_msg=name)
    found = parted["observe"]
    assert found["mass_balance_error"] <= 1e-12
    # what a well had reached before its rate fell is known, and its change counts from there
    change = found["pressure_change"][0, -1]
    assert change == pytest.approx(
        found["well_pressure"][0, -1] - parted["follow"].at_changes[0, 0], rel=1e-9
    )


def test_cases_that_begin_alike_share_their_first_legs():
    def given(schedule):
        well = Well(name="w", at=(0.1, 0.0), radius=0.02, schedule=schedule)
        scene = changed(wells=(well,), times=(1.0, 3.0, 10.0))
        return [stage.given(scene, leg) for leg in range(len(stage.legs_of(scene)))]

    (stage,) = (stage for stage in STAGES if stage.name == "follow")
    one, other = given(((0.0, 1e-6), (5.0, 0.0))), given(((0.0, 1e-6), (5.0, 2e-6)))
    assert one[0] == other[0]
    assert one[1] != other[1]


@pytest.mark.slow
def test_a_step_that_is_not_found_ends_the_march_and_keeps_what_came_before(monkeypatch):
    monkeypatch.setattr(told, "LEG", 1)
    monkeypatch.setattr(following, "MOST_STEPS", 25)
    found = simulate(changed(times=(1e-4, 1e-3, 1e6)))
    assert "raise solver.tolerance" in str(found["stopped"])
    flow = found["boundary_flow"]
    assert np.isfinite(flow[:, 0]).all()
    assert np.isnan(flow[:, -1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("angle", [-0.6, 0.6])
def test_a_stress_at_an_angle_is_where_it_starts_from(angle):
    """Small changes of pressure flow as through apertures that keep what the stress made them."""
    scene = changed(
        stress=Stress(1.5e7, 8e6, angle=angle), times=(10.0, 1e5),
        boundaries=(("left", START), ("right", START - 1e3)),
    )  # fmt: skip
    found = simulate(scene)
    linear = simulate(dataclasses.replace(scene, coupling=Coupling(method="linear")))
    for name in SCENE.observe:
        size = np.abs(linear[name]).max()
        np.testing.assert_allclose(found[name], linear[name], atol=5e-3 * size, err_msg=name)
    assert found["effective_stress"][:2, 0] == pytest.approx(scene.stress.components[:2], rel=2e-2)
    assert np.sign(found["effective_stress"][2, 0]) == np.sign(scene.stress.components[2])


@pytest.mark.slow
def test_smaller_steps_change_flows_to_second_order():
    errors = []
    scene = changed(times=(0.03, 0.1, 0.3))

    def seen(tolerance):
        found = simulate(dataclasses.replace(scene, solver=Solver(tolerance=tolerance)))
        return [found[name] / np.abs(found[name]).max() for name in SCENE.observe[:2]]

    exact = seen(1e-6)
    for tolerance in (1e-2, 1e-4):
        pairs = zip(seen(tolerance), exact, strict=True)
        errors.append([np.abs(found - one).max() for found, one in pairs])
    assert np.all(np.array(errors[0]) < 5e-3)
    # local errors a hundred times smaller, steps shorter by its cube root
    order = 3.0 * np.log(np.divide(*errors)) / np.log(100.0)
    assert np.all(order > 1.6)


def test_auto_takes_what_counts_and_says_so():
    auto = Coupling()
    little = changed(coupling=auto, boundaries=(("left", START), ("right", START - 1e5)))
    much = changed(coupling=auto)
    assert (little.coupling_method, much.coupling_method) == ("linear", "apertures")
    assert changed(coupling=auto, matrix=Matrix(aperture=2e-5)).coupling_method == "linear"
    producing = changed(coupling=auto, boundaries=(("left", START),),
                        wells=(Well(name="w", at=(0.0, 0.0), radius=0.02, rate=1e-5),))  # fmt: skip
    assert producing.coupling_method == "apertures"
    loaded = changed(coupling=Coupling(load_yy=5e6), boundaries=(("left", START),))
    assert loaded.coupling_method == "apertures"
    assert much.reckoned.ratio == pytest.approx(one_way_ratio(0.5, 0.3))
    assert "flows would be off by about 2" in much.reckoned.reason
    assert "no half_stress" in changed(coupling=auto, matrix=Matrix(aperture=2e-5)).reckoned.reason


@pytest.mark.parametrize(
    ("fields", "path"),
    [
        ({"stress": None, "matrix": Matrix(aperture=2e-5)}, "coupling.method"),
        ({"solver": Solver(method="krylov")}, "solver.method"),
    ],
)
def test_what_a_march_cannot_take_is_refused(fields, path):
    with pytest.raises(SceneError) as caught:
        changed(**fields)
    assert path in [where for where, _ in caught.value.problems]
