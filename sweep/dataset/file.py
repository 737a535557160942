"""The file of a dataset: made aside, put in its place whole, known by the hash beside it."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import netCDF4

from sweep.durable import naming, rename_durably, write_durably


def make_in_memory(path: Path, fill: Callable[[netCDF4.Dataset], None], damaged: list[str]) -> None:
    """Make a dataset in memory and put it in place, unless a product was found damaged.

    So the netCDF library never meets a disk that fails: it crashes where its last write does.
    """
    file = netCDF4.Dataset(path, "w", format="NETCDF4", memory=1)
    try:
        fill(file)
    finally:
        content = file.close()
    if not damaged:
        with _hash_beside(path, hashlib.sha256(content).hexdigest()):
            write_durably(path, content)


def make_on_disk(path: Path, fill: Callable[[netCDF4.Dataset], None], damaged: list[str]) -> None:
    """Do the same on disk, for a dataset of any size. Raises OSError."""
    aside = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        try:
            with netCDF4.Dataset(aside, "w", format="NETCDF4") as file:
                fill(file)
                file.sync()  # what cannot be written is told here, and not on closing
        except (RuntimeError, PermissionError) as error:  # its words for whatever happened
            if type(error) not in (RuntimeError, PermissionError):
                raise
            why = f"netCDF cannot write it ({error}); most often the disk is full"
            raise OSError(errno.EIO, why, str(path)) from error
        if damaged:
            return
        with open(aside, "rb+") as written, naming(path):
            os.fsync(written.fileno())
            sha256 = hashlib.file_digest(written, "sha256").hexdigest()
        with _hash_beside(path, sha256):
            rename_durably(aside, path)
    finally:
        with suppress(OSError):
            aside.unlink()


@contextmanager
def _hash_beside(path: Path, sha256: str) -> Iterator[None]:
    """Record the hash of a dataset that takes its place while a `with` block runs.

    Until it has, the hash of the earlier one stands there too, so that whenever this ends
    a whole dataset is known as one.
    """
    line = f"{sha256}  {path.name}\n"
    earlier = "".join(f"{known}  {path.name}\n" for known in _known_hashes(path)[:2])
    write_durably(_hash_file(path), (line + earlier).encode())
    yield
    write_durably(_hash_file(path), line.encode())


def _known_hashes(path: Path) -> list[str]:
    try:
        lines = _hash_file(path).read_text(errors="replace").splitlines()
    except FileNotFoundError:
        return []
    return [line.partition(" ")[0] for line in lines]


def dataset_problem(path: Path) -> str | None:
    """What is wrong with the dataset at `path` by the hash beside it, None if nothing is."""
    recorded = _known_hashes(path)
    if not recorded:
        return f"there is no hash in {_hash_file(path).name} beside it"
    with open(path, "rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    return None if found in recorded else "the data differ from what was written"


def _hash_file(path: Path) -> Path:
    return path.with_name(path.name + ".sha256")  # as `sha256sum --check` reads it


def collected_digest(path: Path) -> str | None:
    """Return what the dataset at `path` was made from, None where there is no whole dataset."""
    if not path.exists() or dataset_problem(path):
        return None
    with suppress(OSError, AttributeError, RuntimeError), netCDF4.Dataset(path) as file:
        return str(file.getncattr("demflow_digest"))
    return None
