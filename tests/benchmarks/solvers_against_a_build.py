"""What krylov and implicit cost for being held to their tolerance, against another build.

On the problems of the check `auto_against_best`, by the build that lies at `DEMFLOW_BASE` and by
this one: two processes that stay, asked in turns, processor time of one thread. A problem that
takes `implicit` longer than PATIENCE in this build is left out for it.
"""

from __future__ import annotations

import itertools
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.benchmarks import auto_against_best as asked
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT
from tests.diffusion import well_problem

METHODS, BOUND = ("krylov", "implicit"), 1.15
DOMAINS = tuple(int(n) for n in os.environ.get("DOMAINS", "1000 8000 40000").split())
TURNS, PATIENCE = 5, 3.0  # runs of each build for a problem; s

# one build: a line in names a problem, a line out is the processor time it took; the flow equation
# comes from a file, so that both builds solve the same one
_SERVER = """
import sys, time
import numpy as np
from tests.benchmarks.auto_against_best import SOLVERS, case, outputs
from tests.diffusion import seconds, well_problem
plain, before, runs = None, None, {}
for line in sys.stdin:
    file, first, decades, tolerance, kind, method = line.split()
    if file != before:
        before, plain = file, well_problem(100)
        system = type(plain.system)(**np.load(file))
        scalars = {k: v.item() for k, v in system._asdict().items() if not v.ndim}
        system = system._replace(**scalars)
        records = outputs(system, np.empty(0, dtype=np.int64))
        plain = plain._replace(system=system, records=records)
    if line not in runs:
        runs.clear()
        problem = case(plain, kind, float(first), float(decades), float(tolerance))
        runs[line] = lambda run=SOLVERS[method].run, problem=problem: run(problem)
        runs[line]()
    print(seconds(runs[line], 1, time.process_time), flush=True)
"""


class Build:
    """A process of one build that solves what it is asked."""

    def __init__(self, root: Path) -> None:
        one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(root)}
        self._process = subprocess.Popen(
            [sys.executable, "-c", _SERVER],
            cwd=root,
            env={**os.environ, **one},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def took(self, problem: str) -> float:
        """Processor time of one run, s."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{problem}\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())

    def end(self) -> None:
        """Let the process go."""
        self._process.communicate()


def problems() -> Iterator[str]:
    """The problems of `auto_against_best`, a line each."""
    for domains in DOMAINS:
        file = results_folder() / f"{domains}.npz"
        if not file.exists():
            np.savez(file, **well_problem(domains).system._asdict())
        each = list(itertools.product(asked.WINDOWS, asked.TOLERANCES, asked.KINDS))
        if domains < asked.DOMAINS[-1]:
            each += itertools.product(asked.WINDOWS[:2], asked.TOLERANCES, asked.FIELDS)
        for (first, decades), tolerance, kind in each:
            yield f"{file} {first} {decades} {tolerance} {kind}"


def run() -> Result:
    """Time of each problem by both builds, of each solver."""
    base = os.environ.get("DEMFLOW_BASE")
    if base is None:
        return Result("no build to compare with (DEMFLOW_BASE)", f"≤ {BOUND:g}", False)
    builds = Build(Path(base)), Build(ROOT)
    lines, figures, worst = [], [], 0.0
    for method in METHODS:
        took = []
        for problem in problems():
            if builds[1].took(f"{problem} {method}") > PATIENCE:
                continue
            turns = [[b.took(f"{problem} {method}") for b in builds] for _ in range(TURNS)]
            before, now = (statistics.median(each) for each in zip(*turns, strict=True))
            took.append((before, now))
            lines.append(f"{method} {Path(problem).name}: {1e3 * before:.1f}, {1e3 * now:.1f} ms")
        both = np.array(took)
        ratio = both[:, 1] / both[:, 0]
        middle, total = float(np.median(ratio)), float(both[:, 1].sum() / both[:, 0].sum())
        worst = max(worst, middle, total)
        figures.append(f"{method} {middle:.2f} in the median of {len(ratio)}, {total:.2f} in total")
        spread = np.percentile(ratio, (5, 25, 75, 95))
        lines.append(f"{method}: 5, 25, 75, 95 %: " + ", ".join(f"{r:.2f}" for r in spread))
    for build in builds:
        build.end()
    return Result("; ".join(figures), f"≤ {BOUND:g} both", worst <= BOUND, "\n".join(lines))
