"""The stages as a whole: purity, what each reads, what is run, what a case reports."""

import dataclasses
import inspect
import math
from functools import cache

import numpy as np
import pytest

from demflow import model
from demflow.model import stages
from demflow.model.maps import case_maps
from demflow.model.outcome import ModelError
from demflow.model.products import named
from demflow.model.quantities import CASE, MAPS, STOPPED, TESTS
from demflow.model.region import Circle, Polygon, Rectangle
from demflow.model.scene import (
    MEASURED_BY_A_TEST,
    OBSERVABLES,
    OF_BREAKING,
    OF_COUPLING,
    BiWing,
    Bonds,
    Coupling,
    FailureTest,
    Fluid,
    FractureSet,
    Grains,
    Joint,
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

# what one scene is made of, but for marches (tests/coupling)
ALONE = tuple(stage for stage in STAGES if stage.family is None and stage.legs is None)
MARCHES = tuple(stage for stage in STAGES if stage.legs is not None)
BY_NAME = {stage.name: stage for stage in ALONE}
OTHERWISE = (*OF_COUPLING, *OF_BREAKING)  # observed of scenes of their own
OBSERVED = tuple(name for name in OBSERVABLES if name not in (*MEASURED_BY_A_TEST, *OTHERWISE))
OBSERVED_LOOSE = tuple(set(OBSERVED) - {"elastic_moduli", "force_chains"})  # of loose grains
GRAINS = Grains(count=150, porosity=0.17, modulus=2e10)
BONDS = Bonds(kind="parallel", tensile_strength=2e7, shear_strength=2e7)
TEST = FailureTest(confining_stress=1e6, strain_step=4e-6)
LOOSE = {"bonds": None, "stress": None, "test": None}
SCENE = Scene(
    region=Rectangle(1.9, 1.8),
    grains=GRAINS,
    matrix=Matrix(permeability=1e-14, half_force=5e6),
    fluid=Fluid(1e-3, 1e9),
    observe=tuple(name for name in OBSERVABLES if name not in OTHERWISE),
    bonds=BONDS,
    stress=Stress(1.2e7, 1e7),
    test=TEST,
    fractures=(
        BiWing(name="wings", aperture=1e-4, at=(0.0, 0.0), angle=0.2, half_length=0.5),
        FractureSet(name="set", permeability=1e-12, angle=1.1, length=0.5, spacing=0.4),
    ),
    wells=(
        Well(name="w", at=(0.0, 0.0), radius=0.15, rate=1e-6),
        Well(name="v", at=(0.6, 0.3), radius=0.1, schedule=((2.0, 1e-6), (20.0, 0.0))),
    ),
    boundaries=(("outer", 7e6),),
    probes=(Probe("p", (0.3, -0.3)),),
    initial_pressure=7e6,
    times=(1.0, 10.0, 100.0),
)
LATTICE = Scene(
    region=Rectangle(2.0, 1.4),
    grains=Grains(count=200, packing="hexagonal"),
    matrix=Matrix(aperture=1e-5),
    fluid=Fluid(1e-3, 1e9),
    observe=("permeability",),
)
COUPLED = Scene(
    region=Rectangle(2.0, 1.2),
    grains=Grains(count=240, packing="square", modulus=2e10),
    matrix=Matrix(aperture=1e-5),
    fluid=Fluid(1e-3, 1e9),
    observe=(*OF_COUPLING, "well_pressure", "pressure_map"),
    bonds=BONDS,
    wells=(Well(name="w", at=(0.0, 0.0), radius=0.15, rate=1e-6),),
    boundaries=(("top", 7e6),),
    initial_pressure=7e6,
    coupling=Coupling(method="linear", load_yy=1e6),
    times=(1.0, 10.0, 100.0),
)
FOLLOWING = dataclasses.replace(
    COUPLED,
    stress=Stress(1.2e7, 1e7),
    matrix=Matrix(aperture=1e-5, half_stress=1e7),
    coupling=Coupling(method="apertures", load_yy=1e6),
    solver=Solver(tolerance=1e-2),
)


@cache
def products(scene: Scene) -> dict:
    """Of all stages of a scene, once for all that look at them."""
    return run_stages(scene)


def seen() -> dict:
    """What the scene is seen to do."""
    return products(SCENE)["observe"]


def made_by(stage):
    """A scene that wants a stage, and its products."""
    return (
        (SCENE, products(SCENE)) if stage.name in products(SCENE) else (COUPLED, products(COUPLED))
    )


def changed(**fields):
    return dataclasses.replace(SCENE, **fields)


def test_same_scene_same_bits():
    again = simulate(SCENE)
    assert set(again) == set(seen())
    for name, value in seen().items():
        np.testing.assert_array_equal(again[name], value, err_msg=name)
    assert model.simulate is simulate


def test_products_are_not_written_to_by_later_stages():
    """Each stage run anew from the stored products gives what it gave before."""
    for stage in ALONE:
        scene, products = made_by(stage)
        parents = [products.get(name) for name in stage.parents]
        again = stage.run(*parents, **stage.given(scene))
        before = named(products[stage.name])
        for name, value in named(again).items():
            np.testing.assert_array_equal(value, before[name], err_msg=f"{stage.name}.{name}")


@pytest.mark.parametrize("stage", STAGES, ids=lambda s: s.name)
def test_what_a_stage_reads_is_what_it_can_be_given(stage):
    """Positional arguments are the parents' products, keyword arguments the scene's parts."""
    parameters = inspect.signature(stage.run).parameters.values()
    keyword = {p.name for p in parameters if p.kind is p.KEYWORD_ONLY}
    positional = [p.name for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD]
    needed = {p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.default is p.empty}
    brought = {"members"} if stage.brings else {"leg"} if stage.legs else set()
    assert needed - brought <= set(stage.reads)
    assert set(stage.reads) | set(stage.options) <= keyword
    assert len(positional) == len(stage.parents)
    assert len(keyword) + len(positional) == len(parameters)
    assert stage.version >= 1


def test_parents_come_first():
    names = [stage.name for stage in STAGES]
    assert len(set(names)) == len(names)
    for k, stage in enumerate(STAGES):
        assert set(stage.parents) - {stage.name} <= set(names[:k])
        assert (stage.name in stage.parents) == (stage.legs is not None)


@pytest.mark.parametrize("name", [name for name in OBSERVABLES if name not in OF_BREAKING])
def test_an_output_runs_the_stages_that_it_needs_and_no_flow_or_test_besides(name):
    scene = dataclasses.replace(COUPLED if name in OF_COUPLING else SCENE, observe=(name,))
    run = {stage.name for stage in STAGES if stage.wanted(scene)}
    assert set(OBSERVABLES[name]) | {"pack", "observe"} <= run
    always = {
        "pack",
        "specimen",
        "unit_loads",
        "stress",
        "calibrate",
        "walk",
        "observe",
    }  # or as the scene has it
    assert run - always == set(OBSERVABLES[name]) - always


@pytest.mark.parametrize("stage", ALONE, ids=lambda s: s.name)
def test_products_are_named_arrays(stage):
    product = made_by(stage)[1][stage.name]
    assert isinstance(product, stage.returns)
    for value in named(product).values():
        assert isinstance(value, np.ndarray)
        assert value.dtype.kind in "fibU"


PACKED = {"region", "grains.count", "grains.seed", "grains.porosity", "grains.radius_ratio"}
PACKED |= {"grains.packing_stress", "grains.packing_friction"}
READS = {
    "pack": PACKED,
    "specimen": PACKED,
    "unit_loads": {"grains.friction", "grains.stiffness_ratio"},
    "stress": {"stress", "bonds", "grains.modulus", "grains.friction", "grains.stiffness_ratio"}
    | {"grains.seed", "joint"},
    "moduli": {"bonds", "grains.modulus", "grains.friction", "grains.stiffness_ratio"},
    "strength": {"test", "bonds", "grains.modulus", "grains.friction", "grains.stiffness_ratio"}
    | {"grains.seed", "joint", "observe"},
    "network": {"region"},
    "calibrate": set(),
    "walk": {"region", "fractures"},
    "open": {"region", "matrix", "fractures", "joint", "viscosity"},
    "measure_bar": {"region", "viscosity"},
    "measure_periodic": {"viscosity"},
    "measure": {"viscosity"},
    # of the pressures it knows only whether the boundary differs from the start
    "flow": {"region", "bulk_modulus", "well.radius", "times", "solver", "probes", "observe"}
    | {"boundary", "initial"},
    "reference": {"region", "bulk_modulus", "well.radius", "times", "probes", "observe"}
    | {"boundary", "initial"},
    "consolidate": {"region", "grains.modulus", "grains.friction", "grains.stiffness_ratio"}
    | {
        "bulk_modulus",
        "well.radius",
        "times",
        "solver",
        "probes",
        "observe",
        "boundary",
        "initial",
    },
    # rates, loads and times are for the legs of a march
    "fracture": {"bonds", "grains.modulus", "grains.friction", "grains.stiffness_ratio"}
    | {"grains.seed", "joint", "stress", "probes", "observe", "well.radius"},
    "follow": {"region", "matrix", "fractures", "joint", "viscosity", "bulk_modulus"}
    | {"grains.modulus", "grains.friction", "grains.stiffness_ratio", "well.radius"}
    | {"solver", "probes", "observe", "boundary", "initial"},
    "fractures": {"region", "fractures", "joint", "viscosity", "well.radius"},
    "observe": {"region", "well.rate", "well.radius", "times", "boundary", "initial", "observe"},
}


def variants():
    grains = {
        "count": 151,
        "seed": 2,
        "porosity": 0.18,
        "radius_ratio": 1.7,
        "packing_stress": 5e6,
        "packing_friction": 0.1,
        "modulus": 3e10,
        "friction": 0.6,
        "stiffness_ratio": 2.0,
        "density": 2700.0,
    }
    for name, value in grains.items():
        yield f"grains.{name}", changed(grains=dataclasses.replace(GRAINS, **{name: value}))
    well = SCENE.wells[0]
    yield "region", changed(region=Rectangle(2.0, 1.8))
    yield "stress", changed(stress=Stress(1.1e7, 1e7))
    yield "bonds", changed(bonds=dataclasses.replace(BONDS, tensile_strength=3e7))
    yield "test", changed(test=dataclasses.replace(TEST, confining_stress=2e6))
    joint = Joint(normal_stiffness=1e10, shear_stiffness=1e10, friction=0.5)
    wings = dataclasses.replace(SCENE.fractures[0], joint=joint)
    yield "joint", changed(fractures=(wings, SCENE.fractures[1]))
    yield "matrix", changed(matrix=Matrix(permeability=2e-14, half_force=5e6))
    yield "fractures", changed(fractures=())
    yield "viscosity", changed(fluid=Fluid(2e-3, 1e9))
    yield "bulk_modulus", changed(fluid=Fluid(1e-3, 2e9))
    yield "well.rate", changed(wells=(dataclasses.replace(well, rate=3e-6), SCENE.wells[1]))
    yield "well.radius", changed(wells=(dataclasses.replace(well, radius=0.16), SCENE.wells[1]))
    yield "boundary", changed(boundaries=(("outer", 6e6),))
    yield "initial", changed(initial_pressure=6e6)
    yield "times", changed(times=(1.0, 11.0))
    yield "solver", changed(solver=Solver(tolerance=1e-5))
    yield "probes", changed(probes=(Probe("p", (0.3, -0.31)),))
    yield "observe", changed(observe=("well_pressure",))


@pytest.mark.parametrize(
    ("what", "other"), list(variants()), ids=lambda v: v if isinstance(v, str) else ""
)
def test_a_parameter_reaches_the_stages_that_need_it_and_no_other(what, other):
    """The inputs of every stage, before and after one parameter changed."""
    for stage in (*ALONE, *MARCHES):
        here = {k: part(SCENE) for k, part in stage.reads.items()}
        there = {k: part(other) for k, part in stage.reads.items()}
        assert (here != there) == (what in READS[stage.name]), (stage.name, what)


def test_a_march_without_legs_is_no_case_without_its_results():
    march = dataclasses.replace(MARCHES[0], legs=lambda _scene: ())
    with pytest.raises(ValueError, match=f"{march.name}.*legs"):
        march.legs_of(FOLLOWING)


def test_rates_share_one_transient():
    """A sweep over rates and pressures of the boundary changes no input of the flow stage."""
    flow = BY_NAME["flow"]
    other = changed(
        wells=(dataclasses.replace(SCENE.wells[0], rate=-5e-6), SCENE.wells[1]),
        initial_pressure=5e6,
        boundaries=(("outer", 5e6),),
    )
    for part in flow.reads.values():
        assert part(SCENE) == part(other)


@pytest.mark.parametrize(
    ("scene", "runs"),
    [
        (LATTICE, {"pack", "network", "open", "measure", "observe"}),
        (
            dataclasses.replace(LATTICE, matrix=Matrix(permeability=1e-14)),
            {"pack", "network", "calibrate", "open", "measure", "observe"},
        ),
        (
            dataclasses.replace(LATTICE, observe=("grain_map",)),
            {"pack", "network", "open", "observe"},
        ),
        (
            dataclasses.replace(
                LATTICE, observe=("boundary_flow",), boundaries=(("left", 1.0), ("right", 0.0))
            ),
            {"pack", "network", "open", "flow", "observe"},
        ),
        (SCENE, {stage.name for stage in ALONE} - {"consolidate"}),
        (COUPLED, {"pack", "network", "open", "consolidate", "observe"}),
        (FOLLOWING, {"pack", "unit_loads", "stress", "network", "open", "follow", "observe"}),
    ],
)
def test_only_what_a_scene_needs_is_run(scene, runs):
    assert set(run_stages(scene)) == runs == {s.name for s in STAGES if s.wanted(scene)}


def refuse(*args, **kwargs):
    raise AssertionError("this stage was not asked for")


def test_permeability_alone_runs_neither_stress_nor_flow(monkeypatch):
    idle = [
        dataclasses.replace(s, function=f"{__name__}:refuse")
        if s.name in ("stress", "flow", "calibrate")
        else s
        for s in STAGES
    ]
    monkeypatch.setattr(stages, "STAGES", tuple(idle))
    found = simulate(LATTICE)
    assert found["permeability"].shape == (2, 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", OBSERVED)
def test_what_is_observed_is_what_the_table_of_quantities_says(name):
    free = LOOSE if name in OBSERVED_LOOSE else {}
    scene = changed(observe=(name,), **free, matrix=Matrix(aperture=1e-5), fractures=())
    found = simulate(scene)
    for key in found:
        assert key in CASE
        assert not CASE[key].needs or name in CASE[key].needs, key
    for key, quantity in CASE.items():
        if name in quantity.needs:
            assert key in found


def test_shapes_are_those_of_the_table():
    sizes = {
        "well": 2,
        "elapsed_time": 3,
        "boundary": 1,
        "probe": 1,
        "row": 2,
        "column": 2,
        "component": 3,
        "direction": 2,
        "energy_part": 7,
    }
    rare = {name for name, quantity in CASE.items() if "event" in quantity.dimensions}
    # which only a march, a family's member, and wells with limits may have
    rare |= {STOPPED, "emulator_snapshots", "well_limited", "highest_well_pressure"}
    rare |= {name for name, quantity in CASE.items() if set(quantity.needs) & set(OF_BREAKING)}
    told = {"coupling_used", "coupling_reason", "kept_conductance"}  # of coupled scenes alone
    assert set(seen()) == set(CASE) - rare - set(OF_COUPLING) - told
    assert told <= set(products(FOLLOWING)["observe"])
    coupled = products(COUPLED)["observe"]
    assert set(OF_COUPLING) <= set(coupled) <= set(CASE) - rare
    for name, value in coupled.items():
        shape = tuple({**sizes, "well": 1, "wall": 4}[d] for d in CASE[name].dimensions)
        assert value.shape == shape, name
    for name, value in seen().items():
        assert value.shape == tuple(sizes[d] for d in CASE[name].dimensions), name
    steady = dataclasses.replace(
        SCENE,
        **LOOSE,
        observe=OBSERVED_LOOSE,
        times=(),
        wells=SCENE.wells[:1],
        matrix=Matrix(aperture=1e-5),
    )
    for name, value in simulate(steady).items():
        shape = tuple(
            1 if d == "well" else sizes[d] for d in CASE[name].dimensions if d != "elapsed_time"
        )
        assert value.shape == shape, name


def test_numbers_of_a_case_are_sound():
    assert seen()["mass_balance_error"] <= 1e-10
    assert seen()["porosity"] == pytest.approx(0.17, abs=0.02)
    assert seen()["grain_count"] == pytest.approx(150, rel=0.1)
    assert seen()["domain_count"] == products(SCENE)["network"].inside.sum()
    np.testing.assert_allclose(seen()["stress_achieved"][:2], [1.2e7, 1e7], rtol=0.02)
    np.testing.assert_array_equal(seen()["permeability"], seen()["permeability"].T)
    assert np.all(seen()["well_pressure"] < 7e6 + 1)


def test_maps_are_named_and_shaped_as_the_table_says():
    maps = case_maps(SCENE, products(SCENE))
    sizes = {
        "domain": int(seen()["domain_count"]),
        "pipe": len(maps["aperture"]),
        "grain": len(products(SCENE)["pack"].x),
        "contact": len(products(SCENE)["stress"].contact_a),
        "crack": len(products(SCENE)["stress"].crack_mode),
        "fracture_node": len(products(SCENE)["open"].node_x),
        "branch": len(products(SCENE)["open"].branch_a),
        "elapsed_time": 3,
        "well": len(SCENE.wells),
        "fracture": len(SCENE.fractures),
        "trace": len(products(SCENE)["open"].trace_start),
    }
    for name, quantity in MAPS.items():
        assert maps[name].shape == tuple(sizes[d] for d in quantity.dimensions), name
    assert maps["from_domain"].min() >= 0
    assert maps["to_domain"].min() == -1
    assert maps["to_domain"].max() < sizes["domain"]
    assert set(np.unique(maps["on_fracture"])) == {-1, 0, 1}
    # polygons: shoelace over the mesh gives the areas of the domains
    faces = maps["mesh_face_nodes"]
    x, y = maps["mesh_node_x"], maps["mesh_node_y"]
    net = products(SCENE)["network"]
    for face, area in zip(faces, net.area[net.inside], strict=True):
        corners = face[face >= 0]
        px, py = x[corners], y[corners]
        shoelace = 0.5 * np.sum(px * np.roll(py, -1) - np.roll(px, -1) * py)
        assert shoelace == pytest.approx(area, rel=1e-9)


def test_the_map_of_a_well_has_the_well_s_pressure():
    maps = case_maps(SCENE, products(SCENE))
    in_well = np.hypot(maps["x"], maps["y"]) < 0.15
    assert in_well.any()
    np.testing.assert_allclose(
        maps["pressure"][:, in_well],
        np.broadcast_to(seen()["well_pressure"][0][:, None], (3, in_well.sum())),
    )


@pytest.mark.parametrize(
    "region", [Circle(1.0), Rectangle(2.0, 1.4), Polygon(((-1, -0.8), (1, -0.7), (0.2, 0.9)))]
)
@pytest.mark.parametrize(("packing", "factor"), [("square", 1.0), ("hexagonal", 1 / math.sqrt(3))])
def test_lattices_through_the_whole_model(region, packing, factor):
    scene = dataclasses.replace(
        LATTICE, region=region, grains=Grains(mean_radius=0.05, packing=packing)
    )
    found = simulate(scene)
    k = 1e-15 / (24 * 0.05) * factor
    np.testing.assert_allclose(found["permeability"] / k, np.eye(2), atol=1e-10)
    porosity = {"square": 1 - math.pi / 4, "hexagonal": 1 - math.pi / (2 * math.sqrt(3))}[packing]
    assert found["porosity"] == pytest.approx(porosity, rel=1e-10)


def test_a_wanted_permeability_is_met_in_the_unstressed_state():
    scene = dataclasses.replace(
        LATTICE, matrix=Matrix(permeability=3e-15), grains=Grains(count=150, porosity=0.17)
    )
    assert 0.5 * np.trace(simulate(scene)["permeability"]) == pytest.approx(3e-15, rel=1e-10)


def test_stress_closes_apertures_across_it_more_than_along():
    """σ_xx presses on contacts along x, whose pipes run along y."""
    loaded = dataclasses.replace(
        SCENE,
        observe=("permeability",),
        bonds=None,
        test=None,
        fractures=(),
        grains=Grains(count=600, porosity=0.165, modulus=2e10, seed=3),
        matrix=Matrix(aperture=1e-5, half_force=5e6, gap_factor=0.0),
        stress=Stress(1.5e7, 1e7),
    )
    free = dataclasses.replace(loaded, stress=None, matrix=Matrix(aperture=1e-5, gap_factor=0.0))
    k, k0 = simulate(loaded)["permeability"], simulate(free)["permeability"]
    assert np.trace(k) < 0.9 * np.trace(k0)
    assert k[0, 0] / k0[0, 0] > k[1, 1] / k0[1, 1]


@pytest.mark.parametrize("traces", [1, 2])
def test_a_trace_in_a_sealed_rock_through_the_whole_model(traces):
    """The pack, cut, open and flow stages together keep the cubic law on a real packing."""
    lines = [((-2.0, 0.1), (2.0, -0.3)), ((-2.0, -0.4), (2.0, -0.45))][:traces]
    scene = Scene(
        region=Rectangle(2.0, 1.4),
        grains=Grains(count=400, porosity=0.17),
        matrix=Matrix(aperture=0.0),
        fluid=Fluid(1e-3, 1e9),
        observe=("boundary_flow",),
        fractures=tuple(
            Trace(name=f"{k}", aperture=1e-4, start=a, end=b) for k, (a, b) in enumerate(lines)
        ),
        boundaries=(("left", 1.0), ("right", 0.0)),
    )
    found = simulate(scene)
    expected = sum(1e-12 / 12e-3 / (math.dist(a, b) / 2) for a, b in lines)
    np.testing.assert_allclose(found["boundary_flow"], [expected, -expected], rtol=1e-9)
    assert found["isolated_domains"] > 100


def test_what_cannot_be_is_said_in_words():
    tiny = dataclasses.replace(LATTICE, matrix=Matrix(aperture=0.0))
    with pytest.raises(ModelError, match="no conducting pipe"):
        simulate(tiny)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("packing", ["random", "square", "hexagonal"])
def test_very_few_grains_give_a_tensor_or_a_clear_error(count, packing):
    """The packing reaches beyond the region, so that even one grain may leave pores inside."""
    porosity = 0.17 if packing == "random" else None
    grains = Grains(count=count, packing=packing, porosity=porosity)
    tensor, why = np.eye(2), ""
    try:
        tensor = simulate(dataclasses.replace(LATTICE, grains=grains))["permeability"]
    except ModelError as error:
        why = str(error)
    assert not why or "raise grains.count" in why or "give the matrix an aperture" in why
    assert np.all(np.linalg.eigvalsh(tensor) >= 0)


def test_a_test_to_failure_needs_no_pores():
    """Only grains are packed and tested; what a test measures is observed, and nothing of flow."""
    scene = Scene(
        region=Rectangle(1.0, 2.0),
        grains=GRAINS,
        bonds=Bonds(kind="parallel", tensile_strength=2e7, shear_strength=2e7),
        test=FailureTest(confining_stress=1e6, strain_step=4e-6),
        observe=MEASURED_BY_A_TEST,
    )
    products = run_stages(scene)
    assert set(products) == {"pack", "strength", "observe"}
    found = products["observe"]
    assert set(MEASURED_BY_A_TEST) <= set(found) <= set(CASE)
    assert all(np.all(np.isfinite(found[name])) for name in MEASURED_BY_A_TEST)
    maps = case_maps(scene, products)
    assert set(maps) == set(TESTS)
    sizes = {"record": len(maps["cracks"]), "crack": int(found["crack_count"]), "wall": 4}
    for name, quantity in TESTS.items():
        assert maps[name].shape == tuple(sizes[d] for d in quantity.dimensions), name
    with pytest.raises(SceneError, match="needs a fluid"):
        dataclasses.replace(scene, observe=("permeability",))
    with pytest.raises(SceneError, match="describe it"):
        dataclasses.replace(scene, test=None, stress=Stress(1e6, 1e6))
