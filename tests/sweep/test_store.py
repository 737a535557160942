"""The store: what comes back is what was written, or it is known to be damaged."""

from __future__ import annotations

import hashlib
import json
import os
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from demflow.sweep.store.products import (
    MAGIC,
    DamagedError,
    MissingError,
    Store,
    StoreError,
    pack,
    unpack,
)
from tests.sweep.stored import put

ID = "ab" + "0" * 62
ARRAYS = {
    "x": np.linspace(0.0, 1.0, 7),
    "kind": np.array([[True, False]]),
    "count": np.asarray(3),
    "name": np.array(["bi-wing", "µ"]),
    "nothing": np.empty((0, 2)),
}

arrays = hnp.arrays(
    dtype=st.sampled_from(["<f8", ">f8", "<i8", "<i4", "?", "<c16", "<U3", "u1"]),
    shape=hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)


@pytest.fixture
def store(tmp_path):
    return Store.open(tmp_path / "store")


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype.newbyteorder("=") == b.dtype.newbyteorder("=") and np.array_equal(
        a, b, equal_nan=a.dtype.kind in "fc"
    )


@given(st.dictionaries(st.text(max_size=5), arrays, max_size=3))
def test_arrays_come_back_as_they_were(content):
    back = unpack(pack(content, {"seconds": 0.25})).arrays
    assert list(back) == list(content)
    for name, array in content.items():
        assert back[name].shape == array.shape
        assert same(array, back[name])
        flags = back[name].flags
        # a kernel compiles anew for any other layout
        assert flags.c_contiguous
        assert flags.aligned
        assert flags.writeable


def test_every_flipped_bit_is_found():
    content = pack({"x": np.arange(3.0), "n": np.asarray(1)}, {"stage": "pack"})
    for position in range(len(content)):
        flipped = bytearray(content)
        flipped[position] ^= 1 << (position % 8)
        with pytest.raises(DamagedError):
            unpack(bytes(flipped))


def test_every_truncation_is_found():
    content = pack({"x": np.arange(3.0)}, {"stage": "pack"})
    for length in range(len(content)):
        with pytest.raises(DamagedError):
            unpack(content[:length])


def test_data_only(store):
    with pytest.raises(TypeError, match="cannot be stored"):
        pack({"x": np.array([object()])}, {})
    forged = pack({"x": np.arange(3.0)}, {}).replace(b'"<f8"', b'"|O8"')
    # with a header hash that fits, the type alone must refuse it
    length = int.from_bytes(forged[8:16], "little")
    header = forged[48 : 48 + length]
    forged = forged[:16] + hashlib.sha256(header).digest() + forged[48:]
    with pytest.raises(DamagedError, match="no plain data"):
        unpack(forged)


def test_a_product_is_there_or_not(store):
    assert not store.has(ID)
    with pytest.raises(MissingError):
        store.get(ID)
    size = put(store, ID, ARRAYS, {"seconds": 1.5})
    assert store.path(ID).stat().st_size == size
    assert store.has(ID)
    back = store.get(ID)
    assert all(same(array, back.arrays[name]) for name, array in ARRAYS.items())
    assert back.meta == store.meta(ID) == {"seconds": 1.5, "id": ID}


@pytest.mark.parametrize("read", [Store.get, Store.meta])
def test_a_damaged_product_is_set_aside(store, read):
    put(store, ID, ARRAYS, {})
    path = store.path(ID)
    content = bytearray(path.read_bytes())
    content[60] ^= 4
    path.write_bytes(content)
    with pytest.raises(DamagedError, match=ID):
        read(store, ID)
    assert not store.has(ID)
    assert [p.name for p in path.parent.iterdir()] == [f"{ID}.product.damaged"]


def test_verify_finds_all_and_only_what_is_damaged(store):
    names = [f"{k:02x}" + "f" * 62 for k in range(40)]
    for name in names:
        put(store, name, {"x": np.arange(5.0)}, {"stage": "pack"})
    store.put_failure(ID, {"status": 1, "message": "no"})
    assert [problem for _, problem in store.verify()] == [None] * 41
    os.truncate(store.path(names[3]), 100)
    store.path(names[5]).replace(store.path(names[7]))  # under a name that is not its own
    store.path(ID, "failed").write_bytes(b"")
    kept = {path.name for path, problem in store.verify(set_aside=False) if problem}
    assert kept == {f"{names[3]}.product", f"{names[7]}.product", f"{ID}.failed"}
    assert {path.name for path, problem in store.verify() if problem} == kept
    assert all(problem is None for _, problem in store.verify())


def test_failures_are_remembered_until_there_is_a_product(store):
    assert store.failure(ID) is None
    store.put_failure(ID, {"status": 1, "message": "the well is dry"})
    assert store.failure(ID)["message"] == "the well is dry"
    put(store, ID, ARRAYS, {})
    assert store.failure(ID) is None
    store.put_failure(ID, {"status": 1, "message": "and again"})
    assert not store.has(ID)


def test_what_interrupted_writers_left_is_removed(store):
    put(store, ID, ARRAYS, {})
    (store.path(ID).parent / f"{ID}.product.1.partial").write_bytes(b"half")
    (store.root / "FORMAT.1.partial").write_bytes(b"")
    assert store.remove_partial() == 2
    assert store.has(ID)


def test_folders_that_are_no_store_are_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("\\begin{document}")
    with pytest.raises(StoreError, match="holds no store"):
        Store.open(tmp_path)
    newer = tmp_path / "newer"
    newer.mkdir()
    (newer / "FORMAT").write_bytes(b"demflow9\n")
    with pytest.raises(StoreError, match="another version"):
        Store.open(newer)
    (tmp_path / "file").write_bytes(MAGIC)
    with pytest.raises(StoreError, match="cannot be used"):
        Store.open(tmp_path / "file" / "store")
    assert not Store.open(tmp_path / "absent", create=False).has(ID)
    assert not (tmp_path / "absent").exists()


@pytest.mark.parametrize("name", ["", "ab", "../" + "a" * 61, "G" * 64])
def test_only_identities_reach_a_path(store, name):
    with pytest.raises(ValueError, match="no identity"):
        store.path(name)


@pytest.mark.parametrize(
    "head",
    [
        {},
        [],
        {"meta": 5, "payload": "", "arrays": []},
        {"meta": {"id": "0" * 64}},
        {"meta": {"id": "0" * 64}, "payload": hashlib.sha256().hexdigest(), "arrays": 5},
        {"meta": {"id": "0" * 64}, "payload": hashlib.sha256().hexdigest(), "arrays": [[1]]},
        {
            "meta": {"id": "0" * 64},
            "payload": hashlib.sha256().hexdigest(),
            "arrays": [["x", "<f8", [9], 0]],
        },
    ],
)
def test_a_file_of_right_hashes_and_other_content_is_damaged(tmp_path, head):
    store = Store.open(tmp_path / "store")
    header = json.dumps(head).encode()
    content = struct.pack("<8sQ32s", MAGIC, len(header), hashlib.sha256(header).digest()) + header
    path = store.path("0" * 64)
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(DamagedError):
        store.get("0" * 64)


@pytest.mark.parametrize(
    "record", [{}, {"status": 99, "message": "x"}, {"status": 1}, {"status": 0, "message": "x"}]
)
def test_a_record_that_tells_no_failure_is_none(tmp_path, record):
    store = Store.open(tmp_path / "store")
    store.put_failure("0" * 64, record)
    assert store.failure("0" * 64) is None
