"""Whether a case takes more time or memory than its study allows."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

from demflow.model.outcome import Status
from demflow.sweep.execution.memory import machine_memory
from demflow.sweep.plan.graph import Plan
from demflow.sweep.store.products import DamagedError, MissingError, Store
from demflow.sweep.study.load import Limits


class Verdict(NamedTuple):
    """How a run ends that took too much, and why."""

    status: Status
    message: str
    memory: float | None = None  # bytes that bounded it


SHARED = 0.9  # of the machine's memory, among its workers; the rest is for the run and others
LEAST = 1e9  # bytes that a worker may always come to: its libraries alone take a tenth


def in_force(limits: Limits, workers: int | None) -> Limits:
    """The limits of a study, its workers' share of this machine where it names no memory.

    Of workers elsewhere (None) nothing is known: theirs is what they were started with.
    """
    if limits.memory is not None or workers is None:
        return limits
    return replace(limits, memory=max(LEAST, SHARED * machine_memory() / workers))


class Judge:
    """Holds runs against the limits of a case.

    A case takes the time of all stage runs that it is made of, shared ones in full, as if
    it were alone: so it does not depend on its neighbours whether it keeps the limit. Of a run
    that works through many members of a family it takes the part of one member.
    """

    def __init__(self, plan: Plan, store: Store, limits: Limits):
        self.plan, self.store, self.limits = plan, store, limits
        self._seconds: dict[int, float] = {}  # what runs took, as far as that was asked for

    def memory(self, worker: Mapping[str, Any]) -> float | None:
        """Bytes that a worker may come to, None: no limit. `worker` as its scheduler knows it."""
        bounds = [self.limits.memory, worker.get("memory_limit")]
        return min((bound for bound in bounds if bound), default=None)

    def before(self, runs: Collection[int]) -> float:
        """What the earlier stages of these runs took, those of the hardest case, s."""
        if self.limits.time is None:
            return 0.0
        return max(self._seconds_before(run, runs) for run in runs)

    def served(self, runs: Collection[int]) -> int:
        """Members of a family that each of these runs works through; 1 of a run without."""
        return min(len(self.plan.runs[run].members) or 1 for run in runs)

    def of_time(self, before: float, seconds: float) -> Verdict | None:
        """Whether runs take too long that are not done after so many seconds."""
        limit = self.limits.time
        if limit is None or before + seconds <= limit:
            return None
        earlier = f", {before:.3g} s of them in earlier stages" if before > 0.01 else ""
        return Verdict(
            Status.TIMED_OUT,
            f"not done after {limit:g} s{earlier}, the study's limits.time; "
            "raise it, or make the case smaller",
        )

    def of_memory(self, worker: Mapping[str, Any]) -> Verdict | None:
        """Whether a worker holds too much, by what it told its scheduler last."""
        held, most = worker.get("metrics", {}).get("memory", 0.0), self.limits.memory
        return None if most is None or held <= most else self.outgrown(worker)

    def outgrown(self, worker: Mapping[str, Any]) -> Verdict:
        """What is said of a run under which a worker came to hold more than it may."""
        most, own = self.memory(worker) or 0.0, self.limits.memory
        if most == own:
            why = (
                "the study's limits.memory or, without one, a worker's share of this machine; "
                "raise it, use fewer workers, or make the case smaller"
            )
        else:
            why = (
                "all that a worker of this cluster may hold; start workers with a larger "
                "--memory-limit, or make the case smaller"
            )
        return Verdict(Status.OUT_OF_MEMORY, f"more than {most / 1e9:.3g} GB, {why}", most)

    def _seconds_before(self, run: int, together: Collection[int]) -> float:
        """What the runs that a run builds on took, other than those done together with it, s."""
        ancestors: set[int] = set()
        stack = [run]
        while stack:
            parents = {p for p in self.plan.runs[stack.pop()].parents if p >= 0}
            stack += parents - ancestors
            ancestors |= parents
        ancestors.difference_update(together)
        for earlier in ancestors - self._seconds.keys():
            with suppress(MissingError, DamagedError):  # the worker will miss it too
                took = self.store.meta(self.plan.runs[earlier].id)["seconds"]
                self._seconds[earlier] = took / self.served([earlier])
        return sum(self._seconds.get(earlier, 0.0) for earlier in ancestors)
