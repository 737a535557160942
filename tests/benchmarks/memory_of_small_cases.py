"""A run of 2,000 trivial cases holds at most 120 MB in its client and 80 MB in a worker.

The largest resident memory of each process is read from the kernel, which begins to count anew
where a process starts a program. `DEMFLOW_BASE` may name the folder of another build: the same
study is run by both in turns, and neither process may hold more than its. CASES (of the
environment) is how many there are.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import psutil

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT, TOYS
from tests.sweep import toys

CASES, CLIENT, WORKER = int(os.environ.get("CASES", "2000")), 120.0, 80.0  # MB
TURNS, LOOKS = 3, 0.05  # runs of each build; s between two looks

_RUN = """
import sys
from PACKAGE.engine import run_study
run_study(sys.argv[1], results=sys.argv[2], workers=2, figures=False, table=sys.argv[3])
"""


def run() -> Result:
    """Run the study, by each build in turns."""
    folder = results_folder() / "memory"
    folder.mkdir()
    rates = tuple(float(k + 1) for k in range(CASES))
    path = toys.write_study(folder, seeds=(1,), stresses=(), rates=rates, seconds=1e-9)
    base = os.environ.get("DEMFLOW_BASE")
    builds = {"this": ROOT} | ({"base": Path(base)} if base else {})
    held: dict[str, list[tuple[float, float]]] = {name: [] for name in builds}
    for turn in range(TURNS):
        for name, root in builds.items():
            held[name].append(peaks(root, path, folder / f"{name}-{turn}"))
    found = {name: [statistics.median(p) for p in zip(*held[name], strict=True)] for name in builds}
    lines = [
        f"{CASES} cases by {name} build: client {client:.1f} MB, worker {worker:.1f} MB"
        for name, (client, worker) in found.items()
    ]
    client, worker = found["this"]
    holds, told, bound = client <= CLIENT and worker <= WORKER, "", ""
    if base:
        ratios = [now / before for now, before in zip(found["this"], found["base"], strict=True)]
        told = f"; {ratios[0]:.2f} and {ratios[1]:.2f} of the other build's"
        holds, bound = holds and max(ratios) <= 1.0, "; ≤ another build's"
    return Result(
        f"client {client:.0f} MB, worker {worker:.0f} MB{told}",
        f"≤ {CLIENT:g} and {WORKER:g} MB{bound}",
        holds,
        "\n".join(lines),
    )


def peaks(root: Path, path: Path, results: Path) -> tuple[float, float]:
    """Largest resident memory of the client and of a worker of a run, MB."""
    package = "demflow.sweep" if (root / "demflow").exists() else "sweep"
    running = subprocess.Popen(
        [sys.executable, "-c", _RUN.replace("PACKAGE", package), path, results, TOYS],
        cwd=root,
        # what compiling would hold is no part of it: after a first run the bytecode is there
        env={**os.environ, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": ""},
    )
    found: dict[int, tuple[bool, float]] = {}  # by process: whether it works, and its peak
    while running.poll() is None:
        client = psutil.Process(running.pid)
        for process in (client, *children(client)):
            try:
                works = "spawn_main" in " ".join(process.cmdline())
                status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
            except (psutil.Error, OSError):
                continue  # it has just ended
            if "VmHWM:" in status and (works or process == client):
                kilobytes = float(status.partition("VmHWM:")[2].split()[0])
                found[process.pid] = works, kilobytes * 1.024e-3
        time.sleep(LOOKS)
    if running.returncode != 0:
        raise RuntimeError(f"the run by {root} ended with status {running.returncode}")
    workers = [peak for works, peak in found.values() if works]
    return found[running.pid][1], max(workers)


def children(process: psutil.Process) -> list[psutil.Process]:
    """Processes that it has started."""
    try:
        return process.children(recursive=True)
    except psutil.Error:
        return []
