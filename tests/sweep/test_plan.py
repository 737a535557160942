"""The plan: shared runs once, and identities that follow exactly what a stage reads."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from demflow.model.parameters import SceneError
from demflow.model.scene import Fluid, Grains, Matrix, Rectangle, Scene, Stress, Well
from demflow.sweep.plan.graph import make_plan
from demflow.sweep.plan.table import stage_table
from tests.sweep.toys import TABLE

STAGES = stage_table(TABLE)
NAMES = [stage.name for stage in STAGES]


def well(rate: float) -> tuple[Well, ...]:
    return (Well(name="w", at=(0.0, 0.0), radius=1.0, rate=rate),)


SCENE = Scene(
    region=Rectangle(14.0, 14.0),
    grains=Grains(count=50, porosity=0.17, modulus=20e9),
    stress=Stress(20e6, 10e6),
    matrix=Matrix(permeability=1e-15),
    fluid=Fluid(1.0, 1e9),
    wells=well(1.0),
    initial_pressure=7e6,
    times=(1.0, 10.0),
    observe=("well_pressure",),
)


def ids(scene: Scene) -> dict[str, str]:
    plan = make_plan([scene], STAGES)
    return {plan.stage_of(run).name: plan.runs[run].id for run in plan.case_runs(0)}


@pytest.mark.parametrize(
    ("change", "affected"),
    [
        ({"grains": replace(SCENE.grains, seed=2)}, NAMES),
        ({"grains": replace(SCENE.grains, friction=0.4)}, []),
        ({"stress": Stress(20e6, 11e6)}, ["stress", "flow", "observe"]),
        ({"wells": well(2.0)}, ["flow", "observe"]),
        ({"fluid": Fluid(2.0, 1e9)}, ["flow", "observe"]),
        ({"fluid": Fluid(1.0, 2e9)}, []),
        ({"times": (1.0, 11.0)}, ["flow", "observe"]),
        ({"matrix": Matrix(permeability=2e-15)}, []),
    ],
)
def test_a_change_reaches_exactly_the_stages_that_read_it_and_their_descendants(change, affected):
    before, after = ids(SCENE), ids(replace(SCENE, **change))
    assert [name for name in NAMES if before[name] != after[name]] == list(affected)


def test_a_new_version_of_a_stage_reaches_its_descendants():
    newer = tuple(replace(s, version=2) if s.name == "stress" else s for s in STAGES)
    before = make_plan([SCENE], STAGES).runs
    after = make_plan([SCENE], newer).runs
    assert [a.id == b.id for a, b in zip(before, after, strict=True)] == [True, False, False, False]


def test_cases_share_what_they_agree_on():
    scenes = [
        replace(SCENE, grains=replace(SCENE.grains, seed=seed), stress=Stress(xx, 1e7), wells=wells)
        for seed, xx, wells in itertools.product(
            (1, 2), (1e7, 2e7, 3e7), (well(1.0), well(2.0), well(3.0), well(4.0))
        )
    ]
    plan = make_plan(scenes, STAGES)
    assert dict(zip(NAMES, plan.counts(), strict=True)) == {
        "pack": 2,
        "stress": 6,
        "flow": 24,
        "observe": 24,
    }
    assert list(plan.wanted()) == [24] * 4
    assert len({run.id for run in plan.runs}) == len(plan.runs)
    for case, scene in enumerate(scenes):
        alone = make_plan([scene], STAGES)
        assert [plan.runs[r].id for r in plan.case_runs(case)] == [r.id for r in alone.runs]
    for number, run in enumerate(plan.runs):
        assert all(parent < number for parent in run.parents)
        assert run.case == int(np.flatnonzero((plan.cases == number).any(axis=1))[0])


def test_what_a_scene_does_not_want_does_not_exist():
    free = make_plan([replace(SCENE, stress=None)], STAGES)
    assert [free.stage_of(run).name for run in free.case_runs(0)] == ["pack", "flow", "observe"]
    assert free.runs[1].parents == (0, -1)
    assert free.runs[1].id != make_plan([SCENE], STAGES).runs[2].id


def test_an_impossible_case_costs_only_itself():
    error = SceneError([("times", "times must increase")])
    plan = make_plan([SCENE, error, replace(SCENE, wells=well(2.0))], STAGES)
    assert plan.impossible == {1: "times: times must increase"}
    assert plan.case_runs(1) == []
    assert len(plan.case_runs(2)) == 4


def test_the_digest_tells_plans_apart():
    other = replace(SCENE, wells=well(2.0))
    digests = {
        make_plan(scenes, STAGES).digest()
        for scenes in ([SCENE], [other], [SCENE, other], [other, SCENE], [SceneError([])])
    }
    assert len(digests) == 5


def test_a_table_in_the_wrong_order_is_refused(monkeypatch):
    from tests.sweep import toy_stages

    monkeypatch.setattr(toy_stages, "STAGES", STAGES[::-1])
    with pytest.raises(ValueError, match="observe stands before its parent pack"):
        stage_table(TABLE)


@pytest.mark.parametrize("observed", [(), ("flow", "observe")])
def test_one_stage_is_observed(monkeypatch, observed):
    from tests.sweep import toy_stages

    table = tuple(replace(stage, observed=stage.name in observed) for stage in STAGES)
    monkeypatch.setattr(toy_stages, "STAGES", table)
    with pytest.raises(ValueError, match="one stage's product is what is observed"):
        stage_table(TABLE)
