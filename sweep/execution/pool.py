"""Where the lots of a run go: worker processes of this machine, or a Dask cluster.

`sweep.execution.loop` decides what runs where and when; a pool starts the workers or finds
them, carries one lot at a time to a worker of its choice, and ends it when told to. All of it
lives in the event loop of one thread. To bound a wait `asyncio.timeout` serves, not `wait_for`,
which before Python 3.12 loses a cancellation that comes together with the answer.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from distributed import Client, Future, KilledWorker

from demflow.sweep.execution.memory import give_back

CLOSING_SECONDS = 5.0  # s for a scheduler to take leave

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
        give_back()
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


class NoAnswerError(Exception):
    """A worker, or what was sent to it, is no longer there."""


class Pool(ABC):
    """Workers, wherever they are; entered and left with `async with`."""

    client: Client
    shares_store: bool  # whether they see the client's store; products travel otherwise
    patience: float  # s without any worker before a run gives up
    look_every: float  # s between two looks at the workers
    parent: int | None = None  # process with which they end; None: they were there before

    def __init__(self) -> None:
        self.name = f"demflow-{uuid.uuid4().hex[:12]}"  # of this run, on a scheduler of many
        self._calls = 0
        self._topics: set[str] = set()

    @abstractmethod
    async def __aenter__(self) -> Pool:
        """Start or find the workers. Raises SchedulerError where there is no scheduler."""

    @abstractmethod
    async def __aexit__(self, *error: object) -> None:
        """Leave no process and no connection behind."""

    @abstractmethod
    async def look(self) -> Mapping[str, Mapping[str, Any]]:
        """What the scheduler knows of the workers that are there, by their addresses.

        Raises RunError where none can be had.
        """

    @abstractmethod
    def kill(self, address: str) -> None:
        """End a worker, whatever it is doing; another takes its place."""

    @abstractmethod
    def ask_for(self, workers: int) -> None:
        """Let it be known that so many workers would have something to do."""

    async def call(self, address: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Have a worker call a function and return what that returns, or raise what it raises.

        Raises NoAnswerError where the worker or a file that was sent to it is gone.
        """
        self._calls += 1
        future: Future[Any] = self.client.submit(
            function,
            *arguments,
            key=f"{self.name}-{self._calls}",
            workers=[address],
            allow_other_workers=False,
            pure=False,
            retries=0,
        )
        error = await future.exception()
        if isinstance(error, KilledWorker) or future.cancelled():
            raise NoAnswerError(address)
        if error is not None:
            raise error
        scheduler: Any = self.client.scheduler
        # not Dask's own `gather`, which joins requests: of two workers one may have stopped
        with suppress(OSError):  # the scheduler is gone: whoever looks at it says so
            told = await scheduler.gather(keys=[future.key])
            if told["status"] == "OK":
                return told["data"][future.key]
        raise NoAnswerError(address)

    def listen(self, topic: str, heard: Callable[[Mapping[str, Any]], None]) -> None:
        """Have a function called with what workers and their nannies tell, `worker` the address."""
        self.client.subscribe_topic(topic, lambda event: heard(event[1]))
        self._topics.add(topic)

    async def _hang_up(self) -> None:
        """Close the connection to the scheduler, if it is still there."""
        with suppress(Exception):
            for topic in self._topics:
                self.client.unsubscribe_topic(topic)
            async with asyncio.timeout(CLOSING_SECONDS):
                await self.client.close(timeout=CLOSING_SECONDS)
