"""The identity of a stage's product: a hash of all that it depends on, and of nothing else.

Values are written as bytes that say their type, their length and their content, so that
no two different values share an encoding. The bytes depend on no process, no hash seed
and no pickle protocol.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any

import numpy as np

MANY = 16  # numbers that are written at once
_FLOATS = np.dtype([("tag", "S1"), ("value", "<f8")])
_DOUBLE, _LENGTH = struct.Struct("<d").pack, struct.Struct("<Q").pack


def encode(value: Any) -> bytes:
    """Return the canonical bytes of a parameter value.

    Takes None, booleans, integers, floats, strings, enumerations, arrays, and tuples,
    lists, mappings with string keys and dataclasses of these. Floats are taken bit by
    bit. Fields of a dataclass that are None are left out: an option added to the model
    later, None by default, leaves the identities of what was computed before alone.

    Raises TypeError for anything else, which has no content that could be hashed.
    """
    known = _OF_TYPE.get(type(value))
    return known(value) if known is not None else _of_another(value)


def _of_another(value: Any) -> bytes:
    """The same of what is no builtin: a type of NumPy's, one that inherits, a dataclass."""
    # bool before int and str before Sequence: the first match decides
    if isinstance(value, np.bool_):
        return _of_bool(bool(value))
    if isinstance(value, Enum):
        return _tagged(b"e", value.name.encode())
    if isinstance(value, int | np.integer):
        return _of_int(int(value))
    if isinstance(value, float | np.floating):
        return _of_float(float(value))
    if isinstance(value, str):
        return _of_str(value)
    if isinstance(value, tuple | list):
        return _of_sequence(value)
    if isinstance(value, Mapping):
        return _of_mapping(value)
    if is_dataclass(value) and not isinstance(value, type):
        head, names = _parts_of(type(value))
        parts = [head]
        for name, encoded in names:
            if (content := getattr(value, name)) is not None:
                parts += (encoded, encode(content))
        return _tagged(b"d", b"".join(parts))
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufcU":
        little = np.asarray(value, dtype=value.dtype.newbyteorder("<"), order="C")
        head = f"{little.dtype.str}{little.shape}".encode()
        return _tagged(b"a", _tagged(b"s", head) + little.tobytes())
    raise TypeError(f"a {type(value).__name__} has no canonical bytes: {value!r}")


def _of_bool(value: bool) -> bytes:
    return b"T" if value else b"F"


def _of_int(value: int) -> bytes:
    return _tagged(b"i", str(value).encode())


def _of_float(value: float) -> bytes:
    return b"f" + _DOUBLE(value)


def _of_str(value: str) -> bytes:
    return _tagged(b"s", value.encode())


def _of_sequence(value: Sequence[Any]) -> bytes:
    if len(value) >= MANY and set(map(type, value)) == {float}:  # as times are
        each = np.empty(len(value), dtype=_FLOATS)
        each["tag"], each["value"] = b"f", value
        return _tagged(b"t", each.tobytes())
    return _tagged(b"t", b"".join(map(encode, value)))


def _of_mapping(value: Mapping[str, Any]) -> bytes:
    items = sorted(value.items())
    return _tagged(b"m", b"".join([encode(key) + encode(item) for key, item in items]))


@cache
def _parts_of(kind: type) -> tuple[bytes, tuple[tuple[str, bytes], ...]]:
    """The encoded name of a dataclass, and those of its fields."""
    return _of_str(kind.__name__), tuple((f.name, _of_str(f.name)) for f in fields(kind))


# a hundred thousand cases are mostly these; whatever inherits from them finds its own way
_OF_TYPE: dict[type, Callable[[Any], bytes]] = {
    type(None): lambda _: b"0",
    bool: _of_bool,
    int: _of_int,
    float: _of_float,
    str: _of_str,
    tuple: _of_sequence,
    list: _of_sequence,
    dict: _of_mapping,
}


def product_id(
    stage: str,
    version: int | tuple[int, str],
    reads: Mapping[str, bytes],
    parents: Mapping[str, str | None],
) -> str:
    """Return the identity of a stage's product, 64 hexadecimal digits (SHA-256).

    A parent that is not run and a part that the scene has not got (None) are left out, as fields
    of a dataclass are: what a stage may take one day leaves alone the identities of all that was
    made without it.

    Parameters
    ----------
    stage, version : the row of the table; the version with its sources, where more than one state
        of them is known.
    reads : canonical bytes (`encode`) of each part of the scene that the stage reads, by name.
    parents : identities of the products that it takes, by the names of their stages.
    """
    taken = {name: parent for name, parent in parents.items() if parent is not None}
    digest = hashlib.sha256(encode((stage, version, taken)))
    for name in sorted(reads):
        if reads[name] != _NOTHING:
            digest.update(encode(name) + _tagged(b"v", reads[name]))
    return digest.hexdigest()


def _tagged(tag: bytes, content: bytes) -> bytes:
    return tag + _LENGTH(len(content)) + content


_NOTHING = encode(None)
