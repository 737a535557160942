"""Worker processes of this machine."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from contextlib import suppress
from typing import Any

import dask
import psutil
from distributed import Client, LocalCluster
from distributed.core import Status as ServerStatus

from demflow.sweep.errors import RunError
from demflow.sweep.execution.pool import Pool
from demflow.sweep.execution.signals import signals_kept_for_later

START_ATTEMPTS = 6  # to start a first worker, should it be killed meanwhile

# One thread per worker, whatever library it comes from; set before the workers start.
ONE_THREAD = {
    name: "1"
    for name in (
        "NUMBA_NUM_THREADS",
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    )
}

# Dask watches itself: by default a thread in every process looks a hundred times a second at
# what the others are doing. Nobody asks for that here, and it took 5 % of two cores. Nor is
# there anything to move between workers: each is sent what it is to run.
UNWATCHED = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.scheduler.work-stealing": False,
    "distributed.scheduler.active-memory-manager.start": False,
}


class LocalPool(Pool):
    """Worker processes of this machine, listening on the loopback alone."""

    shares_store = True
    patience = 60.0

    def __init__(self, workers: int):
        self.parent: int | None = os.getpid()
        self.workers = workers
        self._started = False  # whether a worker ever stood
        self._failures = 0  # to start one, before that
        self._config = dask.config.set(
            {
                # a death is ours to judge: Dask must neither retry nor blame
                "distributed.scheduler.allowed-failures": 0,
                "distributed.worker.multiprocessing-method": "spawn",
                "distributed.nanny.pre-spawn-environ": ONE_THREAD,
                "distributed.comm.timeouts.connect": "30s",
                # a nanny whose worker is being started anew must not be given up
                "distributed.deploy.lost-worker-timeout": "1000 days",
                **UNWATCHED,
            }
        )
        try:
            with signals_kept_for_later():
                self.cluster = _cluster()
                self.client = Client(self.cluster, set_as_default=False)
            self.cluster.scale(workers)
        except BaseException:
            self.close()
            raise

    def addresses(self) -> set[str]:
        """Workers that are there. Raises RunError where none can be started."""
        found = {a for nanny in self._nannies() if (a := nanny.worker_address) is not None}
        self._started = self._started or bool(found)
        self._replace_fallen()
        return found

    def _replace_fallen(self) -> None:
        """Have others take the place of nannies that ended since their first worker did not stand.

        A nanny starts a worker anew that dies later, even while it is starting again.
        """
        over = (ServerStatus.failed, ServerStatus.closed)
        fallen = [name for name, n in list(self.cluster.workers.items()) if n.status in over]
        if not fallen:
            return
        self._failures += 1
        if not self._started and self._failures >= START_ATTEMPTS:
            raise RunError(
                "the worker processes did not start; a script has to call sweep.run below "
                "`if __name__ == '__main__':`"
            )
        for name in fallen:
            self.cluster.worker_spec.pop(name, None)
            # the next may get the same name, and would count as there already
            self.cluster.workers.pop(name, None)
        self.cluster.scale(self.workers)

    def unfit(self, address: str) -> str | None:
        """All are as they were started."""
        return None

    def kill(self, address: str) -> None:
        """End a worker process at once; its nanny starts another."""
        for nanny in self._nannies():
            if nanny.worker_address == address and nanny.pid:
                _kill(nanny.pid)

    def memory(self, address: str) -> float:
        """Resident memory of a worker process, bytes."""
        for nanny in self._nannies():
            if nanny.worker_address == address and nanny.pid:
                with suppress(psutil.Error):
                    return float(psutil.Process(nanny.pid).memory_info().rss)
        return 0.0

    def close(self) -> None:
        """End all processes: those that are busy without waiting for their work."""
        nannies = self._nannies() if hasattr(self, "cluster") else []
        closing = threading.Thread(target=self._close_politely, daemon=True)
        closing.start()
        for patience in (1.0, 2.0, 4.0, 8.0):
            closing.join(patience)
            if not closing.is_alive():
                break
            # the nannies know by now that we are closing, and start no others
            for nanny in nannies:
                if nanny.pid:
                    _kill(nanny.pid)
        self._config.__exit__(None, None, None)

    def _close_politely(self) -> None:
        # an interrupted start may have left only the first of them
        if hasattr(self, "client"):
            self.client.close(timeout=5)
        if hasattr(self, "cluster"):
            self._end_workers()
            self.cluster.close(timeout=20)

    def _end_workers(self) -> None:
        """End the workers without leave-taking, which costs each half a second of its processor.

        What they did is stored.
        """
        for nanny in self._nannies():
            if nanny.worker_address and nanny.pid:
                nanny.close_gracefully()  # no other worker follows
                _kill(nanny.pid)
        # a scheduler that has not seen them go would write to them
        patience = time.monotonic() + 1.0
        scheduler = self.cluster.scheduler
        while scheduler and scheduler.workers and time.monotonic() < patience:
            time.sleep(0.01)

    def _nannies(self) -> list[Any]:
        return list(self.cluster.workers.values())


def _cluster() -> LocalCluster:
    """A scheduler on the loopback that has no workers yet."""
    return LocalCluster(
        n_workers=0,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=0,  # watched here, so that it can be said who took it
        silence_logs=logging.CRITICAL,
    )


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
