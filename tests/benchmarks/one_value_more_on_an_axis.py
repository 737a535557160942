"""One value more on one of four axes computes exactly the stage runs that the plan lists."""

from __future__ import annotations

import json

from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ANGLES, RATES, four_axes, timed_command, timed_run

GRAINS = 500
GROWN = {"rate": {"rates": RATES + 1}, "angle": {"angles": ANGLES + 1}}


def planned(path: str, results: str) -> dict[str, int]:
    """Stage runs that `demflow plan` would run."""
    told = json.loads(timed_command("plan", path, "--results", results, "--json")[1])
    return {stage["name"]: stage["to_run"] for stage in told["stages"] if stage["to_run"]}


def run() -> Result:
    """Grow the axis that nothing but observing reads, then one that networks read."""
    base = four_axes("grown", grains=GRAINS)
    results = base.parent.parent / "grown"
    took = timed_run(base, results, workers=2)
    lines = [f"{'400 cases':12} {took.computed:4} stage runs, {took.cpu:5.1f} s of CPU"]
    wrong = 0
    for axis, more in GROWN.items():
        path = four_axes("grown", grains=GRAINS, **more)
        listed = planned(str(path), str(results))
        took = timed_run(path, results, workers=2)
        wrong += abs(took.computed - sum(listed.values()))
        runs = ", ".join(f"{count} {name}" for name, count in listed.items())
        lines.append(f"{axis:12} {took.computed:4} stage runs, {took.cpu:5.1f} s of CPU; {runs}")
    return Result(f"{wrong} runs beside the plan", "0", wrong == 0, "\n".join(lines))
