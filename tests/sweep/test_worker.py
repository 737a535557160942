"""Inside a worker: lots, lost parents, the products kept in memory, the kernel cache."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from demflow.model.outcome import Status
from demflow.sweep.execution import worker
from demflow.sweep.execution.local import ENVIRONMENT
from demflow.sweep.execution.memory import resident_memory
from demflow.sweep.execution.worker import Lot, Task, run_lot
from demflow.sweep.store.products import Store
from demflow.sweep.store.products import pack as packed_file
from tests.sweep import toy_stages, toys

IDS = {name: f"{k}{k}" + "0" * 62 for k, name in enumerate(("pack", "flow", "observe"))}


@pytest.fixture
def store(tmp_path):
    worker._memory.clear()
    return Store.open(tmp_path / "store")


def store_pack(seed: int, identity: str) -> bytes:
    """The file of a packing."""
    return packed_file(toy_stages.pack(count=5, seed=seed)._asdict(), {"id": identity})


def tasks(rate: float = 1.0, seconds: float = 0.0) -> tuple[Task, ...]:
    flow = {"rate": rate, "viscosity": seconds, "times": (1.0, 2.0)}
    return (
        Task(0, IDS["pack"], "pack", {"count": 5, "seed": 1}, ()),
        Task(1, IDS["flow"], "flow", flow, (IDS["pack"], None)),
        Task(2, IDS["observe"], "observe", {}, (IDS["pack"], None, IDS["flow"])),
    )


def run(store: Store, *chosen: Task, **bounds: Any) -> list:
    return run_lot(Lot(str(store.root), toys.TABLE, chosen, **bounds), {})


def test_a_lot_runs_in_turn_and_stores_each_product(store):
    outcomes = run(store, *tasks())
    assert [(o.run, o.status) for o in outcomes] == [(k, Status.DONE) for k in range(3)]
    found = store.get(IDS["observe"]).arrays
    packed = toy_stages.pack(count=5, seed=1)
    expected = packed.x.mean() + np.log1p([1.0, 2.0])
    np.testing.assert_array_equal(found["well_pressure"], [expected])
    for outcome, identity in zip(outcomes, IDS.values(), strict=True):
        meta = store.meta(identity)
        assert meta["seconds"] == outcome.seconds
        assert outcome.stored == store.path(identity).stat().st_size
        assert meta["versions"]["numpy"] == np.__version__


def test_a_lot_that_takes_longer_than_foreseen_ends_and_stores_what_it_has(store):
    outcomes = run(store, *tasks(seconds=0.06), longest=0.05)
    assert [o.run for o in outcomes] == [0, 1]
    assert [store.has(identity) for identity in IDS.values()] == [True, True, False]


def test_what_a_lot_has_finished_is_stored_while_it_goes_on(store, monkeypatch):
    kept: list[list[str]] = []

    def keep(self: Store, files: dict) -> None:
        kept.append([identity[:2] for identity in files])
        ordinary(self, files)

    ordinary = Store.keep
    monkeypatch.setattr(Store, "keep", keep)
    outcomes = run(store, *tasks(seconds=worker.KEEP_SECONDS + 0.05))
    assert [o.status for o in outcomes] == [Status.DONE] * 3
    assert kept == [["00", "11"], ["22"]]
    assert all(store.has(identity) for identity in IDS.values())


@pytest.mark.slow
def test_compiling_is_left_out_of_the_time_of_a_stage(store):
    outcome = run(store, *tasks(toy_stages.COMPILES))[1]
    assert outcome.status is Status.DONE
    assert outcome.seconds < toy_stages.COMPILING_SECONDS


def test_from_memory_or_from_the_store_the_bits_are_the_same(store):
    run(store, *tasks())
    first = store.path(IDS["observe"])
    kept = store.get(IDS["observe"]).arrays
    first.unlink()
    worker._memory.clear()
    assert run(store, tasks()[2])[0].status is Status.DONE
    again = store.get(IDS["observe"]).arrays
    assert all(kept[name].tobytes() == again[name].tobytes() for name in kept)


def test_what_follows_a_failure_is_left_out(store):
    outcomes = run(store, *tasks(toy_stages.BREAKS))
    assert [o.status for o in outcomes] == [Status.DONE, Status.FAILED]
    record = store.failure(IDS["flow"])
    assert record["status"] == Status.FAILED
    assert "ZeroDivisionError" in record["traceback"]
    assert store.failure(IDS["observe"]) is None


def test_a_lost_parent_is_named(store):
    missing = run(store, tasks()[1])[0]
    assert (missing.status, missing.lost) == (Status.NOT_RUN, IDS["pack"])
    run(store, tasks()[0])
    worker._memory.clear()
    os.truncate(store.path(IDS["pack"]), 90)
    damaged = run(store, tasks()[1])[0]
    assert damaged.lost == IDS["pack"]
    assert not store.has(IDS["pack"])
    assert store.failure(IDS["flow"]) is None


@pytest.mark.parametrize("seconds", [0.0, worker.KEEP_SECONDS + 0.05])
def test_a_store_that_cannot_be_written_is_no_failure_of_the_stage(store, monkeypatch, seconds):
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("demflow.sweep.store.durable.os.replace", fail)
    with pytest.raises(OSError, match="No space"):
        run(store, *tasks(seconds=seconds))
    monkeypatch.undo()
    assert list(store.files()) == []


def test_memory_is_bounded_and_keeps_what_was_used_last(monkeypatch):
    worker._memory.clear()
    most = 3 * worker.SMALL_BYTES
    monkeypatch.setattr(worker._memory, "n", most)
    memory = worker._memory
    for name in "abc":
        memory[name] = {"x": np.zeros(10)}
    assert memory["a"] is not None
    memory["d"] = {"x": np.zeros(10)}
    assert sorted(memory) == ["a", "c", "d"]
    memory["large"] = {"x": np.zeros(most // 8 + 1)}
    assert "large" not in memory
    assert memory.total_weight == most  # of few bytes each
    memory["half"] = {"x": np.zeros(most // 16)}
    assert sorted(memory) == ["d", "half"]


def test_parents_that_went_out_of_memory_come_from_what_came_with_the_lot(store, monkeypatch):
    pack, flow, observe = tasks()
    run_lot(Lot(None, toys.TABLE, (pack, flow)), {})
    monkeypatch.setattr(worker._memory, "n", 60)  # bytes: nothing stays beside anything
    files = {i: store_pack(seed=1, identity=i) for i in (IDS["pack"],)}
    outcomes = run_lot(Lot(None, toys.TABLE, (flow, observe)), files)
    assert [o.status for o in outcomes] == [Status.DONE] * 2


@pytest.mark.slow
def test_what_lies_in_memory_from_before_counts_against_no_run(store):
    """A run that finds no memory is tried again without the products of earlier ones."""
    pack, flow, _ = tasks(toy_stages.FORESEES)
    held = resident_memory() + 4e8
    worker._memory["earlier"] = {"x": np.ones(45_000_000)}  # 360 MB
    worker._memory.n, bound = 1_000_000_000, worker._memory.n
    try:
        worker._memory["earlier"] = {"x": np.ones(45_000_000)}
        outcomes = run(store, pack, flow, memory=held)
    finally:
        worker._memory.n = bound
        worker._memory.clear()
    assert [o.status for o in outcomes] == [Status.DONE] * 2
    assert "earlier" not in worker._memory


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.ENOLCK, errno.EACCES])
def test_what_fails_around_a_stage_is_no_failure_of_the_case(store, monkeypatch, number):
    """A full disk under the compiled kernels, a home without locks."""

    def fails(*_: object, **__: object) -> None:
        try:
            raise OSError(number, os.strerror(number), "/cache/index")
        except OSError as error:
            raise RuntimeError("the kernel cannot be cached") from error

    monkeypatch.setattr(toy_stages, "flow", fails)
    with pytest.raises(OSError, match="/cache/index"):
        run(store, *tasks())
    assert [store.has(identity) for identity in IDS.values()] == [True, False, False]
    assert store.failure(IDS["flow"]) is None
    monkeypatch.undo()
    assert [o.status for o in run(store, *tasks()[1:])] == [Status.DONE] * 2


def test_what_would_not_fit_is_foreseen(store):
    """The limit of a case counts before memory is taken, and only for its own job."""
    pack, flow, _ = tasks(toy_stages.FORESEES)
    ended = run(store, pack, flow, memory=1.5e8)[1]
    assert ended.status is Status.OUT_OF_MEMORY
    assert "a toy needs 0.1 GB" in ended.message
    assert "limits.memory" in ended.message
    record = store.failure(IDS["flow"])
    assert (record["limits"], "room" in record) == ({"memory": 1.5e8}, False)
    assert run(store, flow)[0].status is Status.DONE


AGAIN = """
import resource
import numpy as np
from demflow.sweep.execution.memory import KEPT_BYTES, give_back, keep_freed, resident_memory

keep_freed()
fresh = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_minflt
size = KEPT_BYTES // 4
(np.ones(size // 8), np.ones(size // 8))
begin, held = fresh(), resident_memory()
for _ in range(3):
    (np.ones(size // 8), np.ones(size // 8))
print(fresh() - begin < 16, end=" ")
give_back()
print(held - resident_memory() > 1.9 * size)
"""


def test_what_was_freed_is_used_again_and_given_back_where_it_is_asked_for():
    """Arrays of 64 MB made again bring no page of the system's; it has them all back in the end."""
    environment = {**os.environ, **ENVIRONMENT}
    done = subprocess.run(
        [sys.executable, "-c", AGAIN], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout == "True True\n"
