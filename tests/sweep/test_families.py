"""Families: which cases they hold, what their runs are named by, what comes out of a study."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from demflow import sweep
from demflow.model.outcome import Status
from demflow.model.scene import (
    Bonds,
    Circle,
    Fluid,
    FractureSet,
    Grains,
    Matrix,
    Scene,
    Solver,
    Stress,
    Well,
)
from demflow.model.stages import STAGES
from demflow.sweep.engine import run_study
from demflow.sweep.errors import ResultsError
from demflow.sweep.plan import families
from demflow.sweep.plan.graph import Plan, make_plan
from demflow.sweep.store.products import Store

STIFF = Grains(count=150, porosity=0.17, seed=2, modulus=20e9, stiffness_ratio=2.5)
CEMENT = Bonds("contact", 5e8, 5e8)
STRONG = {"grains": STIFF, "bonds": CEMENT}
WIDTHS = np.geomspace(5e-5, 5e-4, 9)
STUDY = """
study: widths
scene:
  region: {shape: circle, radius: 3 m}
  grains: {count: 150, porosity: 0.17, seed: 2}
  matrix: {aperture: 20 um}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  fractures:
    one: {kind: set, angle: 65 deg, length: 2 m, spacing: 1 m, aperture: 100 um}
    two: {kind: trace, from: [-2 m, 0.1 m], to: [1 m, 0.4 m], aperture: 100 um}
  wells: {w: {at: [0 m, 0 m], radius: 0.3 m, rate: 1e-6 m3/s}}
  boundaries: {outer: 7 MPa}
  initial_pressure: 7 MPa
  times: {first: 1 ms, last: 100 s, per_decade: 5}
vary:
  one: {parameter: fractures.one.aperture, from: 50 um, to: 300 um, count: 4, spacing: log}
  two: {parameter: fractures.two.aperture, from: 50 um, to: 300 um, count: 3, spacing: log}
  rate: {parameter: wells.w.rate, values: [1e-6 m3/s, -3e-6 m3/s]}
