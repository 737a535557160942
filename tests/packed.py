"""Packings that stages of several tests begin with, made once in each process of tests.

The same scene gives the same packing to the bit, to which no later stage writes (`test_stages`).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from unittest import mock

from demflow.model.mechanics.packing import packing

pack = cache(packing.pack)


@contextmanager
def once() -> Iterator[None]:
    """Have the stage *pack* answer from memory what it was asked before, while a block runs."""
    with mock.patch.object(packing, "pack", pack):
        yield
