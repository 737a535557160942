"""The graph of stage runs on Dask workers: processes of one thread each.

Dask starts the workers, carries small messages and notices deaths. What runs where and
when is decided here (`sweep.schedule`): each worker holds the job that it runs and, if
that is short, one more, so that it is always known what a worker was at when it died,
took too long or grew too large, and nobody else is blamed.
"""

from __future__ import annotations

import math
import os
import time
import uuid
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from distributed import Future, KilledWorker

from sweep.pools import Pool, RunError, SchedulerError
from sweep.pools.local import LocalPool
from sweep.pools.remote import RemotePool
from sweep.progress import Progress
from sweep.schedule import Bundle, Schedule, Tally
from sweep.signals import uninterrupted
from sweep.stages import MODEL, Status
from sweep.store import DamagedError, MissingError, Store
from sweep.versions import NUMERICAL, versions
from sweep.worker import COMPILING, Greeting, Job, Outcome, Task, introduce, run_job

if TYPE_CHECKING:
    from model.scene import Scene

TICK = 0.2  # s between looks at times, memory and living workers
AHEAD_SECONDS = 0.5  # a job that ends sooner gets a successor sent in advance
LOST_FOR_GOOD = 60.0  # s without any worker before the run gives up
LOST_PRODUCTS = 3  # times that a product may be found damaged in one run
GREETING_SECONDS = 120.0  # s for a worker to import the stages and answer its greeting
COMPILING_SECONDS = 600.0  # s after which a compilation that did not end counts as the case's time
HEARD_SECONDS = 20.0  # s that the first stage run waits for all workers to be heard
DEAD_SECONDS = 30.0  # s after which an address whose worker died counts as that of another
GREETINGS = 3  # workers that may fail to answer in one run
ANSWER_SECONDS = 0.5  # s to fetch an answer before looking after other things


@dataclass(frozen=True)
class Limits:
    """What one case may take; None: no limit.

    A case takes the time of all stage runs that it is made of, shared ones in full, as if
    it were alone: so it does not depend on its neighbours whether it keeps the limit.
    Compiling kernels, which happens once on a machine, is no case's time.
    """

    time: float | None = None  # s
    memory: float | None = None  # bytes of resident memory of the worker that is at it


@dataclass
class Executed:
    """What an execution did."""

    computed: int = 0  # stage runs
    failed: int = 0
    damaged: list[str] = field(default_factory=list)  # products computed again, and why
    deaths: int = 0  # of workers
    refused: list[str] = field(default_factory=list)  # workers that came in mid-run and cannot help
    seconds: float = 0.0

    def joined(self, other: Executed | None) -> Executed:
        """What this and another execution did together."""
        if other is None:
            return self
        return Executed(
            self.computed + other.computed,
            self.failed + other.failed,
            self.damaged + other.damaged,
            self.deaths + other.deaths,
            self.refused + other.refused,
            self.seconds + other.seconds,
        )


def execute(
    schedule: Schedule,
    store: Store,
    scene_of: Callable[[int], Scene],
    *,
    table: str = MODEL,
    workers: int = 2,
    scheduler: str | None = None,
    limits: Limits | None = None,
    progress: Callable[[Progress], None] | None = None,
    anew: bool = False,
) -> Executed:
    """Run all that the schedule holds and store the products.

    Parameters
    ----------
    schedule : the runs, and which of them are stored already.
    store : where products go. Workers of a scheduler that was named need not see it:
        products travel to them and back.
    scene_of : the scene of a case by its index in the plan.
    table : where the table of stages lies, as `module:name`.
    workers : number of local worker processes.
    scheduler : address of an existing Dask scheduler, instead of local workers.
    limits : what one case may take.
    progress : called with the state of the run, several times a second.
    anew : whether runs may have products that are to be made again all the same.

    Raises SchedulerError where the scheduler or its workers cannot be used; RunError where
    no worker can be had or the store cannot be written;
    KeyboardInterrupt passes through, after the workers have been ended.
    """
    begin = time.monotonic()
    pool: Pool = RemotePool(scheduler) if scheduler else LocalPool(workers)
    try:
        run = _Execution(schedule, store, scene_of, table, limits or Limits(), progress, pool)
        if anew:
            run.note_old_products()
        run.loop()
    finally:
        with uninterrupted():
            pool.close()
    run.report.seconds = time.monotonic() - begin
    return run.report


