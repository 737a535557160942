"""The identity of a stage's product: a hash of all that it depends on, and of nothing else.

Values are written as bytes that say their type, their length and their content, so that
no two different values share an encoding. The bytes depend on no process, no hash seed
and no pickle protocol.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np


def encode(value: Any) -> bytes:
    """Return the canonical bytes of a parameter value.

    Takes None, booleans, integers, floats, strings, enumerations, arrays, and tuples,
    lists, mappings with string keys and dataclasses of these. Floats are taken bit by
    bit. Fields of a dataclass that are None are left out: an option added to the model
    later, None by default, leaves the identities of what was computed before alone.

    Raises TypeError for anything else, which has no content that could be hashed.
    """
    # bool before int and str before Sequence: the first match decides
    if value is None:
        return b"0"
    if isinstance(value, bool | np.bool_):
        return b"T" if value else b"F"
    if isinstance(value, Enum):
        return _tagged(b"e", value.name.encode())
    if isinstance(value, int | np.integer):
        return _tagged(b"i", str(int(value)).encode())
    if isinstance(value, float | np.floating):
        return b"f" + struct.pack("<d", value)
    if isinstance(value, str):
        return _tagged(b"s", value.encode())
    if isinstance(value, tuple | list):
        return _tagged(b"t", b"".join(map(encode, value)))
    if isinstance(value, Mapping):
        items = sorted(value.items())
        return _tagged(b"m", b"".join(encode(key) + encode(item) for key, item in items))
    if is_dataclass(value) and not isinstance(value, type):
        contents = {field.name: getattr(value, field.name) for field in fields(value)}
        given = {name: content for name, content in contents.items() if content is not None}
        parts = [encode(name) + encode(content) for name, content in given.items()]
        return _tagged(b"d", encode(type(value).__name__) + b"".join(parts))
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufcU":
        little = np.asarray(value, dtype=value.dtype.newbyteorder("<"), order="C")
        head = f"{little.dtype.str}{little.shape}".encode()
        return _tagged(b"a", _tagged(b"s", head) + little.tobytes())
    raise TypeError(f"a {type(value).__name__} has no canonical bytes: {value!r}")


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
    return tag + struct.pack("<Q", len(content)) + content


_NOTHING = encode(None)
