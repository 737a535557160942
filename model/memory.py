"""How much memory is left, and whether something will fit before it is made."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path

from demflow.model.outcome import OutOfMemory

# The most resident memory that this process may come to, bytes.
_limit: ContextVar[float | None] = ContextVar("memory_limit", default=None)

# What is smaller is not worth a look, bytes.
SMALL = 1 << 24

CGROUP = Path("/sys/fs/cgroup")


@contextlib.contextmanager
def limited(most: float | None) -> Iterator[None]:
    """Hold what runs inside to a resident memory of `most` bytes (None: what the machine has)."""
    token = _limit.set(most)
    try:
        yield
    finally:
        _limit.reset(token)


def available() -> float:
    """Bytes that this process may still take: of its limit, its control group, the machine.

    Infinity where nothing is known.
    """
    left = [_machine(), _group()]
    if (most := _limit.get()) is not None:
        left.append(most - _resident())
    return max(0.0, min(left))


def foresee(what: str, size: float, cure: str = "lower grains.count") -> None:
    """Raise `OutOfMemory` where `size` bytes for `what` would not fit; `cure` makes it smaller.

    Parameters
    ----------
    what : what takes them
    size : bytes
    cure : what makes it smaller
    """
    if size < SMALL or size <= (left := available()):
        return
    raise OutOfMemory(
        f"{what} needs {size / 1e9:.3g} GB and {left / 1e9:.3g} GB are left; {cure}, "
        "use fewer workers, or raise limits.memory where that is what is short"
    )


def _machine() -> float:
    for line in _read(Path("/proc/meminfo")).splitlines():
        if line.startswith("MemAvailable:"):
            return 1024.0 * float(line.split()[1])
    return float("inf")


def _group() -> float:
    most, used = _read(CGROUP / "memory.max"), _read(CGROUP / "memory.current")
    if not most.isdigit() or not used.isdigit():
        return float("inf")
    return float(most) - float(used)


def _resident() -> float:
    for line in _read(Path("/proc/self/status")).splitlines():
        if line.startswith("VmRSS:"):
            return 1024.0 * float(line.split()[1])
    return 0.0


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
