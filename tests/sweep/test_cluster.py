"""Runs on a Dask cluster of other processes, whose workers share no folder with the client."""

from __future__ import annotations

import asyncio
import operator
import os
import re
import signal
import socket
import threading
from contextlib import ExitStack
from types import SimpleNamespace

import psutil
import pytest
from dask import config

from demflow.model.outcome import Status
from demflow.sweep.dataset.open import open_results
from demflow.sweep.errors import RunError, SchedulerError
from demflow.sweep.execution import worker
from demflow.sweep.execution.cluster import RemotePool
from demflow.sweep.execution.worker import Lot, Task, run_lot
from demflow.sweep.store.products import Store, pack, unpack
from demflow.sweep.store.versions import agreed
from tests.standing import forked_cluster
from tests.sweep import toy_stages, toys
from tests.sweep.clusters import certificate, dask_cluster, extra_worker
from tests.sweep.processes import products, start, wait_until
from tests.sweep.test_engine import assert_same_bits

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("forked_workers")]

RATES = (1.0, 2.0, 3.0, 4.0)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and two workers."""
    with dask_cluster(tmp_path_factory.mktemp("cluster") / "processes") as started:
        yield started


def test_a_cluster_gives_the_same_bits_and_keeps_no_product(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("demflow.sweep.execution.blame.ATTEMPTS_AT_MOST", 3)
    address, folder = cluster.address, cluster.folder
    rates = (*RATES, toy_stages.RAISES, toy_stages.DIES)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(5e6,), rates=rates)
    here = toys.run(path, tmp_path / "here")
    there = toys.run(path, tmp_path / "there", scheduler=address)
    assert (there.failed, there.cases) == (here.failed, here.cases) == (2, 6)
    assert there.executed.computed == here.executed.computed
    assert_same_bits(here.folder, there.folder)
    assert toys.run(path, tmp_path / "there").executed is None  # all lies at the client
    assert list(folder.rglob("*.product")) == []


def same_bits_though_a_worker_is_killed(folder, run, nanny) -> None:
    path = toys.write_study(folder, seeds=(1,), stresses=(), rates=(*RATES, 5.0), seconds=0.4)
    calm = toys.run(path, folder / "calm")
    killed = []

    def kill_one() -> None:
        wait_until(lambda: list(folder.glob("stormy/store/*/*.product")))
        family = psutil.Process(nanny.pid).children(recursive=True)
        victim = next(child for child in family if "spawn_main" in " ".join(child.cmdline()))
        killed.append(victim.pid)
        victim.kill()

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    run(path, folder / "stormy")
    killer.join(5)
    assert killed
    assert_same_bits(calm.folder, folder / "stormy" / "toy")


def test_a_worker_killed_in_mid_run_costs_no_case(cluster, tmp_path):
    address, workers = cluster.address, cluster.workers

    def run(path, results) -> None:
        assert toys.run(path, results, scheduler=address).failed == 0

    same_bits_though_a_worker_is_killed(tmp_path, run, workers[0])


@pytest.mark.parametrize("rate", [toy_stages.ANSWERS_SLOWLY, toy_stages.DIES_ANSWERING])
def test_an_answer_that_takes_long_to_come_is_waited_for(tmp_path, monkeypatch, rate):
    monkeypatch.chdir(tmp_path)  # where the worker is, too
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0, rate, 2.0))
    with forked_cluster(1) as cluster:
        finished = toys.run(path, tmp_path / "results", scheduler=cluster.scheduler_address)
    assert (finished.failed, finished.executed.computed) == (0, 8)
    assert finished.executed.deaths == (rate == toy_stages.DIES_ANSWERING)


def test_parents_that_are_too_large_together_for_a_workers_memory_reach_it(tmp_path):
    rates = (1.0, toy_stages.FORGETS, *map(float, range(2, 12)))
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(5e6,), rates=rates)
    with forked_cluster(1) as cluster:
        finished = toys.run(path, tmp_path / "results", scheduler=cluster.scheduler_address)
    assert (finished.failed, finished.executed.computed) == (0, 2 + 2 * len(rates))


def test_tls_with_a_worker_killed_and_a_client_without_certificate(tmp_path, capsys):
    made = certificate(tmp_path)
    with dask_cluster(tmp_path / "processes", workers=1, certificate=made) as cluster:
        address, workers = cluster.address, cluster.workers
        assert address.startswith("tls://127.0.0.1:")

        def run(path, results) -> None:
            status, _, told = start(
                path, results, "--scheduler", address, **made.environment
            ).finish(60)
            assert status == 0, told

        same_bits_though_a_worker_is_killed(tmp_path, run, workers[0])
        path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES)
        place = (str(path), "--results", str(tmp_path / "none"), "--scheduler", address)

        def refused() -> str:
            assert toys.demflow("run", *place) == 2
            told = capsys.readouterr().err
            assert len(told.splitlines()) == 1
            return told

        told = refused()
        assert f"{address} needs certificates: set DASK_DISTRIBUTED__COMM__TLS__CA_FILE" in told
        with config.set(made._replace(key=tmp_path / "lost.pem").configuration):
            assert str(tmp_path / "lost.pem") in refused()


def test_a_scheduler_that_dies_ends_the_run_and_what_was_finished_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr("demflow.sweep.execution.cluster.CONNECT_SECONDS", 1)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES, seconds=0.5)
    with dask_cluster(tmp_path / "processes", workers=1) as cluster:

        def kill(_) -> None:
            if products(tmp_path / "results") and cluster.scheduler.is_running():
                cluster.scheduler.kill()

        with pytest.raises(RunError, match=f"{cluster.address} answers no longer"):
            toys.run(path, tmp_path / "results", scheduler=cluster.address, progress=kill)
    kept = products(tmp_path / "results")
    finished = toys.run(path, tmp_path / "results")
    assert (finished.failed, finished.executed.computed) == (0, 10 - len(kept))


def test_a_damaged_parent_is_computed_again_before_it_travels(cluster, tmp_path):
    address = cluster.address
    path = toys.write_study(tmp_path, seeds=(3,), stresses=(), rates=(1.0,))
    toys.run(path, tmp_path / "results", scheduler=address)
    more = toys.write_study(tmp_path, name="more", seeds=(3,), stresses=(), rates=(1.0, 2.0))
    prepared = toys.prepared(more, tmp_path / "results")
    packing = next(r.id for r in prepared.plan.runs if prepared.plan.stages[r.stage].name == "pack")
    os.truncate(prepared.store.path(packing), 100)
    finished = toys.run(more, tmp_path / "results", scheduler=address)
    assert finished.failed == 0
    assert len(finished.executed.damaged) == 1
    assert finished.executed.computed == 1 + 2  # the packing, flow and observer of the new rate


def test_a_product_that_is_damaged_on_its_way_is_computed_again(cluster, tmp_path, monkeypatch):
    address = cluster.address
    path = toys.write_study(tmp_path, seeds=(5,), stresses=(), rates=(1.0, 2.0))
    accept, damages = Store.accept, []

    def flip_once(store, files) -> None:
        if not damages:
            files = {i: (kind, content[:-1] + b"?") for i, (kind, content) in files.items()}
            damages.append(len(files))
        accept(store, files)

    monkeypatch.setattr(Store, "accept", flip_once)
    finished = toys.run(path, tmp_path / "results", scheduler=address)
    assert damages
    assert (finished.failed, finished.executed.computed) == (0, 6)
    assert "came damaged from a worker" in finished.damaged[0]


@pytest.mark.parametrize("library", ["demflow", "numpy", "qdldl", "python", "sources"])
def test_workers_of_another_version_run_nothing(cluster, tmp_path, monkeypatch, capsys, library):
    address = cluster.address
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES)
    own = agreed() | {library: "0.0.1"}
    monkeypatch.setattr("demflow.sweep.execution.loop.agreed", lambda: own)
    place = ("--results", str(tmp_path / "results"), "--scheduler", address)
    assert toys.demflow("run", str(path), *place) == 2
    told = capsys.readouterr().err
    assert f"{library} {agreed()[library]} (here 0.0.1)" in told
    assert "give all the same versions" in told
    assert list(tmp_path.rglob("*.product")) == []


def test_one_worker_of_another_version_keeps_all_from_running_though_it_answers_last(
    cluster, tmp_path, monkeypatch
):
    call, greeted = RemotePool.call, []

    async def late(pool, address, function, *given):
        found = await call(pool, address, function, *given)
        if function is worker.introduce:
            greeted.append(address)
            if len(greeted) == 2:
                await asyncio.sleep(1.0)
                found = {**found, "numpy": "0.0.1"}
        return found

    monkeypatch.setattr(RemotePool, "call", late)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES)
    with pytest.raises(SchedulerError, match=r"has numpy 0\.0\.1 \(here .*give all the same"):
        toys.run(path, tmp_path / "results", scheduler=cluster.address)
    assert list(tmp_path.rglob("*.product")) == []


def test_workers_without_the_stages_run_nothing(cluster, tmp_path, monkeypatch):
    address = cluster.address
    (tmp_path / "only_here.py").write_text("from tests.sweep.toy_stages import STAGES")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(toys, "TABLE", "only_here:STAGES")
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES)
    with pytest.raises(SchedulerError, match=r"cannot run demflow: .*only_here"):
        toys.run(path, tmp_path / "results", scheduler=address)


def test_a_worker_of_many_threads_is_refused_before_and_passed_over_in_mid_run(cluster, tmp_path):
    address, folder = cluster.address, cluster.folder
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(*RATES, 5.0), seconds=0.3)
    joined = ExitStack()

    def join() -> None:
        wait_until(lambda: list(tmp_path.glob("results/store/*/*.product")))
        joined.enter_context(extra_worker(address, folder / "wide", "--nthreads", "3"))

    joiner = threading.Thread(target=join)
    joiner.start()
    with joined:
        try:
            finished = toys.run(path, tmp_path / "results", scheduler=address)
        finally:
            joiner.join()
        with pytest.raises(SchedulerError, match="has 3 threads"):
            toys.run(path, tmp_path / "other", scheduler=address)
    assert (finished.failed, finished.cases) == (0, 5)


def test_workers_that_come_late_are_waited_for_and_those_without_a_nanny_not_taken(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES)
    seen = []
    with dask_cluster(tmp_path / "processes", workers=0) as cluster, ExitStack() as joined:

        def join(progress) -> None:
            if not seen and progress.waiting > 0.5:
                one = ("--nthreads", "1")
                joined.enter_context(extra_worker(cluster.address, tmp_path / "joined", *one))
                seen.append(progress)

        finished = toys.run(path, tmp_path / "late", scheduler=cluster.address, progress=join)
        assert (len(seen), finished.failed) == (1, 0)
        alone = ("--nthreads", "1", "--no-nanny")
        joined.enter_context(extra_worker(cluster.address, tmp_path / "alone", *alone))
        with pytest.raises(SchedulerError, match="has no nanny"):
            toys.run(path, tmp_path / "none", scheduler=cluster.address)


def test_no_scheduler_is_wrong_usage(cluster, tmp_path, monkeypatch, capsys):
    """Nothing there, no address, something that takes no questions, and a worker."""
    monkeypatch.setattr("demflow.sweep.execution.cluster.CONNECT_SECONDS", 1.0)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    place = ("--results", str(tmp_path / "results"))
    with socket.create_server(("127.0.0.1", 0)) as mute:
        silent = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        log = cluster.folder / "worker-0" / "log"
        wait_until(lambda: "Start worker at" in log.read_text())
        worker = re.findall(r"Start worker at: +(\S+)", log.read_text())[-1]
        wrong = (
            "tcp://127.0.0.1:1",
            "foo",
            "",
            "ftp://127.0.0.1:1",
            "tcp://nohost",
            silent,
            worker,
        )
        for address in wrong:
            try:
                status = toys.demflow("run", str(path), *place, "--scheduler", address)
            except SystemExit as wrong_usage:  # of what is no address at all
                status = wrong_usage.code
            assert status == 2
            *usage, told = capsys.readouterr().err.strip().splitlines()
            assert (address or repr(address)) in told
            assert bool(usage) == ("is no address of a scheduler" in told)
    assert "it is a Worker" in told


def test_a_case_that_outgrows_the_workers_of_a_cluster_says_what_it_needs(tmp_path):
    """Dask's own limit of a worker, of which the study says nothing."""
    rates = (1.0, toy_stages.GROWS, 2.0)
    path = toys.write_study(tmp_path, seeds=(1, 2), stresses=(), rates=rates)
    with forked_cluster(2, memory_limit="300 MB") as cluster:
        finished = toys.run(path, tmp_path / "results", scheduler=cluster.scheduler_address)
    dataset = open_results(finished.folder)
    ended = {1.0: Status.DONE, 2.0: Status.DONE, toy_stages.GROWS: Status.OUT_OF_MEMORY}
    for rate, status in ended.items():
        assert (dataset.status.sel(rate=rate) == status).all()
    message = str(dataset.message.sel(rate=toy_stages.GROWS, seed=2).item())
    assert "flow: more than 0.3 GB, all that a worker of this cluster may hold" in message
    assert "--memory-limit" in message
    assert finished.executed.deaths <= 2 * 2  # once in company of its past, once without


