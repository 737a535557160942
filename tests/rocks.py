"""Small rocks made by hand, without mechanics: lattices and random planar graphs as packings."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import Delaunay

from demflow.model.products import Packing


def packing_of(x, y, radius, pairs) -> Packing:
    """A packing at rest from grains and touching pairs."""
    pairs = _distinct(np.asarray(pairs, dtype=np.int64))
    zeros = np.zeros(len(pairs))
    return Packing(
        x=np.asarray(x, dtype=float),
        y=np.asarray(y, dtype=float),
        radius=np.asarray(radius, dtype=float),
        contact_a=pairs[:, 0].copy(),
        contact_b=pairs[:, 1].copy(),
        normal_force=zeros,
        shear_force=zeros,
        box=np.array([min(x), max(x), min(y), max(y)]),
        porosity=np.asarray(0.2),
        coordination=np.asarray(2.0 * len(pairs) / len(x)),
        floaters=np.asarray(0),
        packing_friction=np.asarray(0.0),
        packing_pressure=np.asarray(0.0),
        unbalanced_ratio=np.asarray(0.0),
        steps=np.asarray(0),
    )


def _distinct(pairs: np.ndarray) -> np.ndarray:
    """Pairs (m, 2) of grains, each once, the smaller number first, in order."""
    low, high = np.sort(pairs, axis=1).T
    count = int(high.max(initial=0)) + 1
    return np.column_stack(np.divmod(np.unique(low * count + high), count))


def square_lattice(half_extent: float, radius: float, shift=(0.0, 0.0)) -> Packing:
    """Equal grains on a square lattice that covers [−half_extent, half_extent]²."""
    m = math.ceil(half_extent / (2 * radius)) + 2
    k = np.arange(-m, m + 1)
    i, j = np.meshgrid(k, k, indexing="ij")
    index = np.arange(i.size).reshape(i.shape)
    pairs = np.concatenate(
        [
            np.column_stack([index[:-1].ravel(), index[1:].ravel()]),
            np.column_stack([index[:, :-1].ravel(), index[:, 1:].ravel()]),
        ]
    )
    x = 2 * radius * i.ravel() + shift[0]
    y = 2 * radius * j.ravel() + shift[1]
    return packing_of(x, y, np.full(i.size, radius), pairs)


def hexagonal_lattice(half_extent: float, radius: float, shift=(0.0, 0.0)) -> Packing:
    """Equal grains on a hexagonal lattice that covers [−half_extent, half_extent]²."""
    rows = math.ceil(half_extent / (math.sqrt(3) * radius)) + 2
    columns = math.ceil(half_extent / (2 * radius)) + 2
    points = [
        (2 * radius * (i + 0.5 * (j % 2)) + shift[0], math.sqrt(3) * radius * j + shift[1])
        for j in range(-rows, rows + 1)
        for i in range(-columns, columns + 1)
    ]
    return _touching(np.array(points), 2 * radius * 1.0001, radius)


def random_graph(half_extent: float, count: int, seed: int) -> Packing:
    """A random plane graph as a packing: Delaunay edges of scattered grains, some left out.

    Its faces have three to six corners, as those of real packings; grains touch no other.
    """
    rng = np.random.default_rng(seed)
    side = math.ceil(math.sqrt(count))
    step = 2 * half_extent * 1.4 / side
    grid = (np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2) + 0.5) * step
    points = grid - 1.4 * half_extent + rng.uniform(-0.3, 0.3, grid.shape) * step
    triangles = Delaunay(points).simplices
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [0, 2]]])
    edges = _distinct(edges.astype(np.int64))
    length = np.hypot(*(points[edges[:, 0]] - points[edges[:, 1]]).T)
    edges = edges[(rng.random(len(edges)) < 0.8) & (length < 2.5 * step)]
    radius = rng.uniform(0.25, 0.35, len(points)) * step
    return packing_of(points[:, 0], points[:, 1], radius, edges)


def _touching(points: np.ndarray, reach: float, radius: float) -> Packing:
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    return packing_of(points[:, 0], points[:, 1], np.full(len(points), radius), pairs)
