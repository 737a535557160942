"""Runs on real worker processes: what a bad case may cost, and what nobody may see."""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest

from demflow.model.outcome import Status
from demflow.model.quantities import SWEEP
from demflow.sweep.dataset.open import open_results
from demflow.sweep.errors import RunError
from demflow.sweep.execution.local import LocalPool
from tests.standing import forked_cluster
from tests.sweep import toy_stages, toys
from tests.sweep.processes import products, start, wait_until

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("forked_workers")]

POISON = {
    toy_stages.RAISES: (Status.FAILED, "flow: the well is dry; try a smaller rate"),
    toy_stages.BREAKS: (Status.FAILED, "flow: ZeroDivisionError: one over nothing (toy_stages.py"),
    toy_stages.NO_MEMORY: (Status.OUT_OF_MEMORY, "flow: no memory left"),
    toy_stages.DIES: (Status.WORKER_DIED, "flow: its worker process died"),
    toy_stages.NO_NUMBER: (
        Status.FAILED,
        "observe: well_pressure is not a finite number at 3",
    ),
    toy_stages.HOLDS_ON: (Status.TIMED_OUT, "flow: not done after 1 s"),
    toy_stages.HANGS: (Status.TIMED_OUT, "flow: not done after 1 s"),
}
HEALTHY = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)


@pytest.fixture(scope="module")
def poisoned(tmp_path_factory):
    """A study in which every second case does what no case should, and what the run showed."""
    folder = tmp_path_factory.mktemp("poisoned")
    rates = tuple(np.ravel(list(zip(HEALTHY, POISON, strict=True))))
    path = toys.write_study(
        folder,
        seeds=(1,),
        stresses=(),
        rates=tuple(map(float, rates)),
        limits="{time: 1 s}",
    )
    seen = []
    with pytest.MonkeyPatch.context() as patched:  # how often it takes is for the tests of blame
        patched.setattr("demflow.sweep.execution.blame.ATTEMPTS_AT_MOST", 3)
        finished = toys.run(path, folder / "results", progress=seen.append, workers=2)
    return path, finished, open_results(finished.folder), seen


@pytest.mark.parametrize("rate", POISON)
def test_each_bad_case_is_one_status_with_a_message(poisoned, rate):
    status, message = POISON[rate]
    case = poisoned[2].sel(rate=rate, seed=1)
    assert case.status == status
    assert str(case.message.item()).startswith(message)
    assert np.isnan(case.well_pressure).all()


def test_no_other_case_is_lost(poisoned):
    _, finished, dataset, seen = poisoned
    good = dataset.sel(rate=list(HEALTHY))
    assert (good.status == Status.DONE).all()
    assert (good.message == "").all()
    assert np.isfinite(good.well_pressure).all()
    assert (finished.cases, finished.failed) == (14, 7)
    assert (seen[-1].done, seen[-1].failed, seen[-1].left) == (7, 7, 0)


def test_each_stage_tells_how_many_of_its_runs_have_their_product(poisoned):
    _, finished, _, seen = poisoned
    stored = [sum(stage.done for stage in one.stages) for one in seen]
    assert stored == sorted(stored)
    assert stored[-1] == finished.executed.computed
    runs = {stage.stage: (stage.done, stage.runs) for stage in seen[-1].stages}
    assert runs["pack"] == (1, 1)
    assert runs["observe"] == (7, 14)


def variant(path, rates, limit="1 s"):
    """The poisoned study with other rates and another limit, under a name of its own."""
    name = re.sub(r"\W", "", f"variant{len(rates)}{limit}")
    limits = f"{{time: {limit}}}"
    return toys.write_study(
        path.parent, name=name, seeds=(1,), stresses=(), rates=rates, limits=limits
    )


def test_a_failure_is_not_met_again_unless_asked_for(poisoned):
    path, finished, _, _ = poisoned
    results = finished.folder.parent
    again = toys.run(path, results, workers=2)
    assert again.executed is None
    assert not again.collected
    few = variant(path, (1.0, toy_stages.RAISES, toy_stages.BREAKS))
    asked = toys.run(few, results, retry_failed=True, workers=2)
    assert (asked.executed.failed, asked.executed.computed) == (2, 0)


