"""What a run would do, and what that would cost by what runs have cost so far."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from sweep.cost import Costs
from sweep.plan import Kind, Plan
from sweep.prepared import Prepared
from sweep.schedule import Schedule, State


def forecast(prepared: Prepared, workers: int) -> dict[str, Any]:
    """Return what a run would do, and what that would cost by what runs cost so far.

    A number is None where a stage that would run was never measured.
    """
    made, costs = prepared.plan, Costs.read(prepared.store)
    stored = prepared.stored()
    failed = prepared.failed(stored)
    row = np.array([entry.stage for entry in made.runs], dtype=int)
    # what waits for a run that is known to fail does not run either
    left = Schedule(made, stored, failed).state <= State.RUNNING
    count = len(made.stages)
    runs, wanted = made.counts(), made.wanted()
    kept = np.bincount(row[stored], minlength=count)
    bad = np.bincount(row[~stored & ~left], minlength=count)
    waiting = Counter(made.runs[k].kind for k in np.flatnonzero(left))
    every = Counter(run.kind for run in made.runs)
    seconds = {kind: costs.seconds(kind) for kind in every}
    stages: list[dict[str, Any]] = []
    for k, stage in enumerate(made.stages):
        own = {kind: n for kind, n in waiting.items() if kind.stage == stage.name}
        typical = own or {kind: n for kind, n in every.items() if kind.stage == stage.name}
        to_run = sum(own.values())
        time = _sum(_times(n, seconds[kind]) for kind, n in typical.items())
        stages.append(
            {
                "name": stage.name,
                "version": stage.version,
                "runs": int(runs[k]),
                "shared": int(wanted[k] - runs[k]),
                "stored": int(kept[k]),
                "failed": int(bad[k]),
                "to_run": to_run,
                "seconds_each": time / sum(typical.values()) if time else None,
                "seconds": time if to_run else 0.0,
                "bytes": _sum(_times(n, costs.stored(kind)) for kind, n in own.items()),
            }
        )
    elapsed = _elapsed(made, left, seconds, workers)
    peaks = [costs.memory(kind) for kind in waiting]
    peak = None if None in peaks else max(filter(None, peaks), default=0.0)
    return {
        "study": prepared.study.name,
        "cases": len(made.cases),
        "impossible": len(made.impossible),
        "stages": stages,
        "to_run": sum(waiting.values()),
        "seconds": _sum((costs.start or 0.0, elapsed)) if waiting else 0.0,
        "bytes": _sum(stage["bytes"] for stage in stages),
        "memory": None if peak is None else peak * workers,
    }


def _elapsed(
    plan: Plan, left: np.ndarray, seconds: dict[Kind, float | None], workers: int
) -> float | None:
    """Seconds of all runs that are left: shared by the workers, or one after the other.

    However many workers there are, a run cannot begin before its parents have ended.
    """
    total, longest = 0.0, 0.0
    end: dict[int, float] = {}
    for k in map(int, np.flatnonzero(left)):
        own = seconds[plan.runs[k].kind]
        if own is None:
            return None
        end[k] = own + max((end.get(p, 0.0) for p in plan.runs[k].parents), default=0.0)
        total += own
        longest = max(longest, end[k])
    return max(total / workers, longest)


def _times(count: int, each: float | None) -> float | None:
    if count == 0:
        return 0
    return None if each is None else count * each


def _sum(numbers: Iterable[float | None]) -> float | None:
    total = 0.0
    for number in numbers:
        if number is None:
            return None
        total += number
    return total
