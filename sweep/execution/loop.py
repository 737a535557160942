"""The graph of stage runs on Dask workers: processes of one thread each.

Dask starts the workers, carries lots, answers and events, and notices deaths. What runs where
and when is decided here and in `sweep.execution.schedule`. Each worker has a lane, a coroutine:
it greets the worker, sends it one lot after the other, each when the one before is answered, and
ends with it. So it is always known what a worker was at when it died, took too long or grew too
large, and nobody else is blamed. All lanes live in the event loop of one thread.
"""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from demflow.model.outcome import Status
from demflow.sweep.errors import RunError, SchedulerError
from demflow.sweep.execution.blame import Blame
from demflow.sweep.execution.cluster import RemotePool
from demflow.sweep.execution.ledger import Executed, Ledger
from demflow.sweep.execution.limits import Judge, Verdict
from demflow.sweep.execution.local import LocalPool
from demflow.sweep.execution.lots import Lots
from demflow.sweep.execution.pool import NoAnswerError, Pool, silent_loops
from demflow.sweep.execution.progress import Progress
from demflow.sweep.execution.schedule import Schedule
from demflow.sweep.execution.signals import kept_from_children, signals_noted
from demflow.sweep.execution.worker import COMPILING, Outcome, introduce, run_lot
from demflow.sweep.store.products import Store
from demflow.sweep.store.versions import agreed
from demflow.sweep.study.load import Limits

if TYPE_CHECKING:
    from demflow.model.scene import Scene

T = TypeVar("T")

TICK = 0.2  # s between words about the progress
OUTGROWN = "worker-restart-memory"  # topic under which a nanny tells that it ends its worker
UNFIT_SECONDS = 60.0  # s for which workers that cannot be used are all there are
GREETING_SECONDS = 120.0  # s for a worker to import the stages and answer its greeting
COMPILING_SECONDS = 600.0  # s after which a compilation that did not end counts as the case's time
VERDICT_SECONDS = 0.3  # by which a nanny may be later than the scheduler with such news
START_SECONDS = 1.0  # s for which work has to wait for a further worker, about what one costs
HEARD_SECONDS = 20.0  # s that the first stage run waits for other workers to be heard
DEAD_SECONDS = 30.0  # s after which an address whose worker died counts as that of another
GREETINGS = 3  # workers that may fail to answer, or be too small to do so, in one run
STOPPED_SECONDS = 2.0  # s late for a look, from which on the whole run counts as having stood


