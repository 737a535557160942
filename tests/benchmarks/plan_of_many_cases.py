"""`demflow plan` of 100,000 trivial cases takes under 30 s and 1 GB; a run, little memory a case.

The second part runs some ten thousand cases from start to dataset, and looks at the process that
plans, hands out and collects: what it holds at its peak, for one number of cases and for four
times as many. Of the larger number, `demflow plan` foretells the memory after the smaller.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT
from tests.sweep.toys import TEXT

CASES, SECONDS, MEGABYTES = 100_000, 30.0, 1000.0
FEW, MANY, GROWTH = 10_000, 40_000, 10.0  # cases to run, and kB that one more may take
DOUBT = 2.0  # factor by which the memory that was foretold may be off

# what the command line does, on the toys' table of stages
_PLAN = """
import contextlib, io, json, resource, sys
from tests.sweep import toys
with contextlib.redirect_stdout(io.StringIO()) as out:
    assert toys.demflow("plan", sys.argv[1], "--results", sys.argv[2], "--json") == 0
told = json.loads(out.getvalue())
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
print(json.dumps([told["cases"], peak, (told["memory"] or 0.0) / 1e6]))
"""
_RUN = """
import json, resource, sys
from demflow.sweep.engine import run_study
from demflow.sweep.prepared import prepare
from tests.sweep import toys
done = run_study(sys.argv[1], results=sys.argv[2], table=toys.TABLE, figures=False)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
costs = prepare(sys.argv[1], sys.argv[2], table=toys.TABLE).costs()
worker = max(spent.peak for sizes in costs.known.values() for spent in sizes.values())
print(json.dumps([done.cases - done.failed, peak, peak + 2 * worker / 1e6]))
"""


def run() -> Result:
    """Plan many cases; run a few and four times as many."""
    folder = results_folder() / "many"
    folder.mkdir()
    seconds, cases, peak, _ = measured(_PLAN, study(folder, CASES), folder / "planned")
    lines = [f"demflow plan of {cases} cases: {seconds:.1f} s, peak {peak:.0f} MB"]
    peaks, foretold, held = [], 0.0, 0.0
    for count in (FEW, MANY):
        if count == MANY:
            foretold = measured(_PLAN, study(folder, count), folder / "run")[-1]
        spent, done, main, held = measured(_RUN, study(folder, count), folder / "run")
        peaks.append(main)
        lines.append(f"run {done} cases: {spent:.1f} s, peak of the main process {main:.0f} MB")
    lines.append(f"memory of {MANY} cases on 2 workers: {foretold:.0f} MB foretold, {held:.0f} MB")
    each = (peaks[1] - peaks[0]) * 1e3 / (MANY - FEW)
    lines.append(
        f"{each:.1f} kB for one case more: {CASES} would take about "
        f"{peaks[1] + each * (CASES - MANY) / 1e3:.0f} MB"
    )
    off = max(foretold / held, held / max(foretold, 1.0))
    holds = cases == CASES and seconds < SECONDS and peak < MEGABYTES and each < GROWTH
    holds = holds and off < DOUBT
    return Result(
        f"{seconds:.1f} s, {peak:.0f} MB; {each:.1f} kB more for one case more; "
        f"memory foretold within a factor {off:.2f}",
        f"< {SECONDS:g} s, < {MEGABYTES:g} MB; < {GROWTH:g} kB; {DOUBT:g}",
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


def measured(code: str, path: Path, results: Path) -> tuple[float, int, float, float]:
    """Seconds of a process of its own, start included; cases, peak MB and MB as it prints them."""
    command = [sys.executable, "-c", code, str(path), str(results)]
    begin = time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    seconds = time.perf_counter() - begin
    cases, peak, memory = json.loads(done.stdout)
    return seconds, cases, peak, memory
