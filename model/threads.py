"""BLAS on one thread, where its matrices are too small to gain from more.

The projections of a transient are dense, of some tens of columns, and called by the hundred:
threads that wait for one another there cost several times the processor time and the time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    """The BLAS libraries loaded so far; looking for them takes milliseconds, so once."""
    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within this, BLAS uses one thread; afterwards as many as before."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield
