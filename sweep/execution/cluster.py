"""Workers of a Dask cluster that runs already, wherever they are."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import dask
from distributed import Client, Future
from distributed.comm.addressing import parse_address, parse_host_port
from distributed.core import rpc
from distributed.security import Security

from demflow.sweep.errors import RunError, SchedulerError
from demflow.sweep.execution.pool import Pool

CONNECT_SECONDS = 10.0  # s to wait for a scheduler that was named
STOPPED_SECONDS = 120.0  # s without an answer after which a scheduler counts as gone
RESTART_SECONDS = 10.0  # s in which nannies are to end the workers that must go, and start others
WISHES = 10  # tasks of Dask's expected half second for which it takes one worker, in its 5 s
ASKED_AT_MOST = 100  # workers


class RemotePool(Pool):
    """Workers of a Dask cluster that runs already, wherever they are."""

    shares_store = False
    patience = math.inf  # they may stand in a queue
    look_every = 1.0

    def __init__(self, scheduler: str):
        super().__init__()
        self.scheduler = scheduler
        self._restarts: set[asyncio.Task[None]] = set()
        self._wishes: list[Future[Any]] = []

    async def __aenter__(self) -> RemotePool:
        # a parent product may be large, and is meant to travel
        self._config = dask.config.set({"distributed.admin.large-graph-warning-threshold": "1TB"})
        try:
            _check_address(self.scheduler)
            security = _security(self.scheduler)
            async with asyncio.timeout(CONNECT_SECONDS):
                await self._connect(security)
        except BaseException as error:
            self._config.__exit__(None, None, None)
            if isinstance(error, OSError | ValueError | TypeError):  # a TimeoutError too
                why = str(error) or f"nothing of the kind within {CONNECT_SECONDS:g} s"
                raise SchedulerError(
                    f"no Dask scheduler answers at {self.scheduler}: {why}"
                ) from error
            raise
        return self

    async def _connect(self, security: Security) -> None:
        async with rpc(
            self.scheduler, connection_args=security.get_connection_args("client")
        ) as there:
            found = (await there.identity())["type"]
        if not found.endswith("Scheduler"):
            raise ValueError(f"it is a {found}; name the address that its scheduler tells")
        self.client = await Client(
            self.scheduler,
            timeout=CONNECT_SECONDS,
            set_as_default=False,
            security=security,
            asynchronous=True,
        )

    async def look(self) -> Mapping[str, Mapping[str, Any]]:
        """What the scheduler knows of its workers."""
        scheduler: Any = self.client.scheduler
        try:
            async with asyncio.timeout(STOPPED_SECONDS):
                return dict((await scheduler.identity(n_workers=-1))["workers"])
        except TimeoutError:
            why = f"has not answered for {STOPPED_SECONDS:g} s"
        except (OSError, KeyError, AttributeError):  # the last two: the client gave up
            why = "answers no longer"
        raise RunError(f"the scheduler {self.scheduler} {why}; what was finished is kept")

    def kill(self, address: str) -> None:
        """Have the worker's nanny start it anew, which nobody waits for."""
        self._restarts.add(asyncio.ensure_future(self._restart(address)))

    async def _restart(self, address: str) -> None:
        with suppress(Exception):  # it has gone already, or its nanny, or the scheduler
            restarting = self.client.restart_workers(
                [address], timeout=RESTART_SECONDS, raise_for_error=False
            )
            await restarting

    def ask_for(self, workers: int) -> None:
        """Have tasks wait, which is what an adaptive cluster counts, for a kind of worker unknown.

        Lots are sent to workers that are there already.
        """
        count = WISHES * min(workers, ASKED_AT_MOST)
        del self._wishes[count:]
        for number in range(len(self._wishes), count):
            key = f"{self.name}-wish-{number}"
            wish = self.client.submit(str, key=key, resources={"demflow-wish": 1}, pure=False)
            self._wishes.append(wish)

    async def __aexit__(self, *error: object) -> None:
        self._wishes.clear()
        if self._restarts:
            await asyncio.wait(self._restarts, timeout=RESTART_SECONDS)
        await self._hang_up()
        self._config.__exit__(None, None, None)


def _check_address(scheduler: str) -> None:
    """Raise SchedulerError for what cannot be the address of a scheduler."""
    try:
        scheme, rest = parse_address(scheduler, strict=True)
        host, port = parse_host_port(rest)
        if scheme in ("tcp", "tls", "ws", "wss", "ucx") and host and port:
            return
    except ValueError:
        pass
    raise SchedulerError(
        f"no Dask scheduler answers at {scheduler or repr(scheduler)}, which is no address; "
        "write it as tcp://HOST:PORT or tls://HOST:PORT"
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
