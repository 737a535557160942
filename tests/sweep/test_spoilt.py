"""Whatever is done to a file of the store, it is found, and never taken for what was written."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from demflow.model.outcome import Status
from demflow.sweep.command.upkeep import verify
from demflow.sweep.store import durable
from demflow.sweep.store.durable import write_durably
from demflow.sweep.store.products import DamagedError, MissingError, Store, pack
from tests.sweep.stored import put

ONE, OTHER = "ab" + 62 * "0", "ab" + 62 * "1"
ARRAYS = {"pressure": np.arange(100.0), "name": np.array("well"), "count": np.array(3)}


@pytest.fixture
def store(tmp_path):
    made = Store.open(tmp_path / "results" / "store")
    for identity in (ONE, OTHER):
        put(made, identity, ARRAYS, {"seconds": 1.0})
    return made


def with_header(change):
    """A spoiling of the header, whose own hash is right again."""

    def spoil(path):
        content = path.read_bytes()
        _, length, _ = struct.unpack_from("<8sQ32s", content)
        told = json.loads(content[48 : 48 + length])
        told = change(told)
        header = told if isinstance(told, bytes) else json.dumps(told).encode()
        prefix = struct.pack("<8sQ32s", content[:8], len(header), hashlib.sha256(header).digest())
        path.write_bytes(prefix + header + content[48 + length :])

    return spoil


def array(k, value, which=0):
    def change(told):
        told["arrays"][which][k] = value
        return told

    return with_header(change)


def without(key):
    return with_header(lambda told: {k: v for k, v in told.items() if k != key})


def cut(size):
    return lambda path: os.truncate(path, size)


def flip(at):
    def spoil(path):
        content = bytearray(path.read_bytes())
        content[at] ^= 4
        path.write_bytes(content)

    return spoil


def swap(path):
    path.unlink()
    path.mkdir()


def pipe(path):
    path.unlink()
    os.mkfifo(path)


def dangling(path):
    path.unlink()
    path.symlink_to(path.parent / "nowhere")


SPOILINGS = {
    **{f"cut to {size}": cut(size) for size in (0, 1, 7, 8, 15, 16, 47, 48, 49, 100, 300, 600)},
    **{f"bit flipped at {at}": flip(at) for at in (0, 5, 8, 12, 15, 16, 40, 48, 60, 200, 500, -1)},
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"more"),
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "text": lambda path: path.write_text("product"),
    "of another": lambda path: path.write_bytes(path.with_name(f"{OTHER}.product").read_bytes()),
    "renamed identity": with_header(lambda told: told | {"meta": {"id": OTHER}}),
    "no identity": with_header(lambda told: told | {"meta": {}}),
    "no description": without("meta"),
    "no arrays": without("arrays"),
    "no hash": without("payload"),
    "description is a list": with_header(lambda told: told | {"meta": [1]}),
    "header is a number": with_header(lambda told: 3),
    "header is no text": with_header(lambda told: b"\xff\xfe"),
    "header is deep": with_header(lambda told: b"[" * 100_000),
    "array of objects": array(1, "|O8"),
    "array of nothing known": array(1, "no type"),
    "array of a record": array(1, "f8,f8"),
    "array too large": array(2, [10**9]),
    "array beyond all": array(2, [10**30]),
    "array of less than nothing": array(2, [-1]),
    "array behind the end": array(3, 10**6),
    "array before the begin": array(3, -64),
    "shape is a word": array(2, "100"),
    "a folder": swap,
    "a pipe": pipe,
    "a link to nothing": dangling,
}


@pytest.mark.parametrize("name", SPOILINGS)
def test_what_is_spoilt_is_found_and_nothing_else(store, name):
    path = store.path(ONE)
    SPOILINGS[name](path)
    found = verify(store.root.parent)
    assert [where.name for where, _ in found.damaged] == [path.name]
    assert found.checked == 2
    for read in (store.get, store.content, store.meta):
        with pytest.raises((DamagedError, MissingError)):
            read(ONE)
    assert store.get(OTHER).arrays["count"] == 3
    if name != "a link to nothing":
        assert not store.has(ONE)  # it was set aside, and is computed again
    put(store, ONE, ARRAYS, {"seconds": 1.0})
    assert verify(store.root.parent).damaged == []


@pytest.mark.parametrize("name", [n for n in SPOILINGS if n != "a link to nothing"])
def test_reading_alone_finds_it_too(store, name):
    SPOILINGS[name](store.path(ONE))
    with pytest.raises(DamagedError):
        store.get(ONE)
    with pytest.raises(MissingError):
        store.get(ONE)


@pytest.mark.parametrize("meta", [{"status": 99}, {"status": "failed"}, {}, {"status": 1}])
def test_a_record_of_a_failure_without_a_known_status_is_none(store, meta):
    third = 64 * "c"
    words = {} if meta == {"status": 1} else {"message": "dry"}
    store.keep({third: ("failed", pack({}, {**meta, **words, "id": third}))})
    assert store.failure(third) is None
    store.put_failure(third, {"status": int(Status.FAILED), "message": "dry"})
    assert store.failure(third)["message"] == "dry"


def test_verify_goes_on_past_what_it_cannot_read(store, monkeypatch):
    (store.root / "cd").write_text("no folder")
    unreadable = store.path(ONE)
    real = os.stat

    def stat(path, *arguments, **options):
        if os.fspath(path) == os.fspath(unreadable):
            raise OSError(errno.EIO, "Input/output error")
        return real(path, *arguments, **options)

    monkeypatch.setattr("demflow.sweep.store.products.os.stat", stat)
    found = verify(store.root.parent)
    monkeypatch.undo()
    assert [(p.name, what) for p, what in found.damaged] == [
        (unreadable.name, "it cannot be read: Input/output error")
    ]
    assert store.has(ONE)  # it is not set aside: the disk may give it yet


def test_an_error_of_the_disk_names_the_file(store, monkeypatch):
    def broken(path):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("demflow.sweep.store.products._whole_file", broken)
    with pytest.raises(OSError, match="Input/output error") as told:
        store.get(ONE)
    assert told.value.filename == str(store.path(ONE))


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP])
def test_a_file_system_that_cannot_flush_folders_works(tmp_path, monkeypatch, number):
    real = os.fsync

    def fsync(descriptor):
        if Path(f"/proc/self/fd/{descriptor}").is_dir():
            raise OSError(number, os.strerror(number))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(durable, "unflushed", set())
    write_durably(tmp_path / "file", b"content")
    assert (tmp_path / "file").read_bytes() == b"content"
    assert durable.unflushed == {str(tmp_path)}
