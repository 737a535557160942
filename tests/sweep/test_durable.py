"""Durable writing: whole or not at all, flushed before it counts, by either way to flush."""

from __future__ import annotations

import os

import pytest

from demflow.sweep.store import durable
from demflow.sweep.store.durable import write_all_durably, write_durably


@pytest.fixture(params=["together", "one by one"])
def way(request, monkeypatch):
    """Both ways to flush; the second is that of systems without a `syncfs` to trust."""
    if request.param == "one by one":
        monkeypatch.setattr(durable, "_syncfs", lambda: None)
    elif durable._syncfs() is None:
        pytest.fail("this system flushes files one by one only: run this on Linux 5.8 or later")
    monkeypatch.setattr(durable, "_unwritten", lambda: 0)
    return request.param


def contents(folder):
    return {
        p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()
    }


def test_all_files_are_there_whole(tmp_path, way):
    wanted = {f"{k % 7}/deeper/{k}": bytes([k]) * k * 1000 for k in range(40)}
    write_all_durably({tmp_path / name: content for name, content in wanted.items()})
    assert contents(tmp_path) == wanted


def record(monkeypatch):
    """What reaches the system, in order."""
    calls = []

    def telling(kind, function):
        def told(*args):
            calls.append((kind, args))
            return function(*args)

        return told

    monkeypatch.setattr(durable.os, "fsync", telling("flush", os.fsync))
    monkeypatch.setattr(durable.os, "replace", telling("rename", os.replace))
    if (flush := durable._syncfs()) is not None:
        monkeypatch.setattr(durable, "_syncfs", lambda: telling("flush all", flush))
    return calls


def test_no_name_before_the_content_and_no_answer_before_the_name(tmp_path, way, monkeypatch):
    """Data are flushed before the first rename, names after the last."""
    calls = record(monkeypatch)
    write_all_durably({tmp_path / str(k) / "file": b"x" for k in range(8)})
    kinds = [kind for kind, _ in calls]
    first, last = kinds.index("rename"), len(kinds) - 1 - kinds[::-1].index("rename")
    before, after = kinds[:first], kinds[last + 1 :]
    if way == "together":
        assert before == after == ["flush all"]
    else:
        # each file; then each folder, and the one above in which they were made
        assert before == ["flush"] * 8
        assert after == ["flush"] * 9


def test_a_busy_disk_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(durable, "_unwritten", lambda: durable.FOREIGN_BYTES + 1)
    calls = record(monkeypatch)
    write_all_durably({tmp_path / str(k): b"x" for k in range(8)})
    assert "flush all" not in [kind for kind, _ in calls]


@pytest.mark.parametrize("place", ["fsync", "replace", "open", "syncfs"])
@pytest.mark.parametrize("count", [1, 8])
def test_a_failing_disk_leaves_the_earlier_content(tmp_path, monkeypatch, place, count):
    files = {tmp_path / str(k): b"before" for k in range(count)}
    write_all_durably(files)

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    if place == "open":
        monkeypatch.setattr("builtins.open", fail)
    elif place == "syncfs":
        monkeypatch.setattr(durable, "FEW", 0)
        monkeypatch.setattr(durable, "_syncfs", lambda: fail)
    else:
        monkeypatch.setattr(durable, "_syncfs", lambda: None)
        monkeypatch.setattr(durable.os, place, fail)
    with pytest.raises(OSError, match="No space"):
        write_all_durably(dict.fromkeys(files, b"after"))
    monkeypatch.undo()
    assert contents(tmp_path) == dict.fromkeys((p.name for p in files), b"before")


def test_the_system_tells_why_it_could_not_flush(tmp_path):
    """An error of the system becomes an OSError with its number."""
    with (tmp_path / "file").open("wb") as file:
        descriptor = file.fileno()
    with pytest.raises(OSError, match="Bad file descriptor"):
        durable._flush_all(descriptor)


def test_a_file_is_replaced(tmp_path):
    write_durably(tmp_path / "file", b"before")
    write_durably(tmp_path / "file", b"after")
    assert contents(tmp_path) == {"file": b"after"}
