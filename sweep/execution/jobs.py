"""What a worker is sent: stage runs with all that they read, and parents where they travel."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from demflow.sweep.errors import RunError
from demflow.sweep.execution.schedule import LONGEST_SECONDS
from demflow.sweep.execution.worker import Job, Task
from demflow.sweep.plan.graph import Plan
from demflow.sweep.store.products import DamagedError, MissingError, Store

if TYPE_CHECKING:
    from demflow.model.scene import Scene


LOST_AGAIN = 3  # times that a worker may lose parents that came with the very job


class ParentLostError(Exception):
    """A product that a run is to be sent is missing or damaged."""

    def __init__(self, run: int, identity: str, message: str):
        super().__init__(message)
        self.run, self.identity = run, identity


class Jobs:
    """Makes the jobs of a plan.

    Parameters
    ----------
    plan, store : what there is to run, and where products lie.
    scene_of : the scene of a case by its index in the plan.
    table : where the table of stages lies, as `module:name`.
    memory : bytes that a worker may come to, None: no limit.
    travel : whether products travel, since workers do not see the store.
    """

    def __init__(
        self,
        plan: Plan,
        store: Store,
        scene_of: Callable[[int], Scene],
        table: str,
        memory: float | None,
        travel: bool,
    ):
        self.plan, self.store, self.scene_of = plan, store, scene_of
        self.table, self.memory, self.travel = table, memory, travel
        # products that a worker without a store made or was sent
        self._held: dict[str, set[str]] = {}
        self._lost: dict[int, int] = {}  # how often a worker held a run's parents no more

    def make(self, address: str, runs: tuple[int, ...]) -> Job:
        """The job of some runs for a worker. Raises ParentLostError."""
        tasks = tuple(map(self._task, runs))
        if self.travel:
            store, files = None, self._files_for(address, tasks)
        else:
            store, files = str(self.store.root.resolve()), {}
        return Job(store, self.table, tasks, files, self.memory, LONGEST_SECONDS)

    def made(self, address: str, run: int) -> None:
        """A worker made the product of a run."""
        self._held.setdefault(address, set()).add(self.plan.runs[run].id)

    def send_whole(self, address: str, run: int, message: str) -> None:
        """Have all parents of a run go along the next time, whatever its worker was sent.

        A worker drops what it has not used for long, and then says that it lost it; one
        parent alone might put out another. Raises RunError where this does not help.
        """
        self._lost[run] = self._lost.get(run, 0) + 1
        if self._lost[run] > LOST_AGAIN:
            raise RunError(
                f"the worker {address} misses a product again and again, though it was sent: "
                f"{message}"
            )
        held = self._held.get(address, set())
        held.difference_update(self._task(run).parents)

    def forget(self, address: str) -> None:
        """A worker holds nothing any more."""
        self._held.pop(address, None)

    def _task(self, run: int) -> Task:
        entry, stage = self.plan.runs[run], self.plan.stage_of(run)
        reads = stage.given(self.scene_of(entry.case), entry.leg)
        parents = tuple(self.plan.runs[p].id if p >= 0 else None for p in entry.parents)
        return Task(run, entry.id, stage.name, reads, parents)

    def _files_for(self, address: str, tasks: tuple[Task, ...]) -> dict[str, bytes]:
        """Parents that a worker does not make in this very job, nor was sent before."""
        held = self._held.setdefault(address, set())
        own = {task.id for task in tasks}
        files: dict[str, bytes] = {}
        for task in tasks:
            here = own if task.run in self._lost else own | held
            for parent in task.parents:
                if parent is None or parent in here or parent in files:
                    continue
                try:
                    files[parent] = self.store.content(parent)
                except (MissingError, DamagedError) as error:
                    raise ParentLostError(task.run, parent, str(error)) from error
        held.update(files)
        return files
