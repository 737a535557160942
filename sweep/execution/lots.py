"""What a worker is sent: stage runs with all that they read, and parents where they travel."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from distributed import Future
from zict import LRU

from demflow.model.outcome import Status
from demflow.sweep.execution.pool import NoAnswerError, Pool
from demflow.sweep.execution.schedule import LONGEST_SECONDS
from demflow.sweep.execution.worker import Lot, Outcome, Task
from demflow.sweep.plan.graph import Plan
from demflow.sweep.store.products import DamagedError, MissingError, Store

if TYPE_CHECKING:
    from demflow.model.scene import Scene

SENT_BYTES = 100_000_000  # of products that are held on a cluster, each on the workers that took it


class Lots:
    """Makes the lots of a plan.

    Parameters
    ----------
    plan, store : what there is to run, and where products lie.
    scene_of : the scene of a case by its index in the plan.
    table : where the table of stages lies, as `module:name`.
    pool : where they go; products travel if it does not see the store.
    """

    def __init__(
        self, plan: Plan, store: Store, scene_of: Callable[[int], Scene], table: str, pool: Pool
    ):
        self.plan, self.store, self.scene_of = plan, store, scene_of
        self.table, self.pool = table, pool
        # futures of products that a cluster has, and their sizes; its workers take them from
        # each other
        self._sent: LRU[str, tuple[Future[Any], int]] = LRU(
            SENT_BYTES, {}, weight=lambda _, sent: sent[1]
        )
        self._sendings = 0

    def make(self, runs: tuple[int, ...], **bounds: Any) -> Lot:
        """The lot of some runs, within bounds that `Lot` names."""
        store = str(self.store.root.resolve()) if self.pool.shares_store else None
        tasks = tuple(map(self._task, runs))
        return Lot(store, self.table, tasks, longest=LONGEST_SECONDS, **bounds)

    def _task(self, run: int) -> Task:
        entry, stage = self.plan.runs[run], self.plan.stage_of(run)
        reads = stage.given(self.scene_of(entry.case), entry.leg)
        if stage.brings is not None:
            reads["members"] = tuple(stage.brings(self.scene_of(c)) for c in entry.members)
        parents = tuple(self.plan.runs[p].id if p >= 0 else None for p in entry.parents)
        return Task(run, entry.id, stage.name, reads, parents)

    async def files(self, address: str, lot: Lot) -> dict[str, Future[Any]] | Outcome:
        """Parents that a worker does not make in this very lot, or how a run ends that lacks one.

        Raises NoAnswerError.
        """
        if lot.store is not None:
            return {}
        own = {task.id for task in lot.tasks}
        taken = {p: task.run for task in lot.tasks for p in task.parents if p and p not in own}
        futures = {
            identity: self._sent[identity][0] for identity in taken if identity in self._sent
        }
        for identity in taken.keys() - futures.keys():
            try:
                content = self.store.content(identity)
            except (MissingError, DamagedError) as error:
                return Outcome(taken[identity], Status.NOT_RUN, str(error), lost=identity)
            # a name of its own each time: Dask may hear that the one before is forgotten only
            # after it has heard of this one, and would forget this one
            self._sendings += 1
            key = f"{self.pool.name}-{identity}-{self._sendings}"
            try:
                sent = await self.pool.client.scatter({key: content}, workers=[address], hash=False)
            except Exception as error:  # the worker has gone, or the scheduler
                raise NoAnswerError(address) from error
            futures[identity] = sent[key]
            self._sent[identity] = (sent[key], len(content))
        return futures

    def forget(self) -> None:
        """Send anew what was sent: a worker that held some of it is gone, or it came damaged."""
        self._sent.clear()
