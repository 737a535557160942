"""The store: one file per product, under its identity, data only.

A product is there or it is not: a file is written aside in its folder, flushed, renamed
under its final name, and the folder is flushed. It holds

    8 bytes    "demflow1"
    8 bytes    length of the header, little-endian
    32 bytes   SHA-256 of the header
    header     JSON: arrays (name, dtype, shape, offset), meta, SHA-256 of the payload
    payload    the arrays, little-endian, C order, each on a multiple of 64 bytes

so that every flipped bit and every lost byte is found when it is read. Arrays are not
compressed: a stage's floats shrink by 5 % in ten times the time that writing them takes.
A run that failed leaves a record of the same form without arrays, so that a law's error
is not met again at every run.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
import struct
from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from demflow.model.outcome import Status
from demflow.sweep.store.durable import write_all_durably, write_durably

MAGIC = b"demflow1"
_PREFIX = struct.Struct("<8sQ32s")
_ALIGNMENT = 64
PIECE = 1 << 20  # bytes that are read at once
_KINDS = "biufcUS"  # numbers and text: no objects, nothing that would be executed
_HEX = set("0123456789abcdef")
# what a record of a failure tells
FAILURES = frozenset(Status) - {Status.DONE, Status.NOT_RUN, Status.LEFT_OUT}


class DamagedError(ValueError):
    """A stored file whose content is not what was written."""


class MissingError(KeyError):
    """A product that is not in the store."""


class StoreError(RuntimeError):
    """A folder that cannot serve as a store; the text says why."""


class Stored(NamedTuple):
    """What a file of the store holds."""

    arrays: dict[str, np.ndarray]
    meta: dict[str, Any]


def pack(arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> bytes:
    """Return the bytes of a file that holds named arrays and a JSON-able description.

    Raises TypeError for an array that is not of numbers, booleans or text.
    """
    entries, chunks, offset = [], [], 0
    for name, array in arrays.items():
        plain = _plain(array)
        padding = -offset % _ALIGNMENT
        offset += padding
        entries.append([name, plain.dtype.str, list(plain.shape), offset])
        chunks += [bytes(padding), plain.tobytes()]
        offset += plain.nbytes
    payload = b"".join(chunks)
    header = json.dumps(
        {"arrays": entries, "meta": dict(meta), "payload": hashlib.sha256(payload).hexdigest()},
        separators=(",", ":"),
    ).encode()
    prefix = _PREFIX.pack(MAGIC, len(header), hashlib.sha256(header).digest())
    return prefix + header + payload


def unpack(content: bytes) -> Stored:
    """Return what `pack` was given. Raises DamagedError where a byte differs or nothing fits."""
    with _of_its_form():
        return _unpacked(content)


def _unpacked(content: bytes) -> Stored:
    header, start = _header(content)
    payload = memoryview(content)[start:]
    if hashlib.sha256(payload).hexdigest() != header["payload"]:
        raise DamagedError("the data differ from what was written")
    arrays = {}
    for name, dtype, shape, offset in header["arrays"]:
        kind, count = _plain_kind(name, dtype), math.prod(shape)
        if offset + count * kind.itemsize > len(payload):
            raise DamagedError(f"the array {name} reaches beyond the end of the file")
        # copied, hence aligned and writable, as it came from the stage: kernels compile
        # anew for any other layout
        flat = np.frombuffer(payload, kind, count, offset) if count else np.empty(0, kind)
        arrays[name] = flat.reshape(shape).copy()
    return Stored(arrays, header["meta"])


@contextmanager
def _of_its_form() -> Iterator[None]:
    """Hashes may be right although others wrote what they hash."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        if isinstance(error, DamagedError):
            raise
        raise DamagedError("its head is none of a product") from None


def canonical(array: Any) -> np.ndarray:
    """Return the array as the store gives it back: own memory, C order, little-endian."""
    return np.array(_plain(array), copy=True)


def _plain(array: Any) -> np.ndarray:
    """The array in C order, little-endian; itself where it is so already."""
    given = np.asarray(array)
    if given.dtype.kind not in _KINDS:
        raise TypeError(f"an array of {given.dtype} cannot be stored")
    return np.asarray(given, dtype=given.dtype.newbyteorder("<"), order="C")


