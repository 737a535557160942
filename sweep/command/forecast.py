"""What a run would do, and what that would cost by what runs have cost so far."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from heapq import heappop, heappush
from pathlib import Path
from typing import Any

import numpy as np

from demflow.model.compilation import kept_kernels
from demflow.sweep.command.progress_line import size
from demflow.sweep.execution.limits import in_force
from demflow.sweep.execution.memory import machine_memory, peak_memory
from demflow.sweep.plan.graph import Plan
from demflow.sweep.plan.runs import CostClass
from demflow.sweep.prepared import Project
from demflow.sweep.store.costs import ONCE
from demflow.sweep.study.load import Limits

COMPILING = 30.0  # s of processor time to compile the kernels of a study, once on a machine
FEW_KERNELS = 10  # kept ones, below which a run has still to compile


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
    largest = max((p or kind.bytes_held for p, kind in zip(peaks, waiting, strict=True)), default=0)
    # the process that leads the run holds the plan, as this one does
    main = max(costs.main, peak_memory())
    compiling = COMPILING / workers if waiting and _compiles(unknown) else 0.0
    least = {
        "seconds": sum(getattr(costs, name) or 0.0 for name in ONCE)
        + compiling
        + costs.loading(waiting)  # by all workers at once
        + _elapsed(made, left, seconds, workers),
        "bytes": sum(n * (costs.stored(kind) or kind.bytes_kept) for kind, n in waiting.items())
        + _dataset(made),
        "memory": main + workers * largest,
    }
    if not waiting:
        least = dict.fromkeys(least, 0.0)
    whole = {name: None if unknown else number for name, number in least.items()}
    return {
        "study": prepared.study.name,
        "cases": made.count,
        "impossible": len(made.impossible),
        "stages": stages,
        "to_run": sum(waiting.values()),
        **(whole | {"memory": None if None in peaks else whole["memory"]}),
        "unknown": unknown,
        "at_least": least,
        "compiling": compiling,
        "limits": asdict(limits),
        "warnings": [*_short_of(least, largest, limits, prepared.store.root)] if waiting else [],
    }


def _compiles(unknown: list[str]) -> bool:
    """Whether kernels are likely to be compiled first: of stages that never ran here."""
    return bool(unknown) or kept_kernels() < FEW_KERNELS


def _dataset(plan: Plan) -> float:
    """Bytes of the dataset, whose variables are what is observed of every case."""
    observed = (plan.result_of(case)[0] for case in range(len(plan.cases)))
    found: float = sum(plan.runs[run].kind.bytes_kept for run in observed if run >= 0)
    return found


def _short_of(least: dict[str, float], worker: float, limits: Limits, store: Path) -> Iterator[str]:
    """What the machine lacks for a run."""
    there = next(folder for folder in (store, *store.resolve().parents) if folder.exists())
    room, memory = shutil.disk_usage(there).free, machine_memory()
    if least["bytes"] > room:
        told = f"{size(least['bytes'])} of disk are needed and {size(room)} are free in {there}"
        yield f"{told}; give --results elsewhere, fewer cases, or record less"
    if limits.memory is not None and worker > limits.memory:
        told = f"a case needs {size(worker)} of memory, more than its limit of "
        yield f"{told}{size(limits.memory)}; fewer workers leave more to each"
    elif least["memory"] > memory:
        told = f"{size(least['memory'])} of memory are needed and the machine has {size(memory)}"
        yield f"{told}; take fewer workers"


def _elapsed(
    plan: Plan, left: np.ndarray, seconds: dict[CostClass, float | None], workers: int
) -> float:
    """Seconds until the last of the runs that are left has ended.

    Whichever worker is free takes the first one whose parents have ended. What is not known counts
    as nothing.
    """
    children: dict[int, list[int]] = {}
    parents: dict[int, int] = {}  # how many of each run have still to end
    for k in np.flatnonzero(left).tolist():
        awaited = {p for p in plan.runs[k].parents if p in parents}
        parents[k] = len(awaited)
        for parent in awaited:
            children.setdefault(parent, []).append(k)
    ready = [k for k, count in parents.items() if count == 0]  # sorted, as a heap is
    running: list[tuple[float, int]] = []
    now = 0.0
    while ready or running:
        while ready and len(running) < workers:
            k = heappop(ready)
            heappush(running, (now + (seconds[plan.runs[k].kind] or 0.0), k))
        now, ended = heappop(running)
        for child in children.get(ended, ()):
            parents[child] -= 1
            if parents[child] == 0:
                heappush(ready, child)
    return now


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