def execute(
    schedule: Schedule,
    store: Store,
    scene_of: Callable[[int], Scene],
    *,
    table: str,
    workers: int,
    scheduler: str | None,
    limits: Limits,
    progress: Callable[[Progress], None] | None,
    anew: bool,
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
    KeyboardInterrupt passes through, after the workers have been ended. A first Ctrl-C raises
    nothing: what runs is finished, nothing new is begun, and the report says `interrupted`.
    """
    begin = time.monotonic()
    ledger = Ledger(schedule, store, limits, anew=anew)
    pool = RemotePool(scheduler) if scheduler is not None else LocalPool(workers, limits.memory)
    judge = Judge(schedule.plan, store, limits)
    lots = Lots(schedule.plan, store, scene_of, table, pool)
    run = _Execution(ledger, lots, judge, pool)
    with silent_loops(), signals_noted() as noted, ThreadPoolExecutor(1, "execution") as thread:
        with kept_from_children():
            done: Future[None] = thread.submit(asyncio.run, run.go())
        try:
            while wait([done], TICK).not_done and (not noted or noted == [signal.SIGINT]):
                if noted:
                    run.finish()
                if progress and run.state:
                    progress(run.state)
        finally:
            while not done.done() and not run.stop():
                time.sleep(0.01)  # it has not begun yet
        with suppress(asyncio.CancelledError):
            done.result()
        if noted[:1] == [signal.SIGINT]:
            del noted[:1]  # a second signal is raised all the same
            ledger.report.interrupted += 1
        if progress:
            progress(run.now())
    ledger.report.seconds = time.monotonic() - begin
    return ledger.report


@dataclass(eq=False)
class _Worker:
    """A worker that is listed, and what it is at."""

    address: str
    known: Mapping[str, Any]  # what the scheduler knows of it
    end: asyncio.Future[Verdict | None]  # set when it is gone, be it with a verdict on its lot
    lane: asyncio.Task[None] | None = None
    ready: bool = False  # whether it has answered its greeting
    unfit: str | None = None  # why it is sent nothing
    runs: tuple[int, ...] = ()  # its lot
    begin: float = 0.0  # when it came to it; later by what was compiled since
    before: float | None = None  # s that earlier stages took, once that was asked for
    compiling: float | None = None  # since when it compiles kernels

    def gone(self, verdict: Verdict | None = None) -> None:
        """It is no longer there."""
        if not self.end.done():
            self.end.set_result(verdict)


class _Execution:
    """One pass over a schedule."""

    def __init__(self, ledger: Ledger, lots: Lots, judge: Judge, pool: Pool):
        self.ledger, self.schedule, self.report = ledger, ledger.schedule, ledger.report
        self.lots, self.judge, self.pool, self.blame = lots, judge, pool, Blame()
        self.workers: dict[str, _Worker] = {}  # by address
        self.buried: dict[str, float] = {}  # when the worker of an address died
        self.silent = self.small = 0  # workers that never answered, or died of memory before
        self.started = False  # whether a stage run was handed out
        self.ending = False  # whether nothing is handed out any more
        self.begin = self.alive = self.advanced = time.monotonic()
        self.sufficed = self.begin  # when there were as many workers as there was work for
        self.watched = 0.0  # s for which all workers together have stood
        self.own = agreed()
        self.first: float | None = None  # when the first worker was met
        self.state: Progress | None = None  # as of a moment ago
        self.main: tuple[asyncio.AbstractEventLoop, asyncio.Task[None]] | None = None

    async def go(self) -> None:
        """Hand out, wait, take in, until nothing is left to do."""
        task = asyncio.current_task()
        assert task is not None
        self.main = asyncio.get_running_loop(), task
        self.over: asyncio.Future[None] = self.main[0].create_future()
        self.news = asyncio.Event()  # something has ended: there may be more to hand out
        async with self.pool:
            self.pool.listen(COMPILING, self._hear_of_compiling)
            self.pool.listen(OUTGROWN, self._hear_of_memory)
            self.pool.listen("all", self._hear_of_leaving)
            tasks = [self._task(self._watch()), self._task(self._show())]
            try:
                await self.over
            finally:
                lanes = [worker.lane for worker in self.workers.values() if worker.lane]
                for running in (*tasks, *lanes):
                    running.cancel()
                await asyncio.wait([*tasks, *lanes])

    def stop(self) -> bool:
        """From another thread: end all at once. Return whether it was running already."""
        if self.main is not None:
            with suppress(RuntimeError):  # it has just ended
                self.main[0].call_soon_threadsafe(self.main[1].cancel)
        return self.main is not None

    def finish(self) -> None:
        """From another thread: hand out nothing more, and end when what runs has ended."""
        if self.main is not None and not self.ending:
            with suppress(RuntimeError):  # it has just ended
                self.main[0].call_soon_threadsafe(self._begin_to_end)

    def _begin_to_end(self) -> None:
        self.ending = True
        self._end_if_done()

    def _task(self, what: Any) -> asyncio.Task[None]:
        """Have something run beside, whose error is that of the whole run."""
        task: asyncio.Task[None] = asyncio.ensure_future(what)

        def ended(task: asyncio.Task[None]) -> None:
            if not task.cancelled() and (error := task.exception()) and not self.over.done():
                self.over.set_exception(error)

        task.add_done_callback(ended)
        return task

    async def _lane(self, worker: _Worker) -> None:
        """All that one worker does, from its greeting to its end."""
        try:
            if await self._race(worker, self._greet(worker)):
                while not self._all_heard():
                    await self._race(worker, asyncio.sleep(TICK))
                while not self.over.done():
                    await self._next(worker)
        except NoAnswerError:
            self._bury(worker)

    async def _race(self, worker: _Worker, what: Awaitable[T]) -> T:
        """Wait for something unless the worker ends first. Raises NoAnswerError."""
        task = asyncio.ensure_future(what)
        try:
            either: set[asyncio.Future[Any]] = {task, worker.end}
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if not task.done() or task.cancelled():
                raise NoAnswerError(worker.address)
            return task.result()
        finally:
            task.cancel()

    async def _greet(self, worker: _Worker) -> bool:
        """Have a new worker import the stages and say which versions it runs; whether it may."""
        address, why = worker.address, _unfit(worker.address, worker.known)
        if why is None:
            wanted, parent = self.schedule.stages_left(), self.pool.parent
            greeting = self.pool.call(address, introduce, self.lots.table, wanted, parent)
            try:
                async with asyncio.timeout(GREETING_SECONDS):
                    found = await greeting
                other = [name for name, own in self.own.items() if found.get(name) != own]
                if other:
                    told = ", ".join(f"{n} {found.get(n)} (here {self.own[n]})" for n in other)
                    why = f"the worker {address} has {told}; give all the same versions"
            except NoAnswerError:
                raise
            except TimeoutError:
                self._give_up(worker)
            except Exception as error:
                cause = f"{type(error).__name__}: {error}"
                why = f"the worker {address} cannot run demflow: {cause}"
        if why is None:
            worker.ready = True
            self.first = self.first or time.monotonic()
            return True
        if not self.started:
            raise SchedulerError(why)
        worker.unfit = why
        self.report.refused.append(why)
        return False

    def _give_up(self, worker: _Worker) -> None:
        """End a worker that does not answer its greeting; its successor is greeted anew."""
        self.silent += 1
        if self.silent >= GREETINGS:
            raise RunError(
                f"{self.silent} workers did not answer within {GREETING_SECONDS:g} s; "
                f"the last of them was {worker.address}"
            )
        self._end(worker, Verdict(Status.NOT_RUN, "it did not answer"))
        raise NoAnswerError(worker.address)

    def _end(self, worker: _Worker, verdict: Verdict) -> None:
        """End a worker, unless it has ended by itself; its nanny starts another."""
        if not worker.end.done():
            self.pool.kill(worker.address)
            worker.gone(verdict)

    def _all_heard(self) -> bool:
        """Whether the first stage run need not wait for other workers to answer."""
        if not self.started:
            waited = time.monotonic() - (self.first or 0.0) > HEARD_SECONDS
            return waited or all(worker.ready for worker in self.workers.values())
        return True

    async def _next(self, worker: _Worker) -> None:
        """Have a worker do the next lot."""
        runs = () if self.ending else self.schedule.next_lot()
        if not runs:
            if not self.ending and not any(other.runs for other in self.workers.values()):
                raise RunError(f"{self.schedule.pending} stage runs wait for each other")
            self.news.clear()
            await self._race(worker, self.news.wait())
            return
        worker.runs, worker.begin, worker.before = runs, time.monotonic(), None
        if not self.started:
            self.started = True
            self.schedule.costs.start = worker.begin - self.begin
        try:
            answer = await self._race(worker, self._do(worker))
        except NoAnswerError:
            # it may not have been noticed yet that it died; or it misses a parent that was sent
            await asyncio.wait({worker.end}, timeout=2.0 * self.pool.look_every)
            self._end(worker, Verdict(Status.NOT_RUN, "what was sent to it is gone"))
            raise
        worker.runs = ()
        self._settle(worker, runs, answer)

    async def _do(self, worker: _Worker) -> list[Outcome]:
        """Send a worker its lot; what it answers. Raises NoAnswerError."""
        bound, afresh = self.judge.memory(worker.known), worker.runs[0] in self.schedule.suspects
        lot = self.lots.make(worker.runs, memory=bound, afresh=afresh)
        files = await self.lots.files(worker.address, lot)
        if isinstance(files, Outcome):
            return [files]
        try:
            found: list[Outcome] = await self.pool.call(worker.address, run_lot, lot, files)
            return found
        except NoAnswerError:
            raise
        except OSError as error:
            where = error.filename or self.ledger.store.root
            raise RunError(
                f"{where}: {error.strerror or error}; what was finished is kept"
            ) from error
        except Exception as error:
            told = f"{type(error).__name__}: {error}".splitlines()[0]
            raise RunError(f"the worker {worker.address} broke: {told}") from error

    def _settle(self, worker: _Worker, runs: tuple[int, ...], answer: list[Outcome]) -> None:
        """Enter what a worker has answered; what it left out of its lot waits again."""
        if not isinstance(answer, list) or not all(
            isinstance(outcome, Outcome) and outcome.run in runs for outcome in answer
        ):
            raise RunError(
                f"the worker {worker.address} answered what no demflow answers "
                f"({type(answer).__name__}); what was finished is kept"
            )
        if self.pool.shares_store or self.ledger.accept(answer):
            for outcome in answer:
                self.ledger.enter(outcome)
            if any(outcome.lost for outcome in answer):
                self.lots.forget()
        self.schedule.again(runs)
        self._advance()

    def _advance(self) -> None:
        """Something has ended: say so to those who wait for it."""
        self.advanced = time.monotonic()
        self.news.set()
        self._end_if_done()

    def _end_if_done(self) -> None:
        """End the run when nothing is left to do, or nothing runs that is waited for."""
        idle = self.ending and not any(worker.runs for worker in self.workers.values())
        if (idle or not self.schedule.pending) and not self.over.done():
            self.over.set_result(None)

    def _bury(self, worker: _Worker) -> None:
        """A worker is dead, or is ended by us, be it with a verdict on what it was doing."""
        now, verdict = time.monotonic(), worker.end.result() if worker.end.done() else None
        del self.workers[worker.address]
        self.buried[worker.address] = now
        self.lots.forget()
        self.report.deaths += 1
        for run in worker.runs:
            self.ledger.find_stored(run)
        left = tuple(run for run in worker.runs if not self.schedule.is_done(run))
        guilty = None
        if verdict is None:
            seconds = now - worker.begin
            guilty = self.blame.died(left, seconds=seconds, watched=self.watched)
            verdict = Verdict(
                Status.WORKER_DIED,
                "its worker process died, also with nothing else on it; "
                "most often memory ran out: try fewer grains or fewer workers",
            )
        elif verdict.status is not Status.NOT_RUN and len(worker.runs) == len(left) == 1:
            # what lay in memory from before may have been too much: first it is tried without
            afresh = left[0] in self.schedule.suspects
            guilty = left[0] if afresh or verdict.status is Status.TIMED_OUT else None
        if guilty is None:
            self.schedule.suspect(left)
        else:
            self.ledger.convict(guilty, verdict)
        self._advance()

    def _hear_of_compiling(self, told: Mapping[str, Any]) -> None:
        """A worker compiles kernels: None from now on, or so many seconds."""
        if worker := self.workers.get(told["worker"]):
            if told["seconds"] is None:
                worker.compiling = time.monotonic()
            elif worker.compiling is not None:
                worker.compiling = None
                worker.begin += told["seconds"]

    def _hear_of_leaving(self, told: Mapping[str, Any]) -> None:
        """The scheduler has noticed that a worker is gone."""
        if told["action"] == "remove-worker" and (worker := self.workers.get(told["worker"])):
            # its nanny may be about to say why it ended it
            asyncio.get_running_loop().call_later(VERDICT_SECONDS, worker.gone)

    def _hear_of_memory(self, told: Mapping[str, Any]) -> None:
        """A nanny ends a worker that holds more than it may."""
        worker = self.workers.get(told["worker"])
        if worker:
            worker.gone(self.judge.outgrown(worker.known))
        if worker is None or not worker.ready:
            self.small += 1
        if self.small >= GREETINGS and self.first is None and not self.over.done():
            told_of = f"the worker {told['worker']}" if told["worker"] else "a worker"
            self.over.set_exception(
                RunError(
                    f"workers are too small to import demflow: {told_of} was ended by its nanny "
                    f"at {told['rss'] / 1e9:.2g} GB; raise --memory-limit"
                )
            )

    async def _watch(self) -> None:
        """Find workers that come and go, and end what takes too much."""
        looked = time.monotonic()
        while not self.over.done():
            listed = await self.pool.look()
            now = time.monotonic()
            if (late := now - looked - self.pool.look_every) > STOPPED_SECONDS:
                self._stood(late)  # Ctrl-Z, or a machine that slept
            self.watched += len(self.workers) * (now - looked)
            looked = now
            for address in self.workers.keys() | listed.keys():
                self._look_at(address, listed.get(address), now)
            self._look_at_all(now)
            self.schedule.share_out(len(self.workers), self.judge.limits.time)
            wanted = self.schedule.wanted()
            if wanted <= len(self.workers):
                self.sufficed = now
            elif now - self.sufficed >= START_SECONDS:
                self.pool.ask_for(wanted)
            await asyncio.sleep(self.pool.look_every)

    def _stood(self, seconds: float) -> None:
        """The whole run has stood still: that is no case's time, and no worker's to start in."""
        self.alive += seconds
        for worker in self.workers.values():
            worker.begin += seconds

    def _look_at(self, address: str, known: Mapping[str, Any] | None, now: float) -> None:
        worker = self.workers.get(address)
        if worker is None:
            if known and now - self.buried.get(address, -DEAD_SECONDS) >= DEAD_SECONDS:
                worker = _Worker(address, known, asyncio.get_running_loop().create_future())
                self.workers[address] = worker
                worker.lane = self._task(self._lane(worker))
        elif known is None:
            worker.gone()
            if worker.unfit:
                del self.workers[address]
        else:
            worker.known = known
            if worker.runs and (verdict := self._excess(worker, now)):
                self._end(worker, verdict)

    def _look_at_all(self, now: float) -> None:
        """Raise RunError where there has been no worker that can be used for too long."""
        if any(worker.unfit is None for worker in self.workers.values()):
            self.alive = now
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

    def _excess(self, worker: _Worker, now: float) -> Verdict | None:
        if worker.before is None:
            worker.before = self.judge.before(worker.runs)
        since = worker.compiling
        compiling = since is not None and now - since < COMPILING_SECONDS
        seconds = (now - worker.begin) / self.judge.served(worker.runs)
        if not compiling and (late := self.judge.of_time(worker.before, seconds)):
            return late
        return self.judge.of_memory(worker.known)

    async def _show(self) -> None:
        """Say now and then how far the run is."""
        while not self.over.done():
            self.state = self.now()
            await asyncio.sleep(TICK)

    def now(self) -> Progress:
        """How far the run is."""
        now, workers = time.monotonic(), list(self.workers.values())
        tally = self.schedule.tally()
        return Progress(
            self.ledger.plan.count,
            tally.done,
            tally.failed,
            self.schedule.seconds_left(len(workers)),
            compiling=any(worker.compiling is not None for worker in workers),
            waiting=now - self.alive,
            still=now - self.advanced,
            workers=sum(worker.ready for worker in workers),
            deaths=self.report.deaths,
            ending=self.ending,
            stages=self.schedule.stages(),
        )


def _unfit(address: str, known: Mapping[str, Any]) -> str | None:
    """Why a worker must not be sent a lot: it has many threads, or nobody to end it."""
    if (threads := known.get("nthreads", 1)) != 1:
        return (
            f"the worker {address} has {threads} threads; "
            "start each with `dask worker --nthreads 1`, and more of them (--nworkers)"
        )
    if known.get("nanny") is None:
        return (
            f"the worker {address} has no nanny, which ends a case at its limits and starts "
            "the next worker; leave out `--no-nanny`"
        )
    return None
