"""Ctrl-C and SIGTERM: heard by the process that they are meant for, and when it can be."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


@contextmanager
def signals_noted() -> Iterator[list[int]]:
    """Note Ctrl-C and SIGTERM in the list instead of raising; raise them at the end.

    An exception that a signal raises inside a destructor, as of one of Dask's futures, is lost.
    A signal that is ignored, as after `nohup`, stays so.
    """
    noted: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return
    numbers = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) != signal.SIG_IGN]
    before = {n: signal.signal(n, lambda heard, _: noted.append(heard)) for n in numbers}
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for heard in noted:
            signal.raise_signal(heard)


@contextmanager
def kept_from_children() -> Iterator[None]:
    """Let threads that are started inside, and processes that they start, not hear Ctrl-C.

    A terminal sends it to every process in the foreground; it is for this one, which
    then ends the others, also those that a nanny starts later.
    """
    # multiprocessing's tracker unblocks the signal in the thread that starts it: start it now
    resource_tracker.ensure_running()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
