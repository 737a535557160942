"""Writing files so that, whatever happens, each of them is there whole or not at all.

A file is written aside in its folder, flushed, renamed under its final name, and the folder
is flushed. Many files share their flushes: where the system can flush a file system as a
whole (`syncfs`, which reports failed writes since Linux 5.8), two such calls serve them all.
Paths are text here: those of a study are many, and objects for each took a tenth of its time.
"""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, TypeVar

P = TypeVar("P", str, Path)

FEW = 2  # files that are flushed one by one
REPORTS_ERRORS = (5, 8)  # Linux whose syncfs tells of failed writes
# what file systems answer that cannot flush a folder, as some of networks and user space
CANNOT_FLUSH = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.EBADF)
unflushed: set[str] = set()  # folders of this process that could not be flushed
FOREIGN_BYTES = 256_000_000  # not yet written by others: a flush of everything would wait for it


def write_durably(path: Path, content: bytes | memoryview) -> None:
    """Write one file durably. Raises OSError; what was there before stays then."""
    write_all_durably({path: content})


def write_all_durably(files: Mapping[P, bytes | memoryview]) -> None:
    """Write files durably, by their paths, all of them in two flushes.

    Raises OSError that names a file; no half file is left then, and files may be old or new.
    """
    if not files:
        return
    asides = {path: f"{path}.{os.getpid()}.partial" for path in files}
    try:
        with ExitStack() as stack:
            opened: list[IO[Any]] = []
            folders: set[str] = set()
            for path, content in files.items():
                if (folder := os.path.dirname(path) or os.curdir) not in folders:
                    folders.update(_made(folder))
                # unbuffered: a full disk is told here, not when the file is closed
                file = stack.enter_context(open(asides[path], "wb", buffering=0))
                with naming(path):
                    _write(file, content)
                opened.append(file)
            with naming(path):  # the last of them stands for all
                _flush_files(opened)
                for path, aside in asides.items():
                    os.replace(aside, path)
                _flush_folders(folders, opened)
    except BaseException:
        for aside in asides.values():
            with suppress(OSError):
                os.unlink(aside)
        raise


def rename_durably(aside: Path, path: Path) -> None:
    """Rename a flushed file over `path` and flush the folder, so that the name survives too."""
    with naming(path):
        aside.replace(path)
        _flush_folder(str(path.parent))


@contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Let an OSError that names no file, as those of writing and flushing, name this one."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def _made(folder: str) -> Iterator[str]:
    """Make a folder where it is missing; it, and those that were changed for its sake."""
    yield folder
    if not os.path.isdir(folder):
        yield from _made(os.path.dirname(folder) or os.curdir)
        Path(folder).mkdir(exist_ok=True)


def _write(file: Any, content: bytes | memoryview) -> None:
    left = memoryview(content)
    while left:
        left = left[file.write(left) :]


def _flush_files(opened: list[IO[Any]]) -> None:
    if len(opened) > FEW and _flush_all(opened[0].fileno()):
        return
    if len(opened) > 1 and hasattr(os, "posix_fadvise"):
        for file in opened:  # sets all on their way, so that one flush waits for all
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    for file in opened:
        os.fsync(file.fileno())


def _flush_folders(folders: Collection[str], opened: list[IO[Any]]) -> None:
    if len(folders) > FEW and _flush_all(opened[0].fileno()):
        return
    for folder in folders:
        _flush_folder(folder)


def _flush_folder(path: str) -> None:
    """Flush a folder, so that new names in it survive; not where its file system cannot do so."""
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    except OSError as error:
        if error.errno not in CANNOT_FLUSH:
            raise
        unflushed.add(path)
    finally:
        os.close(folder)


def _flush_all(descriptor: int) -> bool:
    """Flush the whole file system of an open file; False where that is not to be had.

    Raises OSError where a write to that file system failed since the file was opened.
    """
    flush = _syncfs()
    if flush is None or _unwritten() > FOREIGN_BYTES:
        return False
    if flush(descriptor) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return True


@cache
def _syncfs() -> Any:
    """The system's `syncfs`, None where there is none that can be trusted."""
    if not sys.platform.startswith("linux"):
        return None
    release = os.uname().release.split(".")[:2]
    if not all(map(str.isdigit, release)) or tuple(map(int, release)) < REPORTS_ERRORS:
        return None
    return getattr(ctypes.CDLL(None, use_errno=True), "syncfs", None)


def _unwritten() -> int:
    """Bytes in the memory of this machine that wait to be written to some disk."""
    try:
        with Path("/proc/meminfo").open(encoding="ascii") as file:
            entries = dict(line.split(":", 1) for line in file)
        return 1024 * sum(int(entries[key].split()[0]) for key in ("Dirty", "Writeback"))
    except (OSError, LookupError, ValueError):
        return 0
