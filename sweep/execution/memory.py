"""Memory of this machine and of this process, bytes, and since when that runs."""

from __future__ import annotations

import ctypes
import resource
import sys
from contextlib import suppress

import psutil

from demflow.model.memory import CGROUP, available

__all__ = ["available", "began", "give_back", "machine_memory", "peak_memory", "resident_memory"]

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


def give_back() -> None:
    """Return to the system what this process holds no longer."""
    if sys.platform == "linux":
        with suppress(AttributeError):  # another C library than that of GNU
            ctypes.CDLL(None).malloc_trim(0)


def began() -> float:
    """When this process began, s since the epoch."""
    return float(psutil.Process().create_time())
