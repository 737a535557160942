"""The one Numba policy: every kernel is compiled through `kernel`.

Kernels are cached on disk (`model.kernel_cache`), release the GIL and keep IEEE arithmetic (no
fastmath: the model promises the same bits on every worker). `NUMBA_DISABLE_JIT=1` runs them
as plain Python, which the tests use on small cases.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Protocol, TypeVar, cast

import numpy as np
from numba import njit, version_info
from numba.core import event
from numba.extending import overload

from demflow.model.compilation import compilation, loading
from demflow.model.kernel_cache import LateCache

Array = np.ndarray  # its docstring says of what, and of which shape

Function = TypeVar("Function", bound=Callable[..., Any])
Returned = TypeVar("Returned", covariant=True)

OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

# `kernel_parts` saves a fifth of compiling or more, and builds on the inside of Numba, which may
# change from version to version: any other compiles each kernel as Numba does, to the same bits.
PARTS_OF = (0, 68)


def kernel(function: Function) -> Function:
    """Compile a function of numbers and arrays to machine code, cached on disk."""
    compiled: Any = _jitted(function)
    if compiled is not function:  # NUMBA_DISABLE_JIT leaves it as it is
        compiled._cache = cache = LateCache(function)
        compile_ = compiled.compile

        def alone(signature: Any) -> Any:
            # processes that want the same kernel compile it once
            with loading.under_way(), cache.alone():
                return compile_(signature)

        compiled.compile = alone
    return cast("Function", compiled)


def _jitted(function: Callable[..., Any]) -> Any:
    compile_: Any = njit  # takes options that its types do not name
    if version_info.short != PARTS_OF:
        return compile_(**OPTIONS)(function)
    from demflow.model.kernel_parts import Wholes, calls_part

    compiled = compile_(pipeline_class=Wholes, **OPTIONS)(function)
    if compiled is not function:
        calls_part(compiled, compile_(no_cpython_wrapper=True, **OPTIONS)(function))
    return compiled


class ByType(Protocol[Returned]):
    """A function for kernels whose first argument decides what it does."""

    def __call__(self, first: Any, *others: Any) -> Returned:
        """Do what is given for the type of the first."""

    def of(self, kind: type) -> Callable[[Function], Function]:
        """Give what is done for a kind."""


def by_type(statement: Callable[..., Returned]) -> ByType[Returned]:
    """Make a function for kernels whose first argument, a named tuple, decides what it does.

    `@function.of(Kind)` gives what is done for a `Kind`, the statement itself what is done for
    any other. All must have been given when a kernel that calls the function is first run. The
    choice is made while compiling, at no cost later.
    """
    implementations: dict[type, Callable[..., Any]] = {}

    @wraps(statement)
    def function(first: Any, *others: Any) -> Returned:
        chosen: Callable[..., Returned] = implementations.get(type(first), statement)
        return chosen(first, *others)

    def of(kind: type) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        def give(implementation: Callable[..., Any]) -> Callable[..., Any]:
            implementations[kind] = implementation
            return implementation

        return give

    def choose(first: Any, *_others: Any) -> Callable[..., Any]:
        return implementations.get(getattr(first, "instance_class", type(None)), statement)

    chosen: Callable[[Any], Any] = overload(function, jit_options=OPTIONS, strict=False)
    chosen(choose)
    vars(function).update(of=of, statement=statement, implementations=implementations)
    return cast("ByType[Returned]", function)


class _Report(event.Listener):
    """Hears of each compilation, not of what is loaded from the cache."""

    def on_start(self, event: event.Event) -> None:
        compilation.start()

    def on_end(self, event: event.Event) -> None:
        compilation.end()


event.register("numba:compile", _Report())
