"""A trivial case costs at most 6 ms beside its own time: scheduled, run, stored, collected.

Side by side with xyzpy harvesting case by case, its mode that loses no finished case, where
the variable XYZPY_PYTHON names a Python that has it. `DEMFLOW_BASE` may name the folder of another
build: the same study is run by both in turns, and the processor time of all processes, from start
to dataset, may be at most 1.1 times its. CASES (of the environment) is how many there are.
"""

from __future__ import annotations

import os
import statistics
import subprocess
from pathlib import Path

from demflow.sweep.store.products import Store
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT, TOYS, timed_run
from tests.sweep import toys

CASES, BOUND = int(os.environ.get("CASES", "1000")), 6.0
MOST, TURNS = 1.1, 5  # processor time against another build, runs of each

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
    base, told = os.environ.get("DEMFLOW_BASE"), ""
    if base:
        ratio, line = against(Path(base), path, folder)
        lines.append(line)
        told, holds = f"; {ratio:.2f} of the other build's", holds and ratio <= MOST
    if other is None:
        beside = "xyzpy not compared (XYZPY_PYTHON names no Python)"
    else:
        beside = f"{max(figures) / other:.2f} of xyzpy's {other:.1f} ms"
    return Result(
        f"{max(figures):.2f} ms a case; {beside}{told}",
        f"≤ {BOUND:g} ms; ≤ a third of xyzpy's; ≤ {MOST:g} of another build's",
        holds,
        "\n".join(lines),
    )


def against(base: Path, path: Path, folder: Path) -> tuple[float, str]:
    """Processor time over that of another build, in the median of turns; and that in words."""
    took: list[list[float]] = []
    for turn in range(TURNS + 1):
        pair = []
        for name, root in (("base", base), ("this", ROOT)):
            results = folder / f"{name}-{turn}"
            pair.append(timed_run(path, results, root=root, workers=1, table=TOYS).cpu)
        took.append([1e3 * cpu / CASES for cpu in pair])
    before, now = (statistics.median(each) for each in zip(*took[1:], strict=True))  # all is cached
    ratio = statistics.median(b / a for a, b in took[1:])
    return ratio, f"processor time a case: {before:.2f} ms by the other build, {now:.2f} ms"


def harvested(folder: str) -> float | None:
    """Milliseconds a case of xyzpy, None where there is none."""
    python = os.environ.get("XYZPY_PYTHON")
    if not python:
        return None
    command = [python, "-W", "ignore", "-c", XYZPY, str(CASES), folder]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return float(done.stdout.split()[-1]) / CASES * 1e3
