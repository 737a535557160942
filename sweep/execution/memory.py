"""Memory of this machine and of this process, bytes, and since when that runs."""

from __future__ import annotations

import ctypes
import resource
import sys
from contextlib import suppress

import psutil

from demflow.model.memory import CGROUP, available

__all__ = [
    "available",
    "began",
    "give_back",
    "keep_freed",
    "machine_memory",
    "peak_memory",
    "resident_memory",
]

KEPT_BYTES = 1 << 28  # of what is freed, for what comes next
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # <malloc.h>

_RSS_UNIT = 1 if sys.platform == "darwin" else 1024  # what getrusage counts in


def machine_memory() -> float:
    """Memory of this machine, or of the control group that bounds its processes."""
    total = float(psutil.virtual_memory().total)
    try:
        bound = (CGROUP / "memory.max").read_text().strip()
    except OSError:
        return total
    return min(total, float(bound)) if bound.isdigit() else total


def resident_memory() -> int:
    """Resident memory of this process now."""
    return int(psutil.Process().memory_info().rss)


def peak_memory() -> int:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _RSS_UNIT


def keep_freed() -> None:
    """Let this process use again what it freed, up to `KEPT_BYTES`, for arrays as large as that.

    By itself the C library of GNU asks the system for each array above 32 MB and returns it at
    once, and the system clears all of its pages anew: a third of what a network of a million
    grains takes, and half of the walk of its traces.
    """
    if sys.platform == "linux":
        with suppress(AttributeError):  # another C library than that of GNU
            change = ctypes.CDLL(None).mallopt
            if change(_M_MMAP_THRESHOLD, KEPT_BYTES):  # older ones refuse
                change(_M_TRIM_THRESHOLD, KEPT_BYTES)


def give_back() -> None:
    """Return to the system what this process holds no longer."""
    if sys.platform == "linux":
        with suppress(AttributeError):  # another C library than that of GNU
            ctypes.CDLL(None).malloc_trim(0)


def began() -> float:
    """When this process began, s since the epoch."""
    return float(psutil.Process().create_time())
