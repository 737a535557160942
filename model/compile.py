"""The one Numba policy: every kernel is compiled through `kernel`.

Kernels are cached on disk, release the GIL and keep IEEE arithmetic (no fastmath:
the model promises the same bits on every worker). `NUMBA_DISABLE_JIT=1` runs them
as plain Python, which the tests use on small cases.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of numbers and arrays to machine code, cached on disk."""
    return njit(cache=True, nogil=True, error_model="numpy")(function)
