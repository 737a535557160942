"""What a run would do, and what that would cost by what runs have cost so far."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from sweep.cost import Costs
from sweep.engine import Prepared
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
    waiting = np.bincount(row[left], minlength=count)
    stages: list[dict[str, Any]] = []
    memory: list[float | None] = []
    for k, stage in enumerate(made.stages):
        to_run = int(waiting[k])
        each, volume = costs.seconds(stage), costs.stored(stage)
        stages.append(
            {
                "name": stage.name,
                "version": stage.version,
                "runs": int(runs[k]),
                "shared": int(wanted[k] - runs[k]),
                "stored": int(kept[k]),
                "failed": int(bad[k]),
                "to_run": to_run,
                "seconds_each": each,
                "seconds": _times(to_run, each),
                "bytes": _times(to_run, volume),
            }
        )
        memory.append(_times(1 if to_run else 0, costs.memory(stage)))
    seconds = _sum(stage["seconds"] for stage in stages)
    known = [peak for peak in memory if peak is not None]
    peak = max(known, default=0) if len(known) == len(memory) else None
    return {
        "study": prepared.study.name,
        "cases": len(made.cases),
        "impossible": len(made.impossible),
        "stages": stages,
        "to_run": int(waiting.sum()),
        "seconds": None if seconds is None else seconds / workers,
        "bytes": _sum(stage["bytes"] for stage in stages),
        "memory": None if peak is None else peak * workers,
    }


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
