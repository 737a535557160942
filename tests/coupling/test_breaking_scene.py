"""Scenes whose bonds break: what contradicts itself, what is run and what it gives."""

import dataclasses
import itertools

import numpy as np
import pytest

from demflow.model.coupling.told import LEG, march_legs
from demflow.model.maps import case_maps
from demflow.model.quantities import CASE, checked
from demflow.model.scene import (
    Bonds,
    Circle,
    CircularHole,
    Fluid,
    Grains,
    Matrix,
    Probe,
    Rectangle,
    Scene,
    SceneError,
    Stress,
    Trace,
    Well,
)
from demflow.model.scene.coupling import Coupling
from demflow.model.stages import STAGES, run_stages, simulate

pytestmark = pytest.mark.usefixtures("packed_once")

WELL = Well(name="w", at=(0.0, 0.0), radius=0.17, schedule=((0.0, -5e-3), (0.3, 0.0), (0.4, -5e-3)))
SCENE = Scene(
    region=Rectangle(2.0, 2.0),
    grains=Grains(count=200, porosity=0.16, modulus=20e9),
    bonds=Bonds(kind="parallel", tensile_strength=5e6, shear_strength=20e6),
    stress=Stress(xx=6e6, yy=5e6),
    matrix=Matrix(aperture=1e-5, gap_factor=1.0),
    fluid=Fluid(viscosity=1e-3, bulk_modulus=2e9),
    wells=(WELL,),
    boundaries=(("outer", 1e6),),
    probes=(Probe("p", (0.5, 0.3)),),
    initial_pressure=1e6,
    coupling=Coupling(method="breaking"),
    times=(0.1, 0.2, 0.3, 0.35, 0.5),
    observe=(
        *("well_pressure", "boundary_flow", "probe_pressure", "pressure_map"),
        *("crack_length", "injected_volume"),
    ),
)


def test_legs_end_at_changes_of_rates_and_after_some_outputs():
    legs = march_legs(SCENE)
    assert [(leg.start, leg.end) for leg in legs] == [(0.0, 0.3), (0.3, 0.4), (0.4, 0.5)]
    assert [leg.rates for leg in legs] == [(-5e-3,), (0.0,), (-5e-3,)]
    assert [leg.changes for leg in legs] == [True, True, False]
    long = dataclasses.replace(SCENE, times=tuple(0.5 + 0.1 * k for k in range(35)))
    legs = march_legs(long)
    assert sum((leg.times for leg in legs), ()) == long.times
    assert max(len(leg.times) for leg in legs) == LEG
    assert all(a.end == b.start for a, b in itertools.pairwise(legs))


@pytest.mark.slow
def test_a_scene_gives_what_the_table_says():
    products = run_stages(SCENE)
    assert "fracture" in products
    assert not {"stress", "unit_loads", "flow", "consolidate"} & set(products)
    found = products["observe"]
    assert checked(found) == ""
    sizes = {"well": 1, "elapsed_time": 5, "boundary": 1, "probe": 1, "row": 2, "column": 2}
    sizes["event"] = len(found["event_time"])
    assert sizes["event"] > 3
    for name, value in found.items():
        assert value.shape == tuple(sizes[d] for d in CASE[name].dimensions), name
    wanted = {n for n, q in CASE.items() if set(q.needs) & {"crack_length", "injected_volume"}}
    assert wanted <= set(found)
    assert found["mass_balance_error"] < 1e-12
    assert found["mass_imbalance"] < 1e-9
    well = found["well_pressure"][0]
    assert well[0] > 2e6  # above the initial pressure
    np.testing.assert_allclose(
        found["injected_volume"], [5e-4, 1e-3, 1.5e-3, 1.5e-3, 2e-3], rtol=1e-12
    )
    np.testing.assert_allclose(found["well_rate"][0], [-5e-3, -5e-3, -5e-3, 0.0, -5e-3])
    assert np.isfinite(found["pressure_change"][0, :3]).all()
    maps = case_maps(SCENE, products)
    assert maps["pressure"].shape == (5, len(maps["x"]))
    own = np.argmin(np.hypot(maps["x"], maps["y"]))  # the hole
    np.testing.assert_allclose(maps["pressure"][:, own], well)
    assert maps["aperture"].max() > 1.5e-5


@pytest.mark.parametrize(
    ("changes", "where", "what"),
    [
        ({"region": Circle(1.0)}, "coupling", "four walls"),
        ({"stress": None}, "stress", "give its stresses"),
        ({"bonds": None}, "bonds", "add bonds"),
        ({"initial_pressure": "steady"}, "initial_pressure", "one pressure everywhere"),
        ({"gravity": 9.81}, "fluid.density", "weigh less by the fluid"),
        (
            {"excavate": (CircularHole(at=(0.5, 0.5), radius=0.2, side="drift"),)},
            "excavate.0.name",
            "a hole keeps a pressure",
        ),
        (
            {"wells": (dataclasses.replace(WELL, skin_factor=1.0),)},
            "wells.w.skin_factor",
            "no skin",
        ),
        (
            {"fractures": (Trace(name="t", start=(-1, 0), end=(1, 0), aperture=1e-4),)},
            "fractures.t",
            "a fracture is a joint",
        ),
        ({"coupling": None}, "observe", "add coupling: breaking"),
    ],
)
def test_what_contradicts_itself_is_refused(changes, where, what):
    with pytest.raises(SceneError) as caught:
        dataclasses.replace(SCENE, **changes)
    assert any(path == where and what in text for path, text in caught.value.problems)


@pytest.mark.parametrize(
    "options",
    [{"load_xx": 1e6}, {"held": "right"}, {"schedule_yy": ((0.0, 1e6),)}],
)
def test_walls_keep_their_stress(options):
    with pytest.raises(SceneError, match="leave it out"):
        Coupling(method="breaking", **options)
    with pytest.raises(SceneError, match="only method breaking"):
        Coupling(method="linear", least_pressure=0.0)


def test_scenes_without_it_have_no_trace_of_it():
    (stage,) = [s for s in STAGES if s.name == "fracture"]
    still = dataclasses.replace(
        SCENE, coupling=None, observe=("well_pressure",), times=(0.1,), fractures=()
    )
    assert not stage.wanted(still)


def test_a_well_that_begins_later_leaves_the_balance_of_mass_judged():
    """Before anything enters, what the pores store is rounding."""
    later = dataclasses.replace(WELL, rate=None, schedule=((0.0, 0.0), (0.1, -1e-4)))
    found = simulate(
        dataclasses.replace(
            SCENE,
            wells=(later,),
            boundaries=(),
            times=(0.05, 0.1, 0.15),
            probes=(),
            observe=("well_pressure",),
        )
    )
    assert float(found["mass_balance_error"]) < 1e-12
