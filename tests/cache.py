"""Where runs note what they cost: away from the user's notes, for tests and checks."""

from __future__ import annotations

import os
from pathlib import Path


def variables(folder: Path) -> dict[str, str]:
    """Environment variables by which costs are noted in a folder of their own.

    Compiled kernels and fonts are still those of the user.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME", "") or Path.home() / ".cache")
    kept = {"NUMBA_CACHE_DIR": str(home), "MPLCONFIGDIR": str(home / "matplotlib")}
    given = {name: os.environ[name] for name in kept if name in os.environ}
    return kept | given | {"XDG_CACHE_HOME": str(folder)}
