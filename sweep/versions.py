"""The versions of all that decides the numbers of a product."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

NUMERICAL = ("numpy", "scipy", "numba", "qdldl")


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
