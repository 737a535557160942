"""What runs next: the ready queue of a plan, and the count of its cases. No Dask, no files.

A stage run becomes ready when its parents are stored. The queue is ordered by the first
case that wants a run, so that cases finish early, one after the other, instead of all at
the end. Short runs are handed out in bundles, since a message to a worker and back costs
as much as they do: long bundles while much is left, short ones at the end, when a worker
that is done early would wait for the others.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from demflow.sweep.execution.blame import Blame
from demflow.sweep.plan.graph import CostClass, Plan
from demflow.sweep.store.costs import Costs

BUNDLE_SECONDS = 0.15  # a bundle of short runs lasts at least about this long
LONGEST_SECONDS = 2.0  # and at most so long, while much is left
SHARES = 8  # bundles that what is left for a worker makes between these two
BUNDLE_LENGTH = 64  # and holds no more runs than this


class State(IntEnum):
    """Where a run stands."""

    WAITING = 0  # for its parents
    READY = 1
    RUNNING = 2
    DONE = 3
    FAILED = 4
    BLOCKED = 5  # a run that it needs has failed


class Bundle(NamedTuple):
    """Runs that one worker does in turn."""

    runs: tuple[int, ...]
    alone: bool  # nothing else may wait on the worker
    seconds: float | None  # expected, None where the stage was not measured yet


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
        self.state = np.full(len(plan.runs), State.WAITING, dtype=np.int8)
        self.state[stored] = State.DONE
        self.state[failed & ~stored] = State.FAILED
        self.suspects: set[int] = set()
        self.blame = Blame()
        self.bundle_seconds = BUNDLE_SECONDS
        number: dict[CostClass, int] = {}
        self._kind = np.array(
            [number.setdefault(run.kind, len(number)) for run in plan.runs], dtype=np.int32
        )
        self._kinds = tuple(number)
        self._measured = Costs()  # in this run: what is expected of the next one
        self._ready: list[tuple[int, int]] = []  # heap of (first case, run)
        self._alone: list[int] = []  # heap of suspects that are ready
        self._children: dict[int, list[int]] = {}
        left = plan.to_run(stored, failed)
        self.state[(self.state == State.WAITING) & ~left] = State.BLOCKED
        # plain lists: numbers of numpy, one at a time, are slow at a hundred thousand cases
        there, waits = stored.tolist(), left.tolist()
        for run, entry in enumerate(plan.runs):
            if not there[run]:
                for parent in entry.parents:
                    if parent >= 0:
                        self._children.setdefault(parent, []).append(run)
                if waits[run] and all(p < 0 or there[p] for p in entry.parents):
                    self.state[run] = State.READY
                    self._ready.append((entry.case, run))
        heapq.heapify(self._ready)

    @property
    def pending(self) -> int:
        """Number of runs that are still to be done."""
        return int(np.count_nonzero(self.state <= State.RUNNING))

    def is_done(self, run: int) -> bool:
        """Whether a run has its product."""
        return bool(self.state[run] == State.DONE)

    def next_bundle(self, alone_possible: bool = True) -> Bundle | None:
        """Hand out the next runs, None where none is ready.

        A suspect, whose worker died, goes alone and before others, so that its verdict
        comes early; it waits while no worker is free of other work.
        """
        while self._alone and alone_possible:
            run = heapq.heappop(self._alone)
            if self.state[run] == State.READY:
                self.state[run] = State.RUNNING
                return Bundle((run,), True, None)
        runs: list[int] = []
        chain: list[tuple[int, int]] = []  # children that this bundle itself makes ready
        seconds: float | None = 0.0
        while len(runs) < BUNDLE_LENGTH and seconds is not None and seconds < self.bundle_seconds:
            heap, wanted = (chain, State.WAITING) if chain else (self._ready, State.READY)
            if not heap:
                break
            run = heapq.heappop(heap)[1]
            if self.state[run] != wanted or run in self.suspects:
                continue
            expected = self._measured.seconds(self.plan.runs[run].kind)
            if runs and (expected is None or seconds + expected > self.bundle_seconds):
                if heap is chain:
                    continue  # it becomes ready in its own right once this one is done
                heapq.heappush(heap, (self.plan.runs[run].case, run))
                break
            self.state[run] = State.RUNNING
            runs.append(run)
            seconds = None if expected is None else seconds + expected
            for child in self._children.get(run, ()):
                if self.state[child] == State.WAITING and self._parents_in(child, runs):
                    heapq.heappush(chain, (self.plan.runs[child].case, child))
        return Bundle(tuple(runs), False, seconds) if runs else None

    def done(
        self,
        run: int,
        seconds: float | None = None,
        stored: int = 0,
        memory: int = 0,
        compiled: bool = False,
        *,
        here: bool = True,
    ) -> None:
        """A run has stored its product; what it took in s and bytes, where that is known.

        What it took elsewhere than `here` counts for this run of the study alone.
        """
        self.state[run] = State.DONE
        if seconds is not None:
            for costs in (self._measured, *([self.costs] if here else [])):
                costs.add(self.plan.runs[run].kind, seconds, stored, memory, compiled)
        self._settle(self._children.get(run, ()))

    def failed(self, run: int) -> list[int]:
        """A run has failed; return it and its descendants, which cannot run now."""
        self.state[run] = State.FAILED
        lost, stack = [run], [run]
        while stack:
            for child in self._children.get(stack.pop(), ()):
                if self.state[child] not in (State.BLOCKED, State.FAILED, State.DONE):
                    self.state[child] = State.BLOCKED
                    lost.append(child)
                    stack.append(child)
        return lost

    def again(self, runs: Iterable[int]) -> None:
        """Runs that were handed out and came to nothing through no fault of theirs."""
        for run in runs:
            if self.state[run] in (State.RUNNING, State.READY):
                self.state[run] = State.WAITING
        self._settle(runs)

    def lost(self, run: int) -> None:
        """A product that was stored is missing or damaged: it has to be computed again.

        Runs that wait for it wait again.
        """
        if self.state[run] == State.DONE:
            self.state[run] = State.WAITING
            for parent in self.plan.runs[run].parents:
                children = self._children.setdefault(parent, [])
                if run not in children:
                    children.append(run)
            for child in self._children.get(run, ()):
                if self.state[child] == State.READY:
                    self.state[child] = State.WAITING
        self._settle([run])

    def died(self, bundle: Bundle, seconds: float = 0.0, watched: float = 0.0) -> int | None:
        """The worker died under a bundle. Return the run to blame, None while it is unknown.

        Its runs are retried, each alone on a worker; `Blame` says what the numbers are.
        """
        runs = self._at_work(bundle.runs)
        guilty = self.blame.died(runs, alone=bundle.alone, seconds=seconds, watched=watched)
        if guilty is None:
            self.quarantine(runs)
        return guilty

    def quarantine(self, runs: Iterable[int]) -> None:
        """Retry runs of which one is suspect, each alone on a worker."""
        runs = self._at_work(runs)
        self.suspects.update(runs)
        self.again(runs)

    def _at_work(self, runs: Iterable[int]) -> list[int]:
        return [run for run in runs if self.state[run] == State.RUNNING]

    def seconds_left(self, workers: int) -> float | None:
        """Expected seconds until all is done, None where a stage was never measured."""
        left = np.bincount(self._kind[self.state <= State.RUNNING])
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
        """Let bundles last as what is left for so many workers asks for.

        They stay well below the time limit of a case, s, so as not to be taken for one.
        """
        left = self.seconds_left(workers)
        share = max(BUNDLE_SECONDS, 0.0 if left is None else left / SHARES)
        longest = LONGEST_SECONDS if limit is None else min(LONGEST_SECONDS, limit / SHARES)
        self.bundle_seconds = min(share, longest)

    def _settle(self, runs: Iterable[int]) -> None:
        """Make ready what has all its parents."""
        for run in runs:
            if self.state[run] == State.WAITING and self._parents_in(run, ()):
                self.state[run] = State.READY
                if run in self.suspects:
                    heapq.heappush(self._alone, run)
                else:
                    heapq.heappush(self._ready, (self.plan.runs[run].case, run))

    def _parents_in(self, run: int, bundle: Iterable[int]) -> bool:
        """Whether every parent of a run is stored or computed in the same bundle."""
        return all(
            p < 0 or self.state[p] == State.DONE or p in bundle for p in self.plan.runs[run].parents
        )


class Tally:
    """Counts of cases that are done, failed and left, kept while runs finish."""

    def __init__(self, plan: Plan, state: np.ndarray):
        flat = plan.cases.ravel()
        order = np.argsort(flat, kind="stable").astype(np.int32)
        self._cases = order // plan.cases.shape[1]
        self._start = np.searchsorted(flat[order], np.arange(len(plan.runs) + 1))
        wanted = plan.cases >= 0
        states = np.where(wanted, state[plan.cases], State.DONE)
        self._open = np.count_nonzero(states <= State.RUNNING, axis=1)
        self._bad = ((states == State.FAILED) | (states == State.BLOCKED)).any(axis=1)
        self._bad[list(plan.impossible)] = True

    def finish(self, run: int, good: bool) -> None:
        """A run is over: stored, failed or blocked."""
        cases = self._cases[self._start[run] : self._start[run + 1]]
        self._open[cases] -= 1
        if not good:
            self._bad[cases] = True

    def reopen(self, run: int) -> None:
        """A run that counted as stored has to run again."""
        self._open[self._cases[self._start[run] : self._start[run + 1]]] += 1

    @property
    def done(self) -> int:
        """Cases of which every product is stored."""
        return int(np.count_nonzero((self._open == 0) & ~self._bad))

    @property
    def failed(self) -> int:
        """Cases of which a run has failed."""
        return int(np.count_nonzero(self._bad))

    @property
    def left(self) -> int:
        """Cases that are neither done nor failed."""
        return int(np.count_nonzero((self._open > 0) & ~self._bad))
