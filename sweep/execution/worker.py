"""What happens inside a worker process: take the parents, run the stage, store the product.

A lot comes as plain data and the answer goes back as plain data of a few hundred bytes;
products do not travel, they lie in the store. A worker elsewhere, which has no store, gets
the parents' files with the lot and gives its own files back with the answer: the same bytes
that it would have stored. Whatever a stage does, the answer is an `Outcome`; only what fails
around it, as a disk, is an error of the whole run.
"""

from __future__ import annotations

import ctypes
import math
import os
import signal
import socket
import sys
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from distributed import get_worker
from zict import LRU

from demflow.model.compilation import compilation, loading
from demflow.model.memory import limited
from demflow.model.outcome import ModelError, OutOfMemory, Status
from demflow.model.parameters import SceneError
from demflow.model.products import build, named
from demflow.model.quantities import STOPPED
from demflow.sweep.execution.memory import (
    available,
    give_back,
    keep_freed,
    peak_memory,
    resident_memory,
)
from demflow.sweep.plan.table import stage_table
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
SHORT = 0.99  # share of a limit of memory below which less than the limit was there
CACHE_BYTES = 256_000_000  # products kept in a worker's memory for the next stage
SMALL_BYTES = 1_000_000  # that each counts as at least: a small one is read as soon


class Task(NamedTuple):
    """One stage run, with all that it reads."""

    run: int  # index in the plan
    id: str
    stage: str
    reads: dict[str, Any]  # keyword arguments: the parts of the scene
    parents: tuple[str | None, ...]  # identities of their products


@dataclass(frozen=True)
class Lot:
    """Stage runs for one worker, in order. No tuple: Dask would look for futures all through it."""

    store: str | None  # where the products lie; None: they travel
    table: str  # where the table of stages lies
    tasks: tuple[Task, ...]
    memory: float | None = None  # bytes of resident memory that the worker may come to
    longest: float = math.inf  # s after which no further task is begun
    afresh: bool = False  # whether nothing that lies in memory from before may count


@dataclass(frozen=True)
class Outcome:
    """How a stage run ended. `lost` names a parent whose product is missing or damaged."""

    run: int
    status: Status
    message: str = ""
    seconds: float = 0.0
    stored: int = 0  # bytes
    memory: int = 0  # largest resident memory of this process so far, bytes
    compiled: bool = False  # whether it has compiled kernels too
    loading: float = 0.0  # s that kernels took to load, beside `seconds`
    machine: str = ""  # the kind of machine that it ran on
    lost: str | None = None
    file: bytes = b""  # what a worker without a store would store


def introduce(table: str, wanted: frozenset[str], parent: int | None) -> dict[str, str]:
    """Import what is wanted of the stages, which is no stage's time; what all must agree in.

    It ends with its parent, the process that started it, where one is named.
    """
    if parent is not None:
        _end_with(parent)
        _go_first()
        keep_freed()
    worker = get_worker()
    compilation.listener = lambda seconds: worker.log_event(COMPILING, {"seconds": seconds})
    worker.loop.add_callback(signal.signal, signal.SIGTSTP, _stand)  # in the main thread
    for stage in stage_table(table):
        if stage.name in wanted:
            _ = stage.run
    return agreed()


def _stand(*_: object) -> None:
    """Do as Ctrl-Z asks, and leave the time until the run goes on out of that of a stage."""
    global _stood
    begin = time.perf_counter()
    os.kill(os.getpid(), signal.SIGSTOP)
    _stood += time.perf_counter() - begin


_stood = 0.0  # s


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


def run_lot(lot: Lot, files: Mapping[str, bytes]) -> list[Outcome]:
    """Run the tasks of a lot in turn; return how each of them ended.

    `files` are those of the parents where there is no store, by identity. A task whose parent
    failed in the same lot is left out of the answer, and so are the rest once the lot has taken
    its longest: another worker may have nothing to do.
    Raises OSError where the store cannot be written, or a stage has met what is no fault of
    its own: a full disk under the compiled kernels, a folder without locks.
    """
    begin = kept = time.monotonic()
    if lot.afresh:
        _forget()
    stages = {stage.name: stage for stage in stage_table(lot.table)}
    made = _Made(lot.store, files)
    outcomes: list[Outcome] = []
    failed: set[str] = set()
    try:
        for task in lot.tasks:
            if failed.intersection(filter(None, task.parents)):
                failed.add(task.id)
                continue
            with limited(lot.memory):
                outcome = _run(task, stages, made, lot.memory)
                if outcome.status is Status.OUT_OF_MEMORY and _forget():
                    # what lay there from before is no part of this run
                    outcome = _run(task, stages, made, lot.memory)
            if outcome.status is not Status.DONE:
                failed.add(task.id)
            if made.store is None and task.id in made.files:
                outcome = replace(outcome, file=made.files[task.id][1])
            outcomes.append(outcome)
            now = time.monotonic()
            if now - kept > KEEP_SECONDS:
                made.keep()
                kept = now
            if now - begin > lot.longest:
                break
    finally:
        made.keep()
    return outcomes


