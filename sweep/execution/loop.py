"""The graph of stage runs on Dask workers: processes of one thread each.

Dask starts the workers, carries small messages and notices deaths. What runs where and
when is decided here (`sweep.execution.schedule`): each worker holds the job that it runs and, if
that is short, one more, so that it is always known what a worker was at when it died,
took too long or grew too large, and nobody else is blamed.
"""

from __future__ import annotations

import time
import uuid
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError
from concurrent.futures import Future as Answer
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from distributed import Future, KilledWorker

from demflow.model.outcome import Status
from demflow.sweep.errors import RunError, SchedulerError
from demflow.sweep.execution.cluster import RemotePool
from demflow.sweep.execution.jobs import Jobs, ParentLostError
from demflow.sweep.execution.ledger import Executed, Ledger
from demflow.sweep.execution.limits import Excess, Judge
from demflow.sweep.execution.local import LocalPool
from demflow.sweep.execution.pool import Pool, silent_loops
from demflow.sweep.execution.progress import Progress
from demflow.sweep.execution.schedule import Bundle, Schedule
from demflow.sweep.execution.signals import signals_noted, uninterrupted
from demflow.sweep.execution.worker import COMPILING, Greeting, Outcome, introduce, run_job
from demflow.sweep.plan.graph import MODEL
from demflow.sweep.store.products import Store
from demflow.sweep.store.versions import agreed
from demflow.sweep.study.load import Limits

if TYPE_CHECKING:
    from demflow.model.scene import Scene

TICK = 0.2  # s between looks at times, memory and living workers
WAITING_SECONDS = 2.0  # s without any worker before that is told
UNFIT_SECONDS = 60.0  # s for which workers that cannot be used are all there are
GREETING_SECONDS = 120.0  # s for a worker to import the stages and answer its greeting
COMPILING_SECONDS = 600.0  # s after which a compilation that did not end counts as the case's time
HEARD_SECONDS = 20.0  # s that the first stage run waits for other workers to be heard
DEAD_SECONDS = 30.0  # s after which an address whose worker died counts as that of another
GREETINGS = 3  # workers that may fail to answer in one run


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
    limits = limits or Limits()
    ledger = Ledger(schedule, store, limits)
    if anew:
        ledger.note_old_products()
    with silent_loops():
        pool: Pool = RemotePool(scheduler) if scheduler else LocalPool(workers)
        try:
            travel, judge = not pool.shares_store, Judge(schedule.plan, store, limits)
            jobs = Jobs(schedule.plan, store, scene_of, table, limits.memory, travel)
            _Execution(ledger, jobs, judge, pool, progress, begin).loop()
        finally:
            with uninterrupted():
                pool.close()
    ledger.report.seconds = time.monotonic() - begin
    return ledger.report


@dataclass(eq=False)
class _Flight:
    """A bundle that is on its way on a worker, or the greeting that comes before all."""

    bundle: Bundle | None  # None: the greeting
    future: Future
    begin: float  # when its worker came to it; later by what was compiled since
    answer: Answer[Any] | None = None  # which is on its way from when the worker has ended it
    before: float | None = None  # s that earlier stages took, once that was asked for


@dataclass(eq=False)
class _Worker:
    """What is known of a worker, while its address is listed."""

    line: deque[_Flight] = field(default_factory=deque)  # in the order of its work
    unfit: str | None = None  # why it is sent nothing
    compiling: float | None = None  # since when it compiles kernels
    died: float | None = None  # when it did

    @property
    def at(self) -> _Flight | None:
        """What it is at; what it has ended may still be on its way."""
        return next((flight for flight in self.line if flight.answer is None), None)

    @property
    def greeted(self) -> bool:
        """Whether it has not answered its greeting yet."""
        return bool(self.line) and self.line[0].bundle is None

    def soon_free(self, moment: float) -> bool:
        """Whether it is at one job, of at most a moment's length, beside which another may wait."""
        bundle = self.line[0].bundle if len(self.line) == 1 else None
        if bundle is None or bundle.alone or bundle.seconds is None:
            return False
        return bundle.seconds <= moment

    @property
    def usable(self) -> bool:
        """Whether it can be sent anything."""
        return self.died is None and self.unfit is None


