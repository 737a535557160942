"""Worker processes of this machine."""

from __future__ import annotations

import asyncio
import logging
import math
import os
import signal
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import dask
from distributed import Client, LocalCluster, Nanny
from distributed.core import Status as ServerStatus
from distributed.security import Security

from demflow.sweep.errors import RunError
from demflow.sweep.execution import certificate
from demflow.sweep.execution.pool import Pool

START_ATTEMPTS, START_SECONDS = 6, 20.0  # to start a first worker, where they end by themselves
KILLED_SECONDS = 120.0  # and where something kills them as they start
HUNG_SECONDS = 60.0  # without any after which those that are starting are ended, for others

# One thread per worker, whatever library it comes from; one heap, and code without the columns of
# its lines, which saves memory. Set before the workers start.
THREADS = "NUMBA_NUM", "OMP_NUM", "OPENBLAS_NUM", "MKL_NUM", "VECLIB_MAXIMUM"
ONE_THREAD = {f"{name}_THREADS": "1" for name in THREADS}
ENVIRONMENT = ONE_THREAD | {"MALLOC_ARENA_MAX": "1", "PYTHONNODEBUGRANGES": "1"}

SETTINGS: dict[str, Any] = {
    # a death is ours to judge: Dask must neither retry nor blame, nor take a worker that is
    # kept from answering by compiled code for a dead one
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-ttl": None,
    # a nanny whose worker is being started anew must not be given up
    "distributed.deploy.lost-worker-timeout": "1000 days",
    "distributed.comm.timeouts.connect": "30s",
    "distributed.worker.multiprocessing-method": "spawn",
    "distributed.nanny.pre-spawn-environ": ENVIRONMENT,
    # a worker is ended at its limit of memory, not before; nothing is moved to the disk
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 1.0,
    # Dask watches itself: by default a thread in every process looks a hundred times a second
    # at what the others are doing. Nobody asks for that here, and it took 5 % of two cores. Nor
    # is there anything to move between workers, and no page that anyone on this machine may read.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.admin.low-level-log-length": 0,  # every message, held for who looks for faults
    "distributed.scheduler.work-stealing": False,
    "distributed.scheduler.active-memory-manager.start": False,
    **{f"distributed.{part}.http.routes": [] for part in ("scheduler", "worker", "nanny")},
}


