"""What happens inside a worker process: take the parents, run the stage, store the product.

A job comes as plain data and the answer goes back as plain data of a few hundred bytes;
products do not travel, they lie in the store. A worker elsewhere, which has no store, gets
the parents' files with the job and gives its own files back with the answer: the same bytes
that it would have stored. Whatever a stage does, the answer is an `Outcome`; only a store
that cannot be written is an error of the whole run.
"""

from __future__ import annotations

import ctypes
import itertools
import math
import os
import signal
import socket
import sys
import time
import traceback
from collections import OrderedDict
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from distributed import get_worker

from demflow.model.compilation import compilation
from demflow.model.memory import limited
from demflow.model.outcome import ModelError, OutOfMemory, Status
from demflow.model.parameters import SceneError
from demflow.model.products import build, named
from demflow.model.quantities import STOPPED
from demflow.sweep.execution.memory import available, peak_memory, resident_memory
from demflow.sweep.plan.graph import stage_table
from demflow.sweep.store.products import (
    DamagedError,
    MissingError,
    Store,
    Stored,
    canonical,
    pack,
    unpack,
)
from demflow.sweep.store.versions import agreed, machine, versions

if TYPE_CHECKING:
    from demflow.model.stages import Stage

COMPILING = "demflow-compiling"  # topic under which workers tell that they compile
KEEP_SECONDS = 0.2  # s of finished work that may be lost with a worker
CACHE_BYTES = 256_000_000  # products kept in a worker's memory for the next stage


class Task(NamedTuple):
    """One stage run, with all that it reads."""

    run: int  # index in the plan
    id: str
    stage: str
    reads: dict[str, Any]  # keyword arguments: the parts of the scene
    parents: tuple[str | None, ...]  # identities of their products


@dataclass(frozen=True)
class Job:
    """Stage runs for one worker, in order."""

    store: str | None  # where the products lie; None: they travel
    table: str  # where the table of stages lies
    tasks: tuple[Task, ...]
    files: Mapping[str, bytes] = field(default_factory=dict)  # of parents that travel, by identity
    memory: float | None = None  # bytes of resident memory that the worker may come to
    longest: float = math.inf  # s after which no further task is begun


@dataclass(frozen=True)
class Outcome:
    """How a stage run ended. `lost` names a parent whose product is missing or damaged."""

    run: int
    status: Status
    message: str = ""
    seconds: float = 0.0
    stored: int = 0  # bytes
    memory: int = 0  # largest resident memory of this process so far, bytes
    compiled: bool = field(default=False, kw_only=True)  # whether it has compiled kernels too
    machine: str = field(default="", kw_only=True)  # the kind of machine that it ran on
    lost: str | None = field(default=None, kw_only=True)
    file: bytes = field(default=b"", kw_only=True)  # what a worker without a store would store


class Greeting(NamedTuple):
    """The first words to a worker."""

    table: str  # where the table of stages lies
    parent: int | None  # process that started the worker and ends with it; None: others did


def introduce(greeting: Greeting) -> dict[str, str]:
    """Import the stages, which is no stage's time, and return what this worker must agree in."""
    if greeting.parent is not None:
        _end_with(greeting.parent)
        _go_first()
    worker = get_worker()
    compilation.listener = lambda seconds: worker.log_event(COMPILING, {"seconds": seconds})
    for stage in stage_table(greeting.table):
        _ = stage.run
    return agreed()


