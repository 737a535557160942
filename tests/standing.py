"""A worker process that stands for many runs: to start one costs more than most runs take.

How workers are started, killed and left is for the tests of the pools; these use it in none.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest import mock

from dask import config
from distributed import LocalCluster

from demflow.sweep.execution.cluster import RemotePool
from demflow.sweep.execution.local import SETTINGS


@contextmanager
def one_worker() -> Iterator[None]:
    """Have runs on workers of their own go to one that stands while a `with` block runs."""
    with (
        config.set(SETTINGS),
        LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=50,
        ) as cluster,
    ):

        class Standing(RemotePool):
            """The worker that stands, which sees the store of every run."""

            shares_store = True
            look_every = 0.2

            def __init__(self, workers: int, memory: float | None = None):
                super().__init__(cluster.scheduler_address)

        with mock.patch("demflow.sweep.execution.loop.LocalPool", Standing):
            yield