def test_a_limit_that_was_raised_is_tried_again(poisoned):
    path, finished, _, _ = poisoned
    rates = (1.0, toy_stages.HANGS)
    raised = toys.run(variant(path, rates, "1.1 s"), finished.folder.parent, workers=2)
    lowered = toys.run(variant(path, rates, "0.9 s"), finished.folder.parent, workers=2)
    assert raised.executed.failed == 1
    assert lowered.executed is None


def test_a_memory_limit_that_was_raised_is_tried_again(tmp_path, capsys):
    """Foreseen by the stage, hence recorded by the worker."""
    rates, results = (1.0, toy_stages.FORESEES), tmp_path / "results"

    def ran(limits: str):
        path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=rates, limits=limits)
        return path, toys.run(path, results, workers=2)

    path, low = ran("{memory: 160 MB}")
    assert open_results(low.folder).status.values.ravel()[1] == Status.OUT_OF_MEMORY
    assert ran("{memory: 159 MB}")[1].executed is None
    toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=rates, limits="{memory: 20 GB}")
    capsys.readouterr()
    toys.demflow("status", str(path), "--results", str(results))
    assert "1 of them: tried again by the next run" in capsys.readouterr().err
    high = toys.run(path, results, workers=2)
    assert (high.executed.computed, high.failed) == (2, 0)


def test_without_limits_a_case_has_its_share_of_the_machine(tmp_path, monkeypatch):
    monkeypatch.setattr("demflow.sweep.execution.limits.machine_memory", lambda: 666e6)
    monkeypatch.setattr("demflow.sweep.execution.limits.LEAST", 1e6)
    rates = (1.0, toy_stages.GROWS, 2.0)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=rates)
    dataset = open_results(toys.run(path, tmp_path / "results", workers=2).folder)
    ended = [Status.DONE, Status.OUT_OF_MEMORY, Status.DONE]
    assert list(dataset.status.values.ravel()) == ended
    assert "flow: more than 0.3 GB" in dataset.message.sel(rate=toy_stages.GROWS, seed=1).item()
    monkeypatch.undo()
    prepared = toys.prepared(path, tmp_path / "results")  # on the whole machine there is more
    assert list(prepared.tried_again(prepared.verdicts())) == [False, True, False]


def test_the_time_of_a_case_is_that_of_all_its_stages(tmp_path):
    seeds = (1, toy_stages.SLOW_SEED)  # with this one two stages take 1.2 s each
    path = toys.write_study(
        tmp_path, seeds=seeds, stresses=(), rates=(1.0,), seconds=1.2, limits="{time: 2 s}"
    )
    dataset = open_results(toys.run(path, tmp_path / "results", workers=2).folder)
    assert list(dataset.status.values.ravel()) == [Status.DONE, Status.TIMED_OUT]
    message = dataset.message.values.ravel()[1]
    assert re.match(r"flow: not done after 2 s, 1\.[2-9]\d* s of them in earlier stages", message)


def test_compiling_is_no_time_of_a_case(tmp_path):
    rates = (1.0, toy_stages.COMPILES, toy_stages.COMPILES_AND_HANGS)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=rates, limits="{time: 1 s}")
    finished = toys.run(path, tmp_path / "results", workers=2)
    status = open_results(finished.folder).status.values.ravel()
    assert list(status) == [Status.DONE, Status.DONE, Status.TIMED_OUT]
    assert finished.failed == 1


def test_a_case_that_grows_is_stopped_at_its_memory_limit(tmp_path):
    rates = (1.0, toy_stages.GROWS)
    path = toys.write_study(
        tmp_path, seeds=(1,), stresses=(), rates=rates, limits="{memory: 300 MB}"
    )
    dataset = open_results(toys.run(path, tmp_path / "results", workers=2).folder)
    assert list(dataset.status.values.ravel()) == [Status.DONE, Status.OUT_OF_MEMORY]
    message = dataset.message.sel(rate=toy_stages.GROWS, seed=1).item()
    assert message.startswith("flow: more than 0.3 GB, the study's limits.memory")


