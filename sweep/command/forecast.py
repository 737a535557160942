"""What a run would do, and what that would cost by what runs have cost so far."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

import numpy as np

from demflow.sweep.execution.limits import in_force
from demflow.sweep.execution.memory import peak_memory
from demflow.sweep.plan.graph import CostClass, Plan
from demflow.sweep.prepared import Project


def forecast(prepared: Project, workers: int) -> dict[str, Any]:
    """Return what a run would do, and what that would cost by what runs cost so far.

    A number is None where a stage that would run was never measured; `unknown` names such
    stages, and `at_least` has the numbers without them.
    """
    made, costs = prepared.plan, prepared.costs()
    limits = in_force(prepared.study.limits, workers)
    stored = prepared.stored()
    row = np.fromiter((entry.stage for entry in made.runs), dtype=int, count=len(made.runs))
    left = made.to_run(stored, prepared.failed(stored, limits))
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
        to_do = sum(own.values())
        time = _sum(_times(n, seconds[kind]) for kind, n in typical.items())
        stages.append(
            {
                "name": stage.name,
                "version": stage.version,
                "runs": int(runs[k]),
                "shared": int(wanted[k] - runs[k]),
                "stored": int(kept[k]),
                "failed": int(bad[k]),
                "to_run": to_do,
                "seconds_each": time / sum(typical.values()) if time else None,
                "seconds": time if to_do else 0.0,
                "bytes": _sum(_times(n, costs.stored(kind)) for kind, n in own.items()),
            }
        )
    unknown = [stage["name"] for stage in stages if None in (stage["seconds"], stage["bytes"])]
    peaks = [costs.memory(kind) for kind in waiting]
    # the process that leads the run holds the plan, as this one does
    main = max(costs.main, peak_memory())
    least = {
        "seconds": (costs.start or 0.0) + _elapsed(made, left, seconds, workers),
        "bytes": sum(n * (costs.stored(kind) or 0.0) for kind, n in waiting.items()),
        "memory": main + workers * max(filter(None, peaks), default=0.0),
    }
    if not waiting:
        least = dict.fromkeys(least, 0.0)
    whole = {name: None if unknown else number for name, number in least.items()}
    return {
        "study": prepared.study.name,
        "cases": len(made.cases),
        "impossible": len(made.impossible),
        "stages": stages,
        "to_run": sum(waiting.values()),
        **(whole | {"memory": None if None in peaks else whole["memory"]}),
        "unknown": unknown,
        "at_least": least,
        "limits": asdict(limits),
    }


def _elapsed(
    plan: Plan, left: np.ndarray, seconds: dict[CostClass, float | None], workers: int
) -> float:
    """Seconds of all runs that are left: shared by the workers, or one after the other.

    However many workers there are, a run cannot begin before its parents have ended. What is
    not known counts as nothing.
    """
    total, longest = 0.0, 0.0
    end: dict[int, float] = {}
    for k in np.flatnonzero(left).tolist():
        own = seconds[plan.runs[k].kind] or 0.0
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
