"""Floaters: grains that carry no load are fitted into their voids, so that they can be bonded.

A floater becomes the largest circle of its void: it touches three of the grains around without
overlap, its radius is the gap (physics of Potyondy & Cundall's treatment, without the motion that
would bring floaters back). Floaters of one void are fitted one after the other, and cover none
that stays.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from demflow.model.mechanics.contact.grains import Array

NEIGHBOURS = 12  # nearest grains among which the three are sought
LEAST = 0.05  # mean radii: no smaller grain is made; the floater stays
TOUCH = 1e-9  # part of the radius by which a fitted grain falls short of its neighbours
AT_ONCE = 32  # voids in which circles are sought at once; more would not stay in a cache
TRIPLES = np.array(list(combinations(range(NEIGHBOURS), 3)))


# A circle, x, y and radius, and the three that it touches; or none.
Circle = tuple[float, float, float, tuple[int, ...]]

# What was found in the void of a grain between some circles, both as bytes.
Found = dict[tuple[int, bytes], Circle | None]


def fit(x: Array, y: Array, radius: Array, floating: Array, box: Array) -> tuple[Array, Array]:
    """Fit floaters into their voids, in place.

    Parameters
    ----------
    x, y, radius : (n,) of all grains, changed for the floaters that are fitted.
    floating : (n,) bool.
    box : (4,) walls xmin, xmax, ymin, ymax, which a fitted grain does not reach.

    Returns
    -------
    (a, b), each (k,): the contacts without force that this makes, a < b, sorted.
    """
    floating = floating.copy()
    found: Found = {}
    while True:
        trial = x.copy(), y.copy(), radius.copy()
        made, placed = _place(*trial, floating, box, found)
        floats = floating.copy()
        floats[placed] = False
        covered = np.flatnonzero(floats)[_covered(*trial, np.flatnonzero(floats), placed)]
        if not len(covered):
            break
        floating[covered] = False  # what stays floating stands in the way of the others
    x[:], y[:], radius[:] = trial
    pairs = np.array(sorted(made), dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _covered(x: Array, y: Array, radius: Array, grains: Array, placed: Array) -> Array:
    """Which of some grains (g,) overlap a placed one: bool (g,)."""
    gap = np.hypot(x[grains, None] - x[placed], y[grains, None] - y[placed])
    gap -= radius[grains, None] + radius[placed]
    found: Array = np.any(gap < -1e-9 * radius.mean(), axis=1)
    return found


def _place(
    x: Array, y: Array, radius: Array, floating: Array, box: Array, found: Found
) -> tuple[list[tuple[int, int]], Array]:
    """Fit floaters one after the other; returns the contacts made and the grains placed.

    What was `found` in a void is not sought again while the same grains lie around.
    """
    standing = np.flatnonzero(~floating)
    if len(standing) < NEIGHBOURS:
        return [], np.empty(0, np.int64)
    tree = cKDTree(np.column_stack([x[standing], y[standing]]))
    made: list[tuple[int, int]] = []
    mean, largest = radius.mean(), radius.max()
    floats = np.flatnonzero(floating)
    # distances between rims decide; grains of unlike size need some more candidates
    _, near = tree.query(
        np.column_stack([x[floats], y[floats]]), k=min(3 * NEIGHBOURS, len(standing))
    )
    near_own = zip(floats.tolist(), standing[near], strict=True)
    nearest = [_nearest(grain, own, x, y, radius) for grain, own in near_own]
    _seek(floats, nearest, x, y, radius, found)
    room, count = np.empty(len(floats), dtype=np.int64), 0
    for grain, own in zip(floats.tolist(), nearest, strict=True):
        placed = room[:count]
        apart = np.hypot(x[placed] - x[grain], y[placed] - y[grain])
        around, close = own, placed[apart < 4.0 * mean]
        if len(close):
            around = _nearest(grain, np.concatenate([own, close]), x, y, radius)
            _seek(np.array([grain]), [around], x, y, radius, found)
        best = found[_key(grain, around, x, y, radius)]
        if best is None or best[2] < LEAST * mean:
            continue
        at_x, at_y, reach = best[:3]
        reaches = tree.query_ball_point((at_x, at_y), reach + largest)
        others = np.concatenate([standing[reaches], placed])
        gaps = np.hypot(x[others] - at_x, y[others] - at_y) - radius[others] - reach
        walls = np.array([at_x - box[0], box[1] - at_x, at_y - box[2], box[3] - at_y]) - reach
        if gaps.min(initial=0.0) < -1e-9 * mean or walls.min() < 0.0:
            continue  # the circle leaves its void
        x[grain], y[grain], radius[grain] = best[0], best[1], best[2] * (1.0 - TOUCH)
        made += [(min(grain, k), max(grain, k)) for k in around[list(best[3])]]
        room[count] = grain
        count += 1
    return made, room[:count]


def _nearest(grain: int, some: Array, x: Array, y: Array, radius: Array) -> Array:
    """Those of some grains whose rims are nearest to the centre of one."""
    gap = np.hypot(x[some] - x[grain], y[some] - y[grain]) - radius[some]
    return some[np.argsort(gap, kind="stable")[:NEIGHBOURS]]


def _key(grain: int, around: Array, x: Array, y: Array, radius: Array) -> tuple[int, bytes]:
    """What a circle in the void of a grain depends on."""
    parts = (part.tobytes() for part in (around, x[around], y[around], radius[around]))
    return int(grain), b"".join(parts)


def _seek(
    grains: Array, nearest: list[Array], x: Array, y: Array, radius: Array, found: Found
) -> None:
    """Add the largest circles in the voids of some grains to what was found."""
    keys = [_key(g, a, x, y, radius) for g, a in zip(grains, nearest, strict=True)]
    new = [k for k, key in enumerate(keys) if key not in found]
    for first in range(0, len(new), AT_ONCE):
        some = new[first : first + AT_ONCE]
        g, a = np.array([grains[k] for k in some]), np.array([nearest[k] for k in some])
        circles = largest_circles(x[a], y[a], radius[a], x[g], y[g], radius[g])
        found.update(zip((keys[k] for k in some), circles, strict=True))


def largest_circles(
    x: Array, y: Array, radius: Array, at_x: Array, at_y: Array, reach: Array
) -> list[Circle | None]:
    """In each of g voids the largest circle that touches three of the given ones, overlapping none.

    A void is the one in which the point `at` lies: the circle's centre is no farther from it
    than `reach`, and the circle is no larger than three times that, so that it is none that
    encloses the others from outside. Each is (x, y, radius, the three), or None.

    Parameters
    ----------
    x : centres of the circles around each void, (g, n)
    y : centres, (g, n)
    radius : radii, (g, n)
    at_x, at_y : a point in each void, (g,)
    reach : how far from it the centre may lie, (g,)
    """
    i, j, k = TRIPLES[np.all(x.shape[1] > TRIPLES, axis=1)].T
    # |c − c_i| = ρ + r_i for three: the differences of the squares are linear in (c, ρ)
    xi, yi, ri = x[:, i], y[:, i], radius[:, i]
    a1, b1, d1 = x[:, j] - xi, y[:, j] - yi, radius[:, j] - ri
    a2, b2, d2 = x[:, k] - xi, y[:, k] - yi, radius[:, k] - ri
    s1 = 0.5 * (a1**2 + b1**2 - d1**2 - 2.0 * d1 * ri)
    s2 = 0.5 * (a2**2 + b2**2 - d2**2 - 2.0 * d2 * ri)
    det = a1 * b2 - a2 * b1
    with np.errstate(divide="ignore", invalid="ignore"):
        px, qx = (s1 * b2 - s2 * b1) / det, (d2 * b1 - d1 * b2) / det
        py, qy = (a1 * s2 - a2 * s1) / det, (a2 * d1 - a1 * d2) / det
        # (p + q ρ)² = (ρ + r_i)²
        a = qx**2 + qy**2 - 1.0
        b = px * qx + py * qy - ri
        c = px**2 + py**2 - ri**2
        root = np.sqrt(b * b - a * c)
        rho = np.concatenate([c / (-b + root), c / (-b - root)], axis=1)
        cx, cy = (
            np.concatenate([from_ + p, from_ + p], axis=1) + np.concatenate([q, q], axis=1) * rho
            for from_, p, q in ((xi, px, qx), (yi, py, qy))
        )
        off = np.hypot(cx - at_x[:, None], cy - at_y[:, None])
        good = (rho > 0.0) & (off <= reach[:, None]) & (rho <= 3.0 * reach[:, None])
    row, column = np.nonzero(good)
    gap = np.hypot(cx[row, column, None] - x[row], cy[row, column, None] - y[row])
    gap -= radius[row]
    free = gap - rho[row, column, None]
    keep = free.min(axis=1) > -1e-9 * radius.mean(axis=1)[row]
    row, column = row[keep], column[keep]
    size = np.full(rho.shape, -np.inf)
    size[row, column] = rho[row, column]
    found: list[Circle | None] = []
    for g, best in enumerate(size.argmax(axis=1).tolist()):
        t = best % len(i)
        three = int(i[t]), int(j[t]), int(k[t])
        circle = float(cx[g, best]), float(cy[g, best]), float(rho[g, best]), three
        found.append(circle if np.isfinite(size[g, best]) else None)
    return found
