"""Where compiled kernels lie, and when they are still those of the code at hand.

Numba's own cache asks whether the file of a kernel has changed: a comment there compiles
it anew, and a change in a kernel that it calls goes unseen. Here a compiled kernel is kept under
the hash of what it means: its code and the code and values of all that it names, and so on
down. Comments, docstrings, places in a file and whatever no kernel names change nothing.

Numba reads its index, chooses a file name and writes both in separate steps; two processes in
the middle of that can leave an index that names the other's code. Here they take turns.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import IO, Any

import numba
import numpy as np
from numba.core import caching

from demflow.model.compilation import compilation

PACKAGE = __name__.rpartition(".")[0]  # kernels name nothing of ours outside it
# s to wait for another process, which may have been stopped in the middle of its turn
INDEX_PATIENCE = 5.0  # of reading or writing some kilobytes
COMPILING_PATIENCE = 60.0

WAY = 4  # raise it whenever the same code is compiled in another way, by `kernel_parts` or else


@cache
def cache_folder() -> Path:
    """Folder of compiled kernels: readable and writable by this user alone.

    Below NUMBA_CACHE_DIR where that is set, else below the user's cache folder, else, where
    neither can be written, below the system's folder for temporary files, and there only where
    nobody else made it: code that lies in it is run.
    """
    name = f"kernels-{sys.version_info[0]}.{sys.version_info[1]}-{numba.__version__}"
    homes = [
        os.environ.get("NUMBA_CACHE_DIR", ""),
        os.environ.get("XDG_CACHE_HOME", "") or str(Path.home() / ".cache"),
    ]
    for home in filter(None, homes):
        folder = Path(home) / "demflow" / name
        if _mine(folder):
            return folder
    shared = Path(tempfile.gettempdir()) / f"demflow-{os.getuid()}"
    if _mine(shared) and _mine(shared / name):
        return shared / name
    return Path(tempfile.mkdtemp(prefix="demflow-"))


def _mine(folder: Path) -> bool:
    """Whether a folder can be made or is there, and nobody else can write to it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    mine = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
    return mine and not found.st_mode & 0o022 and os.access(folder, os.W_OK)


def meaning(function: FunctionType) -> str:
    """Return the hash of a kernel's code and of all that it names (SHA-256, hexadecimal)."""
    digest = hashlib.sha256(b"%d" % WAY)
    for part in _parts(function, set()):
        digest.update(f"{len(part)}:{part}".encode())
    return digest.hexdigest()


def _parts(function: FunctionType, seen: set[int]) -> Iterator[str]:
    """What decides the meaning of a function, in an order that does not depend on the process."""
    if id(function.__code__) in seen:
        return
    seen.add(id(function.__code__))
    yield from _code(function.__code__, function.__doc__)
    named = sorted(_names(function.__code__))
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    for name in named:
        if name not in function.__globals__:
            continue
        value = function.__globals__[name]
        if isinstance(value, ModuleType) and value.__name__.startswith(PACKAGE):
            for attribute in (n for n in named if hasattr(value, n)):
                yield from _value(f"{name}.{attribute}", getattr(value, attribute), seen)
        else:
            yield from _value(name, value, seen)
    for name, value in zip(function.__code__.co_freevars, cells, strict=True):
        yield from _value(name, value, seen)
    chosen = getattr(function, "implementations", {})  # see `model.compile.by_type`
    if "statement" in vars(function):
        yield from _parts(vars(function)["statement"], seen)
    for kind in sorted(chosen, key=lambda kind: kind.__qualname__):
        yield f"for {kind.__qualname__}"
        yield from _parts(chosen[kind], seen)


def _code(code: CodeType, doc: str | None) -> Iterator[str]:
    yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {code.co_argcount}"
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _code(constant, None)
        elif constant != doc:
            yield repr(constant)


def _names(code: CodeType) -> set[str]:
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*map(_names, inner))


