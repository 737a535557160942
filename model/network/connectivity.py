"""Connected parts of a graph given by its edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def component_labels(n: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Number of the connected part to which each of n nodes belongs, given edges (a, b).

    Parameters
    ----------
    n : number of nodes
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    """
    if n == 0:
        return np.empty(0, dtype=np.int64)
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(n, n))
    found: np.ndarray = connected_components(graph, directed=False)[1]
    return found


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
    return np.isin(label, label[np.asarray(origins, dtype=np.int64)])