def test_workers_too_small_to_import_anything_end_the_run_with_a_word(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES)
    options = ("--memory-limit", "60 MB")
    with (
        dask_cluster(tmp_path / "processes", workers=1, options=options) as cluster,
        pytest.raises(RunError, match=r"too small to import demflow.*--memory-limit"),
    ):
        toys.run(path, tmp_path / "results", scheduler=cluster.address)


@pytest.mark.parametrize("minimum", [0, 1])
def test_an_adaptive_cluster_gets_its_workers(tmp_path, minimum):
    path = toys.write_study(tmp_path, seeds=(1, 2, 3), stresses=(), rates=(1.0,), seconds=1.5)
    most = []
    with forked_cluster(0) as cluster:
        cluster.adapt(minimum=minimum, maximum=3, interval="200ms")
        finished = toys.run(
            path,
            tmp_path / "results",
            scheduler=cluster.scheduler_address,
            progress=lambda _: most.append(len(cluster.worker_spec)),
        )
    assert (finished.failed, finished.cases) == (0, 3)
    assert max(most) == 3


def test_a_worker_that_answers_something_else_ends_the_run_with_a_word(
    cluster, tmp_path, monkeypatch
):
    monkeypatch.setattr("demflow.sweep.execution.loop.run_lot", operator.is_)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES)
    with pytest.raises(RunError, match=r"the worker \S+ answered what no demflow answers \(bool\)"):
        toys.run(path, tmp_path / "results", scheduler=cluster.address)


