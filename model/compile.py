"""The one Numba policy: every kernel is compiled through `kernel`.

Kernels are cached on disk, release the GIL and keep IEEE arithmetic (no fastmath:
the model promises the same bits on every worker). `NUMBA_DISABLE_JIT=1` runs them
as plain Python, which the tests use on small cases.

Numba's own cache looks at the file of a kernel only, not at the kernels that it calls,
and its writers race. Here the cache folder bears the hash of all sources of the model,
so that no stale code can be loaded, and processes take turns at its files.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core import caching, event

from demflow.model.compilation import compilation


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of numbers and arrays to machine code, cached on disk."""
    return njit(cache=True, nogil=True, error_model="numpy")(function)


def cache_folder() -> Path:
    """Folder of the compiled kernels of exactly these sources and this Numba.

    Below NUMBA_CACHE_DIR where that is set, else below the user's cache folder, else, where
    that cannot be written, below the system's folder for temporary files.
    """
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    root = Path(__file__).parent
    for source in sorted(root.rglob("*.py")):
        digest.update(str(source.relative_to(root)).encode() + source.read_bytes())
    name = Path("demflow") / f"kernels-{digest.hexdigest()[:16]}"
    homes = [
        os.environ.get("NUMBA_CACHE_DIR", ""),
        os.environ.get("XDG_CACHE_HOME", "") or str(Path.home() / ".cache"),
    ]
    for home in filter(None, homes):
        try:
            folder = Path(home) / name
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.gettempdir()) / f"demflow-{os.getuid()}" / name.name


def _take_turns() -> None:
    """Put Numba's reading and writing of its cache under a lock on the folder.

    It reads its index, chooses a file name and writes both in separate steps; two processes
    in the middle of that can leave an index that names the other's code.
    """

    def locked(method: Any) -> Any:
        def under_lock(self: Any, *args: Any) -> Any:
            os.makedirs(self._cache_path, exist_ok=True)
            with open(os.path.join(self._cache_path, ".lock"), "w") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                return method(self, *args)

        return under_lock

    files = caching.IndexDataCacheFile
    for name in ("load", "save"):
        setattr(files, name, locked(getattr(files, name)))


class _Report(event.Listener):
    """Hears of each compilation, not of what is loaded from the cache."""

    def on_start(self, event: event.Event) -> None:
        compilation.start()

    def on_end(self, event: event.Event) -> None:
        compilation.end()


vars(numba.config)["CACHE_DIR"] = str(cache_folder())
_take_turns()
event.register("numba:compile", _Report())