def test_a_case_that_hangs_in_compiled_code_behind_short_ones_is_the_one_to_blame(tmp_path):
    rates = (*map(float, range(1, 41)), toy_stages.HOLDS_ON, *map(float, range(41, 61)))
    path = toys.write_study(
        tmp_path, seeds=(1,), stresses=(), rates=rates, seconds=0.01, limits="{time: 1 s}"
    )
    finished = toys.run(path, tmp_path / "results", workers=2)
    dataset = open_results(finished.folder)
    assert (finished.cases, finished.failed) == (61, 1)
    assert dataset.status.sel(rate=toy_stages.HOLDS_ON) == Status.TIMED_OUT
    assert finished.executed.computed == 2 + 2 * 60


def test_a_run_that_stood_still_charges_nobody_for_it(tmp_path):
    """Ctrl-Z stops all of its processes; it goes on later."""
    path = toys.write_study(
        tmp_path, seeds=(1,), stresses=(), rates=(1.0, 2.0), seconds=1.0, limits="{time: 3 s}"
    )
    running = start(path, tmp_path / "results")
    wait_until(lambda: products(tmp_path / "results"))
    for process in running.workers():
        process.send_signal(signal.SIGTSTP)
    running.process.send_signal(signal.SIGSTOP)
    time.sleep(4.0)
    for process in running.all():
        process.resume()
    assert running.finish(60)[0] == 0
    made = toys.prepared(path, tmp_path / "results")
    times = [made.store.meta(run.id)["seconds"] for run in made.plan.runs]
    assert max(times) < 3.0


def processes() -> list[psutil.Process]:
    return [psutil.Process(), *psutil.Process().children(recursive=True)]


@pytest.mark.usefixtures("spawned_workers")
def test_it_listens_on_the_loopback_only_with_one_thread_each_and_leaves_nothing(tmp_path):
    before = {p.pid for p in processes()}
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0, 2.0), seconds=0.8)
    listening: set[str] = set()
    environments: list[dict[str, str]] = []
    first: set[int] = set()  # how soon the kernel ends a process where memory is short
    stop = threading.Event()

    def watch() -> None:
        while not stop.wait(0.2):
            for process in processes():
                try:
                    found = process.net_connections("inet")
                    if process.pid not in before and "spawn_main" in " ".join(process.cmdline()):
                        environments.append(process.environ())
                        first.add(int(Path(f"/proc/{process.pid}/oom_score_adj").read_text()))
                except (psutil.Error, OSError):
                    continue
                listening.update(c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        finished = toys.run(path, tmp_path / "results", workers=2)
    finally:
        stop.set()
        watcher.join()
    assert finished.failed == 0
    assert listening == {"127.0.0.1"}
    assert environments
    assert max(first) > int(Path("/proc/self/oom_score_adj").read_text())
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        assert {environment[name] for environment in environments} == {"1"}
    # the resource tracker of multiprocessing belongs to the interpreter, not to the run
    left = [p for p in processes() if p.pid not in before]
    assert [p for p in left if "resource_tracker" not in " ".join(p.cmdline())] == []


@pytest.mark.usefixtures("spawned_workers")
def test_workers_killed_from_outside_cost_no_case(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1, 2), stresses=(), rates=HEALTHY, seconds=0.15)
    undisturbed = open_results(toys.run(path, tmp_path / "calm", workers=2).folder)
    mine = os.getpid()
    stop = threading.Event()
    killed = []

    def kill_now_and_then() -> None:
        while not stop.wait(0.7):
            if not list(tmp_path.glob("stormy/store/*/*.product")):
                continue
            for process in psutil.Process(mine).children():
                with suppress(psutil.Error):  # it may have ended by itself
                    if "spawn_main" in " ".join(process.cmdline()) and len(killed) < 3:
                        process.kill()
                        killed.append(process.pid)
                        break

    killer = threading.Thread(target=kill_now_and_then)
    killer.start()
    try:
        finished = toys.run(path, tmp_path / "stormy", workers=2)
    finally:
        stop.set()
        killer.join()
    assert killed
    assert finished.failed == 0
    for name, variable in open_results(finished.folder).data_vars.items():
        if name not in SWEEP:
            assert variable.identical(undisturbed[name])