@dataclass(eq=False)
class _Flight:
    """A bundle that is on its way on a worker."""

    bundle: Bundle
    future: Future
    begin: float  # when it became the first on its worker; later by what was compiled since


class _Execution:
    """One pass over a schedule."""

    def __init__(
        self,
        schedule: Schedule,
        store: Store,
        scene_of: Callable[[int], Scene],
        table: str,
        limits: Limits,
        progress: Callable[[Progress], None] | None,
        pool: Pool,
    ):
        self.schedule, self.plan, self.store = schedule, schedule.plan, store
        self.scene_of, self.table, self.limits = scene_of, table, limits
        self.progress, self.pool = progress, pool
        self.tally = Tally(self.plan, schedule.state)
        self.report = Executed()
        self.flights: dict[str, deque[_Flight]] = {}  # by worker, in the order of their work
        self.met: set[str] = set()
        self.unfit: dict[str, str] = {}  # workers that are sent nothing, and why
        self.silent = 0  # workers that never answered their greeting
        self.old: dict[int, tuple[int, int]] = {}  # products of earlier runs, to be made again
        self.held: dict[str, set[str]] = {}  # products that a worker without a store was sent
        self.name = f"demflow-{uuid.uuid4().hex[:12]}"  # of this run, on a scheduler of many
        self.dead: dict[str, float] = {}  # when a worker died, while its address is listed still
        self.events: SimpleQueue[tuple[str, _Flight | float | None]] = SimpleQueue()
        self.compiling: dict[str, float] = {}  # workers that compile kernels, since when
        pool.listen(COMPILING, lambda worker, told: self.events.put((worker, told["seconds"])))
        self.unanswered: list[tuple[str, _Flight]] = []  # answers that wait on their worker
        self.losses: dict[int, int] = {}
        self.seconds: dict[int, float] = {}  # what runs took, as far as that was asked for
        self.jobs = 0
        self.started = False  # whether a stage run was handed out
        self.begin = self.alive = time.monotonic()

    def loop(self) -> None:
        """Hand out, wait, take in, until nothing is left to do."""
        shown = looked = 0.0
        while self.schedule.pending:
            self._hand_out()
            with suppress(Empty):
                self._hear(*self.events.get(timeout=TICK))
                while True:
                    self._hear(*self.events.get_nowait())
            now = time.monotonic()
            if now - looked > TICK:
                again, self.unanswered = self.unanswered, []
                for waiting in again:
                    self._take_in(*waiting)
                self._look()
                looked = now
            if self.progress and now - shown > TICK:
                self._show()
                shown = now
        self._show()

    def note_old_products(self) -> None:
        """Remember the products that are there already, so as to tell new ones from them."""
        for run in range(len(self.plan.runs)):
            if not self.schedule.is_done(run) and (found := self._product_file(run)):
                self.old[run] = found

    def _product_file(self, run: int) -> tuple[int, int] | None:
        """What tells one file of a product from the next, None where there is none."""
        try:
            found = os.stat(self.store.path(self.plan.runs[run].id))
        except FileNotFoundError:
            return None
        return found.st_ino, found.st_mtime_ns

    def _hand_out(self) -> None:
        addresses, now = self.pool.addresses(), time.monotonic()
        self.dead = {
            a: at for a, at in self.dead.items() if a in addresses and now - at < DEAD_SECONDS
        }
        addresses -= self.dead.keys()
        for address in sorted(addresses - self.met):
            self.met.add(address)
            if why := self.pool.unfit(address):
                self._refuse(address, why)
            else:
                self._greet(address)
        addresses -= self.unfit.keys()
        if addresses:
            self.alive = now
        greeted = {a for a in addresses if (line := self._line(a)) and not line[0].bundle.runs}
        if greeted and not self.started and now - self.begin < HEARD_SECONDS:
            return  # before the first stage run, all workers are heard
        addresses = addresses - greeted
        # first whoever has nothing to do, then whoever soon will have nothing
        for address in sorted(addresses):
            if not self._line(address):
                self._send_next(address, alone_possible=True)
        for address in sorted(addresses):
            line = self._line(address)
            if len(line) == 1 and not line[0].bundle.alone:
                seconds = line[0].bundle.seconds
                if seconds is not None and seconds < AHEAD_SECONDS:
                    self._send_next(address, alone_possible=False)
        if addresses and not any(self.flights.values()):
            raise RunError(f"{self.schedule.pending} stage runs wait for each other")

    def _line(self, address: str) -> deque[_Flight]:
        return self.flights.setdefault(address, deque())

    def _greet(self, address: str) -> None:
        """Have a new worker import the stages and say which versions it runs."""
        greeting = Greeting(self.table, self.pool.parent)
        self._submit(address, Bundle((), False, 0.0), introduce, greeting)

    def _meet(self, address: str, found: dict[str, str]) -> None:
        own = versions()
        other = [name for name in ("demflow", *NUMERICAL) if found.get(name) != own[name]]
        if other:
            listed = ", ".join(f"{n} {found.get(n)} (here {own[n]})" for n in other)
            self._refuse(address, f"the worker {address} has {listed}; give all the same versions")

    def _refuse(self, address: str, why: str) -> None:
        """Send nothing to a worker. Raises SchedulerError before the first stage run."""
        if not self.started:
            raise SchedulerError(why)
        self.unfit[address] = why
        self.report.refused.append(why)

    def _send_next(self, address: str, *, alone_possible: bool) -> None:
        while bundle := self.schedule.next_bundle(alone_possible):
            tasks = tuple(self._task(run) for run in bundle.runs)
            if self.pool.shares_store:
                store = str(self.store.root.resolve())
                job = Job(store, self.table, tasks, memory=self.limits.memory)
            else:
                files = self._files_for(address, tasks)
                if files is None:
                    self.schedule.again(bundle.runs)
                    continue
                job = Job(None, self.table, tasks, files, self.limits.memory)
            self._submit(address, bundle, run_job, job)
            return

    def _submit(
        self, address: str, bundle: Bundle, function: Callable[[Any], Any], argument: Any
    ) -> None:
        self.jobs += 1
        self.started = self.started or bool(bundle.runs)
        future = self.pool.submit(address, function, argument, f"{self.name}-{self.jobs}")
        flight = _Flight(bundle, future, time.monotonic())
        self._line(address).append(flight)
        future.add_done_callback(lambda _: self.events.put((address, flight)))

    def _files_for(self, address: str, tasks: tuple[Task, ...]) -> dict[str, bytes] | None:
        """Parents that a worker has not been sent yet; None where one is missing or damaged.

        A worker drops what it has not used for long, and then says that it lost it.
        """
        held = self.held.setdefault(address, set())
        held.update(task.id for task in tasks)
        files: dict[str, bytes] = {}
        for task in tasks:
            for parent in task.parents:
                if parent is None or parent in held:
                    continue
                try:
                    files[parent] = self.store.content(parent)
                except (MissingError, DamagedError) as error:
                    self._lost(Outcome(task.run, Status.NOT_RUN, str(error), lost=parent))
                    return None
        held.update(files)
        return files

    def _task(self, run: int) -> Task:
        entry, stage = self.plan.runs[run], self.plan.stage_of(run)
        scene = self.scene_of(entry.case)
        reads = {name: read(scene) for name, read in stage.reads.items()}
        parents = tuple(self.plan.runs[p].id if p >= 0 else None for p in entry.parents)
        return Task(run, entry.id, stage.name, reads, parents)

    def _hear(self, address: str, event: _Flight | float | None) -> None:
        """A flight ended, or a worker compiles kernels: None from now on, or so many seconds."""
        if isinstance(event, _Flight):
            self._take_in(address, event)
        elif event is None:
            self.compiling[address] = time.monotonic()
        elif self.compiling.pop(address, None) is not None and (line := self._line(address)):
            line[0].begin += event

    def _take_in(self, address: str, flight: _Flight) -> None:
        line = self._line(address)
        if flight not in line:
            return  # it was settled when its worker died
        if flight.future.status == "finished":
            answer = self._answer(flight)
            if answer is None and address in self.pool.addresses():
                self.unanswered.append((address, flight))  # asked for again, after other things
                return
        else:
            answer = None
        if answer is not None:
            line.remove(flight)
            if line:
                line[0].begin = time.monotonic()
            if flight.bundle.runs:
                self._settle(address, flight, answer)
            else:
                self._meet(address, answer)
            return
        error = None
        if flight.future.status == "error":
            error = flight.future.exception()
        if error is None or isinstance(error, KilledWorker):
            self._bury(address)
        elif not flight.bundle.runs:
            line.remove(flight)
            why = f"{type(error).__name__}: {error}"
            self._refuse(address, f"the worker {address} cannot run demflow: {why}")
        elif isinstance(error, OSError):
            where = error.filename or self.store.root
            raise RunError(
                f"{where}: {error.strerror or error}; what was finished is kept"
            ) from error
        else:
            raise RunError(f"a worker broke: {type(error).__name__}: {error}") from error

    def _answer(self, flight: _Flight) -> Any:
        """What a worker answered; None while it is on its way, or lost.

        A worker gives it away itself, which it cannot while a stage keeps it from all else.
        """
        with suppress(KilledWorker, CancelledError, OSError):  # a TimeoutError is an OSError
            return flight.future.result(timeout=ANSWER_SECONDS)
        return None

    def _settle(self, address: str, flight: _Flight, outcomes: list[Outcome]) -> None:
        if not (self.pool.shares_store or self._accept(outcomes)):
            self.held.pop(address, None)
            outcomes = []  # computed again
        for outcome in outcomes:
            if outcome.lost is not None:
                held = self.held.get(address, set())
                if outcome.lost in held:
                    held.discard(outcome.lost)  # it goes along the next time
                else:
                    self._lost(outcome)
                continue
            if outcome.status is Status.DONE:
                self.report.computed += 1
                self.schedule.done(outcome.run, outcome.seconds, outcome.stored, outcome.memory)
                self.tally.finish(outcome.run, good=True)
            else:
                self._fail(outcome.run)
        self.schedule.again(flight.bundle.runs)

    def _accept(self, outcomes: list[Outcome]) -> bool:
        """Store what a worker without a store sent; False where it did not arrive whole."""
        files = {
            self.plan.runs[o.run].id: ("product" if o.status is Status.DONE else "failed", o.file)
            for o in outcomes
            if o.file
        }
        try:
            self.store.accept(files)
        except DamagedError as error:
            self._count_loss(outcomes[0].run, f"a product came damaged from a worker: {error}")
            return False
        return True

    def _count_loss(self, run: int, message: str) -> None:
        """Note a product that has to be computed again. Raises RunError if it happens often."""
        self.losses[run] = self.losses.get(run, 0) + 1
        if self.losses[run] > LOST_PRODUCTS:
            raise RunError(f"{message}: again and again; it does not arrive, or is not kept")
        self.report.damaged.append(message)

    def _fail(self, run: int) -> None:
        self.report.failed += 1
        for lost in self.schedule.failed(run):
            self.tally.finish(lost, good=False)

    def _convict(self, run: int, status: Status, message: str) -> None:
        """Fail a run that cannot speak for itself."""
        stage = self.plan.stage_of(run)
        meta: dict[str, Any] = {"stage": stage.name, "version": stage.version}
        meta |= {"status": int(status), "message": message}
        meta |= {"limits": {"time": self.limits.time, "memory": self.limits.memory}}
        self.store.put_failure(self.plan.runs[run].id, meta)
        self._fail(run)

    def _lost(self, outcome: Outcome) -> None:
        """A parent's product turned out missing or damaged."""
        parents = [p for p in self.plan.runs[outcome.run].parents if p >= 0]
        parent = next(p for p in parents if self.plan.runs[p].id == outcome.lost)
        if self.schedule.is_done(parent):
            self._count_loss(parent, outcome.message)
            self.schedule.lost(parent)
            self.tally.reopen(parent)

    def _bury(self, address: str, verdict: tuple[Status, str] | None = None) -> None:
        """A worker is dead, or was ended with a verdict on what it was doing."""
        self.dead[address] = time.monotonic()
        self.met.discard(address)
        self.held.pop(address, None)
        self.compiling.pop(address, None)
        self.report.deaths += 1
        line = self.flights.pop(address, deque())
        for flight in line:
            for run in flight.bundle.runs:
                found = None if self.schedule.is_done(run) else self._product_file(run)
                if found is not None and found != self.old.get(run):
                    self.report.computed += 1
                    self.schedule.done(run)
                    self.tally.finish(run, good=True)
        # a worker that hangs may not have said that it is at the second of its bundles already
        handed = [run for flight in line for run in flight.bundle.runs]
        runs = tuple(run for run in handed if not self.schedule.is_done(run))
        bundle = Bundle(runs, any(flight.bundle.alone for flight in line), None)
        if verdict and len(runs) == 1:
            self._convict(runs[0], *verdict)
        elif (guilty := self.schedule.died(bundle)) is not None:
            self._convict(
                guilty,
                Status.WORKER_DIED,
                "its worker process died, also with nothing else on it; "
                "most often memory ran out: try fewer grains or fewer workers",
            )
        for flight in line:
            flight.future.cancel()

    def _look(self) -> None:
        """End what takes too much, and find workers that went without a word."""
        now = time.monotonic()
        addresses = self.pool.addresses()
        for address, line in list(self.flights.items()):
            if not line:
                continue
            if address not in addresses:
                self._bury(address)
            elif not line[0].bundle.runs:
                if now - line[0].begin > GREETING_SECONDS:
                    self._give_up(address)
            elif verdict := self._excess(address, line[0].bundle, now - line[0].begin):
                self._bury(address, verdict)
                self.pool.kill(address)
        if now - self.alive > LOST_FOR_GOOD:
            why = "; ".join(self.unfit.values()) or "they may not be able to start"
            raise RunError(f"no worker for {LOST_FOR_GOOD:g} s: {why}")

    def _give_up(self, address: str) -> None:
        """End a worker that does not answer its greeting; its successor is greeted anew."""
        self._bury(address)
        self.pool.kill(address)
        self.silent += 1
        if self.silent >= GREETINGS:
            raise RunError(
                f"{self.silent} workers did not answer within {GREETING_SECONDS:g} s; "
                f"the last of them was {address}"
            )

    def _excess(self, address: str, bundle: Bundle, seconds: float) -> tuple[Status, str] | None:
        time_limit, memory_limit = self.limits.time, self.limits.memory
        compiled = time.monotonic() - self.compiling.get(address, -math.inf)
        if time_limit is not None and compiled > COMPILING_SECONDS:
            before = max(map(self._seconds_before, bundle.runs))
            if before + seconds > time_limit:
                earlier = f", {before:.3g} s of them in earlier stages" if before > 0.01 else ""
                return Status.TIMED_OUT, (
                    f"not done after {time_limit:g} s{earlier}, the study's limits.time; "
                    "raise it, or make the case smaller"
                )
        if memory_limit is not None and self.pool.memory(address) > memory_limit:
            return Status.OUT_OF_MEMORY, (
                f"more than {memory_limit / 1e9:.3g} GB, the study's limits.memory; "
                "raise it, or make the case smaller"
            )
        return None

    def _seconds_before(self, run: int) -> float:
        """What the runs that a run builds on took, s."""
        ancestors: set[int] = set()
        stack = [run]
        while stack:
            parents = {p for p in self.plan.runs[stack.pop()].parents if p >= 0}
            stack += parents - ancestors
            ancestors |= parents
        return sum(map(self._seconds_of, ancestors))

    def _seconds_of(self, run: int) -> float:
        if run not in self.seconds:
            try:
                self.seconds[run] = self.store.meta(self.plan.runs[run].id)["seconds"]
            except (MissingError, DamagedError):
                return 0.0  # being computed in the same bundle; or the worker will miss it too
        return self.seconds[run]

    def _show(self) -> None:
        if self.progress:
            workers = len(self.pool.addresses())
            tally, left = self.tally, self.schedule.seconds_left(workers)
            self.progress(Progress(len(self.plan.cases), tally.done, tally.failed, left))
