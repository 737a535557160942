"""What runs next: the ready queue of a plan, and the count of its cases. No Dask, no files.

A stage run becomes ready when its parents are stored. The queue is ordered by the first
case that wants a run, so that cases finish early, one after the other, instead of all at
the end. Short runs are handed out in lots, since a message to a worker and back costs
as much as they do: long lots while much is left, short ones at the end, when a worker
that is done early would wait for the others. A worker has one lot at a time, so that it is
known what it was at when it died.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from demflow.sweep.execution.progress import StageProgress
from demflow.sweep.plan.graph import Plan
from demflow.sweep.plan.runs import CostClass
from demflow.sweep.store.costs import Costs

LOT_SECONDS = 0.15  # a lot of short runs lasts at least about this long
LONGEST_SECONDS = 2.0  # and at most so long, while much is left
SHARES = 8  # lots that what is left for a worker makes between these two
WORTH_SECONDS = 5.0  # of work for which one more worker is worth while
LOT_LENGTH = 128  # and holds no more runs than this


# Where a run stands; blocked: one that it needs has failed. To ask an enumeration is slow.
WAITING, READY, RUNNING, DONE, FAILED, BLOCKED = range(6)


class Tally(NamedTuple):
    """Numbers of cases: all is stored, something has failed, and neither."""

    done: int
    failed: int
    left: int


class Schedule:
    """The runs of a plan, and where each of them stands.

    Parameters
    ----------
    plan : what there is to run.
    stored : which runs have their product already, shape (runs,) bool.
    failed : which runs are known to fail, shape (runs,) bool.
    costs : what runs cost before; what this run measures is added to it.
    """

    def __init__(
        self, plan: Plan, stored: np.ndarray, failed: np.ndarray, costs: Costs | None = None
    ):
        self.plan = plan
        self.costs = costs or Costs()
        self.state = np.full(len(plan.runs), WAITING, dtype=np.int8)
        self.state[stored] = DONE
        self.state[failed & ~stored] = FAILED
        self.suspects: set[int] = set()  # of which one may have ended its worker
        self.lot_seconds = LOT_SECONDS
        number: dict[CostClass, int] = {}
        self._kind = np.array(
            [number.setdefault(run.kind, len(number)) for run in plan.runs], dtype=np.int32
        )
        self._kinds = tuple(number)
        self._stage = np.array([run.stage for run in plan.runs], dtype=np.intp)
        self._of_stages = np.bincount(self._stage, minlength=len(plan.stages)).tolist()
        self._measured = Costs()  # in this run: what is expected of the next one
        self._ready: list[tuple[int, int]] = []  # heap of (first case, −1 of a suspect; run)
        self._children: dict[int, list[int]] = {}
        left = plan.to_run(stored, failed)
        self.state[(self.state == WAITING) & ~left] = BLOCKED
        # plain lists: numbers of numpy, one at a time, are slow at a hundred thousand cases
        there, waits = stored.tolist(), left.tolist()
        for run, entry in enumerate(plan.runs):
            if not there[run]:
                for parent in entry.parents:
                    if parent >= 0:
                        self._children.setdefault(parent, []).append(run)
                if waits[run] and all(p < 0 or there[p] for p in entry.parents):
                    self.state[run] = READY
                    self._ready.append((entry.case, run))
        heapq.heapify(self._ready)

    @property
    def pending(self) -> int:
        """Number of runs that are still to be done."""
        return int(np.count_nonzero(self.state <= RUNNING))

    def stages_left(self) -> frozenset[str]:
        """Stages of which some runs are still to be done."""
        left = np.flatnonzero(self.state <= RUNNING).tolist()
        return frozenset(self.plan.stage_of(run).name for run in left)

    def wanted(self) -> int:
        """Number of workers that would have something to do, each for some seconds."""
        at_hand = np.isin(self.state, (READY, RUNNING))
        left = self.seconds_left(1)
        enough = np.inf if left is None else np.ceil(left / WORTH_SECONDS)
        return int(min(np.count_nonzero(at_hand), enough))

    def is_done(self, run: int) -> bool:
        """Whether a run has its product."""
        return bool(self.state[run] == DONE)

    def next_lot(self) -> tuple[int, ...]:
        """Hand out the next runs, for one worker to do in turn; none where none is ready.

        A suspect goes by itself and before others, so that its verdict comes early.
        """
        runs: list[int] = []
        chain: list[tuple[int, int]] = []  # children that this lot itself makes ready
        seconds: float | None = 0.0
        while len(runs) < LOT_LENGTH and seconds is not None and seconds < self.lot_seconds:
            heap, wanted = (chain, WAITING) if chain else (self._ready, READY)
            if not heap:
                break
            place, run = heapq.heappop(heap)
            if self.state[run] != wanted:
                continue
            kind = self.plan.runs[run].kind
            expected = None if run in self.suspects else self._measured.seconds(kind)
            if runs and (expected is None or seconds + expected > self.lot_seconds):
                if heap is chain:
                    continue  # it becomes ready in its own right once this one is done
                heapq.heappush(heap, (place, run))
                break
            self.state[run] = RUNNING
            runs.append(run)
            seconds = None if expected is None else seconds + expected
            for child in self._children.get(run, ()):
                if self.state[child] == WAITING and self._parents_in(child, runs):
                    heapq.heappush(chain, (self.plan.runs[child].case, child))
        return tuple(runs)

    def done(self, run: int, *spent: Any, here: bool = True) -> None:
        """A run has stored its product; what it took, as `Costs.add` wants it.

        What it took elsewhere than `here` counts for this run of the study alone.
        """
        self.state[run] = DONE
        for costs in (self._measured, *([self.costs] if here else [])):
            costs.add(self.plan.runs[run].kind, *spent)
        self._settle(self._children.get(run, ()))

    def failed(self, run: int) -> None:
        """A run has failed, and its descendants cannot run now."""
        self.state[run] = FAILED
        stack = [run]
        while stack:
            for child in self._children.get(stack.pop(), ()):
                if self.state[child] < DONE:
                    self.state[child] = BLOCKED
                    stack.append(child)

    def again(self, runs: Iterable[int]) -> None:
        """Runs that were handed out and came to nothing through no fault of theirs."""
        for run in runs:
            if self.state[run] in (RUNNING, READY):
                self.state[run] = WAITING
        self._settle(runs)

    def lost(self, run: int) -> None:
        """A product that was stored is missing or damaged: it has to be computed again.

        Runs that wait for it wait again.
        """
        if self.state[run] == DONE:
            self.state[run] = WAITING
            for parent in self.plan.runs[run].parents:
                children = self._children.setdefault(parent, [])
                if run not in children:
                    children.append(run)
            for child in self._children.get(run, ()):
                if self.state[child] == READY:
                    self.state[child] = WAITING
        self._settle([run])

    def suspect(self, runs: Iterable[int]) -> None:
        """Try runs again of which one may have ended its worker, each by itself."""
        runs = [run for run in runs if self.state[run] == RUNNING]
        self.suspects.update(runs)
        self.again(runs)

    def seconds_left(self, workers: int) -> float | None:
        """Expected seconds until all is done, None where a stage was never measured."""
        left = np.bincount(self._kind[self.state <= RUNNING])
        total = 0.0
        for count, kind in zip(left, self._kinds, strict=False):
            if count:
                here = self._measured.seconds(kind)
                each = self.costs.seconds(kind) if here is None else here
                if each is None:
                    return None
                total += each * int(count)
        return total / max(workers, 1)

    def share_out(self, workers: int, limit: float | None = None) -> None:
        """Let lots last as what is left for so many workers asks for.

        They stay well below the time limit of a case, s, so as not to be taken for one.
        """
        left = self.seconds_left(workers)
        share = max(LOT_SECONDS, 0.0 if left is None else left / SHARES)
        longest = LONGEST_SECONDS if limit is None else min(LONGEST_SECONDS, limit / SHARES)
        self.lot_seconds = min(share, longest)

    def tally(self) -> Tally:
        """How many cases are done, failed and left."""
        states = np.where(self.plan.cases >= 0, self.state[self.plan.cases], DONE)
        bad: np.ndarray = np.any(states >= FAILED, axis=1)
        bad[list(self.plan.impossible)] = True
        left: np.ndarray = np.any(states <= RUNNING, axis=1) & ~bad
        failed, waiting = int(np.count_nonzero(bad)), int(np.count_nonzero(left))
        return Tally(self.plan.count - failed - waiting, failed, waiting)

    def stages(self) -> tuple[StageProgress, ...]:
        """How far each stage of the plan is."""
        stored = np.bincount(self._stage[self.state == DONE], minlength=len(self.plan.stages))
        numbers = zip(self.plan.stages, stored.tolist(), self._of_stages, strict=True)
        return tuple(StageProgress(one.name, done, count) for one, done, count in numbers if count)

    def _settle(self, runs: Iterable[int]) -> None:
        """Make ready what has all its parents."""
        for run in runs:
            if self.state[run] == WAITING and self._parents_in(run, ()):
                self.state[run] = READY
                place = -1 if run in self.suspects else self.plan.runs[run].case
                heapq.heappush(self._ready, (place, run))

    def _parents_in(self, run: int, lot: Iterable[int]) -> bool:
        """Whether every parent of a run is stored or computed in the same lot."""
        return all(p < 0 or self.state[p] == DONE or p in lot for p in self.plan.runs[run].parents)