@pytest.mark.usefixtures("spawned_workers")
def test_what_had_finished_when_its_worker_was_killed_is_stored_and_never_runs_again(
    tmp_path, monkeypatch
):
    diary, short, long = tmp_path / "diary", 20, 4
    monkeypatch.setenv(toy_stages.DIARY, str(diary))
    rates = [float(k) for k in range(1, short + 1)]
    rates += [toy_stages.LONG + k for k in range(long)]  # nothing foretells them
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=tuple(rates), seconds=1e-3)
    third = f"1 {rates[short + 2]:g}"
    kept = []

    def kill() -> None:
        wait_until(lambda: toy_stages.noted(diary, "begins")[third])
        for process in psutil.Process().children():
            if "spawn_main" in " ".join(process.cmdline()):
                process.kill()
        prepared = toys.prepared(path, tmp_path / "results")
        kept.extend(run for run in prepared.plan.runs if prepared.store.has(run.id))

    killer = threading.Thread(target=kill)
    killer.start()
    finished = toys.run(path, tmp_path / "results", workers=1)
    killer.join()
    assert (finished.failed, finished.executed.deaths) == (0, 1)
    flows = [run for run in kept if run.kind.stage == "flow"]
    assert len(flows) == short + 2
    assert set(toy_stages.noted(diary, "ends").values()) == {1}
    assert [flow for flow, times in toy_stages.noted(diary, "begins").items() if times > 1] == [
        third
    ]


def test_a_running_scheduler_can_be_used(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0, toy_stages.RAISES))
    with forked_cluster(1) as cluster:
        finished = toys.run(path, tmp_path / "results", scheduler=cluster.scheduler_address)
        assert len(cluster.scheduler.workers) == 1  # left as it was found
    assert (finished.cases, finished.failed) == (2, 1)


async def nobody(pool: object) -> dict:
    return {}


def test_local_workers_that_never_stand_end_the_run_with_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr("demflow.sweep.execution.local.LocalPool.patience", 0.5)
    monkeypatch.setattr("demflow.sweep.execution.local.LocalPool.look", nobody)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    with pytest.raises(RunError, match="try fewer workers"):
        toys.run(path, tmp_path / "results", workers=1)


def test_a_run_that_stood_still_before_it_had_a_worker_has_not_waited_for_one(
    tmp_path, monkeypatch
):
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=time.sleep)
    look = LocalPool.look

    async def stand_still(pool: LocalPool) -> Mapping[str, Mapping[str, Any]]:
        if clock.monotonic is time.monotonic:
            clock.monotonic = lambda: time.monotonic() + 1e4
            return {}
        return await look(pool)

    monkeypatch.setattr("demflow.sweep.execution.loop.time", clock)
    monkeypatch.setattr(LocalPool, "look", stand_still)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    assert toys.run(path, tmp_path / "results").failed == 0


SILENT = """
import multiprocessing, pathlib, time
from tests.sweep.toy_stages import STAGES
flag = pathlib.Path(__file__).with_suffix(".flag")
if multiprocessing.parent_process() and not flag.exists():
    flag.touch()
    time.sleep(3600)
"""


def test_a_worker_that_never_answers_is_ended_and_another_takes_its_place(tmp_path, monkeypatch):
    (tmp_path / "silent.py").write_text(SILENT)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(toys, "TABLE", "silent:STAGES")
    monkeypatch.setattr("demflow.sweep.execution.loop.GREETING_SECONDS", 1.5)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    finished = toys.run(path, tmp_path / "results", workers=1)
    assert (finished.failed, finished.executed.deaths) == (0, 1)