@dataclass(frozen=True)
class Store:
    """The products below a folder. Reading needs no lock; writing is atomic."""

    root: Path

    @classmethod
    def open(cls, root: Path, *, create: bool = True) -> Store:
        """Return the store at `root`; where nothing is there yet, make it or take it as empty.

        Raises StoreError where the folder holds something else or a newer store.
        """
        root = Path(root)
        mark = root / "FORMAT"
        try:
            if create:
                root.mkdir(parents=True, exist_ok=True)
            if not mark.exists():
                if root.exists() and any(entry.suffix != ".partial" for entry in root.iterdir()):
                    raise StoreError(f"{root} is not empty and holds no store of demflow")
                if create:
                    write_durably(mark, MAGIC + b"\n")
            elif mark.read_bytes().strip() != MAGIC:
                raise StoreError(
                    f"{root} was made by another version of demflow "
                    f"({mark.read_bytes()[:40].decode(errors='replace').strip()}); "
                    "use that version, or another --results folder"
                )
        except OSError as error:
            raise StoreError(f"{root} cannot be used: {error.strerror or error}") from error
        return cls(root)

    def path(self, identity: str, kind: str = "product") -> Path:
        """Where a product (or, for kind "failed", the record of a failure) lies."""
        return Path(self._file(identity, kind))

    def _file(self, identity: str, kind: str = "product") -> str:
        """The same as text, which costs a tenth of time and memory: there are many."""
        if len(identity) != 64 or not _HEX.issuperset(identity):
            raise ValueError(f"{identity!r} is no identity of a product")
        return f"{self.root}/{identity[:2]}/{identity}.{kind}"

    def has(self, identity: str) -> bool:
        """Whether the product is there (whole or not: reading it tells)."""
        return os.path.exists(self._file(identity))

    def get(self, identity: str) -> Stored:
        """Return a product, its hash checked.

        Raises MissingError where it is not there, DamagedError where it is not what was
        written; the damaged file is set aside then, so that the product counts as missing.
        """
        with self._reading(identity) as path, _whole_file(path) as file:
            return _of(identity, unpack(file.read()))

    def content(self, identity: str) -> bytes:
        """Return a product as the bytes of its file, its hash checked. Raises as `get` does."""
        with self._reading(identity) as path, _whole_file(path) as file:
            content = file.read()
            _of(identity, unpack(content))
            return content

    def accept(self, files: Mapping[str, tuple[str, bytes]]) -> None:
        """Do as `keep` does with files that were packed elsewhere.

        Raises DamagedError where one is not what was packed there: then none is stored; OSError.
        """
        for identity, (_, content) in files.items():
            _of(identity, unpack(content))
        self.keep(files)

    def keep(self, files: Mapping[str, tuple[str, bytes]]) -> None:
        """Store packed files, kind and content by identity, in one flush. Raises OSError.

        A product replaces the record of an earlier failure, and the other way round.
        """
        write_all_durably({self._file(i, kind): content for i, (kind, content) in files.items()})
        for identity, (kind, _) in files.items():
            other = "failed" if kind == "product" else "product"
            with suppress(FileNotFoundError):
                os.unlink(self._file(identity, other))

    def meta(self, identity: str) -> dict[str, Any]:
        """Return a product's description alone. Raises as `get` does."""
        with self._reading(identity) as path:
            return _read_meta(path, identity)

    def put_failure(self, identity: str, meta: Mapping[str, Any]) -> None:
        """Record that a run failed, and how; a product of an earlier try goes."""
        self.keep({identity: ("failed", pack({}, {**meta, "id": identity}))})

    def failure(self, identity: str) -> dict[str, Any] | None:
        """Return the record of a failed run, None where there is none (or it is damaged)."""
        with suppress(MissingError, DamagedError), self._reading(identity, "failed") as path:
            record = _read_meta(path, identity)
            known = isinstance(record.get("status"), int) and record["status"] in FAILURES
            if not known or not isinstance(record.get("message"), str):
                raise DamagedError("it tells no failure")
            return record
        return None

    @contextmanager
    def _reading(self, identity: str, kind: str = "product") -> Iterator[str]:
        """Where a file lies that is read; a damaged one is set aside."""
        path = self._file(identity, kind)
        try:
            yield path
        except FileNotFoundError:
            raise MissingError(identity) from None
        except DamagedError as error:
            put_aside(path)
            raise DamagedError(f"{path}: {error}") from None
        except OSError as error:
            raise OSError(error.errno, error.strerror or str(error), path) from error

    def files(self) -> Iterator[Path]:
        """Every product and every record of a failure."""
        return self._files(".product", ".failed")

    def unwanted(self, wanted: Container[str]) -> Iterator[Path]:
        """Files whose identity is not wanted, and those that were set aside."""
        for path in self._files(".product", ".failed", ".damaged", ".partial"):
            if path.suffix in (".damaged", ".partial") or path.stem not in wanted:
                yield path

    def _files(self, *suffixes: str) -> Iterator[Path]:
        for folder in self._folders():
            yield from sorted(p for p in folder.iterdir() if p.suffix in suffixes)

    def _folders(self) -> list[Path]:
        """Those of the products, by the first digits of their identities."""
        return sorted(f for f in self.root.glob("[0-9a-f][0-9a-f]") if f.is_dir())

    def verify(self, *, set_aside: bool = True) -> Iterator[tuple[Path, str | None]]:
        """Re-hash every file: its path, and what is wrong with it or None.

        Damaged files are set aside if wished, so that the next run computes them again.
        """
        for folder in self._folders():
            try:
                paths = sorted(folder.iterdir())
            except OSError as error:
                yield folder, _unreadable(error)
                continue
            for path in paths:
                if path.suffix not in (".product", ".failed"):
                    continue
                try:
                    check_file(path)
                except DamagedError as error:
                    if set_aside:
                        put_aside(path)
                    yield path, str(error)
                except OSError as error:
                    yield path, _unreadable(error)
                else:
                    yield path, None

    def remove_partial(self) -> int:
        """Remove what interrupted writers left; return how many. Only under the folder's lock."""
        count = 0
        for path in self.root.glob("**/*.partial"):
            with suppress(OSError):  # it is in nobody's way
                path.unlink()
                count += 1
        return count


