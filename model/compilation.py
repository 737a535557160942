"""The time that a process spends compiling and loading kernels, apart from what it computes.

A fresh machine compiles for up to a minute inside its first stage runs, and each process loads
what is compiled once, which is no part of any case: `model.compile` reports both here.
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path


class Compilation:
    """A stopwatch that runs from the start to the end of the outermost compilation.

    It counts wall-clock `seconds` and `cpu_seconds` of this process, both so far, and
    calls `listener` with None when a compilation starts and with its seconds when it ends.
    Python's search for cycles stands still meanwhile: it finds none that matter among the
    many small objects of a compilation, and takes a sixth of the time.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.cpu_seconds = 0.0
        self.listener: Callable[[float | None], None] | None = None
        self._depth = 0
        self._collects = True
        self._begin = self._cpu = 0.0

    def start(self) -> None:
        """Begin a compilation, perhaps inside another."""
        self._depth += 1
        if self._depth == 1:
            self._begin, self._cpu = time.perf_counter(), time.process_time()
            self._collects = gc.isenabled()
            gc.disable()
            self._tell(None)

    def end(self) -> None:
        """End the compilation that was begun last."""
        self._depth -= 1
        if self._depth == 0:
            if self._collects:
                gc.enable()
            seconds = time.perf_counter() - self._begin
            self.seconds += seconds
            self.cpu_seconds += time.process_time() - self._cpu
            self._tell(seconds)

    @contextmanager
    def under_way(self) -> Iterator[None]:
        """Count what is done within a `with` block."""
        self.start()
        try:
            yield
        finally:
            self.end()

    def _tell(self, seconds: float | None) -> None:
        if self.listener is not None:
            self.listener(seconds)


compilation = Compilation()


class Loading:
    """A stopwatch of kernels that are made ready to be called, without what compiling them takes.

    It counts wall-clock `seconds` and `cpu_seconds` of this process, both so far.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.cpu_seconds = 0.0
        self._depth = 0

    @contextmanager
    def under_way(self) -> Iterator[None]:
        """Count what is done within a `with` block, perhaps inside another."""
        self._depth += 1
        begin, cpu = _clocks()
        try:
            yield
        finally:
            self._depth -= 1
            if self._depth == 0:
                end, cpu_end = _clocks()
                self.seconds += end - begin
                self.cpu_seconds += cpu_end - cpu


def _clocks() -> tuple[float, float]:
    """Clocks of time and processor time, s; both stand still while kernels are compiled."""
    return (
        time.perf_counter() - compilation.seconds,
        time.process_time() - compilation.cpu_seconds,
    )


loading = Loading()


def kept_kernels() -> int:
    """Number of kernels that were compiled by this user on this machine and are kept.

    Where `model.kernel_cache` keeps them first; asking takes no Numba.
    """
    homes = [
        os.environ.get("NUMBA_CACHE_DIR", ""),
        os.environ.get("XDG_CACHE_HOME", "") or str(Path.home() / ".cache"),
    ]
    found = (Path(home) / "demflow" for home in homes if home)
    return sum(1 for folder in found for _ in folder.glob("kernels-*/*.nbi"))