observe: [well_pressure]
solver: {method: METHOD, tolerance: 1e-5}
"""


def scene(one: float, two: float, rate: float = 1e-6, **changed) -> Scene:
    told = {
        "region": Circle(3.0),
        "grains": Grains(count=150, porosity=0.17, seed=2),
        "matrix": Matrix(aperture=2e-5),
        "fluid": Fluid(1e-3, 1e9),
        "fractures": (
            FractureSet(name="one", angle=1.1, length=2.0, spacing=1.0, aperture=one),
            FractureSet(name="two", angle=0.1, length=2.0, spacing=1.0, aperture=two),
        ),
        "wells": (Well(name="w", at=(0.0, 0.0), radius=0.3, rate=rate),),
        "boundaries": (("outer", 7e6),),
        "initial_pressure": 7e6,
        "times": (1e-3, 1.0),
        "observe": ("well_pressure",),
    }
    return Scene(**{**told, **changed})


def measured(one: float, two: float, **changed) -> Scene:
    """A scene of which permeabilities are observed and nothing else."""
    none = {"wells": (), "boundaries": (), "initial_pressure": None, "times": ()}
    return scene(one, two, **{**none, "observe": ("permeability",), **changed})


def grid(**changed) -> list[Scene]:
    return [scene(*at, **changed) for at in itertools.product(WIDTHS, WIDTHS, (1e-6, 2e-6))]


def names(plan: Plan, case: int) -> list[str]:
    return [plan.stage_of(run).name for run in plan.case_runs(case)]


def test_a_large_family_is_served_by_a_few_runs():
    plan = make_plan(grid(), STAGES)
    counts = dict(zip((s.name for s in STAGES), plan.counts(), strict=True))
    assert counts["flow"] == counts["open"] == counts["observe"] == 0
    assert counts["emulator"] == 1
    assert counts["emulate"] == -(-2 * 81 // 512)
    assert names(plan, 100) == ["pack", "network", "walk", "emulator", "emulate"]
    served = [
        (plan.runs[run].members[at], case)
        for case in range(162)
        for run, at in [plan.result_of(case)]
    ]
    assert all(member == case for member, case in served)
    for number, run in enumerate(plan.runs):
        assert all(p < number for p in run.parents)


def test_what_a_model_is_made_of_lies_apart():
    """The middle of the family, its corners, and then what is farthest from them."""
    plan = make_plan(grid(), STAGES)
    made = next(run for run in plan.runs if plan.stages[run.stage].name == "emulator")
    at = np.array([(c // 2 // 9, c // 2 % 9) for c in made.members])
    assert len(made.members) == families.CHOSEN
    assert len({tuple(one) for one in at}) == families.CHOSEN
    assert tuple(at[0]) == (4, 4)
    assert {tuple(one) for one in at[1:5]} == {(0, 0), (0, 8), (8, 0), (8, 8)}


@pytest.mark.parametrize(
    "changed",
    [
        {"solver": Solver(method="krylov")},
        {"observe": ("well_pressure", "pressure_map")},
        {"observe": ("well_pressure", "permeability")},
        {"boundaries": (("outer", 8e6),)},
        {"times": ()},
    ],
    ids=("named", "map", "tensor", "side", "steady"),
)
def test_who_asks_for_more_is_solved_case_by_case(changed):
    if changed.get("times") == ():
        changed["initial_pressure"] = None
    plan = make_plan(grid(**changed), STAGES)
    assert not len(plan.member)
    assert "flow" in names(plan, 0)


def test_permeabilities_of_a_large_family_are_measured_together():
    """Blocks of 64 cases, beside another family and cases that want more."""
    told = [measured(*at) for at in itertools.product(WIDTHS, WIDTHS)]
    more = scene(1e-4, 1e-4, observe=("permeability", "well_pressure"))
    plan = make_plan(
        [*told, *grid(), more, measured(1e-4, 1e-4, matrix=Matrix(aperture=1e-5))], STAGES
    )
    counts = dict(zip((s.name for s in STAGES), plan.counts(), strict=True))
    assert counts["tensors"] == 2
    assert counts["emulator"] == 1
    assert counts["open"] == counts["measure"] == counts["observe"] == 2
    assert counts["flow"] == 1
    assert names(plan, 70) == ["pack", "network", "walk", "tensors"]
    assert names(plan, 81 + 70) == ["pack", "network", "walk", "emulator", "emulate"]
    assert plan.member[-2:].tolist() == [-1, -1]
    for case in range(len(plan.cases) - 2):
        run, at = plan.result_of(case)
        assert plan.runs[run].members[at] == case
    alone = make_plan(told[:63], STAGES)
    assert not len(alone.member)
    assert "measure" in names(alone, 0)


@pytest.mark.parametrize("axis", ["fluid", "stress"])
def test_cases_of_other_rocks_or_fluids_are_measured_alone(axis):
    """Members differ in apertures: of those that differ otherwise each is a family of its own."""
    changes = {
        "fluid": [{"fluid": Fluid(1e-3 * k, 1e9)} for k in range(1, 81)],
        "stress": [{"stress": Stress(xx=1e6 * k, yy=1e6), **STRONG} for k in range(1, 81)],
    }
    plan = make_plan([measured(1e-4, 1e-4, **one) for one in changes[axis]], STAGES)
    assert not len(plan.member)


def loaded(one: float, load: float, **changed) -> Scene:
    """A scene of which permeabilities are observed, under a stress that unit loads give."""
    stress = Stress(xx=1e6 * load, yy=1e6, method="static")
    return measured(one, 1e-4, stress=stress, **{**STRONG, **changed})


def test_states_of_stress_of_a_large_family_are_found_together():
    """Blocks of 16; each case by its place; others stay alone."""
    told = [loaded(1e-4, k, fractures=()) for k in range(1, 81)]
    auto = measured(1e-4, 1e-4, stress=Stress(xx=9e6, yy=1e6), fractures=(), **STRONG)
    plan = make_plan([*told, auto], STAGES)
    counts = dict(zip((s.name for s in STAGES), plan.counts(), strict=True))
    assert counts["states"] == 5
    assert counts["stress"] == counts["open"] == counts["measure"] == counts["observe"] == 1
    assert names(plan, 70) == ["pack", "unit_loads", "network", "states"]
    for case in range(80):
        run, at = plan.result_of(case)
        assert plan.runs[run].members[at] == case
    assert plan.member[80] == -1
    assert not len(make_plan(told[:63], STAGES).member)


def test_of_two_families_the_first_of_the_table_serves_if_it_is_large():
    """Apertures × stresses: 81 apertures under a stress are measured, few are loaded."""
    many = [loaded(w, load) for load in (1.0, 2.0) for w in np.geomspace(5e-5, 5e-4, 81)]
    few = [loaded(w, load) for load in range(3, 12) for w in WIDTHS]
    plan = make_plan([*many, *few], STAGES)
    counts = dict(zip((s.name for s in STAGES), plan.counts(), strict=True))
    assert counts["tensors"] == 4
    assert counts["states"] == -(-len(few) // 16)
    assert counts["stress"] == 2
    assert counts["open"] == 0
    for case in range(len(plan.cases)):
        run, at = plan.result_of(case)
        assert plan.runs[run].members[at] == case


def test_few_members_are_solved_case_by_case():
    """Rates do not count: they share one response anyway."""
    few = [scene(*at) for at in itertools.product(WIDTHS[:7], WIDTHS, (1e-6, 2e-6, 3e-6))]
    assert len(few) > families.LEAST > 63
    plan = make_plan(few, STAGES)
    assert not len(plan.member)


def test_identities_tell_the_family():
    """Alone, in another family or in its own, a case is three products; the rock is one."""
    alone, whole = make_plan([scene(WIDTHS[0], WIDTHS[0])], STAGES), make_plan(grid(), STAGES)
    less = make_plan(grid()[:150], STAGES)
    assert whole.runs[whole.cases[0, 0]].id == alone.runs[alone.cases[0, 0]].id
    found = {plan.runs[plan.result_of(0)[0]].id for plan in (alone, whole, less)}
    assert len(found) == 3
    assert make_plan(grid(), STAGES).digest() == whole.digest() != less.digest()


def test_two_rocks_are_two_families():
    other = Grains(count=150, porosity=0.17, seed=3)
    plan = make_plan(
        [*grid(), *grid(grains=other), scene(1e-4, 1e-4, matrix=Matrix(aperture=1e-5))], STAGES
    )
    counts = dict(zip((s.name for s in STAGES), plan.counts(), strict=True))
    assert counts["emulator"] == 2
    assert counts["flow"] == 1
    assert plan.member[-1] == -1
    shared = {run.id for run in make_plan(grid(), STAGES).runs}
    assert shared < {run.id for run in plan.runs}


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_a_study_of_a_family_gives_what_its_cases_give(tmp_path, monkeypatch):
    """Within the tolerance of what each case gives by itself; cases open, and run once."""
    monkeypatch.setattr(families, "LEAST", 8)
    found = {}
    for method in ("auto", "krylov"):
        path = tmp_path / f"{method}.yaml"
        text = STUDY.replace("METHOD", method).replace("study: widths", f"study: {method}")
        path.write_text(text)
        done = run_study(path, results=tmp_path / "results", workers=1, figures=False)
        assert done.failed == 0
        found[method] = sweep.open_results(done.folder).load()
    auto, alone = found["auto"], found["krylov"]
    assert set(np.unique(auto.solver_used)) == {"emulated"}
    assert "emulator_snapshots" not in alone
    assert float(auto.estimated_error.max()) <= 1e-5
    off = abs(auto.pressure_change - alone.pressure_change) / abs(alone.pressure_change)
    assert float(off.max()) <= 2e-5
    for name in ("smallest_pore", "domain_count", "idle_traces", "porosity", "pores_per_well"):
        np.testing.assert_array_equal(auto[name], alone[name], err_msg=name)
    again = run_study(tmp_path / "auto.yaml", results=tmp_path / "results", figures=False)
    assert again.executed is None
    at = {name: float(alone[name][1]) for name in ("one", "two", "rate")}
    cases = [sweep.open_case(tmp_path / "results" / name, **at) for name in ("auto", "krylov")]
    np.testing.assert_array_equal(cases[0].branch_aperture, cases[1].branch_aperture)


MEASURED = """
study: tensors
scene:
  region: {shape: rectangle, width: 5 m, height: 4 m}
  grains: {count: 150, porosity: 0.17, seed: 2}
  matrix: {aperture: 20 um}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  fractures:
    one: {kind: set, angle: 65 deg, length: 2 m, spacing: 1 m, aperture: 100 um}
    two: {kind: trace, from: [-2 m, 0.1 m], to: [1 m, 0.4 m], aperture: 100 um}
