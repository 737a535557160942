"""Forecasts: exact where a size was measured, a power law elsewhere, by stage and by solver."""

from __future__ import annotations

import dataclasses
import json
import math
from collections import defaultdict
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demflow.model.amounts import held_by_flow, kept_by_flow
from demflow.model.scene import Circle, Fluid, Grains, Matrix, Scene, Solver, Trace, Well
from demflow.model.stages import STAGES, grain_count
from demflow.sweep.command.forecast import _elapsed, forecast
from demflow.sweep.engine import run_study
from demflow.sweep.execution.memory import peak_memory
from demflow.sweep.plan.graph import make_plan
from demflow.sweep.plan.runs import SIZE_STEP, CostClass
from demflow.sweep.plan.table import stage_table
from demflow.sweep.store.costs import OUTLIERS, STEEPEST, Costs, Spent, exponent, scaled
from demflow.sweep.store.products import Store
from tests.sweep import toys


def kind(grains: float, stage: str = "flow", variant: str = "krylov") -> CostClass:
    return CostClass(stage, 1, variant, round(math.log(grains) / SIZE_STEP))


def measured(law, sizes, runs: int = 5) -> Costs:
    """Costs after runs that took law(n) seconds each, give or take a tenth."""
    rng = np.random.default_rng(1)
    costs = Costs()
    for n in sizes:
        for _ in range(runs):
            seconds = law(n) * rng.uniform(0.9, 1.1)
            costs.add(kind(n), seconds, int(1e3 * n), int(1.5e8 + 4e3 * n))
    return costs


