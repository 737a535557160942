"""Whole runs on toy stages: nothing twice, nothing lost, the same bits however it ran."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from demflow import sweep
from demflow.model.outcome import Status
from demflow.model.quantities import SWEEP
from demflow.sweep import engine
from demflow.sweep.dataset.open import open_results
from demflow.sweep.prepared import prepare
from demflow.sweep.store.lock import FolderLock, LockedError
from demflow.sweep.store.products import StoreError
from tests.sweep import toy_stages, toys
from tests.sweep.processes import leftovers, products, start, wait_until
from tests.sweep.stored import put

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("forked_workers")]

CASES = 2 * 2 * 3
RUNS = 2 + 4 + 12 + 12  # packs, stresses, flows, observers


def data(folder: Path) -> dict:
    """All that a dataset holds but the times that were measured."""
    dataset = open_results(folder)
    return {name: v for name, v in dataset.data_vars.items() if name not in SWEEP}


def assert_same_bits(a: Path, b: Path) -> None:
    first, second = data(a), data(b)
    assert first.keys() == second.keys()
    for name, variable in first.items():
        assert variable.dtype == second[name].dtype
        assert variable.values.tobytes() == second[name].values.tobytes() or (
            variable.dtype.kind in "UO" and variable.equals(second[name])
        )


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("done")
    path = toys.write_study(folder)
    return path, toys.run(path, folder / "results", workers=2)


def test_shared_stages_run_once(done):
    _, finished = done
    assert (finished.cases, finished.failed) == (CASES, 0)
    assert finished.executed.computed == RUNS
    assert finished.collected


def test_a_second_run_computes_nothing_and_starts_no_dask(done):
    path, finished = done
    code = (
        "import sys\n"
        "from tests.sweep import toys\n"
        "f = toys.run(sys.argv[1], sys.argv[2])\n"
        "assert f.executed is None and not f.collected, f\n"
        "heavy = {'dask', 'distributed', 'xarray', 'matplotlib', 'pandas'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    before = finished.dataset.read_bytes()
    arguments = [sys.executable, "-c", code, str(path), str(finished.folder.parent)]
    subprocess.run(arguments, env=environment(), check=True)
    assert finished.dataset.read_bytes() == before


def test_one_worker_and_two_give_the_same_bits(done, tmp_path):
    path, finished = done
    alone = toys.run(path, tmp_path, workers=1)
    assert alone.executed.computed == RUNS
    assert_same_bits(alone.folder, finished.folder)


def test_a_growing_study_computes_only_what_is_new(tmp_path):
    def grown(**changes):
        path = toys.write_study(tmp_path, **changes)
        made = prepare(path, tmp_path / "results", table=toys.TABLE)
        planned = int((~made.stored()).sum())
        finished = toys.run(path, tmp_path / "results")
        executed = finished.executed.computed if finished.executed else 0
        assert executed == planned
        return executed, finished

    small = {"seeds": (1,), "stresses": (5e6,), "rates": (1.0, 2.0)}
    assert grown(**small)[0] == 1 + 1 + 2 + 2
    assert grown(**(small | {"rates": (1.0, 3.0, 2.0)}))[0] == 2  # a value between two
    assert grown(**(small | {"stresses": (5e6, 6e6)}))[0] == 1 + 2 + 2
    executed, finished = grown(**(small | {"seeds": ()}))  # an axis gone: its value was the default
    assert executed == 0
    assert open_results(finished.folder).well_pressure.dims[:2] == ("stress_yy", "rate")
    path = toys.write_study(tmp_path, **small)
    path.write_text(path.read_text().replace("[well_pressure]", "[well_pressure, pressure_map]"))
    assert toys.run(path, tmp_path / "results").executed is None  # toy stages do not read it


def test_force_computes_everything_again(done):
    path, finished = done
    again = toys.run(path, finished.folder.parent, force=True)
    assert again.executed.computed == RUNS


def test_what_lay_there_before_is_not_taken_for_new_where_a_worker_dies(tmp_path, monkeypatch):
    monkeypatch.setattr("demflow.sweep.execution.blame.ATTEMPTS_AT_MOST", 3)
    rates = (1.0, toy_stages.DIES)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=rates)
    toys.run(path, tmp_path / "results")
    plan = toys.prepared(path, tmp_path / "results")
    dying = next(r.id for r in plan.plan.runs if r.stage == 2 and r.case == 1)
    # of an earlier, luckier run
    put(plan.store, dying, {"pressure": np.zeros(3)}, {"seconds": 0.0})
    finished = toys.run(path, tmp_path / "results", force=True)
    assert (finished.failed, finished.executed.computed) == (1, 4)


def test_damaged_products_are_found_recomputed_and_reported(done, tmp_path):
    path, finished = done
    first = toys.run(path, tmp_path / "results")
    made = prepare(path, tmp_path / "results", table=toys.TABLE)
    by_stage = {made.plan.stage_of(k).name: made.plan.runs[k].id for k in range(RUNS)}
    # a parent that is read again, and a case's own product
    for name in ("stress", "observe"):
        file = made.store.path(by_stage[name])
        content = bytearray(file.read_bytes())
        content[-1] ^= 1
        file.write_bytes(content)
    made.store.path(by_stage["flow"]).unlink()
    first.dataset.unlink()
    again = toys.run(path, tmp_path / "results")
    assert again.executed.computed == 3
    assert sorted(by_stage[n] in m for m in again.damaged for n in ("stress", "observe")) == [
        False,
        False,
        True,
        True,
    ]
    assert again.failed == 0
    assert_same_bits(again.folder, finished.folder)


def test_two_runs_on_one_folder(done):
    path, finished = done
    with (
        FolderLock(finished.folder.parent, "demflow run toy"),
        pytest.raises(LockedError, match=f"process {os.getpid()}"),
    ):
        toys.run(path, finished.folder.parent)


def test_a_folder_that_is_something_else_is_left_alone(tmp_path):
    path = toys.write_study(tmp_path)
    home = tmp_path / "home"
    (home / "store").mkdir(parents=True)
    (home / "store" / "diary.txt").write_text("dear diary")
    with pytest.raises(StoreError, match="holds no store"):
        toys.run(path, home)
    assert [p.name for p in home.rglob("*")] == ["store", "diary.txt"]


@pytest.mark.parametrize("quote", ["", '"'])
def test_a_results_folder_may_be_cleaned_by_hand(tmp_path, quote):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    path.write_text(path.read_text().replace("study: toy", f"study: {quote}toy{quote}  # a toy"))
    folder = toys.run(path, tmp_path / "results").folder
    for left in folder.iterdir():
        if left.name != "study.yaml":
            left.unlink()
    path.write_text(path.read_text().replace("[1.0]", "[1.0, 2.0]"))
    assert toys.run(path, tmp_path / "results").cases == 2
    assert (folder / "study.yaml").read_text() == path.read_text()


@pytest.mark.parametrize("name", ["figures_of_1987.tex", "dataset.nc.old", "report.html.txt"])
def test_files_that_are_called_much_like_ours_are_not(tmp_path, name):
    path = toys.write_study(tmp_path)
    folder = tmp_path / "results" / "toy"
    folder.mkdir(parents=True)
    for left in (name, "download.partial"):
        (folder / left).touch()
    with pytest.raises(StoreError, match=name):
        toys.run(path, tmp_path / "results")
    assert sorted(p.name for p in folder.iterdir()) == sorted([name, "download.partial"])


def test_only_half_files_of_runs_are_removed(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    folder = toys.run(path, tmp_path / "results").folder
    for left in ("download.partial", "dataset.nc.17.partial", "report.html.partial"):
        (folder / left).touch()
    toys.run(path, tmp_path / "results")
    assert [p.name for p in folder.glob("*.partial")] == ["download.partial"]


def test_a_script_is_warned_of_what_the_command_line_tells(tmp_path, monkeypatch):
    rates = (1.0, toy_stages.RAISES)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=rates)
    monkeypatch.setattr(engine, "run_study", functools.partial(engine.run_study, table=toys.TABLE))
    monkeypatch.setattr(engine, "draw", lambda prepared, finished, **_: finished)
    with pytest.warns(engine.RunWarning, match="1 of 2 cases failed.*retry_failed=True") as told:
        sweep.run(path, results=tmp_path / "results")
    assert len(told) == 1
    made = toys.prepared(path, tmp_path / "results")
    os.truncate(made.store.path(made.plan.runs[int(made.plan.cases[0, -1])].id), 99)
    (tmp_path / "results" / "toy" / "dataset.nc").unlink()
    with pytest.warns(engine.RunWarning) as told:
        sweep.run(path, results=tmp_path / "results")
    assert "damaged, computed again" in str(told[0].message)
    assert {warning.filename for warning in told} == {__file__}


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path.cwd()), *filter(None, sys.path)])}


def stored(results: Path) -> set[str]:
    return {path.name for path in results.glob("store/*/*.product")}


def test_workers_end_with_a_killed_run_whatever_they_are_at(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(toy_stages.HOLDS_ON,))
    running = start(path, tmp_path / "results")
    try:
        wait_until(lambda: len(stored(tmp_path / "results")) == 2)  # packed and stressed
        time.sleep(0.5)
    finally:
        running.process.kill()
        running.finish()
    assert running.left_after(5.0) == []


def test_a_first_interrupt_lets_what_runs_end_and_collects_it(tmp_path):
    path = toys.write_study(
        tmp_path, seeds=(1,), stresses=(), rates=tuple(range(1, 9)), seconds=1.5
    )
    results, diary = tmp_path / "results", tmp_path / "diary"
    running = start(path, results, **{toy_stages.DIARY: str(diary)})
    wait_until(lambda: len(stored(results)) > 4)  # the first case is done
    os.killpg(running.process.pid, signal.SIGINT)
    status, _, err = running.finish(60)
    assert (status, "Traceback" in err) == (130, False)
    ended = toy_stages.noted(diary, "ends")
    assert ended == toy_stages.noted(diary, "begins")  # nothing was cut off
    with open_results(results / "toy") as dataset:
        done = dataset["status"].values == Status.DONE
        assert np.isfinite(dataset["well_pressure"].values[done]).all()
    assert 0 < done.sum() <= len(ended) < 8
    assert leftovers(results) == []


def test_a_second_interrupt_stops_at_once(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(toy_stages.HOLDS_ON,))
    results = tmp_path / "results"
    running = start(path, results)
    wait_until(lambda: len(stored(results)) == 2)  # the flow holds on
    os.killpg(running.process.pid, signal.SIGINT)
    with pytest.raises(subprocess.TimeoutExpired):
        running.process.wait(1.0)  # it waits for the flow
    os.killpg(running.process.pid, signal.SIGINT)
    status, _, err = running.finish(20)
    assert (status, "Traceback" in err) == (130, False)
    assert running.left_after(20) == []
    assert leftovers(results) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, number):
    rates = tuple(range(1, 11))
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=rates, seconds=0.25)
    results = tmp_path / "results"
    running = start(path, results)
    wait_until(lambda: len(stored(results)) > 4)
    if number == signal.SIGINT:
        os.killpg(running.process.pid, number)  # as a terminal does: to all of them
    else:
        running.process.send_signal(number)
    status, _, err = running.finish(60)
    assert status == (-9 if number == signal.SIGKILL else 130)
    if number != signal.SIGKILL:
        assert "interrupted" in err
        assert "Traceback" not in err
    assert running.left_after(20) == []
    kept = stored(results)
    assert 4 < len(kept) < 2 + 20
    files = products(results)
    finished = toys.run(path, results)
    assert (finished.cases, finished.failed) == (10, 0)
    assert finished.executed.computed == 2 + 20 - len(kept)
    assert products(results).items() >= files.items()
    assert leftovers(results) == []
