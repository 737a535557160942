"""Weight and holes of rock whose bonds break: what they load, what breaks, what flows."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from demflow.model.coupling.setting import setting
from demflow.model.coupling.skeleton import borne, forces
from demflow.model.outcome import ModelError
from demflow.model.region import Rectangle
from demflow.model.scene import (
    Bonds,
    CircularHole,
    Coupling,
    Fluid,
    Grains,
    Matrix,
    RectangularHole,
    Scene,
    Stress,
    Well,
)
from demflow.model.stages import STAGES, run_stages, simulate

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("packed_once")]

STRONG = Bonds(kind="parallel", tensile_strength=1e12, shear_strength=1e12)
DRIFT = CircularHole(at=(0.2, 0.1), radius=0.25, side="drift")
SCENE = Scene(
    region=Rectangle(2.4, 1.6),
    grains=Grains(count=500, porosity=0.17, seed=3, modulus=2e10),
    matrix=Matrix(aperture=2e-5, gap_factor=1.0),
    fluid=Fluid(1e-3, 2.2e9, density=1000.0),
    bonds=STRONG,
    stress=Stress(2e7, 2e7),
    excavate=(DRIFT,),
    boundaries=(("drift", 0.0), ("top", 5e6)),
    initial_pressure=5e6,
    coupling=Coupling(method="breaking"),
    times=(1.0, 1e3, 1e5),
    observe=("boundary_flow", "crack_length", "pressure_map"),
)


def changed(**fields):
    return dataclasses.replace(SCENE, **fields)


@cache
def packing(count=500):
    stage = next(one for one in STAGES if one.name == "pack")
    grains = dataclasses.replace(SCENE.grains, count=count)
    return stage.run(**stage.given(changed(grains=grains), 0))


def start(scene, count=500):
    """The loaded rock of a scene."""
    stage = next(one for one in STAGES if one.name == "fracture")
    told = stage.given(scene, 0)
    return setting(packing(count), None, rock=told["rock"], wet=told["wet"], wells=told["wells"])


def test_the_bottom_bears_the_top_and_the_weight_and_mid_height_the_stress():
    scene = changed(excavate=(), boundaries=(("top", 5e6),), gravity=9.81)
    given = start(scene)
    case, s = given.case, given.case.skeleton
    found = borne(s, given.hold, given.u)
    floor, roof = (found.normal[s.b == -1 - wall].sum() for wall in (2, 3))
    box = packing().box
    radius, unit = packing().radius, case.unit * case.stiffness
    weight = 9.81 * (scene.grains.density - 1000.0) * np.pi * (radius**2).sum() / unit
    wanted = 2e7 * (box[1] - box[0]) / unit
    assert floor - roof == pytest.approx(weight, rel=1e-6)
    assert 0.5 * (floor + roof) == pytest.approx(wanted, rel=1e-9)
    sides = (found.normal[s.b == -1 - wall].sum() for wall in (0, 1))
    assert next(sides) == pytest.approx(next(sides), rel=1e-6)


def test_the_rock_around_a_hole_is_at_rest_and_a_rim_that_is_held_moves_less():
    """A drift at the rock's own pressure adds nothing to what its rim bears."""
    moved, sides = [], (("drift", 5e6), ("top", 5e6))
    whole = start(changed(excavate=(), boundaries=sides[1:]))
    for pressure in (0.0, 2e7):
        dug = dataclasses.replace(DRIFT, pressure=pressure)
        given = start(changed(excavate=(dug,), boundaries=sides))
        s = given.case.skeleton
        found = borne(s, given.hold, given.u)
        off = given.case.load + forces(s, given.hold, found, given.u)
        assert np.abs(off).max() < 1e-4 * np.mean(np.abs(found.force))
        grains = np.flatnonzero(given.grains)
        way = (given.u - whole.u)[3 * grains[:, None] + np.arange(2)]
        moved.append(float(np.sqrt(np.mean(way**2))))
    assert moved[1] < 0.5 * moved[0]


def test_a_drained_drift_in_the_end_takes_what_it_takes_where_nothing_can_break():
    found = simulate(SCENE)
    drift, top = found["boundary_flow"][:, -1]
    assert "stopped" not in found
    assert drift + top == pytest.approx(0.0, abs=1e-6 * top)
    assert found["mass_balance_error"] <= 1e-11
    assert found["energy_imbalance"] <= 1e-9
    linear = simulate(changed(coupling=Coupling(method="linear"), observe=("boundary_flow",)))
    # here pipes lead into the hole as long as they are, there they end at its rim
    assert top == pytest.approx(linear["boundary_flow"][1, -1], rel=0.15)


def test_a_drift_in_weak_rock_breaks_at_its_flanks_as_it_is_dug():
    """Hoop stress is the largest where the largest stress runs along the rim (Kirsch 1898)."""
    weak = Bonds(kind="parallel", tensile_strength=3e7, shear_strength=3e7)
    hole = CircularHole(at=(0.0, 0.0), radius=0.25, side="drift")
    scene = changed(
        bonds=weak, stress=Stress(1e7, 3e7), excavate=(hole,), times=(1e-2,),
        grains=dataclasses.replace(SCENE.grains, count=1000),
    )  # fmt: skip
    products = run_stages(scene)
    events = products["fracture"].events
    assert np.count_nonzero(events.time == 0.0) > 3
    near = np.hypot(events.x, events.y) < 0.6
    assert np.abs(events.x[near]).mean() > np.abs(events.y[near]).mean()


def test_a_march_goes_on_from_leg_to_leg_with_weight_and_a_hole():
    scene = changed(gravity=9.81, times=tuple(np.linspace(0.01, 0.12, 12)))
    stage = next(one for one in STAGES if one.name == "fracture")
    assert len(stage.legs_of(scene)) == 2
    found = run_stages(scene)["fracture"]
    assert len(found.records.time) == 12
    assert str(found.state.stopped) == ""
    assert np.all(np.diff(found.records.stored) < 0.0)  # it drains


def test_a_well_has_no_pore_whose_pressure_a_side_keeps():
    well = Well(name="w", at=(0.5, 0.795), radius=0.002, rate=-1e-4)
    with pytest.raises(ModelError, match="the well w lies in a pore whose pressure"):
        start(changed(wells=(well,)))


def test_a_rectangle_is_dug_too():
    hole = RectangularHole(at=(-0.3, 0.1), width=0.4, height=0.3, side="drift")
    given = start(changed(excavate=(hole,)))
    (face,) = np.flatnonzero(given.side == 0)
    grain = 2.0 * float(packing().radius.mean())
    assert 0.4 * 0.3 < given.network.area[face] < (0.4 + grain) * (0.3 + grain)
