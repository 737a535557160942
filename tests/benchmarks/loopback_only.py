"""A run listens on the loopback address alone; with a scheduler named, on nothing at all."""

from __future__ import annotations

import subprocess
import sys
import time

import psutil

from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result
from tests.sweep.clusters import dask_cluster

LOOPBACK = ("127.", "::1")


def listening(pid: int) -> set[str]:
    """Addresses on which a process and its children listen."""
    found = set()
    try:
        family = [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
    except psutil.NoSuchProcess:
        return found
    for process in family:
        try:
            sockets = process.net_connections(kind="inet")
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue
        found |= {s.laddr.ip for s in sockets if s.status == psutil.CONN_LISTEN}
    return found


def watched(name: str, *options: str) -> tuple[set[str], int]:
    """Addresses on which a run and its workers listen until it ends, and its exit status."""
    command = [
        sys.executable,
        "-m",
        "demflow",
        "run",
        str(STUDIES / "quickstart.yaml"),
    ]
    run_process = subprocess.Popen(
        [*command, *options, "--results", str(results_folder() / f"sockets_{name}")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    seen: set[str] = set()
    while run_process.poll() is None:
        seen |= listening(run_process.pid)
        time.sleep(0.05)
    return seen, run_process.returncode


def run() -> Result:
    """Watch every listening socket of a run, its scheduler, dashboard and workers."""
    seen, status = watched("local", "--workers", "2")
    with dask_cluster(results_folder() / "sockets_cluster") as cluster:
        there, status_there = watched("there", "--scheduler", cluster.address)
    beyond = {address for address in seen if not address.startswith(LOOPBACK)}
    lines = [
        f"{STUDIES.name}/quickstart.yaml on 2 workers of its own: exit status {status}, "
        f"listened on {sorted(seen)}",
        f"on a cluster at {cluster.address}: exit status {status_there}, listened on "
        f"{sorted(there)}; looked at every 50 ms, the run and all its children",
    ]
    return Result(
        f"listened on {', '.join(sorted(seen)) or 'nothing'}; "
        f"with a cluster named, on {', '.join(sorted(there)) or 'nothing'}",
        "loopback only; nothing",
        bool(seen) and not beyond and not there and status == status_there == 0,
        "\n".join(lines),
    )
