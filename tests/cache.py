"""Where runs note what they cost: away from the user's notes, for tests and checks."""

from __future__ import annotations

import os
from pathlib import Path


def variables(folder: Path) -> dict[str, str]:
    """Environment variables by which costs are noted in a folder of their own.

    Compiled kernels and fonts are still those of the user.
    """
    home = _home()
    kept = {"NUMBA_CACHE_DIR": str(home), "MPLCONFIGDIR": str(home / "matplotlib")}
    given = {name: os.environ[name] for name in kept if name in os.environ}
    return kept | given | {"XDG_CACHE_HOME": str(folder)}


def share_sources(folder: Path) -> None:
    """What was read of sources is the user's for whoever notes costs in a folder of his own."""
    kept = _home() / "demflow" / "sources"
    kept.mkdir(parents=True, exist_ok=True)
    (folder / "demflow").mkdir(parents=True)
    (folder / "demflow" / "sources").symlink_to(kept.resolve())


def _home() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME", "") or Path.home() / ".cache")
