"""One aperture is one permeability, and one porosity, wherever it is in the rock.

What a part of a packing conducts scatters by some per cent, as grains happen to lie, and grains of
several sizes do not come to rest alike: finer ones are some 6 % denser beside a well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from demflow.model.products import Network

POOLED = 16  # pores nearest to a place of which its rock is measured, fewer the further away
PASSES = 3  # each leaves some third of the differences of the one before
CHUNK = 20_000  # pores whose neighbours are held in memory at once


def evened(network: Network) -> Network:
    """The same pores, with lengths of pipes and volumes of rock that is alike everywhere.

    What rock conducts is compared by its dissipation where pressure is linear, Σ g Δ ⊗ Δ / A over
    the pores around, of one aperture everywhere; pipes are made longer where, and along which, it
    is above the mean. Volumes are scaled to the porosity of the whole.

    Parameters
    ----------
    network : pores and pipes of a graded packing
    """
    pores = np.flatnonzero(network.area > 0.0)
    place = np.column_stack([network.x, network.y])
    i, j = network.pipe_from, network.pipe_to
    step = place[j] - place[i]
    squared = np.maximum((step * step).sum(axis=1), np.finfo(float).tiny)
    # of a direction, in twice its angle: that of a tensor's part without trace
    double = np.column_stack([step[:, 0] ** 2 - step[:, 1] ** 2, 2.0 * step[:, 0] * step[:, 1]])
    weight = np.where(network.inside, network.area, 0.0)[pores]
    length, count = network.pipe_length, len(network.x)
    around = _Around(cKDTree(place[pores]), network.area[pores])
    for _ in range(PASSES):
        conducts = np.column_stack([squared, double]) / length[:, None]
        own = np.zeros((count, 3))
        np.add.at(own, i, conducts)
        np.add.at(own, j, conducts)
        over = np.tile([1.0, 0.0, 0.0], (count, 1))
        over[pores] = around.pooled(own[pores])
        over[pores] /= np.average(over[pores, 0], weights=weight)
        alike = np.sqrt(over[i, 0] * over[j, 0])
        along = (0.5 * (over[i] + over[j])[:, 1:] * double).sum(axis=1) / squared
        # a change of pipes by their direction changes the tensor by half of it
        length = length * alike * np.exp(2.0 * along / alike)
    volume = network.volume.copy()
    volume[pores] *= float(network.porosity) / around.pooled(volume[pores, None])[:, 0]
    return network._replace(pipe_length=length, volume=volume)


class _Around(NamedTuple):
    """The pores around each."""

    tree: cKDTree
    area: np.ndarray  # (n,)

    def pooled(self, amount: np.ndarray) -> np.ndarray:
        """Amounts (n, k) per area of the pores around each, (n, k)."""
        found = np.empty_like(amount)
        most = np.arange(1, min(POOLED, self.tree.n) + 1)
        for first in range(0, len(amount), CHUNK):
            of = slice(first, first + CHUNK)
            distance, near = self.tree.query(self.tree.data[of], k=most)
            share = 1.0 - (distance / (1.001 * distance[:, -1:] + np.finfo(float).tiny)) ** 2
            weighed = np.einsum("ij,ijk->ik", share, amount[near])
            found[of] = weighed / (share * self.area[near]).sum(axis=1)[:, None]
        return found