def _end_with(parent: int) -> None:
    """Have the kernel end this process when its parent dies, whatever it is at then.

    Dask's own watch is a thread, which a compiled stage can keep from running for hours; it
    remains where the kernel is not Linux.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it was quicker
            os._exit(1)


_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
OOM_SCORE = "500"  # of 1000: as if half of the machine's memory were held on top


def _go_first() -> None:
    """Where the machine runs out of memory, let the kernel end a worker and not its client."""
    with suppress(OSError):  # not Linux, or not allowed
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)


def run_job(job: Job) -> list[Outcome]:
    """Run the tasks of a job in turn; return how each of them ended.

    A task whose parent failed in the same job is left out of the answer, and so are the rest
    once the job has taken its longest: another worker may have nothing to do.
    Raises OSError where the store cannot be written.
    """
    begin = kept = time.monotonic()
    stages = {stage.name: stage for stage in stage_table(job.table)}
    held = _Held(job)
    outcomes: list[Outcome] = []
    failed: set[str] = set()
    for task in job.tasks:
        if failed.intersection(filter(None, task.parents)):
            failed.add(task.id)
            continue
        with limited(job.memory):
            outcome = _run(task, stages, held, job.memory)
        if outcome.status is not Status.DONE:
            failed.add(task.id)
        if held.store is None and task.id in held.made:
            outcome = replace(outcome, file=held.made[task.id][1])
        outcomes.append(outcome)
        now = time.monotonic()
        if now - kept > KEEP_SECONDS:
            held.begin_to_keep()
            kept = now
        if now - begin > job.longest:
            break
    held.keep()
    return outcomes


class _Held:
    """What a job made so far, before the store or what came with the job.

    Parents that lie in memory when it begins stay at hand until it ends, though what it
    loads and makes meanwhile may put them out there: its sender counts on them.

    It is stored when the job ends, and every moment before that: one flush serves all that
    was made since the one before.
    """

    def __init__(self, job: Job):
        self.store = Store(Path(job.store)) if job.store is not None else None
        self.files = job.files
        parents = {identity for task in job.tasks for identity in task.parents if identity}
        self.at_hand = {i: arrays for i in parents if (arrays := _memory.get(i)) is not None}
        self.made: dict[str, tuple[str, bytes]] = {}  # kind and file, by identity
        self._begun = 0  # of them, so many are stored or on their way to the disk
        self._writing: Future[None] | None = None

    def get(self, identity: str) -> Stored:
        """Return a product. Raises MissingError, DamagedError."""
        if identity in self.made:
            return unpack(self.made[identity][1])
        if identity in self.files:
            return unpack(self.files[identity])
        if self.store is None:
            raise MissingError(identity)
        return self.store.get(identity)

    def put(self, identity: str, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> int:
        """Take a product and return its size in bytes."""
        self.made[identity] = ("product", pack(arrays, {**meta, "id": identity}))
        return len(self.made[identity][1])

    def put_failure(self, identity: str, meta: Mapping[str, Any]) -> None:
        """Take the record of a failure."""
        self.made[identity] = ("failed", pack({}, {**meta, "id": identity}))

    def begin_to_keep(self) -> None:
        """Store what was made since the last time; the disk takes its time beside the next run.

        Raises OSError where what was begun before could not be stored.
        """
        if self.store is not None:
            self._wait()
            self._writing = _writer.submit(self.store.keep, self._fresh())

    def keep(self) -> None:
        """Store all that was made. Raises OSError."""
        if self.store is not None:
            self._wait()
            self.store.keep(self._fresh())

    def _fresh(self) -> dict[str, tuple[str, bytes]]:
        fresh = dict(itertools.islice(self.made.items(), self._begun, None))
        self._begun = len(self.made)
        return fresh

    def _wait(self) -> None:
        if self._writing is not None:
            self._writing.result()


_writer = ThreadPoolExecutor(1, "store")  # one file after the other


def _run(task: Task, stages: Mapping[str, Stage], held: _Held, limit: float | None) -> Outcome:
    stage = stages[task.stage]
    parents: list[Any] = []
    for name, identity in zip(stage.parents, task.parents, strict=True):
        if identity is None:
            parents.append(None)
            continue
        try:
            parents.append(build(stages[name].returns, _load(held, identity)))
        except (MissingError, DamagedError) as error:
            return Outcome(task.run, Status.NOT_RUN, str(error), lost=identity)
    begin, cpu = _working_time()
    meta: dict[str, Any] = {"stage": stage.name, "version": stage.version}
    try:
        product = stage.run(*parents, **task.reads)
        arrays = {name: canonical(array) for name, array in named(product).items()}
        if stage.check is not None and (stopped := stage.check(arrays)):
            meta[STOPPED] = stopped
    except MemoryError:
        status, message = Status.OUT_OF_MEMORY, "no memory left; try fewer grains or fewer workers"
    except OutOfMemory as error:
        status, message = Status.OUT_OF_MEMORY, str(error)
    except (ModelError, SceneError) as error:
        status, message = Status.FAILED, str(error)
    except Exception as error:  # whatever a stage does must cost this run only
        status = Status.FAILED
        message = f"{type(error).__name__}: {error} ({_place(error)})"
        meta["traceback"] = traceback.format_exc()
    else:
        status, message = Status.DONE, ""
    end, cpu_end = _working_time()
    seconds = end - begin
    meta |= {"seconds": seconds, "cpu_seconds": cpu_end - cpu}
    meta |= {"machine": machine(), "host": socket.gethostname()}
    meta |= {"worker": os.getpid(), "versions": versions()}
    spent = Outcome(
        task.run,
        status,
        message,
        seconds,
        memory=peak_memory(),
        # what compiling took, once on this machine, is no measure of the next run
        compiled=compilation.seconds > 0.0,
        machine=machine(),
    )
    if status is Status.OUT_OF_MEMORY:
        meta |= _memory_there(limit)
    if status is not Status.DONE:
        held.put_failure(task.id, {**meta, "status": int(status), "message": message})
        return spent
    size = held.put(task.id, arrays, meta)
    _memory.put(task.id, arrays)
    return replace(spent, stored=size)


SHORT = 0.99  # share of a limit below which less than the limit was there


def _memory_there(limit: float | None) -> dict[str, Any]:
    """What bounded a run that found no memory: its limit, or less, all that there was."""
    room = available() + resident_memory()
    short = limit is None or room < SHORT * limit
    return {"limits": {"memory": limit}} | ({"room": room} if short else {})


def _working_time() -> tuple[float, float]:
    """Clocks of time and processor time, s, which stand still while kernels are compiled."""
    return (
        time.perf_counter() - compilation.seconds,
        time.process_time() - compilation.cpu_seconds,
    )


class _Memory:
    """The products that this process used last, up to a number of bytes."""

    def __init__(self, limit: int):
        self.limit = limit
        self.size = 0
        self.products: OrderedDict[str, Mapping[str, np.ndarray]] = OrderedDict()

    def get(self, identity: str) -> Mapping[str, np.ndarray] | None:
        """Return a product that is kept, None otherwise."""
        if identity not in self.products:
            return None
        self.products.move_to_end(identity)
        return self.products[identity]

    def put(self, identity: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep a product, and drop those that were not used for longest."""
        size = _bytes(arrays)
        if identity in self.products or size > self.limit:
            return
        self.products[identity] = arrays
        self.size += size
        while self.size > self.limit:
            self.size -= _bytes(self.products.popitem(last=False)[1])


_memory = _Memory(CACHE_BYTES)


def _load(held: _Held, identity: str) -> Mapping[str, np.ndarray]:
    arrays = held.at_hand.get(identity)
    if arrays is None:
        arrays = _memory.get(identity)
    if arrays is None:
        arrays = held.get(identity).arrays
        _memory.put(identity, arrays)
    return arrays


def _bytes(arrays: Mapping[str, np.ndarray]) -> int:
    return sum(array.nbytes for array in arrays.values())


def _place(error: BaseException) -> str:
    """File and line in which an unforeseen error arose."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(frame.filename).name}, line {frame.lineno}"
