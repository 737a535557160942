"""Connected parts of a graph given by its edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from demflow.model.compile import Array, kernel


def component_labels(n: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Number of the connected part to which each of n nodes belongs, given edges (a, b).

    Parts are numbered in the order of their first nodes.

    Parameters
    ----------
    n : number of nodes
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    """
    return np.asarray(_labels(n, np.asarray(a, dtype=np.int64), np.asarray(b, dtype=np.int64)))


@kernel
def _labels(n: int, a: Array, b: Array) -> Array:
    """By trees whose roots are their first nodes, halved on the way (Tarjan 1975, J. ACM 22)."""
    above = np.arange(n)
    for k in range(a.size):
        i, j = a[k], b[k]
        while above[i] != i:
            above[i] = above[above[i]]
            i = above[i]
        while above[j] != j:
            above[j] = above[above[j]]
            j = above[j]
        if i < j:
            above[j] = i
        else:
            above[i] = j
    count = 0
    for i in range(n):  # a root comes before all that hangs on it
        if above[i] == i:
            above[i] = -1 - count
            count += 1
        else:
            above[i] = above[above[i]]
    return -1 - above


def reached(
    n: int, a: np.ndarray, b: np.ndarray, origins: np.ndarray | Sequence[int]
) -> np.ndarray:
    """Which of n nodes edges (a, b) connect to one of the origins, as a mask (n,).

    Parameters
    ----------
    n : number of nodes
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    origins : nodes (k,) from which the others are looked for
    """
    label = component_labels(n, a, b)
    found = np.zeros(n, dtype=bool)  # no more parts than nodes
    found[label[np.asarray(origins, dtype=np.int64)]] = True
    return np.asarray(found[label])
