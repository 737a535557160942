"""Results that are asked for again and again, kept by what they were made of."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

import numpy as np

Result = TypeVar("Result")


class Kept(Generic[Result]):
    """The results used last, up to a number of bytes, and always the very last.

    A result is a pure function of what it is made of, so that whether it was kept changes nothing
    but the time that it takes.
    """

    def __init__(self, most: int, size: Callable[[Result], int]) -> None:
        """At most `most` bytes, of which a result takes `size`."""
        self.most, self.size = most, size
        self._results: OrderedDict[bytes, tuple[Result, int]] = OrderedDict()

    def get(self, made_of: Iterable[object], make: Callable[[], Result]) -> Result:
        """The result of arrays, and of others by their `repr`; made where it is not there."""
        digest = hashlib.sha256()
        for one in made_of:
            if isinstance(one, np.ndarray):
                digest.update(f"{one.dtype.str}{one.shape}".encode())
                digest.update(np.ascontiguousarray(one).data)
            else:
                digest.update(f"{one!r};".encode())
        key = digest.digest()
        if key not in self._results:
            result = make()
            self._results[key] = result, self.size(result)
        self._results.move_to_end(key)
        while len(self._results) > 1 and sum(n for _, n in self._results.values()) > self.most:
            self._results.popitem(last=False)
        return self._results[key][0]

    def clear(self) -> None:
        """Forget all."""
        self._results.clear()