class _Made:
    """What a lot has made so far, before the store or what came with the lot.

    It is stored when the lot ends, and every moment before that: one flush serves all that
    was made since the one before.
    """

    def __init__(self, store: str | None, parents: Mapping[str, bytes]):
        self.store = Store(Path(store)) if store is not None else None
        self.parents = parents
        self.files: dict[str, tuple[str, bytes]] = {}  # kind and file, by identity; none stored

    def get(self, identity: str) -> Stored:
        """Return a product. Raises MissingError, DamagedError."""
        if identity in self.files:
            return unpack(self.files[identity][1])
        if identity in self.parents:
            return unpack(self.parents[identity])
        if self.store is None:
            raise MissingError(identity)
        return self.store.get(identity)

    def put(self, identity: str, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> int:
        """Take a product, or the record of a failure; return its size in bytes."""
        kind = "failed" if "status" in meta else "product"
        self.files[identity] = (kind, pack(arrays, {**meta, "id": identity}))
        return len(self.files[identity][1])

    def keep(self) -> None:
        """Store what was made since the last time. Raises OSError."""
        if self.store is not None:
            self.store.keep(self.files)
            self.files.clear()


def _run(task: Task, stages: Mapping[str, Stage], made: _Made, limit: float | None) -> Outcome:
    stage = stages[task.stage]
    parents: list[Any] = []
    for name, identity in zip(stage.parents, task.parents, strict=True):
        if identity is None:
            parents.append(None)
            continue
        try:
            parents.append(build(stages[name].returns, _load(made, identity)))
        except (MissingError, DamagedError) as error:
            return Outcome(task.run, Status.NOT_RUN, str(error), lost=identity)
    (begin, cpu), loaded = _working_time(), loading.seconds
    meta: dict[str, Any] = {"stage": stage.name, "version": stage.version}
    status, message, arrays = _ended(stage, parents, task.reads, meta)
    end, cpu_end = _working_time()
    meta |= {"seconds": end - begin, "cpu_seconds": cpu_end - cpu, "machine": machine()}
    meta |= {"host": socket.gethostname(), "worker": os.getpid(), "versions": versions()}
    if status is Status.OUT_OF_MEMORY:
        room = available() + resident_memory()
        # what bounded it: its limit, or less, all that there was
        short = limit is None or room < SHORT * limit
        meta |= {"limits": {"memory": limit}} | ({"room": room} if short else {})
    # what compiling took, once on this machine, and loading is no measure of the next run
    size, memory, compiled = 0, peak_memory(), compilation.seconds > 0.0
    loaded = loading.seconds - loaded
    if status is Status.DONE:
        size = made.put(task.id, arrays, meta)
        if not stage.observed:  # what is observed is read by no stage
            _memory[task.id] = arrays
    else:
        made.put(task.id, {}, {**meta, "status": int(status), "message": message})
    spent = end - begin, size, memory, compiled
    return Outcome(task.run, status, message, *spent, loading=loaded, machine=machine())


def _ended(
    stage: Stage, parents: list[Any], reads: Mapping[str, Any], meta: dict[str, Any]
) -> tuple[Status, str, dict[str, np.ndarray]]:
    """How a stage ended, with words, and what it made; more about that goes into `meta`."""
    try:
        product = stage.run(*parents, **reads)
        arrays = {name: canonical(array) for name, array in named(product).items()}
        if stage.check is not None and (stopped := stage.check(arrays)):
            meta[STOPPED] = stopped
    except MemoryError:
        message = "no memory left; try fewer grains or fewer workers"
        return Status.OUT_OF_MEMORY, message, {}
    except OutOfMemory as error:
        return Status.OUT_OF_MEMORY, str(error), {}
    except (ModelError, SceneError) as error:
        return Status.FAILED, str(error), {}
    except Exception as error:  # whatever a stage does must cost this run only
        if surroundings := _surroundings(error):
            raise surroundings from error
        meta["traceback"] = traceback.format_exc()
        return Status.FAILED, f"{type(error).__name__}: {error} ({_place(error)})", {}
    return Status.DONE, "", arrays


def _working_time() -> tuple[float, float]:
    """Clocks of time and processor time, s; they stand while kernels are compiled and loaded."""
    return (
        time.perf_counter() - compilation.seconds - loading.seconds - _stood,
        time.process_time() - compilation.cpu_seconds - loading.cpu_seconds,
    )


# the products that this process used last
_memory: LRU[str, Mapping[str, np.ndarray]] = LRU(
    CACHE_BYTES,
    {},
    weight=lambda _, arrays: max(SMALL_BYTES, sum(array.nbytes for array in arrays.values())),
)


def _forget() -> bool:
    """Give back the memory of products that are kept; return whether there were any."""
    some = bool(_memory)
    _memory.clear()
    give_back()
    return some


def _load(made: _Made, identity: str) -> Mapping[str, np.ndarray]:
    if identity not in _memory:
        _memory[identity] = arrays = made.get(identity).arrays
        return arrays  # it may have been too large to stay
    return _memory[identity]


def _surroundings(error: BaseException | None) -> OSError | None:
    """What failed around a stage, which reads and writes no files of its own."""
    while error is not None and not isinstance(error, OSError):
        error = error.__cause__ or error.__context__
    return error


def _place(error: BaseException) -> str:
    """File and line in which an unforeseen error arose."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(frame.filename).name}, line {frame.lineno}"
