"""Regular packings of equal discs, at rest without force."""

from __future__ import annotations

import numpy as np

from demflow.model.mechanics.contact.grains import Array, at_rest
from demflow.model.mechanics.contact.neighbours import find_pairs, no_pairs
from demflow.model.mechanics.specimen.measures import contact_counts, listed
from demflow.model.products import Packing

CELL_AREA = {"square": 4.0, "hexagonal": 2.0 * np.sqrt(3.0)}  # area of a grain's cell over R²


def lattice(kind: str, radius: float, box: tuple[float, float, float, float]) -> Packing:
    """A square or hexagonal lattice of discs of `radius` that covers the box (m).

    Grains stand symmetrically to the centre of the box, which is the centre of a pore.
    Rows of the hexagonal lattice run along x. The walls are the planes that touch the
    outermost grains. Contacts are the pairs at distance 2 R.

    Parameters
    ----------
    kind : square or hexagonal
    radius : of the discs, m
    box : xmin, xmax, ymin, ymax that is covered, m
    """
    width, height = box[1] - box[0], box[3] - box[2]
    x, y = (_square if kind == "square" else _hexagonal)(
        0.5 * width / radius, 0.5 * height / radius
    )
    x = radius * x + 0.5 * (box[0] + box[1])
    y = radius * y + 0.5 * (box[2] + box[3])
    radii = np.full(len(x), float(radius))
    walls = np.array([x.min() - radius, x.max() + radius, y.min() - radius, y.max() + radius])
    # the next neighbours are at 2.8 R (square) and 3.5 R (hexagonal)
    pairs = find_pairs(at_rest(x, y, radii, np.ones(len(x))), 0.1 * radius, no_pairs(len(x)))
    a, b = listed(pairs)
    touching = walls + 1e-6 * radius * np.array([1.0, -1.0, 1.0, -1.0])
    counts = contact_counts(x, y, radii, touching, a, b)
    loaded = counts >= 2
    return Packing(
        x=x,
        y=y,
        radius=radii,
        contact_a=a,
        contact_b=b,
        normal_force=np.zeros(len(a)),
        shear_force=np.zeros(len(a)),
        box=walls,
        porosity=np.array(1.0 - np.pi / CELL_AREA[kind]),
        coordination=np.array(counts[loaded].mean()),
        floaters=np.array(np.count_nonzero(~loaded)),
        packing_friction=np.array(0.0),
        packing_pressure=np.array(0.0),
        unbalanced_ratio=np.array(0.0),
        steps=np.array(0),
    )


def _square(a: float, b: float) -> tuple[Array, Array]:
    """Centres (unit radius) that cover |x| ≤ a, |y| ≤ b."""
    nx, ny = int(np.ceil(0.5 * a)), int(np.ceil(0.5 * b))
    x, y = np.meshgrid(2.0 * np.arange(-nx, nx) + 1.0, 2.0 * np.arange(-ny, ny) + 1.0)
    return x.ravel(), y.ravel()


def _hexagonal(a: float, b: float) -> tuple[Array, Array]:
    """Centres (unit radius) that cover |x| ≤ a, |y| ≤ b; the origin is a triangle's centre."""
    half = int(np.ceil(0.5 * a)) + 1
    odd = 2.0 * np.arange(-half, half) + 1.0
    even = 2.0 * np.arange(-half, half + 1)
    first, last = -int(np.ceil(b / np.sqrt(3.0))), int(np.ceil(b / np.sqrt(3.0))) + 1
    rows = [odd if k % 2 == 0 else even for k in range(first, last + 1)]
    heights = np.sqrt(3.0) * np.arange(first, last + 1) - 1.0 / np.sqrt(3.0)
    return np.concatenate(rows), np.repeat(heights, [len(row) for row in rows])
