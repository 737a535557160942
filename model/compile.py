"""The one Numba policy: every kernel is compiled through `kernel`.

Kernels are cached on disk (`model.kernel_cache`), release the GIL and keep IEEE arithmetic (no
fastmath: the model promises the same bits on every worker). `NUMBA_DISABLE_JIT=1` runs them
as plain Python, which the tests use on small cases.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core import event

from demflow.model.compilation import compilation
from demflow.model.kernel_cache import LateCache


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of numbers and arrays to machine code, cached on disk."""
    compiled: Any = njit(nogil=True, error_model="numpy")(function)
    if compiled is not function:  # NUMBA_DISABLE_JIT leaves it as it is
        compiled._cache = LateCache(function)
    return compiled


class _Report(event.Listener):
    """Hears of each compilation, not of what is loaded from the cache."""

    def on_start(self, event: event.Event) -> None:
        compilation.start()

    def on_end(self, event: event.Event) -> None:
        compilation.end()


event.register("numba:compile", _Report())
