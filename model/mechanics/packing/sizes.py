"""How large grains are: radii over their mean, by a law."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.packing.grading import Grading

CUT = 2.5  # standard deviations of ln r beyond which no radius is drawn
QUANTILES = 20_000  # by which moments of a log-normal law are found


class Sizes(NamedTuple):
    """A law of radii with a mean of one."""

    kind: str  # "uniform", "log-normal" or "list"
    ratio: float  # largest over smallest radius
    mean_square: float  # mean of r² over the square of the mean of r
    deviation: float  # of ln r, log-normal
    radii: tuple[float, ...]  # of a list, their mean one
    grading: Grading | None = None  # by which they are finer, from the middle of the box


def sizes_of(
    kind: str, ratio: float, deviation: float | None, radii: tuple[float, ...] | None
) -> Sizes:
    """The law of radii of that kind; uniform on [r, ratio · r] needs the ratio only.

    Parameters
    ----------
    kind : uniform, log-normal or list
    ratio : largest over smallest radius
    deviation : of ln r, of a log-normal law
    radii : of a list, m
    """
    if kind == "log-normal":
        assert deviation is not None  # the scene asks for it
        r = _log_normal(deviation, (np.arange(QUANTILES) + 0.5) / QUANTILES)
        return Sizes(kind, np.exp(2.0 * CUT * deviation), float(np.mean(r**2)), deviation, ())
    if kind == "list":
        assert radii is not None
        r = np.array(radii) / np.mean(radii)
        return Sizes(kind, float(r.max() / r.min()), float(np.mean(r**2)), 0.0, tuple(r.tolist()))
    q = ratio
    return Sizes("uniform", q, 4.0 * (1.0 + q + q * q) / (3.0 * (1.0 + q) ** 2), 0.0, ())


def draw_radii(sizes: Sizes, n: int, rng: np.random.Generator) -> Array:
    """Radii (n,) of a law with a mean of one; a list's in equal parts, as far as n allows.

    Parameters
    ----------
    sizes : law of the radii
    n : number of grains
    rng : source of randomness
    """
    if sizes.kind == "log-normal":
        return _log_normal(sizes.deviation, rng.random(n))
    if sizes.kind == "list":
        return np.resize(rng.permutation(np.array(sizes.radii)), n)
    return rng.uniform(1.0, sizes.ratio, n) * 2.0 / (1.0 + sizes.ratio)


def _log_normal(deviation: float, quantile: Array) -> Array:
    """Radii at quantiles of the cut law, over the mean."""
    tail = 0.5 * (1.0 - _within(CUT))
    centre = (np.arange(QUANTILES) + 0.5) / QUANTILES
    mean = np.exp(deviation * ndtri(tail + centre * (1.0 - 2.0 * tail))).mean()
    found: Array = np.exp(deviation * ndtri(tail + quantile * (1.0 - 2.0 * tail))) / mean
    return found


def _within(z: float) -> float:
    """Part of a normal law within ± z."""
    return float(ndtr(z) - ndtr(-z))
