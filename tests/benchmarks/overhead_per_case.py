"""A trivial case costs at most 6 ms beside its own time: scheduled, run, stored, collected.

Side by side with xyzpy harvesting case by case, its mode that loses no finished case, where
the variable XYZPY_PYTHON names a Python that has it.
"""

from __future__ import annotations

import os
import subprocess

from demflow.sweep.store.products import Store
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import TOYS, timed_run
from tests.sweep import toys

CASES, BOUND = 1000, 6.0

XYZPY = """
import sys, time
import numpy as np
import xyzpy

def flow(rate):
    return rate * np.log1p(np.array([1.0, 10.0, 100.0]))

runner = xyzpy.Runner(flow, var_names="p", var_dims={"p": ["t"]}, var_coords={"t": [1, 10, 100]})
harvester = xyzpy.Harvester(runner, data_name=sys.argv[2] + "/harvest.h5")
begin = time.perf_counter()
for rate in range(int(sys.argv[1])):
    harvester.harvest_combos({"rate": [float(rate)]}, verbosity=0)
print(time.perf_counter() - begin)
"""


def run() -> Result:
    """Run 1,000 cases of two stages each that take no time, on one worker and on two."""
    folder = results_folder() / "overhead"
    folder.mkdir()
    rates = tuple(float(k + 1) for k in range(CASES))
    path = toys.write_study(folder, seeds=(1,), stresses=(), rates=rates, seconds=1e-9)
    lines, figures = [], []
    for workers in (1, 2):
        results = folder / f"workers-{workers}"
        took = timed_run(path, results, workers=workers, table=TOYS)
        store = Store.open(results / "store", create=False)
        own = sum(store.meta(file.stem)["seconds"] for file in store.files())
        figures.append((took.seconds - own) / CASES * 1e3)
        lines.append(
            f"{workers} worker(s): {took.seconds:.2f} s from start to dataset for {CASES} cases, "
            f"{took.computed} stage runs, {own:.2f} s of them their own: "
            f"{figures[-1]:.2f} ms a case"
        )
    other = harvested(str(folder))
    if other is not None:
        lines.append(f"xyzpy, one harvest per case: {other:.2f} ms a case")
    holds = max(figures) <= BOUND and (other is None or max(figures) <= other / 3)
    if other is None:
        beside = "xyzpy not compared (XYZPY_PYTHON names no Python)"
    else:
        beside = f"{max(figures) / other:.2f} of xyzpy's {other:.1f} ms"
    return Result(
        f"{max(figures):.2f} ms a case; {beside}",
        f"≤ {BOUND:g} ms; ≤ a third of xyzpy's",
        holds,
        "\n".join(lines),
    )


def harvested(folder: str) -> float | None:
    """Milliseconds a case of xyzpy, None where there is none."""
    python = os.environ.get("XYZPY_PYTHON")
    if not python:
        return None
    command = [python, "-W", "ignore", "-c", XYZPY, str(CASES), folder]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout.split()[-1]) / CASES * 1e3
