"""Wells without storage: their pressure follows the pores around them at once.

The rows of the wells at a rate are algebraic, K_ww p_w = f_w + G_wd p_d, with a small dense
K_ww. Eliminating them leaves an ordinary differential equation for the pores alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from demflow.model.flow.equation.system import System
from demflow.model.outcome import ModelError

# Up to so many wells their conductances are a dense matrix: what a sparse one takes for each
# product would be most of its time.
DENSE = 4


class Algebraic(NamedTuple):
    """The wells that store nothing as functions of the unknowns that do."""

    inverse: np.ndarray  # (w, w) K_ww⁻¹
    near: np.ndarray  # (k,) pores that wells meet, of
    pores: int  # unknowns that store
    coupling: csr_array | np.ndarray  # (w, k) conductances G_wd

    def follow(self, pores: np.ndarray) -> np.ndarray:
        """Pressures of the wells that follow those of the pores (pores, …), (w, …)."""
        found: np.ndarray = self.inverse @ (self.coupling @ pores[self.near])
        return found

    def lift(self, pores: np.ndarray) -> np.ndarray:
        """Pores (pores, …) completed by the wells that follow them, (n, …)."""
        if len(pores) == 0:
            return np.zeros((len(self.inverse), *pores.shape[1:]))
        return np.concatenate([pores, self.follow(pores)])

    def reduce_source(self, rhs: np.ndarray) -> np.ndarray:
        """Source on the pores alone that acts as `rhs` (n,) does, (pores,)."""
        found = rhs[: self.pores].copy()
        found[self.near] += self.coupling.T @ (self.inverse @ rhs[self.pores :])
        return found

    def direct(self, rhs: np.ndarray) -> np.ndarray:
        """What `rhs` (n,) adds to the wells by itself, (w,) Pa."""
        found: np.ndarray = self.inverse @ rhs[self.pores :]
        return found


def algebraic(system: System) -> Algebraic:
    """Set up the elimination of the wells.

    Raises `ModelError` where a well has no conducting pipe.
    """
    wells, pores = system.n - system.pores, system.pores
    matrix = np.zeros((wells, wells))
    rows, columns, values = [], [], []
    for i, j in ((system.edge_i, system.edge_j), (system.edge_j, system.edge_i)):
        at_well = i >= pores
        w, other, g = i[at_well] - pores, j[at_well], system.edge_g[at_well]
        np.add.at(matrix, (w, w), g)
        between = other >= pores
        np.subtract.at(matrix, (w[between], other[between] - pores), g[between])
        rows.append(w[~between])
        columns.append(other[~between])
        values.append(g[~between])
    np.add.at(matrix, (np.arange(wells), np.arange(wells)), system.excess[pores:])
    if wells and not np.diag(matrix).all():
        raise ModelError(
            "a well, or a side with an inflow, touches no conducting pipe: move or widen the well, "
            "or give the matrix an aperture"
        )
    near, place = np.unique(np.concatenate(columns), return_inverse=True)
    row, value = np.concatenate(rows), np.concatenate(values)
    coupling: csr_array | np.ndarray
    if wells <= DENSE:
        coupling = np.zeros((wells, len(near)))
        np.add.at(coupling, (row, place), value)
    else:
        coupling = csr_array((value, (row, place)), shape=(wells, len(near)))
    return Algebraic(np.linalg.inv(matrix) if wells else matrix, near, pores, coupling)
