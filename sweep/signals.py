"""Ctrl-C and SIGTERM: heard by the process that they are meant for, and when it can be."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def signals_kept_for_later() -> Iterator[None]:
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
