"""Workers of a Dask cluster that runs already, wherever they are."""

from __future__ import annotations

import math
import threading
import time
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import Any

import dask
from distributed import Client
from distributed.security import Security

from demflow.sweep.errors import RunError, SchedulerError
from demflow.sweep.execution.pool import Pool

CONNECT_SECONDS = 10  # s to wait for a scheduler that was named
RESTART_SECONDS = 10.0  # s in which nannies are to end the workers that must go, and start others


class RemotePool(Pool):
    """Workers of a Dask cluster that runs already, wherever they are."""

    shares_store = False
    patience = math.inf  # they may stand in a queue
    parent: int | None = None

    def __init__(self, scheduler: str):
        # a parent product may be large, and is meant to travel
        self._config = dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"})
        self.scheduler = scheduler
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
        self._restarts: list[threading.Thread] = []

    def addresses(self) -> set[str]:
        """Workers that are there."""
        return set(self._look())

    def unfit(self, address: str) -> str | None:
        """Why a worker must not be sent a job: it has many threads, or nobody to end it."""
        worker = self._look().get(address, {})
        if (threads := worker.get("nthreads", 1)) != 1:
            return (
                f"the worker {address} has {threads} threads; "
                "start each with `dask worker --nthreads 1`, and more of them (--nworkers)"
            )
        if worker and worker.get("nanny") is None:
            return (
                f"the worker {address} has no nanny, which ends a case at its limits and starts "
                "the next worker; leave out `--no-nanny`"
            )
        return None

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

    def kill(self, address: str) -> None:
        """Have the worker's nanny start it anew; without a nanny it is left to itself.

        That takes as long as its successor needs to stand: nobody waits for it here.
        """
        restart = threading.Thread(target=self._restart, args=(address,), daemon=True)
        restart.start()
        self._restarts.append(restart)

    def _restart(self, address: str) -> None:
        with suppress(ValueError, OSError, TimeoutError, CancelledError):
            self.client.restart_workers([address], timeout=RESTART_SECONDS, raise_for_error=False)

    def memory(self, address: str) -> float:
        """Resident memory of a worker as it told its scheduler last, bytes."""
        worker = self._look().get(address, {})
        return float(worker.get("metrics", {}).get("memory", 0.0))

    def close(self) -> None:
        """Leave the cluster as it was found, its workers ended that were told to."""
        patience = time.monotonic() + RESTART_SECONDS
        for restart in self._restarts:
            restart.join(max(0.0, patience - time.monotonic()))
        self.client.close(timeout=10)
        self._config.__exit__(None, None, None)


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
