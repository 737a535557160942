"""Where the jobs of a run go: worker processes of this machine, or a Dask cluster.

`sweep.execution.loop` decides what runs where and when; a pool starts the workers or finds
them, carries one job at a time to a worker of its choice, and ends it when told to.
"""

from __future__ import annotations

import asyncio
import gc
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import Future as Answer
from contextlib import contextmanager
from typing import Any

from distributed import Client, Future

FETCH_AGAIN_SECONDS = 0.2  # s before an answer that could not be had is asked for again

_LOOPS = (
    "asyncio",
    "tornado.application",
    "distributed",
    "distributed.client",  # Dask gives these two a level of their own
    "distributed.batched",
)


@contextmanager
def silent_loops() -> Iterator[None]:
    """Keep Dask's loops from reporting dead workers: a run judges them, and tells the outcome."""
    loggers = [logging.getLogger(name) for name in _LOOPS]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        gc.collect()  # tasks that ended with an error report it when they go
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


class Pool(ABC):
    """Workers, wherever they are."""

    client: Client
    shares_store: bool  # whether they see the client's store; products travel otherwise
    patience: float  # s without any worker before a run gives up
    parent: int | None  # process with which they end; None: they were there before

    @abstractmethod
    def addresses(self) -> set[str]:
        """Workers that are there. Raises RunError where none can be had."""

    @abstractmethod
    def unfit(self, address: str) -> str | None:
        """Why a worker must not be sent a job, None where it may."""

    @abstractmethod
    def kill(self, address: str) -> None:
        """End a worker, whatever it is doing; another takes its place."""

    @abstractmethod
    def memory(self, address: str) -> float:
        """Resident memory of a worker in bytes, 0 where it cannot be seen."""

    @abstractmethod
    def close(self) -> None:
        """Leave no process and no connection behind."""

    def submit(
        self, address: str, function: Callable[[Any], Any], argument: Any, key: str
    ) -> Future:
        """Have a worker call a function."""
        return self.client.submit(
            function,
            argument,
            key=key,
            workers=[address],
            allow_other_workers=False,
            pure=False,
            retries=0,
        )

    def fetch(self, finished: Future) -> Answer[Any]:
        """Have the answer of a call that has ended brought here, however long that takes.

        Each by itself: Dask's own `gather` joins requests, and the answer of a worker that
        hangs in its next job would hold up those of others. The answer raises OSError where
        the worker does not give it.
        """
        client: Any = self.client
        bringing = _bring(client.scheduler, finished.key)
        return asyncio.run_coroutine_threadsafe(bringing, client.loop.asyncio_loop)

    def listen(self, topic: str, heard: Callable[[str, dict[str, Any]], None]) -> None:
        """Have a function called with the address and words of workers that tell something."""
        # the scheduler adds who said it
        self.client.subscribe_topic(topic, lambda event: heard(event[1]["worker"], event[1]))


async def _bring(scheduler: Any, key: Any) -> Any:
    told = await scheduler.gather(keys=[key])
    if told["status"] != "OK":
        await asyncio.sleep(FETCH_AGAIN_SECONDS)
        raise OSError(f"no worker gives {key}")
    return told["data"][key]
