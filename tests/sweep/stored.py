"""Products put into a store without a worker."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from demflow.sweep.store.products import Store, pack


def put(
    store: Store, identity: str, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]
) -> int:
    """Store a product as a worker does and return its size in bytes."""
    content = pack(arrays, {**meta, "id": identity})
    store.keep({identity: ("product", content)})
    return len(content)
