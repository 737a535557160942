"""One aperture is one permeability, and one porosity, wherever it is in the rock.

What a part of a packing conducts scatters by some per cent, as grains happen to lie, and grains of
several sizes do not come to rest alike: finer ones are some 6 % denser beside a well.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from demflow.model.products import Network

POOLED = 60  # pores nearest to a place of which its rock is measured, fewer the further away
PASSES = 3  # each leaves some third of the differences of the one before
CHUNK = 20_000  # pores whose neighbours are held in memory at once


def evened(network: Network) -> Network:
    """The same pores, with lengths of pipes and volumes of rock that is alike everywhere.

    What rock conducts is compared by its dissipation where pressure is linear, Σ g Δx² / A over
    the pores around, of one aperture everywhere; pipes are made longer where it is above the
    mean. Volumes are scaled to the porosity of the whole.

    Parameters
    ----------
    network : pores and pipes of a graded packing
    """
    pores = np.flatnonzero(network.area > 0.0)
    place = np.column_stack([network.x, network.y])
    i, j = network.pipe_from, network.pipe_to
    squared = np.sum((place[i] - place[j]) ** 2, axis=1)
    weight = np.where(network.inside, network.area, 0.0)[pores]
    length, count = network.pipe_length, len(network.x)
    tree = cKDTree(place[pores])
    for _ in range(PASSES):
        conducts = squared / length
        own = np.bincount(i, conducts, count) + np.bincount(j, conducts, count)
        found = _pooled(tree, own[pores], network.area[pores])
        over = np.ones(count)
        over[pores] = found / np.average(found, weights=weight)
        length = length * np.sqrt(over[i] * over[j])
    volume = network.volume.copy()
    volume[pores] *= float(network.porosity) / _pooled(tree, volume[pores], network.area[pores])
    return network._replace(pipe_length=length, volume=volume)


def _pooled(tree: cKDTree, amount: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Amount per area of the pores around each, (n,)."""
    found = np.empty(len(amount))
    for first in range(0, len(amount), CHUNK):
        of = slice(first, first + CHUNK)
        distance, near = tree.query(tree.data[of], k=np.arange(1, min(POOLED, tree.n) + 1))
        share = 1.0 - (distance / (1.001 * distance[:, -1:] + np.finfo(float).tiny)) ** 2
        found[of] = (share * amount[near]).sum(axis=1) / (share * area[near]).sum(axis=1)
    return found
