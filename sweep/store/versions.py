"""The versions of all that decides the numbers of a product."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

NUMERICAL = ("numpy", "scipy", "numba", "qdldl")


@cache
def installed(name: str) -> str:
    """Return the version of a distribution, "not installed" where it has none."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


@cache
def versions() -> dict[str, str]:
    """Return the versions of Python, demflow and the numerical libraries, by name."""
    found = {"python": platform.python_version()}
    return found | {name: installed(name) for name in ("demflow", *NUMERICAL)}


@cache
def agreed() -> dict[str, str]:
    """Return what must be the same wherever a study runs: versions, and the sources of demflow.

    Two states of a checkout under development bear one version.
    """
    found = versions() | {"python": ".".join(platform.python_version_tuple()[:2])}
    return found | {"sources": _sources()[:12]}


def _sources() -> str:
    """SHA-256 of the sources of the model and of the sweep."""
    digest, root = hashlib.sha256(), Path(__file__).parents[2]
    for source in sorted(p for part in ("model", "sweep") for p in (root / part).rglob("*.py")):
        digest.update(f"{source.relative_to(root)}\n".encode() + source.read_bytes())
    return digest.hexdigest()


@cache
def machine() -> str:
    """Return what kind of machine this is: architecture, processor and system."""
    return ", ".join(filter(None, (platform.machine(), _processor(), platform.system())))


def _processor() -> str:
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8", errors="replace") as file:
            named = (line.partition(":")[2].strip() for line in file if "model name" in line)
            return next(named, "")
    except OSError:
        return platform.processor()
