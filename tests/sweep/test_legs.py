"""Stages that march leg by leg: shared beginnings, growth, deaths, and the same bits as at once."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from demflow.model import stages as model_stages
from demflow.model.outcome import ModelError, Status
from demflow.model.quantities import STOPPED, checked
from demflow.model.scene import Circle, Fluid, Grains, Matrix, Scene, Solver, Well
from demflow.model.stages import run_stages, simulate
from demflow.sweep import engine
from demflow.sweep.analysis.cases import events
from demflow.sweep.command.forecast import forecast
from demflow.sweep.dataset import collect as collecting
from demflow.sweep.dataset.open import open_results
from demflow.sweep.dataset.ragged import Ragged
from demflow.sweep.dataset.tiles import Tile
from demflow.sweep.plan.graph import make_plan
from demflow.sweep.plan.table import stage_table
from demflow.sweep.prepared import prepare
from tests.sweep import marches, toys
from tests.sweep.toy_stages import DIARY
from tests.sweep.toy_stages import pack as toy_pack

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("forked_workers")]

STEPS = {  # rates from 0, 10 and 20 s on
    "a": (1.0, 2.0, 3.0),
    "b": (1.0, 2.0, 0.0),
    "c": (1.0, 4.0, 0.0),
    "d": (1.0, 4.0, 5.0),
}
BEGINNINGS = {rates[:k] for rates in STEPS.values() for k in (1, 2, 3)}


def write(folder: Path, steps=STEPS, last: float = 30.0, seconds: float = 1e-6) -> Path:
    return marches.write_study(folder, steps.values(), last=last, seconds=seconds)


def run(path: Path, table: str = marches.TOY, **options) -> engine.Finished:
    results = path.parent / "results"
    return engine.run_study(path, results=results, figures=False, table=table, **options)


def test_schedules_share_what_they_begin_with(tmp_path):
    path = write(tmp_path)
    made = prepare(path, tmp_path / "results", table=marches.TOY)
    runs = Counter(made.plan.stage_of(run).name for run in range(len(made.plan.runs)))
    assert runs == {"pack": 1, "march": len(BEGINNINGS), "observe": len(STEPS)}
    assert len(BEGINNINGS) == 7
    for case in range(len(STEPS)):
        names = [made.plan.stage_of(run).name for run in made.plan.case_runs(case)]
        assert names == ["pack", "march", "march", "march", "observe"]
        assert [made.plan.runs[run].leg for run in made.plan.case_runs(case)] == [0, 0, 1, 2, 0]
    told = {stage["name"]: stage for stage in forecast(made, 2)["stages"]}
    assert (told["march"]["runs"], told["march"]["shared"]) == (7, 3 * len(STEPS) - 7)


@pytest.fixture(scope="module")
def marched(tmp_path_factory):
    folder = tmp_path_factory.mktemp("marched")
    path = write(folder)
    return path, run(path)


@pytest.mark.slow
def test_what_marches_by_legs_is_what_is_superposed(marched):
    """Whatever is shared, each case is its own schedule; and the legs bear no trace of it."""
    _path, finished = marched
    assert (finished.failed, finished.executed.computed) == (0, 1 + 7 + 4)
    seen = open_results(finished.folder)
    packed = toy_pack(count=50, seed=1)
    for case, rates in enumerate(STEPS.values()):
        steps = [(10.0 * k, rate) for k, rate in enumerate(rates)]
        exact = marches.toy_result(packed, steps, seen.elapsed_time.values)
        np.testing.assert_allclose(seen.well_pressure[case, 0], exact, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_events_stand_case_after_case_with_the_count_of_each(tmp_path, monkeypatch):
    """Over two axes, whatever is collected at once; what failed or had none counts as none."""
    steps = {
        "none": (0.0, 0.0, 0.0),
        "many": (3.0, 0.0, 4.0),
        "fails": (1.0, marches.RAISES, 1.0),
        "stops": (2.0, marches.STOPS, 1.0),
    }
    text = write(tmp_path, steps).read_text()
    seeds = "  seed: {parameter: grains.seed, values: [1, 2]}\n"
    path = tmp_path / "both.yaml"
    path.write_text(text.replace("vary:\n", f"vary:\n{seeds}").replace("study: m", "study: two-m"))
    folder = run(path).folder
    seen = open_results(folder)
    assert seen.event_count.dims == ("seed", "schedule")
    assert seen.event_count.attrs["sample_dimension"] == "event"
    assert seen.event_count.values.tolist() == [[0, 7, 0, 2 + 7]] * 2
    assert seen.event_time.dims == seen.event_x.dims == ("event",)
    assert "event_energy" not in seen
    ends = {"none": (), "fails": (), "many": (10, 20, 30), "stops": (10, 15)}
    for case, (name, rates) in enumerate(steps.items()):
        exact = [
            np.linspace(10.0 * k, end, int(rates[k]) % 10 + 2)[1:-1]
            for k, end in enumerate(ends[name])
        ]
        for seed in range(2):
            own = events(seen, {"seed": seed, "schedule": case})
            np.testing.assert_array_equal(own.event_time, np.concatenate([[], *exact]))
            np.testing.assert_array_equal(own.event_x, np.sqrt(own.event_time))
    for together in (1, 2, 3):  # cases that are written at once
        monkeypatch.setattr(collecting, "TILE_CASES", together)
        (folder / "dataset.nc").unlink()
        assert run(path).executed is None
        assert seen.equals(open_results(folder))


def test_quantities_of_the_events_of_a_case_are_as_many(tmp_path):
    with netCDF4.Dataset(tmp_path / "some.nc", "w") as file:
        ragged = Ragged(file, ())
        ragged.add(0, "event_time", np.arange(3.0))
        ragged.add(0, "event_x", np.arange(2.0))
        with pytest.raises(ValueError, match="event_x has 2 values in a case of 3"):
            ragged.flush(Tile(range(1), (), ()))


@pytest.mark.slow
def test_what_is_stored_serves_a_later_end_and_a_further_change(tmp_path):
    """A last time that grows costs the last leg anew, a further change of a rate one more."""
    first = run(write(tmp_path, {"a": (1.0, 2.0)}))
    assert first.executed.computed == 1 + 2 + 1
    further = run(write(tmp_path, {"a": (1.0, 2.0, 3.0)}))
    assert further.executed.computed == 2 + 1  # the second leg ends at the third rate now
    later = run(write(tmp_path, {"a": (1.0, 2.0, 3.0)}, last=40.0))
    assert later.executed.computed == 1 + 1
    assert run(write(tmp_path, {"a": (1.0, 2.0, 3.0)}, last=40.0)).executed is None


@pytest.mark.slow
@pytest.mark.usefixtures("spawned_workers")
def test_a_killed_worker_loses_no_finished_leg(tmp_path, monkeypatch):
    """The leg under which it died is run again, those before it are not; the bits are the same."""
    diary = tmp_path / "diary"
    monkeypatch.setenv(DIARY, str(diary))
    steps = {"a": (1.0, marches.DIES_ONCE, 3.0), "b": (1.0, marches.DIES_ONCE, 4.0)}
    path = write(tmp_path, steps, seconds=0.3)
    finished = run(path, workers=1)
    assert (finished.failed, finished.executed.deaths) == (0, 1)
    begun = Counter(line for line in diary.read_text().splitlines() if line.startswith("begins"))
    again = f"begins 10 {marches.DIES_ONCE:g}"
    assert begun.pop(again) == 2
    assert begun == {"begins 0 1": 1, "begins 20 3": 1, "begins 20 4": 1}
    calm = write(tmp_path, steps)
    seen = open_results(finished.folder).load()
    whole = open_results(
        engine.run_study(
            calm, results=tmp_path / "undisturbed", figures=False, table=marches.TOY
        ).folder
    )
    np.testing.assert_array_equal(seen.well_pressure, whole.well_pressure)


@pytest.mark.slow
def test_a_leg_that_fails_is_told_with_what_was_finished_before_it(tmp_path):
    steps = {"a": (1.0, 2.0, marches.RAISES), "b": (1.0, marches.RAISES, 3.0), "c": (1.0, 2.0, 3.0)}
    path = write(tmp_path, steps)
    finished = run(path)
    seen = open_results(finished.folder)
    assert seen.status.values.tolist() == [Status.FAILED, Status.FAILED, Status.DONE]
    assert all("march: ValueError: the well is dry" in str(m) for m in seen.message.values[:2])
    made = prepare(path, tmp_path / "results", table=marches.TOY)
    there = [[bool(made.stored()[run]) for run in made.plan.case_runs(case)] for case in range(3)]
    assert there == [
        [True, True, True, False, False],
        [True, True, False, False, False],
        [True] * 5,
    ]
    assert run(path).executed is None  # known to fail, tried again only where that is asked for


@pytest.mark.slow
def test_a_case_that_stops_keeps_what_came_before(tmp_path, capsys):
    """Its status says so and its message when; the legs that it does not reach change nothing."""
    steps = {"a": (1.0, 2.0, 3.0), "b": (1.0, marches.STOPS, 3.0), "c": (1.0, 2.0, marches.STOPS)}
    path = write(tmp_path, steps)
    finished = run(path)
    assert (finished.failed, finished.stopped) == (2, 2)
    seen = open_results(finished.folder).load()
    assert seen.status.values.tolist() == [Status.DONE, Status.STOPPED, Status.STOPPED]
    assert seen.status.attrs["flag_meanings"].split()[Status.STOPPED] == "stopped"
    assert seen.message.values.tolist() == ["", "it came apart at 15 s", "it came apart at 25 s"]
    assert "stopped" not in seen
    reached = seen.elapsed_time.values[:, None] <= [np.inf, 15.0, 25.0]
    pressure = seen.well_pressure.values[:, 0].T
    np.testing.assert_array_equal(np.isfinite(pressure), reached)
    np.testing.assert_array_equal(pressure[:2, 1], pressure[:2, 0])
    assert run(path).executed is None  # what stopped is a result
    assert toys.demflow(
        "status", str(path), "--results", str(tmp_path / "results"), table=marches.TOY
    )
    assert capsys.readouterr().out.startswith(
        "3 cases: 1 done, 2 stopped early, 0 failed, 0 missing"
    )
    assert toys.demflow(
        "collect", str(path), "--results", str(tmp_path / "results"), table=marches.TOY
    )
    assert "1 of 3 cases good, 2 stopped early; " in capsys.readouterr().err
    path.write_text(path.read_text() + "expect: stopped\n")
    assert run(path).failed == 1  # the one that went on to its end


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_what_stopped_has_gaps_in_time_and_nowhere_else(value):
    good = {"well_pressure": np.array([[1.0, np.nan]]), "porosity": np.array(0.2)}
    assert checked({**good, STOPPED: np.array("at 1 s")}) == "at 1 s"
    with pytest.raises(ModelError, match="well_pressure is not a finite number at 1 of 2"):
        checked({**good, STOPPED: np.array("")})
    for name, wrong in (("porosity", value), ("well_pressure", np.inf)):
        with pytest.raises(ModelError, match=f"{name} is not a finite number at 1 of 1"):
            checked({**good, name: np.array(wrong)[None], STOPPED: np.array("at 1 s")})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parents": ("pack",)}, "march has legs and is no parent of its own"),
        ({"legs": None}, "march stands before its parent march"),
    ],
)
def test_a_march_is_its_own_parent(monkeypatch, change, message):
    pack, march, observe = marches.TOY_STAGES
    table = (pack, dataclasses.replace(march, **change), observe)
    monkeypatch.setattr(marches, "TOY_STAGES", table)
    with pytest.raises(ValueError, match=message):
        stage_table(marches.TOY)


def scene(*steps: tuple[float, float]) -> Scene:
    return Scene(
        region=Circle(1.0),
        grains=Grains(count=200, packing="hexagonal"),
        matrix=Matrix(aperture=1e-5),
        fluid=Fluid(1e-3, 1e9),
        wells=(
            Well(name="w", at=(0.1, 0.2), radius=0.15, schedule=steps),
            Well(name="v", at=(-0.4, -0.3), radius=0.15, rate=1e-6),
        ),
        boundaries=(("outer", 7e6),),
        initial_pressure=7e6,
        times=(1.0, 10.0, 50.0, 300.0, 1000.0),
        observe=("well_pressure",),
    )


@pytest.mark.slow
def test_a_march_through_the_rates_of_a_network_is_what_the_model_superposes(monkeypatch):
    one = scene((0.0, 1e-6), (20.0, -2e-6), (200.0, 5e-7))
    monkeypatch.setattr(model_stages, "STAGES", marches.RATE_STAGES)
    marched = run_stages(one)["observe"]["well_pressure"]
    monkeypatch.undo()
    exact = simulate(dataclasses.replace(one, solver=Solver(tolerance=1e-9)))["well_pressure"]
    assert np.ptp(exact) > 1e3
    np.testing.assert_allclose(marched, exact, atol=1e-6 * np.ptp(exact), rtol=0)
    other = scene((0.0, 1e-6), (20.0, -2e-6), (250.0, 0.0))
    plan = make_plan([one, other], marches.RATE_STAGES)
    shared = [a == b for a, b in zip(plan.case_runs(0), plan.case_runs(1), strict=True)]
    names = [plan.stage_of(run).name for run in plan.case_runs(0)]
    # the second leg ends where the third begins
    assert shared == [name in ("pack", "network", "open") for name in names[:3]] + [
        True, False, False, False
    ]  # fmt: skip
