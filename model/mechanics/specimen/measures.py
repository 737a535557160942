"""What is measured on grains at rest: contacts, porosity, coordination."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.contact.neighbours import Pairs
from demflow.model.outcome import ModelError
from demflow.model.products import Packing
from demflow.model.region import Region, contains

MOST_OVERLAP = 0.5  # mean radii, at which a state of grains is none
PARTS = 16  # of a branch, to find how much of it lies in a region


def listed(pairs: Pairs) -> tuple[Array, Array]:
    """The pairs of a list as two int64 arrays (a, b), a < b, sorted by (a, b)."""
    return pairs.one.astype(np.int64), pairs.other.astype(np.int64)


def overlaps(x: Array, y: Array, radius: Array, a: Array, b: Array) -> Array:
    """Overlap r_a + r_b − distance of each pair, (c,); negative for a gap.

    Parameters
    ----------
    x, y : centres, (n,) m
    radius : radii, (n,) m
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    """
    found: Array = radius[a] + radius[b] - np.hypot(x[b] - x[a], y[b] - y[a])
    return found


def largest_overlap(x: Array, y: Array, radius: Array, a: Array, b: Array) -> float:
    """Largest overlap of pairs of grains (a, b), all in mean radii, 0 where none overlap.

    Raises `ModelError` beyond `MOST_OVERLAP`: grains that stand for a rock do not pass through
    one another.

    Parameters
    ----------
    x, y : centres, (n,) m
    radius : radii, (n,) m
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    """
    found = float(overlaps(x, y, radius, a, b).max(initial=0.0))
    if found > MOST_OVERLAP:
        raise ModelError(
            f"grains overlap by {found:.2g} mean radii, more than {MOST_OVERLAP:g}: they are too "
            "soft for the stress; raise grains.modulus, or lower the stress"
        )
    return found


def contact_counts(x: Array, y: Array, radius: Array, box: Array, a: Array, b: Array) -> Array:
    """Number of contacts of each grain, (n,), walls included; a, b are those between grains.

    Parameters
    ----------
    x, y : centres, (n,) m
    radius : radii, (n,) m
    box : walls xmin, xmax, ymin, ymax, (4,) m
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    """
    walls = (
        (x - radius < box[0]).astype(np.int64)
        + (x + radius > box[1])
        + (y - radius < box[2])
        + (y + radius > box[3])
    )
    found: Array = walls + np.bincount(a, minlength=len(x)) + np.bincount(b, minlength=len(x))
    return found


def porosity(x: Array, y: Array, radius: Array, box: Array) -> float:
    """Part of a box (xmin, xmax, ymin, ymax) that no disc covers, cut discs exactly.

    Overlaps of discs count twice; in a packing at rest they are of order 1e-6 of the area.

    Parameters
    ----------
    x, y : centres, (n,) m
    radius : radii, (n,) m
    box : walls xmin, xmax, ymin, ymax, (4,) m
    """
    left, right = (box[0] - x) / radius, (box[1] - x) / radius
    below, above = (box[2] - y) / radius, (box[3] - y) / radius
    part = (
        _corner_area(right, above)
        - _corner_area(left, above)
        - _corner_area(right, below)
        + _corner_area(left, below)
    )
    return float(1.0 - np.sum(part * radius**2) / ((box[1] - box[0]) * (box[3] - box[2])))


def _corner_area(a: Array, b: Array) -> Array:
    """Area of the unit disc where x < a and y < b."""
    a, b = np.clip(a, -1.0, 1.0), np.clip(b, -1.0, 1.0)
    to_a = a * np.sqrt(1.0 - a * a) + np.arcsin(a)
    to_b = b * np.sqrt(1.0 - b * b) + np.arcsin(b)
    cut = a * b + 0.5 * (to_a + to_b) + 0.25 * np.pi
    half_a, half_b = to_a + 0.5 * np.pi, to_b + 0.5 * np.pi
    whole = np.select(
        [(a >= 0) & (b >= 0), a >= 0, b >= 0], [half_a + half_b - np.pi, half_b, half_a], 0.0
    )
    found: Array = np.where(a * a + b * b < 1.0, cut, whole)
    return found


def fabric(x: Array, y: Array, a: Array, b: Array) -> Array:
    """Fabric tensor (2, 2) of contacts (a, b): mean of n ⊗ n; half the unit tensor if isotropic.

    Parameters
    ----------
    x, y : centres, (n,) m
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    """
    dx, dy = x[b] - x[a], y[b] - y[a]
    normal = np.column_stack([dx, dy]) / np.maximum(np.hypot(dx, dy), 1e-300)[:, None]
    found: Array = normal.T @ normal / max(len(a), 1)
    return found


def packing_quality(packing: Packing) -> dict[str, Array]:
    """How good a packing is and how it was made, under its names in `model.quantities.CASE`.

    Floaters count neither in the coordination nor in the fabric; walls do in the coordination,
    and a grain that was fitted into its void does in both.
    """
    a, b = packing.contact_a, packing.contact_b
    found = fabric(packing.x, packing.y, a, b)
    principal = np.linalg.eigvalsh(found)
    return {
        "coordination": packing.coordination,
        "fabric": found,
        "fabric_anisotropy": np.asarray(np.ptp(principal) / max(principal.sum(), 1e-300)),
        "floater_fraction": packing.floaters / len(packing.x),
        "largest_overlap": packing.normal_force.max(initial=0.0) / packing.radius.mean(),
        "packing_friction": packing.packing_friction,
        "packing_pressure": packing.packing_pressure,
    }


def affine_strain(x: Array, y: Array, u: Array, v: Array) -> Array:
    """Strain tensor (2, 2) that fits displacements (u, v) of grains best, extension positive.

    Least squares of u = u₀ + H x over the grains given; the strain is the symmetric part of H.
    Raises ValueError for fewer than three grains, or grains on a line.

    Parameters
    ----------
    x, y : centres, (n,) m
    u : displacements along x, (n,) m
    v : displacements along y, (n,) m
    """
    base = np.column_stack([np.ones(len(x)), x - x.mean(), y - y.mean()])
    found, _, rank, _ = np.linalg.lstsq(base, np.column_stack([u, v]), rcond=None)
    if rank < 3:
        raise ValueError("a strain needs three grains that do not lie on a line")
    gradient = found[1:].T
    result: Array = 0.5 * (gradient + gradient.T)
    return result


def mean_stress(
    region: Region,
    x: Array,
    y: Array,
    a: Array,
    b: Array,
    normal: Array,
    shear: Array,
) -> Array:
    """Mean stress tensor (2, 2) of contact forces over a region, compression positive.

    σ = Σ f ⊗ l / A over the contacts, each branch l counted by the part of it inside the
    region; unlike a sum over whole grains this has no bias from the rim.

    Parameters
    ----------
    region : any shape; contacts with walls are not counted, so keep it within the grains.
    x, y : centres, (n,) m.
    a, b : contacts, (c,).
    normal, shear : forces, (c,) N per metre of depth.
    """
    dx, dy = x[b] - x[a], y[b] - y[a]
    inside = np.zeros(len(a))
    steps = (np.arange(PARTS) + 0.5) / PARTS
    for t in steps:
        inside += contains(region, np.column_stack([x[a] + t * dx, y[a] + t * dy]))
    weight = inside / PARTS
    distance = np.hypot(dx, dy)
    nx, ny = dx / distance, dy / distance
    fx, fy = normal * nx - shear * ny, normal * ny + shear * nx
    tensor = np.array(
        [
            [np.sum(weight * fx * dx), np.sum(weight * fx * dy)],
            [np.sum(weight * fy * dx), np.sum(weight * fy * dy)],
        ]
    )
    found: Array = 0.5 * (tensor + tensor.T) / region.area
    return found


def force_chains(
    x: Array, y: Array, a: Array, b: Array, normal: Array, shear: Array, angle: float = 45.0
) -> Array:
    """Chain of each contact, (c,), −1 for none: quasi-linear strings of strongly pressed grains.

    Grains whose larger principal stress exceeds the mean over all grains belong to a chain;
    a contact joins two of them if its direction lies within `angle` (degrees) of the larger
    principal stress of both (Peters et al. 2005, Phys. Rev. E 72, 041307). Chains of fewer than
    three grains do not count. They are numbered from 0 in the order of their first contact.

    Parameters
    ----------
    x, y : centres, (n,) m
    a : first grain of each contact, (c,)
    b : second grain of each contact, (c,)
    normal : forces, (c,) N per metre of depth, compression positive
    shear : forces, (c,) N per metre of depth
    angle : within which a contact lies along the larger principal stress, degrees
    """
    n = len(x)
    dx, dy = x[b] - x[a], y[b] - y[a]
    distance = np.hypot(dx, dy)
    nx, ny = dx / distance, dy / distance
    fx, fy = normal * nx - shear * ny, normal * ny + shear * nx
    xx, yy, xy = np.zeros(n), np.zeros(n), np.zeros(n)
    for ends in (a, b):
        np.add.at(xx, ends, 0.5 * fx * dx)
        np.add.at(yy, ends, 0.5 * fy * dy)
        np.add.at(xy, ends, 0.25 * (fx * dy + fy * dx))
    larger = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
    direction = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    strong = larger > larger[larger > 0.0].mean() if np.any(larger > 0.0) else larger > 0.0
    along = np.cos(np.radians(angle))
    aligned = np.ones(len(a), bool)
    for ends in (a, b):
        aligned &= np.abs(nx * np.cos(direction[ends]) + ny * np.sin(direction[ends])) >= along
    joins = strong[a] & strong[b] & aligned & (normal > 0.0)
    graph = coo_array((np.ones(joins.sum()), (a[joins], b[joins])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    counted = joins & (np.bincount(label, minlength=n)[label[a]] >= 3)
    chain = np.full(len(a), -1)
    _, first, number = np.unique(label[a[counted]], return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    chain[counted] = rank[number]
    return chain