vary:
  one: {parameter: fractures.one.aperture, from: 50 um, to: 300 um, count: 9, spacing: log}
  two: {parameter: fractures.two.aperture, from: 50 um, to: 300 um, count: 8, spacing: log}
observe: [permeability, bar_permeability, periodic_permeability]
"""


LOADED = """
study: states
scene:
  region: {shape: rectangle, width: 5 m, height: 4 m}
  grains: {count: 150, porosity: 0.17, seed: 2, modulus: 20 GPa, stiffness_ratio: 2.5}
  bonds: {kind: contact, tensile_strength: 500 MPa, shear_strength: 500 MPa, installation_gap: 0.01}
  stress: {xx: 10 MPa, yy: 10 MPa, method: static}
  matrix: {permeability: 1 mD, half_stress: 8 MPa}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
vary:
  one: {parameter: stress.xx, from: 10 MPa, to: 20 MPa, count: 9}
  two: {parameter: stress.yy, from: 8 MPa, to: 12 MPa, count: 8}
observe: [permeability, bar_permeability, periodic_permeability]
"""


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
@pytest.mark.parametrize(
    ("text", "stage", "count"), [(MEASURED, "tensors", 2), (LOADED, "states", 5)]
)
def test_a_study_of_tensors_gives_what_its_cases_give(text, stage, count, tmp_path, monkeypatch):
    """To the bit; a block that is lost is made again alone, cases open, and nothing is left."""
    path = tmp_path / "study.yaml"
    path.write_text(text)
    results = tmp_path / "results"
    done = run_study(path, results=results, workers=1, figures=False)
    assert done.failed == 0
    found = sweep.open_results(done.folder).load()
    first = sweep.open_case(done.folder, one=float(found.one[3]), two=float(found.two[2]))
    store = Store.open(results / "store", create=False)
    blocks = [p for p in store.files() if store.meta(p.stem)["stage"] == stage]
    assert len(blocks) == count
    blocks[0].unlink()
    again = run_study(path, results=results, workers=1, figures=False)
    assert again.executed is not None
    assert again.executed.computed == 1
    assert run_study(path, results=results, figures=False).executed is None
    monkeypatch.setattr(families, "LEAST", 1000)
    alone = run_study(path, results=tmp_path / "alone", workers=1, figures=False)
    each = sweep.open_results(alone.folder).load()
    for name in each.data_vars:
        if not name.endswith("_time"):
            np.testing.assert_array_equal(found[name], each[name], err_msg=name)
    assert set(found.data_vars) == set(each.data_vars)
    other = sweep.open_case(alone.folder, one=float(each.one[3]), two=float(each.two[2]))
    for name in other.data_vars:
        np.testing.assert_array_equal(first[name], other[name], err_msg=name)
    assert set(first.data_vars) == set(other.data_vars)


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_a_case_that_failed_in_a_block_does_not_open(tmp_path, monkeypatch):
    """Nor one that is left out; they say why. The others of their block do open."""
    monkeypatch.setattr(families, "LEAST", 8)
    text = LOADED.replace("from: 10 MPa, to: 20 MPa, count: 9", "values: [10 MPa, 20 MPa, 3 GPa]")
    weak = text.replace("500 MPa", "100 MPa").replace("count: 8}", "count: 4}")
    path = tmp_path / "study.yaml"
    path.write_text(weak + "where: [one > 10 MPa or two < 12 MPa]\n")
    done = run_study(path, results=tmp_path / "results", workers=1, figures=False)
    found = sweep.open_results(done.folder).load()
    ends = {Status(int(one)) for one in np.unique(found.status)}
    assert ends == {Status.DONE, Status.FAILED, Status.LEFT_OUT}
    for at in np.ndindex(found.status.shape):
        one, two = (float(v[k]) for v, k in zip((found.one, found.two), at, strict=True))
        if Status(int(found.status[at])) is Status.DONE:
            assert sweep.open_case(done.folder, one=one, two=two).sizes["pipe"] > 0
        else:
            with pytest.raises(ResultsError) as error:
                sweep.open_case(done.folder, one=one, two=two)
            assert str(error.value) == f"the case has no results: {found.message[at].item()}"
    told = {"results": tmp_path / "results", "workers": 1, "figures": False}
    assert run_study(path, **told).executed is None
    again = run_study(path, **told, retry_failed=True)
    assert again.executed is not None
    assert again.executed.computed == 1
    assert again.failed == done.failed > 0


def test_scenes_of_a_family_are_no_other_scenes_alone():
    """By itself no scene wants the stages of a family, and none is one of two."""
    for stage in STAGES:
        if stage.family is not None:
            for one in (scene(1e-4, 1e-4), measured(1e-4, 1e-4)):
                assert not stage.wanted(one)
                measures = stage.name == "tensors" and not one.wells
                emulates = stage.name in ("emulator", "emulate") and bool(one.wells)
                assert stage.family(one) == (measures or emulates)
    held = dataclasses.replace(scene(1e-4, 1e-4), boundaries=(("outer", 9e6),))
    assert not any(stage.family(held) for stage in STAGES if stage.family is not None)
