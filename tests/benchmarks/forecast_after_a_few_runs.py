"""After runs of two sizes, `demflow plan` foretells time, memory and disk of a third one.

Two small studies of a few cases are run; then a larger one, with more grains than either and
more cases, is planned and run. Its time is that by the clock, process starts included, its memory
the largest of a worker and that of the process that leads, its disk the size of its products. What
this machine measured for other folders is left out.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from unittest import mock

from demflow.sweep.store.costs import Costs
from demflow.sweep.store.products import Store
from tests import cache
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import four_axes, timed_command, timed_run

SIZES, LARGER, BOUND = (500, 1000), 3000, 2.0


def run() -> Result:
    """Measure small studies, forecast a larger one, run it, compare."""
    results = results_folder() / "forecast"
    with mock.patch.dict(os.environ, cache.variables(results_folder() / "cache")):
        return compared(results)


def compared(results: Path) -> Result:
    """What is foretold in a results folder, and what is spent."""
    for grains in SIZES:
        timed_run(study(grains, angles=1, rates=1), results, workers=1)
    store = Store.open(results / "store", create=False)
    before = set(store.files())
    path = study(LARGER, angles=3, rates=2)
    told = json.loads(
        timed_command("plan", str(path), "--results", str(results), "--workers", "1", "--json")[1]
    )
    took = timed_run(path, results, workers=1)
    fresh = [file for file in store.files() if file not in before]
    costs = Costs.read(store)
    peaks = [spent.peak for sizes in costs.known.values() for spent in sizes.values()]
    spent = {
        "seconds": took.seconds,
        "bytes": float(sum(file.stat().st_size for file in fresh)),
        "memory": float(max(peaks) + costs.main),
    }
    ratios = {name: told[name] / value for name, value in spent.items()}
    lines = [
        f"measured with {' and '.join(map(str, SIZES))} grains; {LARGER} grains foretold",
        *(f"{name}: {told[name]:.3g} foretold, {spent[name]:.3g} spent" for name in spent),
    ]
    worst = max(max(ratio, 1.0 / ratio) for ratio in ratios.values())
    return Result(
        f"off by a factor {worst:.2f} at most", f"≤ {BOUND:g}", worst <= BOUND, "\n".join(lines)
    )


def study(grains: int, *, angles: int, rates: int) -> Path:
    """Write a study of four axes with so many grains."""
    return four_axes(f"forecast_{grains}", grains=grains, angles=angles, rates=rates)
