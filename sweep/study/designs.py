"""Designs: points of the unit cube at which parameters are sampled.

Each method says how many cases a point of `count` makes, and every longer design begins with the
shorter one, so that a study which is extended computes only what is new:

`sobol`
    A scrambled Sobol' sequence (Owen 1998), best at powers of two.
`latin_hypercube`
    A Latin hypercube (McKay et al. 1979), extended by doubling: of the two halves of each old
    stratum one holds an old point, and the other gets a new one (Tong 2006). Counts that differ
    by a power of two share their points; others do not.
`saltelli`
    For Sobol' indices: of each point of a Sobol' sequence in 2 d dimensions the rows A, B and
    AB_1 … AB_d, where AB_i is A with its i-th number from B (Saltelli et al. 2010): count (d + 2)
    cases.
`morris`
    For elementary effects: random trajectories along each of which one number after the other
    moves by half of its range, up or down (Morris 1991): count (d + 1) cases. Levels lie in the
    middle of four equal parts, so that laws without ends have no infinite values there.
"""

from __future__ import annotations

import warnings

import numpy as np

METHODS = ("sobol", "latin_hypercube", "saltelli", "morris")
LEVELS = 4  # of trajectories
STEP = 0.5  # by which a number moves along a trajectory, in probability
_EDGE = 2.0**-40  # no number is nearer to 0 or 1


def block(method: str, dimensions: int) -> int:
    """Cases that one point of a design makes."""
    return {"saltelli": dimensions + 2, "morris": dimensions + 1}.get(method, 1)


def design(method: str, dimensions: int, count: int, seed: int) -> np.ndarray:
    """Points of the unit cube, (count · block, dimensions), none on its faces.

    Parameters
    ----------
    method : one of `METHODS`.
    dimensions : number of parameters, d.
    count : number of points, pairs of points or trajectories.
    seed : of what is random in the design.
    """
    if method == "sobol":
        points = _sobol(dimensions, count, seed)
    elif method == "latin_hypercube":
        points = _latin_hypercube(dimensions, count, seed)
    elif method == "saltelli":
        pairs = _sobol(2 * dimensions, count, seed)
        a, b = pairs[:, 0::2], pairs[:, 1::2]
        mixed = np.repeat(a[:, None, :], dimensions, axis=1)
        every = np.arange(dimensions)
        mixed[:, every, every] = b
        points = np.concatenate([a[:, None], b[:, None], mixed], axis=1)
    else:
        points = np.array([_trajectory(dimensions, seed, number) for number in range(count)])
    found: np.ndarray = np.clip(points.reshape(-1, dimensions), _EDGE, 1.0 - _EDGE)
    return found


def _sobol(dimensions: int, count: int, seed: int) -> np.ndarray:
    from scipy.stats import qmc  # it takes long to import

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of counts that are no powers of two
        return np.asarray(qmc.Sobol(dimensions, scramble=True, rng=seed).random(count))


def _latin_hypercube(dimensions: int, count: int, seed: int) -> np.ndarray:
    doublings = (count & -count).bit_length() - 1
    first = count >> doublings
    rng = np.random.default_rng([seed, first])
    strata = np.array([rng.permutation(first) for _ in range(dimensions)]).T
    points = (strata + rng.random((first, dimensions))) / first
    for _ in range(doublings):
        halves = 2 * len(points)
        new = np.empty_like(points)
        for k in range(dimensions):
            # one half of each old stratum is taken
            taken = np.floor(points[:, k] * halves).astype(int)
            free = rng.permutation(np.setdiff1d(np.arange(halves), taken))
            new[:, k] = (free + rng.random(len(free))) / halves
        points = np.concatenate([points, new])
    return points


def _trajectory(dimensions: int, seed: int, number: int) -> np.ndarray:
    """Points of one trajectory, (d + 1, d)."""
    rng = np.random.default_rng([seed, number])
    low = rng.integers(LEVELS // 2, size=dimensions)
    up = rng.integers(2, size=dimensions).astype(bool)
    start = (low + 0.5) / LEVELS + np.where(up, 0.0, STEP)
    points = np.tile(start, (dimensions + 1, 1))
    for step, k in enumerate(rng.permutation(dimensions)):
        points[step + 1 :, k] += STEP if up[k] else -STEP
    return points