class LocalPool(Pool):
    """Worker processes of this machine, listening on the loopback, for holders of a key alone.

    One stands from the beginning, the others once they have something to do: to start one costs
    more than a second of processor.

    Parameters
    ----------
    workers : their number at most.
    memory : bytes at which one is ended, None: no limit.
    """

    shares_store = True
    patience = 120.0
    look_every = 0.2

    def __init__(self, workers: int, memory: float | None = None):
        super().__init__()
        self.parent = os.getpid()
        self.workers, self.memory = workers, memory
        self._wanted = 1
        self._started = False  # whether a worker ever stood
        self._begin = self._seen = time.monotonic()
        self._failures = 0  # to start one, before that, which nobody killed
        self.cluster: Any = None

    async def __aenter__(self) -> LocalPool:
        self._config = dask.config.set(SETTINGS)
        self._foreign = ENVIRONMENT.keys() - os.environ.keys()  # Dask's nannies set it here, too
        try:
            # other users of the machine may reach the ports, and nothing behind them
            security = _security(*certificate.made())
            self.cluster = await LocalCluster(
                n_workers=0,
                threads_per_worker=1,
                worker_class=_Nanny,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=math.ceil(self.memory or 0),
                security=security,
                silence_logs=logging.CRITICAL,
                asynchronous=True,
            )
            self.client = await Client(self.cluster, set_as_default=False, asynchronous=True)
            self.cluster.scale(self._wanted)
        except BaseException:
            await self.__aexit__()
            raise
        return self

    async def look(self) -> Mapping[str, Mapping[str, Any]]:
        """Workers that are there. Raises RunError where none can be started."""
        found: Mapping[str, Mapping[str, Any]]
        found = self.cluster.scheduler.identity()["workers"]
        self._started = self._started or bool(found)
        if found or time.monotonic() - self._seen > HUNG_SECONDS:
            self._seen = time.monotonic()
            if not found:
                self._kill_all()
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
        code = min(self.cluster.workers[name].exit_code for name in fallen)
        self._failures += code >= 0
        tried = time.monotonic() - self._begin
        if tried > START_SECONDS and not self._started and self._failures >= START_ATTEMPTS:
            raise RunError(
                "the worker processes did not start; a script has to call sweep.run below "
                "`if __name__ == '__main__':`"
            )
        if tried > KILLED_SECONDS and not self._started and code < 0:
            raise RunError(
                f"the worker processes were killed as they started, by signal {-code}, again and "
                f"again for {KILLED_SECONDS:g} s; most often memory ran out"
            )
        for name in fallen:
            self.cluster.worker_spec.pop(name, None)
            # the next may get the same name, and would count as there already
            self.cluster.workers.pop(name, None)
        self.cluster.scale(self._wanted)

    def ask_for(self, workers: int) -> None:
        """Start further ones, as long as they are not all there."""
        if self._wanted < min(workers, self.workers):
            self._wanted = min(workers, self.workers)
            self.cluster.scale(self._wanted)

    def kill(self, address: str) -> None:
        """End a worker process at once; its nanny starts another."""
        for nanny in self._nannies():
            if nanny.worker_address == address:
                _kill(nanny)

    async def __aexit__(self, *error: object) -> None:
        # without leave-taking, which costs each half a second of its processor
        if hasattr(self, "client"):  # an interrupted start may have left only the cluster
            await self._hang_up()
        for nanny in self._nannies():
            if nanny.worker_address:
                nanny.close_gracefully()  # no other worker follows
                _kill(nanny)
        leaving = asyncio.ensure_future(self._leave())
        for patience in (1.0, 2.0, 4.0, 8.0):
            await asyncio.wait({leaving}, timeout=patience)
            if leaving.done():
                break
            self._kill_all()  # they know by now that we leave, and start no others
        for name in self._foreign:
            os.environ.pop(name, None)
        self._config.__exit__(None, None, None)

    async def _leave(self) -> None:
        if self.cluster:
            # a scheduler that has not seen the workers go would write to them
            patience = time.monotonic() + 1.0
            while self.cluster.scheduler.workers and time.monotonic() < patience:
                await asyncio.sleep(0.01)
            await self.cluster.close(timeout=20)

    def _nannies(self) -> list[Any]:
        """Those whose worker is still starting too, of which the cluster does not know yet."""
        own = self.cluster.scheduler_address if self.cluster else None
        return [nanny for nanny in Nanny._instances if nanny.scheduler_addr == own]

    def _kill_all(self) -> None:
        for nanny in self._nannies():
            _kill(nanny)


def _security(made: str, key: str) -> Security:
    """What lets processes that were given it connect to each other, and nobody else.

    Certificate and key go from memory to memory, but for a moment: OpenSSL reads files alone, for
    which Dask makes a folder that nobody else may enter, and removes it at once.
    """
    files = {"tls_ca_file": made}
    for role in ("client", "scheduler", "worker"):
        files |= {f"tls_{role}_cert": made, f"tls_{role}_key": key}
    return Security(require_encryption=True, **files)


class _Nanny(Nanny):
    """One that remembers how its worker process ended."""

    exit_code = 0  # below zero: minus the signal

    def _on_worker_exit_sync(self, exitcode: int) -> None:
        self.exit_code = exitcode
        super()._on_worker_exit_sync(exitcode)  # type: ignore[no-untyped-call]


def _kill(nanny: Any) -> None:
    with suppress(ProcessLookupError):
        if nanny.pid:
            os.kill(nanny.pid, signal.SIGKILL)