def check_file(path: Path) -> None:
    """Re-hash a file of the store, a piece at a time, and check the arrays that it names.

    Raises DamagedError where it is not what was written, or is no file; OSError.
    """
    with _whole_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(_PREFIX.size)
        if len(content) == _PREFIX.size:
            content += file.read(min(_PREFIX.unpack(content)[1], size))
        header, start = _header(content)
        _of(path.stem, Stored({}, header["meta"]))
        digest = hashlib.sha256()
        while piece := file.read(PIECE):
            digest.update(piece)
    if digest.hexdigest() != header["payload"]:
        raise DamagedError("the data differ from what was written")
    for name, kind, shape, offset in header["arrays"]:
        if start + offset + math.prod(shape) * _plain_kind(name, kind).itemsize > size:
            raise DamagedError(f"the array {name} reaches beyond the end of the file")


def _whole_file(path: str | Path) -> IO[bytes]:
    """Open a file of the store. Raises DamagedError where it is none: a pipe would never end."""
    if not stat.S_ISREG(os.stat(path).st_mode):
        raise DamagedError("it is no file")
    return open(path, "rb")


def _plain_kind(name: str, kind: str) -> np.dtype[Any]:
    """The type of an array by its name. Raises DamagedError where it is no plain data."""
    try:
        found = np.dtype(kind)
    except (TypeError, ValueError) as error:
        raise DamagedError(f"the array {name} is of {kind}, which is unknown") from error
    if found.kind not in _KINDS or found.names is not None:
        raise DamagedError(f"the array {name} is of {kind}, which is no plain data")
    return found


def _unreadable(error: OSError) -> str:
    return f"it cannot be read: {error.strerror or error}"


def put_aside(path: str | Path) -> None:
    """Rename a damaged file out of the way; it stays for whoever wants to look.

    Where that cannot be done it stays where it is, and is found damaged again.
    """
    with suppress(OSError):
        os.replace(path, f"{path}.damaged")


def _header(content: bytes) -> tuple[dict[str, Any], int]:
    if len(content) < _PREFIX.size:
        raise DamagedError("the file is cut short")
    magic, length, digest = _PREFIX.unpack_from(content)
    if magic != MAGIC:
        raise DamagedError("the file does not begin as a product of this version does")
    start = _PREFIX.size + length
    header = content[_PREFIX.size : start]
    if len(header) != length or hashlib.sha256(header).digest() != digest:
        raise DamagedError("the header differs from what was written")
    try:
        told = json.loads(header)
        entries = [(str(n), str(d), [int(k) for k in s], int(o)) for n, d, s, o in told["arrays"]]
        parts = {"arrays": entries, "meta": dict(told["meta"]), "payload": str(told["payload"])}
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise DamagedError("the header is none of a product") from error
    listed = all(isinstance(shape, list) for _, _, shape, _ in told["arrays"])
    if not listed or any(k < 0 for _, _, shape, offset in entries for k in (*shape, offset)):
        raise DamagedError("the header is none of a product")
    return parts, start


def _read_meta(path: str, identity: str) -> dict[str, Any]:
    with _whole_file(path) as file:
        content = file.read(_PREFIX.size)
        if len(content) == _PREFIX.size:
            length = _PREFIX.unpack(content)[1]
            # a damaged length must not ask for all memory
            content += file.read(min(length, os.fstat(file.fileno()).st_size))
    with _of_its_form():
        header, _ = _header(content)
        return _of(identity, Stored({}, dict(header["meta"]))).meta


def _of(identity: str, stored: Stored) -> Stored:
    if stored.meta.get("id") != identity:
        raise DamagedError("the file lies under a name that is not its own")
    return stored
