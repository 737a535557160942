"""The one Numba policy: every kernel is compiled through `kernel`.

Kernels are cached on disk (`model.kernel_cache`), release the GIL and keep IEEE arithmetic (no
fastmath: the model promises the same bits on every worker). `NUMBA_DISABLE_JIT=1` runs them
as plain Python, which the tests use on small cases.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from numba import njit
from numba.core import event
from numba.extending import overload

from demflow.model.compilation import compilation
from demflow.model.kernel_cache import LateCache


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of numbers and arrays to machine code, cached on disk."""
    compiled: Any = njit(nogil=True, error_model="numpy")(function)
    if compiled is not function:  # NUMBA_DISABLE_JIT leaves it as it is
        compiled._cache = LateCache(function)
    return compiled


def by_type(statement: Callable[..., Any]) -> Any:
    """Make a function for kernels whose first argument, a named tuple, decides what it does.

    `@function.of(Kind)` gives what is done for a `Kind`, the statement itself what is done for
    any other. All must have been given when a kernel that calls the function is first run. The
    choice is made while compiling, at no cost later.
    """
    implementations: dict[type, Callable[..., Any]] = {}

    @wraps(statement)
    def function(first: Any, *others: Any) -> Any:
        return implementations.get(type(first), statement)(first, *others)

    def of(kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        def give(implementation: Callable[..., Any]) -> Callable[..., Any]:
            implementations[kind] = implementation
            return implementation

        return give

    def choose(first: Any, *_others: Any) -> Callable[..., Any]:
        return implementations.get(getattr(first, "instance_class", type(None)), statement)

    overload(function, jit_options={"nogil": True, "error_model": "numpy"}, strict=False)(choose)
    vars(function).update(of=of, statement=statement, implementations=implementations)
    return function


class _Report(event.Listener):
    """Hears of each compilation, not of what is loaded from the cache."""

    def on_start(self, event: event.Event) -> None:
        compilation.start()

    def on_end(self, event: event.Event) -> None:
        compilation.end()


event.register("numba:compile", _Report())
