"""A transient of a million domains over eight decades costs a few steady solutions.

Each size runs in a process of its own, which is handed the flow equation in a file, so that
its largest memory is that of the solver, the equation and the libraries.
"""

from __future__ import annotations

import json
import math
import pickle
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from demflow.model.flow.equation.problem import Problem
from demflow.model.flow.linear.factor import analyse, factorise, solve
from demflow.model.flow.solvers.registry import SOLVERS
from tests.benchmarks.result import Result
from tests.diffusion import relative_error, well_pressure, well_problem

DOMAINS = (100_000, 1_000_000)
TOLERANCE, EXACT = 1e-4, 1e-7
MEMORY, STEADY, EXPONENT = 2.0, 6.0, 1.5
ROOT = Path(__file__).parents[2]


def steady_seconds(problem: Problem) -> float:
    """Time to order, factor and solve the steady equation once, s."""
    system = problem.system
    start = time.perf_counter()
    symbolic = analyse(system.n, system.edge_i, system.edge_j)
    solve(factorise(symbolic, system.edge_g, system.excess), system.source(1))
    return time.perf_counter() - start


def peak_gigabytes() -> float:
    """Largest memory of this process; unlike that of `resource`, not of whom it came from."""
    status = Path("/proc/self/status").read_text()
    return float(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e9


def child(path: str, work: str) -> None:
    """In a process of its own: print what one run took and found."""
    warm = well_problem(300)
    SOLVERS["krylov"].run(warm)  # loads the kernels
    problem: Problem = pickle.loads(Path(path).read_bytes())
    if work == "steady":
        print(json.dumps({"seconds": steady_seconds(problem)}))
        return
    start = time.perf_counter()
    answer = SOLVERS["krylov"].run(problem._replace(tolerance=float(work)))
    took = time.perf_counter() - start
    found = {"seconds": took, "gigabytes": peak_gigabytes(), "work": answer.work}
    print(json.dumps(found | {"pressure": well_pressure(answer).tolist()}))


def in_child(path: Path, work: str) -> dict:
    """What `child` printed."""
    call = [sys.executable, "-m", "tests.benchmarks.transient_of_a_million_domains"]
    told = subprocess.run([*call, str(path), work], check=True, capture_output=True, cwd=ROOT)
    return json.loads(told.stdout)


def run() -> Result:
    """Memory, error and time, beside one steady solution, and how the time grows."""
    lines, rows = [], []
    with tempfile.TemporaryDirectory() as folder:
        for domains in DOMAINS:
            path = Path(folder) / "problem"
            path.write_bytes(pickle.dumps(well_problem(domains)))
            steady = in_child(path, "steady")
            asked = in_child(path, f"{TOLERANCE}")
            exact = in_child(path, f"{EXACT}")
            error = relative_error(np.array(asked["pressure"]), np.array(exact["pressure"]))
            rows.append((domains, asked["seconds"], steady["seconds"], asked["gigabytes"], error))
            lines.append(
                f"{domains} domains: {asked['seconds']:.2f} s, {asked['gigabytes']:.2f} GB, "
                f"{asked['work']} factors and solves, error {error:.1e} against tolerance "
                f"{EXACT:.0e} ({exact['seconds']:.2f} s); steady {steady['seconds']:.2f} s"
            )
    (few, quick, *_), (many, slow, steady_time, memory, error) = rows
    exponent = math.log(slow / quick) / math.log(many / few)
    ratio = slow / steady_time
    return Result(
        f"{memory:.2f} GB, error {error:.1e}, {ratio:.1f} steady solutions, "
        f"time grows with the power {exponent:.2f}",
        f"≤ {MEMORY:g} GB, ≤ 1e-4, ≤ {STEADY:g}, ≤ {EXPONENT:g}",
        bool(memory <= MEMORY and error <= 1e-4 and ratio <= STEADY and exponent <= EXPONENT),
        "\n".join(lines),
    )


if __name__ == "__main__":
    child(*sys.argv[1:])