class _Execution:
    """One pass over a schedule."""

    def __init__(
        self,
        ledger: Ledger,
        jobs: Jobs,
        judge: Judge,
        pool: Pool,
        progress: Callable[[Progress], None] | None,
        begin: float,
    ):
        self.ledger, self.schedule, self.report = ledger, ledger.schedule, ledger.report
        self.jobs, self.judge, self.pool, self.progress = jobs, judge, pool, progress
        self.workers: dict[str, _Worker] = {}  # by address
        self.silent = 0  # workers that never answered their greeting
        self.name = f"demflow-{uuid.uuid4().hex[:12]}"  # of this run, on a scheduler of many
        self.events: SimpleQueue[tuple[str, _Flight | float | None]] = SimpleQueue()
        pool.listen(COMPILING, lambda worker, told: self.events.put((worker, told["seconds"])))
        self.submitted = 0
        self.started = False  # whether a stage run was handed out
        self.begin, self.alive = begin, time.monotonic()
        self.looked = self.alive
        self.watched = 0.0  # s for which all workers together have stood
        self.own = agreed()
        self.first: float | None = None  # when the first worker was met

    def loop(self) -> None:
        """Hand out, wait, take in, until nothing is left to do or a signal ends it."""
        shown = 0.0
        with signals_noted() as noted:
            while self.schedule.pending and not noted:
                self._hand_out()
                with suppress(Empty):
                    self._hear(*self.events.get(timeout=TICK))
                    while True:
                        self._hear(*self.events.get_nowait())
                now = time.monotonic()
                if now - self.looked > TICK:
                    self._look()
                if self.progress and now - shown > TICK:
                    self._show()
                    shown = now
            self._show()

    def _hand_out(self) -> None:
        addresses, now = self.pool.addresses(), time.monotonic()
        for address, worker in list(self.workers.items()):
            forgiven = worker.died is not None and now - worker.died > DEAD_SECONDS
            if forgiven or (address not in addresses and not worker.line):
                del self.workers[address]
                self.jobs.forget(address)
        for address in sorted(addresses - self.workers.keys()):
            self.workers[address] = _Worker()
            if why := self.pool.unfit(address):
                self._refuse(address, why)
            else:
                self._greet(address)
        usable = {a: w for a, w in self.workers.items() if a in addresses and w.usable}
        if usable:
            self.alive = now
            self.first = self.first or now
        ready = {a: w for a, w in usable.items() if not w.greeted}
        all_heard = len(ready) == len(usable) or now - (self.first or now) > HEARD_SECONDS
        if not (self.started or all_heard):
            return  # before the first stage run
        # first whoever has nothing to do, then whoever soon will have nothing
        for address in sorted(ready):
            if not ready[address].line:
                self._send_next(address, alone_possible=True)
        for address in sorted(ready):
            if ready[address].soon_free(self.schedule.bundle_seconds):
                self._send_next(address, alone_possible=False)
        if ready and not any(worker.line for worker in self.workers.values()):
            raise RunError(f"{self.schedule.pending} stage runs wait for each other")

    def _greet(self, address: str) -> None:
        """Have a new worker import the stages and say which versions it runs."""
        greeting = Greeting(self.jobs.table, self.pool.parent)
        self._submit(address, None, introduce, greeting)

    def _meet(self, address: str, found: dict[str, str]) -> None:
        other = [name for name, own in self.own.items() if found.get(name) != own]
        if other:
            listed = ", ".join(f"{n} {found.get(n)} (here {self.own[n]})" for n in other)
            self._refuse(address, f"the worker {address} has {listed}; give all the same versions")

    def _refuse(self, address: str, why: str) -> None:
        """Send nothing to a worker. Raises SchedulerError before the first stage run."""
        if not self.started:
            raise SchedulerError(why)
        self.workers[address].unfit = why
        self.report.refused.append(why)

    def _send_next(self, address: str, *, alone_possible: bool) -> None:
        while bundle := self.schedule.next_bundle(alone_possible):
            try:
                job = self.jobs.make(address, bundle.runs)
            except ParentLostError as lost:
                self.ledger.lost(lost.run, lost.identity, str(lost))
                self.schedule.again(bundle.runs)
                continue
            self._submit(address, bundle, run_job, job)
            return

    def _submit(
        self, address: str, bundle: Bundle | None, function: Callable[[Any], Any], argument: Any
    ) -> None:
        self.submitted += 1
        if bundle is not None and not self.started:
            self.started = True
            self.schedule.costs.start = time.monotonic() - self.begin
        future = self.pool.submit(address, function, argument, f"{self.name}-{self.submitted}")
        flight = _Flight(bundle, future, time.monotonic())
        self.workers[address].line.append(flight)
        future.add_done_callback(lambda _: self.events.put((address, flight)))

    def _hear(self, address: str, event: _Flight | float | None) -> None:
        """A flight ended, or a worker compiles kernels: None from now on, or so many seconds."""
        worker = self.workers.get(address)
        if worker is None:
            return  # of others on the same cluster, or long dead
        if isinstance(event, _Flight):
            self._take_in(address, worker, event)
        elif event is None:
            worker.compiling = time.monotonic()
        elif worker.compiling is not None:
            worker.compiling = None
            if worker.at is not None:
                worker.at.begin += event

    def _take_in(self, address: str, worker: _Worker, flight: _Flight) -> None:
        if flight not in worker.line:
            return  # it was settled when its worker died
        if flight.future.status == "finished":
            if flight.answer is None:
                self._fetch(address, flight)
                if worker.at is not None:
                    worker.at.begin = time.monotonic()
                return
            try:
                answer = flight.answer.result()
            except (CancelledError, OSError):
                if address in self.pool.addresses():
                    self._fetch(address, flight)
                    return
            else:
                worker.line.remove(flight)
                if flight.bundle is not None:
                    self._settle(address, flight.bundle, answer)
                else:
                    self._meet(address, answer)
                return
        error = None
        if flight.future.status == "error":
            error = flight.future.exception()
        if error is None or isinstance(error, KilledWorker):
            self._bury(address)
        elif flight.bundle is None:
            worker.line.remove(flight)
            why = f"{type(error).__name__}: {error}"
            self._refuse(address, f"the worker {address} cannot run demflow: {why}")
        elif isinstance(error, OSError):
            where = error.filename or self.ledger.store.root
            raise RunError(
                f"{where}: {error.strerror or error}; what was finished is kept"
            ) from error
        else:
            raise RunError(f"a worker broke: {type(error).__name__}: {error}") from error

    def _fetch(self, address: str, flight: _Flight) -> None:
        """Have an answer brought here, which takes as long as it takes.

        A worker gives it away itself, which it cannot while a stage keeps it from all else.
        """
        flight.answer = self.pool.fetch(flight.future)
        flight.answer.add_done_callback(lambda _: self.events.put((address, flight)))

    def _settle(self, address: str, bundle: Bundle, outcomes: list[Outcome]) -> None:
        if not (self.pool.shares_store or self.ledger.accept(outcomes)):
            self.jobs.forget(address)
            outcomes = []  # computed again
        for outcome in outcomes:
            if outcome.lost is None:
                self.ledger.enter(outcome)
                if outcome.status is Status.DONE:
                    self.jobs.made(address, outcome.run)
            elif self.pool.shares_store:
                self.ledger.lost(outcome.run, outcome.lost, outcome.message)
            else:
                self.jobs.send_whole(address, outcome.run, outcome.message)
        self.schedule.again(bundle.runs)

    def _bury(self, address: str, verdict: Excess | None = None, *, ours: bool = False) -> None:
        """A worker is dead, or is ended by us, be it with a verdict on what it was doing."""
        worker, now = self.workers[address], time.monotonic()
        seconds = now - worker.at.begin if worker.at else 0.0
        self.workers[address] = _Worker(died=now)
        self.jobs.forget(address)
        self.report.deaths += 1
        # a worker that hangs may not have said that it is at the second of its bundles already
        bundles = [flight.bundle for flight in worker.line if flight.bundle is not None]
        handed = [run for bundle in bundles for run in bundle.runs]
        for run in handed:
            self.ledger.find_stored(run)
        runs = tuple(run for run in handed if not self.schedule.is_done(run))
        bundle = Bundle(runs, any(bundle.alone for bundle in bundles), None)
        if verdict and len(runs) == 1:
            self.ledger.convict(runs[0], *verdict)
        elif verdict or ours:
            self.schedule.quarantine(runs)
        elif (guilty := self.schedule.died(bundle, seconds, self.watched)) is not None:
            self.ledger.convict(
                guilty,
                Status.WORKER_DIED,
                "its worker process died, also with nothing else on it; "
                "most often memory ran out: try fewer grains or fewer workers",
            )
        for flight in worker.line:
            flight.future.cancel()
            if flight.answer is not None:
                flight.answer.cancel()

    def _look(self) -> None:
        """End what takes too much, and find workers that went without a word."""
        now = time.monotonic()
        addresses = self.pool.addresses()
        self.schedule.share_out(len(addresses), self.judge.limits.time)
        self.watched += len(addresses) * (now - self.looked)
        self.looked = now
        for address, worker in list(self.workers.items()):
            at = worker.at
            if worker.line and address not in addresses:
                self._bury(address)
            elif at is None:
                continue
            elif at.bundle is None:
                if now - at.begin > GREETING_SECONDS:
                    self._give_up(address)
            elif verdict := self._excess(address, worker, at, now):
                self._bury(address, verdict)
                self.pool.kill(address)
        unfit = [worker.unfit for worker in self.workers.values() if worker.unfit]
        if unfit and now - self.alive > UNFIT_SECONDS:
            told = "; ".join(unfit)
            raise RunError(f"no worker that can be used for {UNFIT_SECONDS:g} s: {told}")
        if now - self.alive > self.pool.patience:
            raise RunError(
                f"no worker process for {self.pool.patience:g} s, though others were started; "
                "most often memory runs out: try fewer workers, or close other programs. "
                "What was finished is kept"
            )

    def _give_up(self, address: str) -> None:
        """End a worker that does not answer its greeting; its successor is greeted anew."""
        self._bury(address, ours=True)
        self.pool.kill(address)
        self.silent += 1
        if self.silent >= GREETINGS:
            raise RunError(
                f"{self.silent} workers did not answer within {GREETING_SECONDS:g} s; "
                f"the last of them was {address}"
            )

    def _excess(self, address: str, worker: _Worker, at: _Flight, now: float) -> Excess | None:
        if at.before is None and at.bundle is not None:
            at.before = self.judge.before(at.bundle.runs)
        since = worker.compiling
        compiling = since is not None and now - since < COMPILING_SECONDS
        if not compiling and (late := self.judge.of_time(at.before or 0.0, now - at.begin)):
            return late
        return self.judge.of_memory(self.pool.memory(address))

    def _show(self) -> None:
        if self.progress:
            workers = len(self.pool.addresses())
            tally, left = self.ledger.tally, self.schedule.seconds_left(workers)
            cases = len(self.ledger.plan.cases)
            compiling = any(w.compiling is not None for w in self.workers.values())
            without = time.monotonic() - self.alive
            waiting = without if without > WAITING_SECONDS else 0.0
            self.progress(Progress(cases, tally.done, tally.failed, left, compiling, waiting))
