"""100,000 trivial cases are planned in under 30 s and 1 GB; running more takes little more memory.

The second part runs some thousand cases from start to dataset, and looks at the process that
plans, hands out and collects: what it holds at its peak, for one number of cases and for four
times as many.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT, TOYS
from tests.sweep.toys import TEXT

CASES, SECONDS, MEGABYTES = 100_000, 30.0, 1000.0
FEW, MANY, GROWTH = 1_000, 4_000, 10.0  # cases to run, and kB that one more may take

_PLAN = """
import json, resource, sys, time
begin = time.perf_counter()
from sweep.prepared import prepare
cases = len(prepare(sys.argv[1], sys.argv[2], table=sys.argv[3]).plan.cases)
seconds = time.perf_counter() - begin
print(json.dumps([cases, seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3]))
"""
_RUN = """
import json, resource, sys, time
begin = time.perf_counter()
from sweep.engine import run_study
done = run_study(sys.argv[1], results=sys.argv[2], table=sys.argv[3], figures=False)
seconds = time.perf_counter() - begin
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
print(json.dumps([done.cases - done.failed, seconds, peak]))
"""


def run() -> Result:
    """Plan many cases; run a few and four times as many."""
    folder = results_folder() / "many"
    folder.mkdir()
    cases, seconds, peak = measured(_PLAN, study(folder, CASES), folder / "planned")
    lines = [f"plan {cases} cases: {seconds:.1f} s, peak {peak:.0f} MB"]
    peaks = []
    for count in (FEW, MANY):
        done, spent, held = measured(_RUN, study(folder, count), folder / "run")
        peaks.append(held)
        lines.append(f"run {done} cases: {spent:.1f} s, peak of the main process {held:.0f} MB")
    each = (peaks[1] - peaks[0]) * 1e3 / (MANY - FEW)
    lines.append(
        f"{each:.1f} kB for one case more: {CASES} would take about "
        f"{peaks[1] + each * (CASES - MANY) / 1e3:.0f} MB"
    )
    holds = cases == CASES and seconds < SECONDS and peak < MEGABYTES and each < GROWTH
    return Result(
        f"{seconds:.1f} s, {peak:.0f} MB; {each:.1f} kB more for one case more",
        f"< {SECONDS:g} s, < {MEGABYTES:g} MB; < {GROWTH:g} kB",
        holds,
        "\n".join(lines),
    )


def study(folder: Path, cases: int) -> Path:
    """Write a study of so many trivial cases, over two axes."""
    vary = (
        f"vary:\n  rate: {{parameter: wells.producer.rate, from: 1 m3/s, to: 2 m3/s, "
        f"count: {cases // 10}}}\n  xx: {{parameter: stress.xx, from: 1 MPa, to: 2 MPa, count: 10}}"
    )
    path = folder / f"many-{cases}.yaml"
    path.write_text(TEXT.format(name=f"many-{cases}", seconds=1e-9, vary=vary, limits=""))
    return path


def measured(code: str, path: Path, results: Path) -> tuple[int, float, float]:
    """Cases, seconds and peak MB of a process of its own."""
    command = [sys.executable, "-c", code, str(path), str(results), TOYS]
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    cases, seconds, peak = json.loads(done.stdout)
    return cases, seconds, peak