def _value(name: str, value: Any, seen: set[int]) -> Iterator[str]:
    function = getattr(value, "py_func", value)
    if isinstance(function, FunctionType) and function.__module__.startswith(PACKAGE):
        yield f"{name} calls"
        yield from _parts(function, seen)
    elif isinstance(value, type):
        fields = getattr(value, "_fields", ())
        yield f"{name} is {value.__module__}.{value.__qualname__} {fields}"
    elif isinstance(value, np.ndarray):
        yield f"{name} is {value.dtype} {value.shape} {value.tobytes().hex()}"
    elif isinstance(value, bool | int | float | complex | str | bytes | tuple | np.generic):
        yield f"{name} is {value!r}"
    else:  # of a library, whose version the folder bears
        yield f"{name} is of {type(value).__module__}.{type(value).__qualname__}"


class _Locator:
    """Tells Numba the folder of a kernel and what its files are called."""

    def __init__(self, function: FunctionType, file: str):
        self._py_file = file  # Numba names it in a warning
        self._meaning = meaning(function)

    @classmethod
    def from_function(cls, function: FunctionType, file: str) -> _Locator:
        return cls(function, file)

    def ensure_cache_path(self) -> None:
        cache_folder().mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(cache_folder())

    def get_source_stamp(self) -> str:
        return self._meaning

    def get_disambiguator(self) -> str:
        return self._meaning[:20]


class _Implementation(caching.CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012 (as Numba declares it)


# What was compiled for types that are gone or have moved, or was cut short, is no use any more.
UNREADABLE = (AttributeError, ImportError, EOFError)


class _Files(caching.IndexDataCacheFile):
    """Index and data of one kernel, read and written by one process at a time."""

    def load(self, key: Any) -> Any:
        with self._turn() as mine:
            return super().load(key) if mine else None

    def save(self, key: Any, data: Any) -> None:
        with self._turn() as mine:
            if mine:
                super().save(key, data)

    def _load_index(self) -> dict[Any, str]:
        with suppress(*UNREADABLE):
            return dict(super()._load_index())
        return {}

    def _load_data(self, name: str) -> Any:
        with suppress(*UNREADABLE):
            return super()._load_data(name)
        return None  # compiled again

    def _turn(self) -> AbstractContextManager[bool]:
        return _turn(Path(self._cache_path) / ".lock", INDEX_PATIENCE)


@contextmanager
def _turn(
    lock: Path, patience: float, waiting: Callable[[], AbstractContextManager[Any]] = nullcontext
) -> Iterator[bool]:
    """Hold a lock, or tell that no turn has come; `waiting` is entered meanwhile."""
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open("w") as file:
        mine = _taken(file)
        if not mine:
            with waiting():
                end = time.monotonic() + patience
                while not (mine := _taken(file)) and time.monotonic() < end:
                    time.sleep(0.01)
        yield mine


def _taken(file: IO[str]) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class KernelCache(caching.FunctionCache):
    """Numba's cache of one kernel, under the meaning of the kernel."""

    _impl_class = _Implementation

    def __init__(self, function: Any):
        super().__init__(function)
        self._cache_file = _Files(
            self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp()
        )

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        """Numba's key, and the order of the fields of all named tuples that are passed."""
        return (*super()._index_key(sig, codegen), tuple(_fields(getattr(sig, "args", sig))))


def _fields(passed: Iterable[Any]) -> Iterator[tuple[str, ...]]:
    """Names of the fields of the named tuples among types of Numba's, in their order."""
    for kind in passed:
        yield getattr(kind, "fields", ())
        yield from _fields(getattr(kind, "types", ()))


class LateCache:
    """Makes a kernel's cache when it is first needed: all that the kernel names is there then."""

    def __init__(self, function: Callable[..., Any]):
        self._function = function
        self._made: KernelCache | None = None

    def alone(self) -> AbstractContextManager[bool]:
        """Within this no other process compiles the kernel; what one has made is there then.

        To wait counts as compiling: it is no stage's time. Whoever waits in vain compiles too.
        """
        name = f"{self._impl.locator.get_disambiguator()}.lock"
        return _turn(cache_folder() / name, COMPILING_PATIENCE, compilation.under_way)

    def __getattr__(self, name: str) -> Any:
        if self._made is None:
            self._made = KernelCache(self._function)
        return getattr(self._made, name)
