"""Where the jobs of a run go: worker processes of this machine, or a Dask cluster.

`sweep.execute` decides what runs where and when; a pool starts the workers or finds
them, carries one job at a time to a worker of its choice, and ends it when told to.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from typing import Any, Protocol

import dask
import psutil
from distributed import Client, Future, LocalCluster
from distributed.core import Status as ServerStatus
from distributed.security import Security

START_ATTEMPTS = 6  # to start a first worker, should it be killed meanwhile
CONNECT_SECONDS = 10  # s to wait for a scheduler that was named

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


class RunError(RuntimeError):
    """The run as a whole cannot go on; what was finished is stored."""


class SchedulerError(RunError):
    """The workers that were named cannot be used; nothing was run."""


class Pool(Protocol):
    """Workers, wherever they are."""

    shares_store: bool  # whether they see the client's store; products travel otherwise
    parent: int | None  # process with which they end; None: they were there before

    def addresses(self) -> set[str]:
        """Workers that are there."""

    def unfit(self, address: str) -> str | None:
        """Why a worker must not be sent a job, None where it may."""

    def submit(
        self, address: str, function: Callable[[Any], Any], argument: Any, key: str
    ) -> Future:
        """Have a worker call a function."""

    def listen(self, topic: str, heard: Callable[[str, dict[str, Any]], None]) -> None:
        """Have a function called with the address and words of workers that tell something."""

    def kill(self, address: str) -> None:
        """End a worker, whatever it is doing; another takes its place."""

    def memory(self, address: str) -> float:
        """Resident memory of a worker in bytes, 0 where it cannot be seen."""

    def close(self) -> None:
        """Leave no process and no connection behind."""


class LocalPool:
    """Worker processes of this machine, listening on the loopback alone."""

    shares_store = True

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
            }
        )
        try:
            with _signals_kept_for_later():
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
        self.cluster.scale(self.workers)

    def unfit(self, address: str) -> str | None:
        """All are as they were started."""
        return None

    def submit(
        self, address: str, function: Callable[[Any], Any], argument: Any, key: str
    ) -> Future:
        """Have a worker call a function."""
        return _submit(self.client, address, function, argument, key)

    def listen(self, topic: str, heard: Callable[[str, dict[str, Any]], None]) -> None:
        """Have a function called with the address and words of workers that tell something."""
        _listen(self.client, topic, heard)

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


class RemotePool:
    """Workers of a Dask cluster that runs already, wherever they are."""

    shares_store = False
    parent: int | None = None

    def __init__(self, scheduler: str):
        # a parent product may be large, and is meant to travel
        self._config = dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"})
        self.scheduler = scheduler
        for name in ("distributed", "distributed.client", "distributed.batched"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters is said here
        try:
            security = _security(scheduler)
            self.client = Client(
                scheduler, timeout=CONNECT_SECONDS, set_as_default=False, security=security
            )
        except SchedulerError:
            self._config.__exit__(None, None, None)
            raise
        except (OSError, ValueError, TypeError) as error:
            self._config.__exit__(None, None, None)
            raise SchedulerError(f"no Dask scheduler answers at {scheduler}: {error}") from error
        self._workers: dict[str, Any] = {}
        self._asked = -float("inf")

    def addresses(self) -> set[str]:
        """Workers that are there."""
        return set(self._look())

    def unfit(self, address: str) -> str | None:
        """Why a worker must not be sent a job: it has many threads."""
        threads = self._look().get(address, {}).get("nthreads", 1)
        if threads == 1:
            return None
        return (
            f"the worker {address} has {threads} threads; "
            "start each with `dask worker --nthreads 1`, and more of them (--nworkers)"
        )

    def _look(self) -> dict[str, Any]:
        """What the scheduler knows of its workers; asked for once a second."""
        if time.monotonic() - self._asked > 1.0:
            try:
                self._workers = dict(self.client.scheduler_info(n_workers=-1)["workers"])
            except (OSError, TimeoutError, KeyError) as error:  # KeyError: the client gave up
                raise RunError(
                    f"the scheduler {self.scheduler} answers no longer; what was finished is kept"
                ) from error
            self._asked = time.monotonic()
        return self._workers

    def submit(
        self, address: str, function: Callable[[Any], Any], argument: Any, key: str
    ) -> Future:
        """Have a worker call a function."""
        return _submit(self.client, address, function, argument, key)

    def listen(self, topic: str, heard: Callable[[str, dict[str, Any]], None]) -> None:
        """Have a function called with the address and words of workers that tell something."""
        _listen(self.client, topic, heard)

    def kill(self, address: str) -> None:
        """Have the worker's nanny start it anew; without a nanny it is left to itself."""
        with suppress(ValueError, OSError, TimeoutError):
            self.client.restart_workers([address], timeout=30, raise_for_error=False)

    def memory(self, address: str) -> float:
        """Resident memory of a worker as it told its scheduler last, bytes."""
        worker = self._look().get(address, {})
        return float(worker.get("metrics", {}).get("memory", 0.0))

    def close(self) -> None:
        """Leave the cluster as it was found."""
        self.client.close(timeout=10)
        self._config.__exit__(None, None, None)


def _cluster() -> LocalCluster:
    """A scheduler on the loopback that has no workers yet."""
    # the loop reports here what is judged in `_replace_fallen`
    logging.getLogger("tornado.application").setLevel(logging.CRITICAL)
    return LocalCluster(
        n_workers=0,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=0,  # watched here, so that it can be said who took it
        silence_logs=logging.CRITICAL,
    )


def _security(scheduler: str) -> Security:
    """Certificates from Dask's configuration. Raises SchedulerError where they are needed."""
    security = Security()
    if not scheduler.startswith("tls://"):
        return security
    names = ("tls_ca_file", "tls_client_cert", "tls_client_key")
    files = {n: getattr(security, n) for n in names}
    missing = [n for n, file in files.items() if file is None]
    if not missing:
        try:
            security.get_connection_args("client")
            return security
        except OSError as error:  # also of a file that is no certificate
            given = ", ".join(map(str, files.values()))
            raise SchedulerError(
                f"{scheduler}: the certificates cannot be used: {error} ({given})"
            ) from error
    wanted = ", ".join(
        "DASK_DISTRIBUTED__COMM__TLS__" + n[4:].upper().replace("CLIENT_", "CLIENT__")
        for n in missing
    )
    raise SchedulerError(f"{scheduler} needs certificates: set {wanted}, or Dask's configuration")


def _submit(
    client: Client, address: str, function: Callable[[Any], Any], argument: Any, key: str
) -> Future:
    return client.submit(
        function,
        argument,
        key=key,
        workers=[address],
        allow_other_workers=False,
        pure=False,
        retries=0,
    )


def _listen(client: Client, topic: str, heard: Callable[[str, dict[str, Any]], None]) -> None:
    # the scheduler adds who said it
    client.subscribe_topic(topic, lambda event: heard(event[1]["worker"], event[1]))


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


@contextmanager
def _signals_kept_for_later() -> Iterator[None]:
    """Start processes that do not hear Ctrl-C, and hear it oneself only once they stand.

    A terminal sends it to every process in the foreground; it is for this one, which
    then ends the others. Threads and processes started here inherit the mask, also those
    that a nanny starts later.
    """
    # multiprocessing's tracker unblocks the signal in the thread that starts it: start it now
    resource_tracker.ensure_running()
    caught: list[int] = []
    handlers = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            handlers[number] = signal.signal(number, lambda n, _: caught.append(n))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for heard in caught:
            signal.raise_signal(heard)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let no second Ctrl-C stop what cleans up after the first."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.signal(s, signal.SIG_IGN) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