def test_a_scheduler_that_stands_still_is_told_and_ends_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("demflow.sweep.execution.cluster.STOPPED_SECONDS", 2.0)
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=RATES, seconds=0.5)
    seen = []
    with dask_cluster(tmp_path / "processes", workers=1) as cluster:

        def stop(progress) -> None:
            seen.append(progress)
            if products(tmp_path / "results"):
                cluster.scheduler.send_signal(signal.SIGSTOP)

        try:
            with pytest.raises(RunError, match="has not answered for 2 s; what was finished"):
                toys.run(path, tmp_path / "results", scheduler=cluster.address, progress=stop)
        finally:
            cluster.scheduler.send_signal(signal.SIGCONT)
    assert seen[-1].still > 1.0


def test_a_look_that_is_called_off_just_as_its_answer_comes_has_no_answer():
    """A watch that went on looking then would never end."""

    async def look() -> None:
        answered = asyncio.get_running_loop().create_future()

        async def identity(n_workers: int) -> dict[str, dict]:
            return await answered

        pool = RemotePool("tcp://127.0.0.1:1")
        pool.client = SimpleNamespace(scheduler=SimpleNamespace(identity=identity))
        looking = asyncio.ensure_future(pool.look())
        await asyncio.sleep(0.01)
        answered.set_result({"workers": {}})
        looking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await looking

    asyncio.run(look())


def test_a_worker_without_a_store_gives_back_the_file_it_would_store():
    worker._memory.clear()
    parent, own = "a" * 64, "b" * 64
    packed = toy_stages.pack(count=5, seed=1)
    flow = {"rate": 1.0, "viscosity": 0.0, "times": (1.0, 2.0)}
    task = Task(1, own, "flow", flow, (parent, None))
    missing = run_lot(Lot(None, toys.TABLE, (task,)), {})[0]
    assert (missing.lost, missing.file) == (parent, b"")
    file = pack(packed._asdict(), {"id": parent})
    outcome = run_lot(Lot(None, toys.TABLE, (task,)), {parent: file})[0]
    assert outcome.status is Status.DONE
    arrays, meta = unpack(outcome.file)
    assert meta["id"] == own
    assert outcome.stored == len(outcome.file)
    expected = toy_stages.flow(packed, None, **flow).pressure
    assert arrays["pressure"].tobytes() == expected.tobytes()
