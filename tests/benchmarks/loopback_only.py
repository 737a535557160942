"""A run listens on the loopback address alone."""

from __future__ import annotations

import subprocess
import sys
import time

import psutil

from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result

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


def run() -> Result:
    """Watch every listening socket of a run and its workers until it ends."""
    command = [sys.executable, "-m", "sweep.cli", "run", str(STUDIES / "quickstart.yaml")]
    run_process = subprocess.Popen(
        [*command, "--workers", "2", "--results", str(results_folder() / "sockets")],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    seen: set[str] = set()
    while run_process.poll() is None:
        seen |= listening(run_process.pid)
        time.sleep(0.05)
    beyond = {address for address in seen if not address.startswith(LOOPBACK)}
    return Result(
        f"listened on {', '.join(sorted(seen)) or 'nothing'}",
        "loopback only",
        bool(seen) and not beyond and run_process.returncode == 0,
    )
