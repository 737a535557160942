"""What came of the runs: products and failures taken in, losses counted, cases told. No Dask."""

from __future__ import annotations

import operator
from collections import Counter
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

from demflow.model.outcome import Status
from demflow.sweep.errors import RunError
from demflow.sweep.execution.limits import Verdict
from demflow.sweep.execution.schedule import Schedule
from demflow.sweep.execution.worker import Outcome
from demflow.sweep.store.products import DamagedError, MissingError, Store
from demflow.sweep.store.versions import machine
from demflow.sweep.study.load import Limits

LOST_PRODUCTS = 3  # times that a product may be found damaged in one run


@dataclass
class Executed:
    """What an execution did."""

    computed: int = 0  # stage runs
    failed: int = 0
    damaged: list[str] = field(default_factory=list)  # products computed again, and why
    deaths: int = 0  # of workers
    refused: list[str] = field(default_factory=list)  # workers that came in mid-run and cannot help
    seconds: float = 0.0  # by the clock, from the first worker's start
    worked: float = 0.0  # s that the stage runs took, without compiling
    interrupted: int = 0  # whether Ctrl-C ended it before all was done

    def joined(self, other: Executed | None) -> Executed:
        """What this and another execution did together."""
        if other is None:
            return self
        return Executed(*map(operator.add, vars(self).values(), vars(other).values()))


class Ledger:
    """Enters how runs ended into the schedule, the store and the report."""

    def __init__(self, schedule: Schedule, store: Store, limits: Limits, *, anew: bool = False):
        self.schedule, self.plan, self.store = schedule, schedule.plan, store
        self.limits = limits
        self.anew = anew  # what lies in the store may be of an earlier run
        self.report = Executed()
        self._losses: Counter[int] = Counter()

    def accept(self, outcomes: list[Outcome]) -> bool:
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

    def enter(self, outcome: Outcome) -> None:
        """A worker told how a run ended."""
        if outcome.lost:
            self._lost(outcome)
        elif outcome.status is Status.DONE:
            spent = outcome.seconds, outcome.stored, outcome.memory, outcome.compiled
            # what a worker on another kind of machine took is no measure of this one
            here = outcome.machine in ("", machine())
            self._done(outcome.run, *spent, outcome.loading, here=here)
        else:
            self._fail(outcome.run)

    def _lost(self, outcome: Outcome) -> None:
        """A run missed a parent: where it lay, or on its way to a worker without a store."""
        known, parents = self.plan.runs, self.plan.runs[outcome.run].parents
        parent = next(p for p in parents if p >= 0 and known[p].id == outcome.lost)
        if self.schedule.is_done(parent):
            whole = self.store.has(known[parent].id)  # a damaged one was set aside
            self._count_loss(outcome.run if whole else parent, outcome.message)
            if not whole:
                self.schedule.lost(parent)

    def find_stored(self, run: int) -> None:
        """Count a run as done whose worker stored its product and died before it said so."""
        if self.anew or self.schedule.is_done(run):
            return
        identity = self.plan.runs[run].id
        with suppress(MissingError, DamagedError):  # then it is computed again
            seconds = self.store.meta(identity)["seconds"]
            self._done(run, seconds, self.store.path(identity).stat().st_size)

    def convict(self, run: int, verdict: Verdict) -> None:
        """Fail a run that cannot speak for itself."""
        stage, limits = self.plan.stage_of(run), asdict(self.limits)
        limits["memory"] = verdict.memory or limits["memory"]
        meta: dict[str, Any] = {"stage": stage.name, "version": stage.version, "limits": limits}
        meta |= {"status": int(verdict.status), "message": verdict.message}
        self.store.put_failure(self.plan.runs[run].id, meta)
        self._fail(run)

    def _done(self, run: int, *spent: Any, here: bool = True) -> None:
        self.report.computed += 1
        self.report.worked += spent[0]
        self.schedule.done(run, *spent, here=here)

    def _fail(self, run: int) -> None:
        self.report.failed += 1
        self.schedule.failed(run)

    def _count_loss(self, run: int, message: str) -> None:
        """Note a product that has to be computed again. Raises RunError if it happens often."""
        self._losses[run] += 1
        if self._losses[run] > LOST_PRODUCTS:
            raise RunError(f"{message}: again and again; it does not arrive, or is not kept")
        self.report.damaged.append(message)
