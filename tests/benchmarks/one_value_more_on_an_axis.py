"""One value more on one of four axes computes exactly the stage runs that the plan lists.

Its CPU time is in proportion: that of starting, planning and collecting, measured by a run that
lacks one product, and of what the full study took beyond that, the part that the listed runs
have in it by the times of their stages.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from demflow.sweep.store.products import Store
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ANGLES, RATES, four_axes, timed_command, timed_run

GRAINS, BOUND = 3000, 1.5
GROWN = {"rate": {"rates": RATES + 1}, "angle": {"angles": ANGLES + 1}}


def run() -> Result:
    """Grow the axis that nothing but observing reads, then one that networks read."""
    small = four_axes("small", grains=100, angles=1, rates=1)
    timed_run(small, small.parent.parent / "small", workers=1)  # compiles, once on a machine
    base = four_axes("grown", grains=GRAINS)
    results = base.parent.parent / "grown"
    full = timed_run(base, results, workers=2)
    store = Store.open(results / "store", create=False)
    each, total = stage_cpu(store)
    one_observed = next(p for p in store.files() if store.meta(p.stem)["stage"] == "observe")
    one_observed.unlink()
    least = timed_run(base, results, workers=2).cpu
    lines = [
        f"{'400 cases':10} {full.computed:4} stage runs, {full.cpu:5.1f} s of CPU; "
        f"{least:.1f} s where one of them lacks"
    ]
    wrong, ratios = 0, []
    for axis, more in GROWN.items():
        path = four_axes("grown", grains=GRAINS, **more)
        listed = planned(path, results)
        took = timed_run(path, results, workers=2)
        wrong += abs(took.computed - sum(listed.values()))
        share = sum(count * each[name] for name, count in listed.items()) / total
        fair = least + share * (full.cpu - least)
        ratios.append(took.cpu / fair)
        runs = ", ".join(f"{count} {name}" for name, count in listed.items())
        lines.append(
            f"{axis:10} {took.computed:4} stage runs, {took.cpu:5.1f} s of CPU, in proportion "
            f"{fair:.1f} s ({share:.1%} of the stages' time); {runs}"
        )
    return Result(
        f"{wrong} runs beside the plan, {max(ratios):.2f} of the CPU in proportion at most",
        f"0, ≤ {BOUND:g}",
        wrong == 0 and max(ratios) <= BOUND,
        "\n".join(lines),
    )


def planned(path: Path, results: Path) -> dict[str, int]:
    """Stage runs that `demflow plan` would run."""
    told = json.loads(timed_command("plan", str(path), "--results", str(results), "--json")[1])
    return {stage["name"]: stage["to_run"] for stage in told["stages"] if stage["to_run"]}


def stage_cpu(store: Store) -> tuple[dict[str, float], float]:
    """CPU seconds of one run of each stage in the mean, and of all runs, as the store has them."""
    seconds: Counter[str] = Counter()
    count: Counter[str] = Counter()
    for path in store.files():
        meta = store.meta(path.stem)
        seconds[meta["stage"]] += meta["cpu_seconds"]
        count[meta["stage"]] += 1
    return {name: seconds[name] / count[name] for name in count}, sum(seconds.values())