@pytest.mark.parametrize("power", [0.7, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("asked", [300, 1500, 8000])
def test_a_power_law_is_found_within_a_factor_of_two(power, asked):
    def law(n):
        return 1e-3 * (n / 1000) ** power

    costs = measured(law, (500, 1000, 2000))
    assert law(asked) / 2 < costs.seconds(kind(asked)) < 2 * law(asked)
    assert 500 * asked < costs.stored(kind(asked)) < 2000 * asked
    assert costs.memory(kind(asked)) == pytest.approx(1.5e8 + 4e3 * asked, rel=0.1)


def test_what_was_measured_at_a_size_is_what_is_expected_there():
    costs = Costs()
    for seconds in (1.0, 2.0):
        costs.add(kind(1000), seconds, 10, 1)
    costs.add(kind(4000), 100.0, 10, 1)
    assert costs.seconds(kind(1000)) == pytest.approx(1.5)
    assert costs.seconds(kind(4000)) == pytest.approx(100.0)


def test_a_first_run_that_loads_its_code_is_soon_forgotten():
    costs = Costs()
    costs.add(kind(1000), 0.5, 10)
    for _ in range(OUTLIERS - 1):
        costs.add(kind(1000), 0.01, 10)
    assert costs.seconds(kind(1000)) == pytest.approx(0.01)


def test_one_size_grows_in_proportion():
    costs = Costs()
    costs.add(kind(1000), 2.0, 10)
    assert costs.seconds(kind(3000)) == pytest.approx(6.0, rel=0.1)
    assert costs.stored(kind(500)) == pytest.approx(5.0, rel=0.1)


def test_what_small_runs_take_that_does_not_grow_hides_no_growth():
    """Above all that was seen; below it the smallest tell how little of it grows."""
    costs = measured(lambda n: 0.1 + 1e-4 * n, (100, 300, 900))
    for n in (3000, 9000):
        exact = 0.1 + 1e-4 * n
        assert exact / 1.1 < costs.seconds(kind(n)) < 1.1 * costs.seconds(kind(900)) * n / 900
    assert costs.seconds(kind(30)) > 0.06


@given(st.integers(1, 4), st.integers(0, 10**6))
def test_no_worker_waits_while_a_run_is_ready(workers, seed):
    """So that what waits for others is all that is lost (Graham 1969, SIAM J. Appl. Math. 17)."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 25))
    seconds = {k: float(rng.integers(0, 5)) for k in range(count)}
    parents = [
        tuple({int(p) for p in rng.integers(-1, k, rng.integers(0, 3))}) for k in range(count)
    ]
    left = rng.random(count) < 0.8
    plan = SimpleNamespace(
        runs=[SimpleNamespace(kind=k, parents=of) for k, of in enumerate(parents)]
    )
    end = {}
    for k in np.flatnonzero(left).tolist():
        end[k] = seconds[k] + max((end.get(p, 0.0) for p in parents[k]), default=0.0)
    longest, total = max(end.values(), default=0.0), sum(seconds[k] for k in end)
    found = _elapsed(plan, left, seconds, workers)
    assert max(longest, total / workers) <= found <= total / workers + longest
    if workers == 1:
        assert found == total


def test_three_alike_take_two_workers_two_rounds():
    plan = SimpleNamespace(runs=[SimpleNamespace(kind="any", parents=(-1,))] * 3)
    assert _elapsed(plan, np.ones(3, dtype=bool), {"any": 2.0}, 2) == 4.0


def test_other_studies_are_led_and_drawn_as_those_before_on_the_whole(tmp_path, monkeypatch):
    """The last one counts half; its own folder goes by itself alone."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for seconds in (1.0, 3.0):
        store = Store.open(tmp_path / str(seconds) / "store")
        costs = Costs.read(store, everywhere=True)
        costs.note("drawing", seconds)
        costs.write(store, everywhere=True)
        assert Costs.read(store, everywhere=True).drawing == seconds
    assert Costs.read(Store.open(tmp_path / "new" / "store"), everywhere=True).drawing == 2.0


@given(
    st.dictionaries(st.integers(0, 150), st.floats(1e-6, 1e6), min_size=1, max_size=6),
    st.integers(0, 150),
)
def test_expectations_are_positive_and_grow_no_faster_than_allowed(values, step):
    seen = defaultdict(lambda: Spent(runs=3))
    found = scaled(values, seen, step)
    assert found > 0.0
    assert 0.0 <= exponent(values, seen) <= STEEPEST
    for other in (step - 1, step + 1):
        if min(values, key=lambda s: (abs(s - step), s)) == min(
            values, key=lambda s: (abs(s - other), s)
        ):
            ratio = scaled(values, seen, other) / found
            assert abs(math.log(ratio)) <= STEEPEST * SIZE_STEP * (1 + 1e-9)


def test_stages_and_solvers_are_told_apart():
    costs = measured(lambda n: 1.0, (1000,))
    assert costs.seconds(kind(1000, variant="explicit")) is None
    assert costs.seconds(kind(1000, stage="pack")) is None
    assert costs.memory(kind(1000, stage="pack")) is None
    assert costs.seconds(kind(1000)._replace(version=2)) is None


def test_costs_are_kept_for_machines_of_their_kind(tmp_path, monkeypatch):
    store = Store.open(tmp_path / "store")
    costs = measured(lambda n: n * 1e-3, (500, 1000))
    costs.write(store)
    assert Costs.read(store).known == costs.known
    monkeypatch.setattr("demflow.sweep.store.costs.machine", lambda: "abacus")
    assert Costs.read(store).known == {}
    monkeypatch.undo()
    for text in ("{]", "[]", "{}", '{"machine": 1}'):
        (store.root / "costs.json").write_text(text)
        assert Costs.read(store).known == {}


def test_what_one_folder_measured_serves_the_next_on_this_machine(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    first, second = (Store.open(tmp_path / name / "store") for name in ("first", "second"))
    costs = measured(lambda n: n * 1e-3, (500, 1000))
    costs.led(int(2e8))
    costs.write(first, everywhere=True)
    assert Costs.read(second).known == {}
    told = Costs.read(second, everywhere=True)
    assert (told.known, told.main) == (costs.known, costs.main)
    other = measured(lambda n: n * 2e-3, (1000, 2000))
    other.write(second, everywhere=True)
    both = Costs.read(first, everywhere=True)
    assert both.seconds(kind(500)) == costs.seconds(kind(500))
    assert both.seconds(kind(1000)) == costs.seconds(kind(1000))  # what was measured here
    assert both.seconds(kind(2000)) == other.seconds(kind(2000))
    (tmp_path / "cache" / "demflow" / "costs.json").write_text("{")
    assert Costs.read(first, everywhere=True).known == costs.known


def test_a_cache_that_cannot_be_written_is_done_without(tmp_path, monkeypatch):
    (tmp_path / "cache").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    store = Store.open(tmp_path / "store")
    costs = measured(lambda n: n * 1e-3, (500,))
    costs.write(store, everywhere=True)
    assert Costs.read(store, everywhere=True).known == costs.known


def test_memory_of_workers_that_compiled_counts_until_others_were_seen():
    costs = Costs()
    costs.add(kind(1000), 1.0, 10, 400, compiled=True)
    assert costs.memory(kind(1000)) == 400
    costs.add(kind(1000), 1.0, 10, 300)
    costs.add(kind(1000), 1.0, 10, 500, compiled=True)
    assert costs.memory(kind(1000)) == 300


def test_scenes_with_traces_are_told_apart_once_they_were_seen():
    costs, plain = Costs(), kind(1000)
    costs.add(plain, 1.0, 10)
    traced = plain._replace(manner="traces")
    assert costs.seconds(traced) == 1.0  # better than nothing
    costs.add(traced, 5.0, 10)
    assert (costs.seconds(plain), costs.seconds(traced)) == (1.0, 5.0)
    assert costs.seconds(plain._replace(variant="kry")) is None


def test_each_process_loads_the_code_of_a_stage_once_whatever_its_size():
    costs = Costs()
    for grains, loading in ((1000, 0.2), (1000, 0.0), (4000, 0.25)):
        costs.add(kind(grains), 1.0, 10, loading=loading)
    costs.add(kind(1000, stage="pack"), 1.0, 10, loading=0.5)
    wanted = [kind(1000), kind(9000), kind(1000, stage="pack"), kind(1000, stage="walk")]
    assert costs.loading(wanted) == pytest.approx(0.75)
    assert costs.loading([kind(1000)._replace(manner="traces")]) == pytest.approx(0.25)
    assert costs.seconds(kind(1000)) == 1.0


@pytest.mark.slow
def test_what_is_known_is_told_as_a_lower_bound(tmp_path, capsys):
    rates = (1.0, 2.0)
    path = toys.write_study(tmp_path, seconds=0.02, seeds=(1,), stresses=(), rates=rates)
    toys.run(path, tmp_path / "results")
    made = toys.prepared(path, tmp_path / "results")
    known = made.costs()
    for key in [key for key in known.known if key.startswith("observe/")]:
        del known.known[key]
    made.keep(known)
    for product in made.store.root.glob("*/*.product"):
        product.unlink()
    told = forecast(made, 2)
    assert told["unknown"] == ["observe"]
    assert (told["seconds"], told["bytes"], told["memory"]) == (None, None, None)
    own = sum(stage["seconds"] or 0.0 for stage in told["stages"])
    assert 0.015 < own / 2 < told["at_least"]["seconds"]
    assert told["at_least"]["memory"] > peak_memory()
    toys.demflow("plan", str(path), "--results", str(tmp_path / "results"))
    out = capsys.readouterr().out
    assert "expected time: at least " in out
    assert "never run on this machine: observe" in out
    assert "limits of a case: 24 h 00 min, " in out


SCENE = Scene(
    region=Circle(2.0),
    grains=Grains(count=500, porosity=0.17),
    matrix=Matrix(permeability=1e-15),
    fluid=Fluid(1.0, 1e9),
    wells=(Well(name="w", at=(0.0, 0.0), radius=0.5, rate=1e-6),),
    boundaries=(("outer", 0.0),),
    initial_pressure=0.0,
    times=(1.0, 10.0),
    observe=("well_pressure",),
)


def test_a_run_is_of_a_kind_by_its_size_and_its_solver():
    scenes = [
        SCENE,
        dataclasses.replace(SCENE, solver=Solver(method="implicit")),
        dataclasses.replace(SCENE, grains=dataclasses.replace(SCENE.grains, count=5000)),
    ]
    plan = make_plan(scenes, stage_table())
    flows = [run.kind for run in plan.runs if run.kind.stage == "flow"]
    assert len(set(flows)) == 3
    assert flows[0].variant != flows[1].variant == "implicit"
    assert flows[2].step - flows[0].step == pytest.approx(math.log(10) / SIZE_STEP, abs=1)
    # the solver decides nothing of what comes before
    assert len({run.kind for run in plan.runs if run.kind.stage == "pack"}) == 2


def test_a_description_of_fractures_grows_with_their_lines_and_with_no_grain():
    def step(lines, grains):
        at = np.linspace(-1.0, 1.0, lines)
        traces = tuple(
            Trace(name=f"t{k}", vertices=((-0.5, y), (0.5, y)), aperture=1e-4)
            for k, y in enumerate(at.tolist())
        )
        scene = dataclasses.replace(
            SCENE,
            grains=dataclasses.replace(SCENE.grains, count=grains),
            fractures=traces,
            observe=("fracture_network",),
        )
        runs = make_plan([scene], stage_table()).runs
        (found,) = (run.kind.step for run in runs if run.kind.stage == "fractures")
        return found

    assert step(20, 500) == step(20, 50_000)
    assert step(200, 500) - step(20, 500) == pytest.approx(math.log(10) / SIZE_STEP, abs=1)


def test_a_radius_counts_as_about_the_grains_that_it_gives():
    radius = math.sqrt(0.83 * SCENE.region.area / (500 * math.pi))
    by_radius = dataclasses.replace(SCENE.grains, count=None, mean_radius=radius)
    assert grain_count(dataclasses.replace(SCENE, grains=by_radius)) == pytest.approx(500, rel=0.3)


@pytest.mark.slow
def test_a_forecast_after_a_few_runs_is_right_within_a_factor_of_two(tmp_path):
    """Ten cases measured; then forty, of which the plan tells what they will take."""
    results, seconds = tmp_path / "results", 0.02
    few = tuple(map(float, range(1, 11)))
    assert forecast(toys.prepared(toys.write_study(tmp_path), results), 2)["seconds"] is None
    toys.run(toys.write_study(tmp_path, rates=few, seconds=seconds, seeds=(1,)), results)
    many = toys.write_study(
        tmp_path, rates=tuple(map(float, range(1, 51))), seconds=seconds, seeds=(1,)
    )
    before = toys.prepared(many, results)
    told = forecast(before, 1)
    fresh = [run for run, there in zip(before.plan.runs, before.stored(), strict=True) if not there]
    toys.run(many, results)
    spent = sum(before.store.meta(run.id)["seconds"] for run in fresh)
    size = sum(before.store.path(run.id).stat().st_size for run in fresh)
    assert told["to_run"] == len(fresh) == 2 * 2 * 40
    stages = sum(stage["seconds"] for stage in told["stages"])
    assert spent / 2 < stages < 2 * spent
    assert told["seconds"] > stages  # workers have to start
    assert size / 2 < told["bytes"] < 2 * size
    assert told["memory"] > 10e6
    assert forecast(before, 2)["seconds"] == 0.0
    assert forecast(toys.prepared(many, results), 2)["bytes"] == 0


@pytest.mark.slow
def test_figures_and_report_count_as_they_took_the_last_time(tmp_path):
    """What the plan tells of more cases is that much longer; a run that draws nothing keeps it."""
    results = tmp_path / "results"
    few = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    run_study(few, results=results, workers=1, table=toys.TABLE)
    many = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0, 2.0))
    made = toys.prepared(many, results)
    costs, told = made.costs(), forecast(made, 1)["at_least"]["seconds"]
    drawing = costs.drawing
    assert drawing is not None
    assert 0.0 < drawing < told
    leading = costs.leading
    assert 0.0 < leading < told - drawing
    costs.drawing, costs.leading = 3.0 * drawing, 2.0 * leading
    made.keep(costs)
    longer = told + 2.0 * drawing + leading
    assert forecast(made, 1)["at_least"]["seconds"] == pytest.approx(longer)
    toys.run(many, results)
    assert toys.prepared(many, results).costs().drawing == 3.0 * drawing


@pytest.mark.parametrize("changes", [1, 7, 60])
@pytest.mark.parametrize("maps", [False, True])
def test_numbers_of_the_responses_are_counted_before_they_are_made(changes, maps):
    """Exactly, but for the maps, whose pores are about as many as the grains."""
    begin = np.linspace(0.0, 100.0, changes) + 0.1 * np.arange(changes) ** 1.5
    scene = Scene(
        region=Circle(1.0),
        grains=Grains(count=300, packing="hexagonal"),
        matrix=Matrix(aperture=1e-5),
        fluid=Fluid(1e-3, 1e9),
        observe=("well_pressure", "pressure_map") if maps else ("well_pressure",),
        wells=(
            Well(
                name="w",
                at=(0.0, 0.0),
                radius=0.1,
                schedule=tuple((float(t), 1e-6 * (1 + k % 2)) for k, t in enumerate(begin)),
            ),
        ),
        boundaries=(("outer", 1e6),),
        initial_pressure=1e6,
        times=tuple(np.geomspace(1.0, 1e3, 20).tolist()),
    )
    responses = run_stages_of(scene)["flow"]
    arrays = [np.asarray(array) for array in responses]
    many = sum(array.size for array in arrays if array.ndim == 3)
    counted = kept_by_flow(scene)
    if maps:
        assert many / 3 < counted < 3 * many
    else:
        assert counted == pytest.approx(many, rel=0.05)
    assert held_by_flow(scene) > counted


def run_stages_of(scene):
    products = {}
    for stage in STAGES:
        if stage.name != "observe" and stage.wanted(scene):
            parents = [products.get(name) for name in stage.parents]
            products[stage.name] = stage.run(*parents, **stage.given(scene))
    return products


def test_more_times_take_more_disk_and_memory_at_the_same_size():
    costs, few = Costs(), kind(1000)
    costs.add(few, 1.0, 50_000, 200_000_000)
    many = few._replace(
        kept=round(math.log(1e8) / SIZE_STEP), held=round(math.log(2e8) / SIZE_STEP)
    )
    assert costs.stored(many) == pytest.approx(8e8, rel=0.06)
    assert costs.memory(many) == pytest.approx(2e8 + 1.6e9, rel=0.06)
    costs.add(many, 1.0, 800_000_000, 1_800_000_000)
    assert costs.memory(few) < 4e8  # what times took is no part of the size's


@pytest.mark.parametrize(
    "entry",
    [
        "[0, 0, 0, 0, 0, 0]",
        "[-1, 1.0]",
        "[1, NaN]",
        "[1, 1e999]",
        "[null]",
        "{}",
        "[1,1,1,1,1,1,1,1,1,1]",
    ],
)
def test_costs_that_cannot_be_are_no_costs(tmp_path, entry):
    store = Store.open(tmp_path / "store")
    costs = Costs()
    costs.add(kind(1000), 1.0, 10, 1)
    costs.write(store)
    path = tmp_path / "store" / "costs.json"
    told = json.loads(path.read_text())
    told["stages"] = {kind(1000).key: {str(kind(1000).step): "ENTRY"}}
    path.write_text(json.dumps(told).replace('"ENTRY"', entry))
    read = Costs.read(store)
    assert read.seconds(kind(1000)) is read.stored(kind(1000)) is read.memory(kind(1000)) is None
