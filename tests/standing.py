"""Worker processes that cost little: forked from one that has imported all, or standing for long.

To start one, as a user's run does, takes longer than most runs of the tests, and so does to make a
certificate. How workers are started, killed and left, and whom they let in, is for the tests of the
pools; these use it in none.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from multiprocessing import forkserver
from typing import Any
from unittest import mock

from dask import config
from distributed import LocalCluster

from demflow.sweep.execution import certificate
from demflow.sweep.execution.cluster import RemotePool
from demflow.sweep.execution.local import ONE_THREAD, SETTINGS, LocalPool

LOOP_POOL = "demflow.sweep.execution.loop.LocalPool"
MADE, BEGIN = certificate.made, certificate.begin
METHOD = "distributed.worker.multiprocessing-method"
PRELOADED = ["distributed.nanny", "demflow.sweep.execution.worker", "tests.preloaded"]


@contextmanager
def forked_workers() -> Iterator[None]:
    """Have local workers forked while a `with` block runs."""
    parent = _fork_server()
    gc.freeze()  # what is there stays: each run looks for garbage

    class Forked(LocalPool):
        """Workers that end with the process from which they are forked, which ends with ours."""

        def __init__(self, workers: int, memory: float | None = None):
            super().__init__(workers, memory)
            self.parent = parent

    with (
        mock.patch.dict(SETTINGS, {METHOD: "forkserver"}),
        mock.patch(LOOP_POOL, Forked),
        _certificates(_one_for_all, _nothing),
    ):
        yield


@contextmanager
def spawned_workers() -> Iterator[None]:
    """Have local workers started as a user's are, while a `with` block runs."""
    with (
        mock.patch.dict(SETTINGS, {METHOD: "spawn"}),
        mock.patch(LOOP_POOL, LocalPool),
        _certificates(MADE, BEGIN),
    ):
        yield


def _start(workers: int, **options: Any) -> LocalCluster:
    """A scheduler in this process, and workers forked beside it."""
    _fork_server()
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
        **options,
    )


@contextmanager
def forked_cluster(workers: int, **options: Any) -> Iterator[LocalCluster]:
    """A scheduler in this process, and workers forked beside it, while a `with` block runs."""
    with config.set({METHOD: "forkserver"}), _start(workers, **options) as cluster:
        yield cluster


@contextmanager
def standing_worker() -> Iterator[str]:
    """A worker set up as those of runs are, while a `with` block runs; its scheduler's address."""
    with config.set(SETTINGS | {METHOD: "forkserver"}):  # which are read at the start
        cluster = _start(1)
    with cluster:
        yield cluster.scheduler_address


@contextmanager
def runs_on(scheduler: str) -> Iterator[None]:
    """Have runs on workers of their own go to one that stands, while a `with` block runs."""
    gc.freeze()  # what is there stays: each run looks for garbage

    class Standing(RemotePool):
        """The worker that stands, which sees the store of every run."""

        shares_store = True
        look_every = 0.2

        def __init__(self, workers: int, memory: float | None = None):
            super().__init__(scheduler)

    with mock.patch(LOOP_POOL, Standing), _certificates(MADE, _nothing):
        yield


def _certificates(made: Callable[[], tuple[str, str]], begin: Callable[[], None]) -> Any:
    """Have certificates made, and begun before they are asked for, in some way."""
    return mock.patch.multiple(certificate, made=made, begin=begin)


@cache
def _one_for_all() -> tuple[str, str]:
    """A certificate, made once."""
    with _certificates(MADE, BEGIN):
        return MADE()


def _nothing() -> None:
    """Begin nothing."""


def _fork_server() -> int:
    """Start the process from which workers are forked, if it does not stand; its number."""
    multiprocessing.get_context("forkserver").set_forkserver_preload(PRELOADED)
    with mock.patch.dict(os.environ, ONE_THREAD):
        forkserver.ensure_running()
    return forkserver._forkserver._forkserver_pid
