"""Growing a study: on every kind of axis, exactly what is new is computed."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from demflow.model.parameters import SceneError
from demflow.model.scene import OBSERVABLES, Refinement, Scene
from demflow.sweep.dataset.open import open_results
from demflow.sweep.plan.graph import Plan, make_plan
from demflow.sweep.plan.table import stage_table
from demflow.sweep.prepared import planned
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import Study, load_study
from demflow.sweep.study.scenes import SceneBuilder
from tests.sweep import toys
from tests.sweep.study_text import EXAMPLE

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_worker")]

STAGES = stage_table()

HEAD, TAIL = EXAMPLE.split("vary:")[0], "observe:" + EXAMPLE.split("observe:")[1]
OBSERVED = "observe: [well_pressure, permeability, pressure_map]"
AXES = {
    "angle": "{parameter: fractures.natural.angle, values: [0 deg, 30 deg]}",
    "rate": "{parameter: wells.producer.rate, values: [1e-5 m3/s, 2e-5 m3/s]}",
}


def study(folder, axes: dict[str, str], tail: str = TAIL) -> Study:
    """The example with other axes."""
    path = folder / "study.yaml"
    lines = [f"  {name}: {axis}" for name, axis in axes.items()]
    path.write_text("\n".join([HEAD, "vary:", *lines, tail]))
    return load_study(path)


def new_runs(before: Plan, after: Plan) -> dict[str, int]:
    """Runs of a plan that the other one has not, by stage."""
    known = {run.id for run in before.runs}
    fresh = [after.stages[run.stage].name for run in after.runs if run.id not in known]
    return dict(Counter(fresh))


@pytest.mark.parametrize(
    ("axis", "before", "after", "expected"),
    [
        # two angles and two rates stand beside the axis that grows
        pytest.param(
            "stress",
            "{parameter: stress.yy, values: [5 MPa, 10 MPa]}",
            "{parameter: stress.yy, values: [5 MPa, 7 MPa, 10 MPa]}",
            {"stress": 1, "open": 2, "measure": 2, "flow": 2, "observe": 4},
            id="numbers",
        ),
        pytest.param(
            "aperture",
            "{parameter: fractures.natural.aperture, from: 20 um, to: 500 um, count: 3}",
            "{parameter: fractures.natural.aperture, from: 20 um, to: 500 um, count: 5}",
            {"open": 4, "measure": 4, "flow": 4, "observe": 8},
            id="from, to, count: finer",
        ),
        pytest.param(
            "aperture",
            "{parameter: fractures.natural.aperture, from: 0.1 mm, to: 0.3 mm, count: 3}",
            "{parameter: fractures.natural.aperture, from: 0.1 mm, to: 0.6 mm, count: 6}",
            {"open": 6, "measure": 6, "flow": 6, "observe": 12},
            id="from, to, count: further",
        ),
        pytest.param(
            "aperture",
            "{parameter: fractures.natural.aperture, from: 1 um, to: 100 um, count: 3,"
            " spacing: log}",
            "{parameter: fractures.natural.aperture, from: 1 um, to: 1 mm, count: 4, spacing: log}",
            {"open": 2, "measure": 2, "flow": 2, "observe": 4},
            id="from, to, count: logarithmic",
        ),
        pytest.param(
            "hydraulic_angle",
            "{parameter: fractures.hydraulic.angle, values: [0 deg, 20 deg, 40 deg]}",
            "{parameter: fractures.hydraulic.angle, from: 0 deg, to: 60 deg, count: 4}",
            {"walk": 2, "open": 2, "measure": 2, "flow": 2, "observe": 4},
            id="angles: a list that becomes a range",
        ),
        pytest.param(
            "stresses",
            "{parameters: [stress.xx, stress.yy], values: [[20 MPa, 10 MPa]]}",
            "{parameters: [stress.xx, stress.yy], values: [[20 MPa, 10 MPa], [9 MPa, 9 MPa]]}",
            {"stress": 1, "open": 2, "measure": 2, "flow": 2, "observe": 4},
            id="pairs",
        ),
        pytest.param(
            "solver",
            "{parameter: solver.method, values: [krylov]}",
            "{parameter: solver.method, values: [krylov, implicit]}",
            {"flow": 2, "observe": 4},
            id="words",
        ),
        pytest.param(
            "seed",
            "{parameter: grains.seed, values: [1, 2]}",
            "{parameter: grains.seed, values: [1, 2, 3]}",
            {"pack": 1, "unit_loads": 1, "stress": 1, "network": 1, "calibrate": 1}
            | {"walk": 2, "open": 2, "measure": 2, "flow": 2, "observe": 4},
            id="seeds",
        ),
        pytest.param(
            "initial",
            "{parameters: [initial_pressure, boundaries.outer], values: [[7 MPa, 7 MPa]]}",
            "{parameters: [initial_pressure, boundaries.outer],"
            " values: [[7 MPa, 7 MPa], [5 MPa, 5 MPa]]}",
            {"observe": 4},
            id="pressures that shift a response",
        ),
    ],
)
def test_one_value_more_computes_what_hangs_on_it(tmp_path, axis, before, after, expected):
    small = planned(study(tmp_path, {**AXES, axis: before}))
    large = planned(study(tmp_path, {**AXES, axis: after}))
    assert new_runs(small, large) == expected
    assert new_runs(large, small) == {}  # what was there is wanted still


@pytest.mark.parametrize(
    ("parameter", "value"),
    [
        ("stress.yy", "10 MPa"),
        ("fractures.natural.aperture", "100 um"),
        ("fractures.natural.angle", "65 deg"),
        ("wells.producer.rate", "2e-5 m3/s"),
        ("grains.seed", "1"),
        ("grains.count", "4000"),
        ("fluid.viscosity", "1000 cP"),
        ("matrix.permeability", "0.458 mD"),
    ],
)
def test_a_new_axis_with_one_value_taken_as_before_computes_nothing(tmp_path, parameter, value):
    axes = {} if parameter.startswith(("fractures.natural.angle", "wells")) else AXES
    before = planned(study(tmp_path, {"yy": "{parameter: stress.xx, values: [20 MPa]}", **axes}))
    more = {**axes, "more": f"{{parameter: {parameter}, values: [{value}]}}"}
    assert new_runs(before, planned(study(tmp_path, more))) == {}


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ("boundary_flow", {"flow": 2, "observe": 4}),
        ("grain_map", {"observe": 4}),
    ],
)
def test_a_further_output_computes_no_more_than_it_needs(tmp_path, more, expected):
    before = planned(study(tmp_path, AXES))
    tail = TAIL.replace(OBSERVED, OBSERVED.replace("]", f", {more}]"))
    assert new_runs(before, planned(study(tmp_path, AXES, tail))) == expected


def test_fewer_values_compute_nothing(tmp_path):
    before = planned(study(tmp_path, AXES))
    after = planned(study(tmp_path, {"rate": AXES["rate"], "angle": AXES["angle"]}))
    assert new_runs(before, after) == {}  # the axes the other way round
    part = planned(study(tmp_path, {"angle": AXES["angle"]}))
    assert {run.id for run in part.runs} <= {run.id for run in before.runs}


def test_the_dataset_grows_with_the_study(tmp_path):
    """Computed are the runs that the plan lists; what was there has the same bits."""
    results = tmp_path / "results"
    toys.run(toys.write_study(tmp_path), results)
    before = open_results(results / "toy").load()
    path = toys.write_study(tmp_path, seeds=(1, 2, 3), rates=(1.0, 1.5, 2.0, 3.0))
    made = toys.prepared(path, results)
    fresh = int((~made.stored()).sum())
    finished = toys.run(path, results)
    assert finished.executed.computed == fresh == 1 + 2 + 2 * (2 * 2 * 1 + 2 * 4)
    grown = open_results(results / "toy")
    assert dict(grown.sizes) == {**before.sizes, "seed": 3, "rate": 4}
    for name in ("well_pressure", "porosity", "stress_achieved"):
        np.testing.assert_array_equal(
            grown[name].sel(seed=before.seed, rate=before.rate), before[name]
        )


SHIPPED = sorted((Path(__file__).parents[2] / "studies").glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_what_no_scene_wants_changes_no_identity(path):
    """A stage that the table gets, a parent of others, and a part that no scene has."""
    shipped = load_study(path, smoke=True)
    idle = dataclasses.replace(STAGES[0], name="idle", wanted=lambda scene: False)
    grown = [
        dataclasses.replace(
            stage,
            parents=("idle", *stage.parents),
            reads={"absent": lambda scene: None, **stage.reads},
        )
        for stage in STAGES
    ]
    before = make_plan(_scenes(shipped), STAGES)
    after = make_plan(_scenes(shipped), (idle, *grown))
    assert [run.id for run in after.runs] == [run.id for run in before.runs]


def _scenes(shipped: Study) -> Iterator[Scene | SceneError]:
    builder = SceneBuilder(shipped.values, shipped.axes)
    for place in itertools.islice(itertools.product(*map(range, shipped.shape)), 100):
        try:
            yield builder.scene(place)
        except SceneError as error:
            yield error


# Every declared parameter in turn.

# Without weight results ignore the grains' density, by a permeability the fluid's; packings with
# walls the tile, linear contacts the ratio.
UNREAD = {"grains.density", "fluid.density", "grains.tile", "grains.poissons_ratio"}


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Scene:
    """A scene with every block that there is."""
    folder = tmp_path_factory.mktemp("scene")
    made = case_at(study(folder, {"one": "{parameter: grains.seed, values: [1]}"}), [0]).scene
    # elastic moduli rule out contacts that resist rolling, and with them their parameter
    for name in sorted(set(OBSERVABLES) - set(made.observe) - {"elastic_moduli"}):
        with suppress(SceneError):  # what it has not got cannot be observed
            made = dataclasses.replace(made, observe=(*made.observe, name))
    return made


def leaves(value: Any, path: str, rebuild: Any) -> Iterator[tuple[str, Any, Any]]:
    """Each parameter of a scene: its path, its declaration and value, and how to change it."""
    for field in dataclasses.fields(value):
        own = getattr(value, field.name)
        inner = f"{path}.{field.name}".lstrip(".")

        def put(new: Any, value: Any = value, name: str = field.name) -> Scene:
            return rebuild(dataclasses.replace(value, **{name: new}))

        if dataclasses.is_dataclass(own):
            yield from leaves(own, inner, put)
        elif isinstance(own, tuple) and own and dataclasses.is_dataclass(own[0]):
            for k, one in enumerate(own):

                def put_one(new: Any, own: tuple = own, k: int = k, put: Any = put) -> Scene:
                    return put((*own[:k], new, *own[k + 1 :]))

                yield from leaves(one, f"{inner}.{one.name}", put_one)
        elif field.metadata:
            yield inner, (field, own), put


def others(field: dataclasses.Field, value: Any) -> list[Any]:
    """Values beside the one that a parameter has, some of which may be out of bounds."""
    if field.metadata["choices"]:
        return [choice for choice in field.metadata["choices"] if choice != value]
    if "Refinement" in str(field.type):
        return [(Refinement(around="wells", within=1.0, factor=2.0),)]
    if value is None:
        return [0.5, 1.5, 2, 1e-5]
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int):
        return [value + 1]
    if isinstance(value, float):
        return [value * 1.01 + 1e-6, value * 0.99, 0.5]
    if isinstance(value, tuple) and all(isinstance(part, float) for part in value):
        return [(*value[:-1], value[-1] * 1.01 + 1e-6)]
    return []


def test_every_parameter_reaches_exactly_the_stages_that_read_it(scene):
    """Identities follow what a stage is given, for each declared parameter and each stage."""

    def identities(scene: Scene) -> dict[str, str]:
        plan = make_plan([scene], STAGES)
        return {plan.stage_of(run).name: plan.runs[run].id for run in plan.case_runs(0)}

    before = identities(scene)
    tried, unread = set(), set()
    for path, (field, value), put in leaves(scene, "", lambda scene: scene):
        for other in others(field, value):
            try:
                after = put(other)
            except (SceneError, TypeError, ValueError):
                continue  # not a value that this scene could have
            tried.add(path)
            found = identities(after)
            reached: set[str] = set()
            for stage in STAGES:
                if stage.name in before and stage.name in found:
                    parts = {**stage.reads, **stage.options}.values()
                    given = any(part(scene) != part(after) for part in parts)
                    # a parent that comes or goes counts as one that changed
                    changed = any(
                        p in reached or (p in before) != (p in found) for p in stage.parents
                    )
                    if given or changed:
                        reached.add(stage.name)
            assert {n for n in found if n in before and found[n] != before[n]} == reached, path
            if not reached and set(found) == set(before):
                unread.add(path)
            break
    assert unread <= UNREAD
    # what a scene must have is among them
    assert {
        "grains.count",
        "grains.seed",
        "grains.friction",
        "stress.yy",
        "fractures.natural.angle",
        "fractures.natural.aperture",
        "fluid.viscosity",
        "wells.producer.rate",
        "solver.tolerance",
        "initial_pressure",
    } <= tried
