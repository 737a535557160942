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
TRIPLES = np.array(list(combinations(range(NEIGHBOURS), 3)))


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
    while True:
        trial = x.copy(), y.copy(), radius.copy()
        made, placed = _place(*trial, floating, box)
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
    x: Array, y: Array, radius: Array, floating: Array, box: Array
) -> tuple[list[tuple[int, int]], Array]:
    """Fit floaters one after the other; returns the contacts made and the grains placed."""
    standing = np.flatnonzero(~floating)
    if len(standing) < NEIGHBOURS:
        return [], np.empty(0, np.int64)
    tree = cKDTree(np.column_stack([x[standing], y[standing]]))
    made: list[tuple[int, int]] = []
    placed: list[int] = []
    mean = radius.mean()
    for grain in np.flatnonzero(floating):
        # distances between rims decide; grains of unlike size need some more candidates
        _, near = tree.query([x[grain], y[grain]], k=min(3 * NEIGHBOURS, len(standing)))
        around = standing[near]
        if placed:
            close = np.array(placed)
            apart = np.hypot(x[close] - x[grain], y[close] - y[grain])
            around = np.r_[around, close[apart < 4.0 * mean]]
        gap = np.hypot(x[around] - x[grain], y[around] - y[grain]) - radius[around]
        around = around[np.argsort(gap, kind="stable")[:NEIGHBOURS]]
        best = largest_circle(
            x[around], y[around], radius[around], (x[grain], y[grain]), radius[grain]
        )
        if best is None or best[2] < LEAST * mean:
            continue
        at_x, at_y, reach = best[:3]
        others = np.r_[standing, np.array(placed, dtype=np.int64)]
        gaps = np.hypot(x[others] - at_x, y[others] - at_y) - radius[others] - reach
        walls = np.array([at_x - box[0], box[1] - at_x, at_y - box[2], box[3] - at_y]) - reach
        if gaps.min() < -1e-9 * mean or walls.min() < 0.0:
            continue  # the circle leaves its void
        x[grain], y[grain], radius[grain] = best[0], best[1], best[2] * (1.0 - TOUCH)
        made += [(min(grain, k), max(grain, k)) for k in around[list(best[3])]]
        placed.append(int(grain))
    return made, np.array(placed, dtype=np.int64)


def largest_circle(
    x: Array, y: Array, radius: Array, at: tuple[float, float], reach: float
) -> tuple[float, float, float, tuple[int, ...]] | None:
    """The largest circle that touches three of the given ones and overlaps none, in a void.

    The void is the one in which the point `at` lies: the circle's centre is no farther from it
    than `reach`, and the circle is no larger than three times that, so that it is none that
    encloses the others from outside. Returns (x, y, radius, the three), or None.

    Parameters
    ----------
    x : centres of the circles, (n,)
    y : centres, (n,)
    radius : radii, (n,)
    at : a point in the void
    reach : how far from it the centre may lie
    """
    i, j, k = TRIPLES[np.all(len(x) > TRIPLES, axis=1)].T
    # |c − c_i| = ρ + r_i for three: the differences of the squares are linear in (c, ρ)
    a1, b1, d1 = x[j] - x[i], y[j] - y[i], radius[j] - radius[i]
    a2, b2, d2 = x[k] - x[i], y[k] - y[i], radius[k] - radius[i]
    s1 = 0.5 * (a1**2 + b1**2 - d1**2 - 2.0 * d1 * radius[i])
    s2 = 0.5 * (a2**2 + b2**2 - d2**2 - 2.0 * d2 * radius[i])
    det = a1 * b2 - a2 * b1
    with np.errstate(divide="ignore", invalid="ignore"):
        px, qx = (s1 * b2 - s2 * b1) / det, (d2 * b1 - d1 * b2) / det
        py, qy = (a1 * s2 - a2 * s1) / det, (a2 * d1 - a1 * d2) / det
        # (p + q ρ)² = (ρ + r_i)²
        a = qx**2 + qy**2 - 1.0
        b = px * qx + py * qy - radius[i]
        c = px**2 + py**2 - radius[i] ** 2
        root = np.sqrt(b * b - a * c)
        rho = np.concatenate([c / (-b + root), c / (-b - root)])
    triple = np.concatenate([np.arange(len(i))] * 2)
    with np.errstate(invalid="ignore"):
        cx = x[i][triple] + px[triple] + qx[triple] * rho
        cy = y[i][triple] + py[triple] + qy[triple] * rho
        free = np.hypot(cx[:, None] - x, cy[:, None] - y) - radius - rho[:, None]
        good = (rho > 0.0) & (free.min(axis=1) > -1e-9 * radius.mean())
        good &= (np.hypot(cx - at[0], cy - at[1]) <= reach) & (rho <= 3.0 * reach)
    if not good.any():
        return None
    best = int(np.argmax(np.where(good, rho, -np.inf)))
    t = triple[best]
    return float(cx[best]), float(cy[best]), float(rho[best]), (int(i[t]), int(j[t]), int(k[t]))
