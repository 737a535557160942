"""Worker processes of this machine, without a run."""

from __future__ import annotations

import time

import psutil
import pytest

from demflow.sweep.execution.local import LocalPool
from demflow.sweep.execution.pool import silent_loops


@pytest.fixture
def pool():
    with silent_loops():
        pool = LocalPool(2)
        yield pool
        pool.close()


def starting(known: set[int]) -> list[psutil.Process]:
    """Worker processes that were not there before."""
    found = []
    for process in psutil.Process().children(recursive=True):
        try:
            if process.pid not in known and "spawn_main" in " ".join(process.cmdline()):
                found.append(process)
        except psutil.Error:
            continue
    return found


def test_workers_killed_while_they_start_are_replaced_each_time(pool):
    killed: set[int] = set()
    patience = time.monotonic() + 60.0
    while len(pool.addresses()) < 2 and time.monotonic() < patience:
        if len(killed) < 3:
            for process in starting(killed)[:1]:
                process.kill()
                killed.add(process.pid)
        time.sleep(0.02)
    assert len(killed) == 3
    assert len(pool.addresses()) == 2
