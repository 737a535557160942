"""Cutting the cases of a study into blocks that are collected and written at once."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tile:
    """Cases that lie side by side in the dataset: all of the last axes, a part of one."""

    cases: range
    at: tuple[int | slice, ...]  # where they lie among the axes
    shape: tuple[int, ...]  # of the block that `at` selects


def tiles(shape: tuple[int, ...], most: int) -> Iterator[Tile]:
    """Cut the cases of a study (the last axis runs fastest) into tiles of at most `most`."""
    if not shape:
        yield Tile(range(1), (), ())
        return
    # axes behind `cut` are whole in a tile, those before it stand still
    cut = len(shape) - 1
    while cut > 0 and math.prod(shape[cut:]) <= most:
        cut -= 1
    inner = math.prod(shape[cut + 1 :])
    step = max(1, min(shape[cut], most // inner))
    for number, outer in enumerate(np.ndindex(*shape[:cut])):
        for start in range(0, shape[cut], step):
            stop = min(start + step, shape[cut])
            first = (number * shape[cut] + start) * inner
            yield Tile(
                range(first, first + (stop - start) * inner),
                (*outer, slice(start, stop), *(slice(None) for _ in shape[cut + 1 :])),
                (stop - start, *shape[cut + 1 :]),
            )
