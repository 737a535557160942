"""Which parameters decide a result: Sobol' indices and elementary effects of a sample.

A case without a good result is never filled in and never passed over: it would bias what is left.
Either the indices are refused, or its value is only known to lie between two limits, and the
indices are known between two bounds.

Sources: Saltelli et al. 2010 (first-order index, their eq. b in table 2), Jansen 1999 (total
index), Morris 1991 and Campolongo et al. 2007 (elementary effects).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.designs import STEP, block, design

Array = np.ndarray
OBSERVED = "observed"
# Points of a Sobol' sequence are not independent: the bootstrap most often takes its error for
# larger than it is, and for some pairs of dimensions and counts for a quarter smaller.
SAFE = 0.25  # part of the tails that an interval leaves out
SAMPLE, PARAMETER = "sample", "parameter"


class _Box(NamedTuple):
    """Values (n, block, m) that lie between two bounds; known where these are the same."""

    low: Array
    high: Array

    def part(self, which: int | slice) -> _Box:
        return _Box(self.low[:, which], self.high[:, which])


def sensitivity(
    dataset: xr.Dataset,
    of: str | xr.DataArray,
    *,
    limits: tuple[float, float] | str | None = None,
    confidence: float = 0.95,
    resamples: int = 1000,
    seed: int = 0,
) -> xr.Dataset:
    """Return how much each sampled parameter decides a result.

    Parameters
    ----------
    dataset : of a study with `sample: {method: saltelli}` (indices) or `morris` (effects).
    of : name of a variable, or values made of the dataset's, along `sample` and further
        dimensions.
    limits : between which the value of a case without a good result would have been, in the
        unit of the result; `"observed"` takes the range of those that are good, for each place
        by itself. Without limits such cases are an error.
    confidence : least one of the intervals, which are percentiles of bootstrap samples of the
        design's points, wide enough for quasi-random ones; where values are bounded, from the
        least of the lower bounds to the largest of the upper ones.
    resamples, seed : number of bootstrap samples, and what they are drawn with.

    Returns
    -------
    Along `parameter` and the further dimensions, of a Saltelli sample `first_order` and `total`
    (the part of the variance that goes where the parameter is known, and that stays where all
    others are; NaN where cases failed), of a Morris sample `mu`, `mu_star` and `sigma` (mean,
    mean size and standard deviation of the effect of the parameter's whole range of probability,
    in the unit of the result); each with `…_low` and `…_high`. `unknown` counts the cases without
    a good result behind each.

    Raises ResultsError where the dataset has no such sample, or cases lack a value and no limits
    are given.
    """
    method, names = _design_of(dataset)
    values = dataset[of] if isinstance(of, str) else of
    if SAMPLE not in values.dims:
        raise ResultsError(f"{values.name or 'the result'} does not lie along {SAMPLE}")
    values = values.transpose(SAMPLE, ...)
    status = dataset["status"].transpose(SAMPLE, ...)
    if bool(np.any(status == Status.LEFT_OUT)):
        raise ResultsError("where leaves samples out: their parameters are no longer independent")
    good = xr.broadcast(status == Status.DONE, values)[0].transpose(*values.dims).values
    flat = values.values.astype(float).reshape(len(values), -1)
    known = good.reshape(flat.shape) & np.isfinite(flat)
    _check_known(known, limits, values.name)
    size = block(method, len(names))
    box = _Box(*(one.reshape(-1, size, flat.shape[1]) for one in _between(flat, known, limits)))
    weights = _resampled(len(box.low), resamples, seed)
    tail = 0.5 * (1.0 - confidence)
    unknown = (~known).sum(axis=0)
    if method == "saltelli":
        found = _indices(box, weights, tail, unknown)
    else:
        up = _steps(method, names, dataset)
        found = _effects(box, up, weights, tail, unknown)
    shape = (len(names), *values.shape[1:])
    dimensions = (PARAMETER, *values.dims[1:])
    unit = "1" if method == "saltelli" else values.attrs.get("units", "1")
    made = {
        name: (dimensions, array.reshape(shape), {"units": unit, "long_name": _MEANING[name]})
        for name, array in found.items()
    }
    made["unknown"] = (
        dimensions[1:],
        unknown.reshape(shape[1:]),
        {"units": "1", "long_name": "cases without a good result"},
    )
    coordinates = {
        name: coordinate
        for name, coordinate in values.coords.items()
        if SAMPLE not in coordinate.dims
    }
    told = "none" if limits is None else limits if isinstance(limits, str) else list(limits)
    attributes = {
        "of": str(values.name or ""),
        "method": method,
        "confidence": confidence,
        "resamples": resamples,
        "limits_of_unknown_values": told,
    }
    return xr.Dataset(made, {**coordinates, PARAMETER: (PARAMETER, list(names))}, attributes)


_MEANING = {
    "first_order": "part of the variance by the parameter alone",
    "total": "part of the variance by the parameter and its interactions",
    "mu": "mean effect of the parameter",
    "mu_star": "mean size of the effect of the parameter",
    "sigma": "standard deviation of the effect of the parameter",
}
_MEANING |= {
    f"{name}_{end}": f"{end} end of the interval of: {text}"
    for name, text in dict(_MEANING).items()
    for end in ("low", "high")
}


def _design_of(dataset: xr.Dataset) -> tuple[str, tuple[str, ...]]:
    """Method and parameters of the sample of a dataset."""
    attributes = dataset[SAMPLE].attrs if SAMPLE in dataset.coords else {}
    method = str(attributes.get("sampling_method", ""))
    if method not in ("saltelli", "morris"):
        has = f"its sample is {method}" if method else "it has no sample"
        raise ResultsError(
            f"{has}; indices need sample: {{method: saltelli, …}}, effects {{method: morris, …}}"
        )
    names = tuple(str(attributes["sampled"]).split())
    size = int(attributes["sampling_count"]) * block(method, len(names))
    if dataset.sizes[SAMPLE] != size:
        raise ResultsError(f"a part of the sample is not enough: it has {size} points as a whole")
    return method, names


def _check_known(known: Array, limits: tuple[float, float] | str | None, name: object) -> None:
    """Raise ResultsError where values are missing and nothing says between what they lie."""
    missing = int(np.max(np.count_nonzero(~known, axis=0), initial=0))
    if isinstance(limits, str) and limits != OBSERVED:
        raise ResultsError(f"limits is {limits!r}; give (least, largest) or 'observed'")
    if missing and limits is None:
        raise ResultsError(
            f"{missing} of {len(known)} cases have no good {name or 'value'}, and indices without "
            "them are biased; give limits=(least, largest) between which their values would be, or "
            "limits='observed' for the range of the others, and the indices come with bounds"
        )
    if limits == OBSERVED and np.any(~known.any(axis=0)):
        raise ResultsError(f"no case has a good {name or 'value'}")


def _between(
    flat: Array, known: Array, limits: tuple[float, float] | str | None
) -> tuple[Array, Array]:
    """Bounds of all values (cases, m)."""
    if limits is None:
        return flat, flat
    if isinstance(limits, str):
        least = np.min(flat, axis=0, where=known, initial=np.inf)
        largest = np.max(flat, axis=0, where=known, initial=-np.inf)
    else:
        if not limits[0] <= limits[1]:
            raise ResultsError(f"limits are {limits}; give the least first, then the largest")
        least, largest = np.asarray(limits[0], float), np.asarray(limits[1], float)
    return np.where(known, flat, least), np.where(known, flat, largest)


def _resampled(points: int, resamples: int, seed: int) -> Array:
    """Weights of the points (1 + resamples, points), each row with mean 1; the first all alike."""
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(points, np.full(points, 1.0 / points), size=resamples)
    return np.concatenate([np.ones((1, points)), drawn])


def _indices(box: _Box, weights: Array, tail: float, unknown: Array) -> dict[str, Array]:
    """Sobol' indices of a Saltelli design, each (d, m)."""
    shape = (box.low.shape[1] - 2, box.low.shape[2])
    found = {name: np.full(shape, np.nan) for name in _names("first_order", "total")}
    for k in range(shape[1]):
        low, high = box.low[:, :, k], box.high[:, :, k]
        if (size := max(np.abs(low).max(), np.abs(high).max())) == 0.0 or np.all(low == low[0, 0]):
            continue  # of a constant nothing is explained by anything
        column = _Box(low / size, high / size)
        one = _bounded if unknown[k] else _known
        for name, ends in one(column, weights).items():
            for key, values in _interval(name, *ends, tail, bool(unknown[k])).items():
                # what is only bounded needs no more than is known of every index
                found[key][:, k] = np.clip(values, 0.0, 1.0) if unknown[k] else values
    return found


def _known(box: _Box, weights: Array) -> dict[str, tuple[Array, Array]]:
    """Both indices (1 + resamples, d) of values (n, d + 2) that are all known."""
    y = box.low - box.low[:, :2].mean()
    a, b, mixed = y[:, :1], y[:, 1:2], y[:, 2:]
    points = len(y)
    mean = weights @ y[:, :2].mean(axis=1) / points
    variance = weights @ (y[:, :2] ** 2).mean(axis=1) / points - mean**2
    first = weights @ (b * (mixed - a)) / points / variance[:, None]
    total = weights @ (0.5 * (a - mixed) ** 2) / points / variance[:, None]
    return {"first_order": (first, first), "total": (total, total)}


def _bounded(box: _Box, weights: Array) -> dict[str, tuple[Array, Array]]:
    """Bounds of both indices (1 + resamples, d) over all that the unknown values can be.

    Both follow from a ratio r = E(X − Y)² / 2V of two columns (Jansen 1999): the total index is
    that of A and AB_i, the first-order one is 1 − r of B and AB_i.
    """
    a, b, mixed = box.part(slice(0, 1)), box.part(slice(1, 2)), box.part(slice(2, None))
    total = _ratio(a, b, mixed, weights)
    rest = _ratio(b, a, mixed, weights)
    return {"first_order": (1.0 - rest.high, 1.0 - rest.low), "total": (total.low, total.high)}


def _ratio(x: _Box, other: _Box, y: _Box, weights: Array) -> _Box:
    """Bounds of E(X − Y)² / 2V, V the variance of X and another column, between 0 and 1.

    The ratio is at most r where N − r V is negative for all values, N = E(X − Y)² / 2; V is the
    least over m of E((X − m)² + (O − m)²) / 2. For one m the worst values are found point by
    point; the largest over m bounds both ways. The grid of r errs to the safe side, since the worst
    is convex in r and the best concave.
    """
    means = [
        0.5 * (x_end + o_end)
        for x_end, o_end in zip(map(np.mean, x), map(np.mean, other), strict=True)
    ]
    centres = np.linspace(means[0], means[1], CENTRES)
    grid = np.linspace(0.0, 1.0, GRID)
    points, d = y.low.shape
    worst, best = (np.empty((GRID, points, d)) for _ in range(2))
    for number, r in enumerate(grid):
        for kept, of in ((worst, _largest), (best, _least)):
            terms = [of(x, other, y, r, m) for m in centres]
            chosen = np.argmax([term.mean(axis=0) for term in terms], axis=0)
            kept[number] = np.stack(terms)[chosen, :, np.arange(d)].T
    low, high = (
        _root(
            grid, (weights @ kept.reshape(GRID, points, d).transpose(1, 0, 2).reshape(points, -1))
        )
        for kept in (best, worst)
    )
    return _Box(low, high)


GRID, CENTRES = 41, 9  # values of a ratio, and of the mean, that are tried


def _largest(x: _Box, other: _Box, y: _Box, r: float, m: float) -> Array:
    """Largest of (X − Y)² − r ((X − m)² + (O − m)²) at each point (n, d), for 0 ≤ r ≤ 1."""
    ends = [(p - q) ** 2 - r * (p - m) ** 2 for p in x for q in y]
    near = np.clip(m, *other)
    found: Array = np.maximum.reduce(ends) - r * (near - m) ** 2
    return found


def _least(x: _Box, other: _Box, y: _Box, r: float, m: float) -> Array:
    """Least of the same: of a convex parabola in X where Y can follow no further."""
    tried = [*x]
    for q in y:
        tried += [np.clip(q, *x)]
        if r < 1.0:
            tried += [np.clip((q - r * m) / (1.0 - r), *x)]
    values = [(p - np.clip(p, *y)) ** 2 - r * (p - m) ** 2 for p in tried]
    far = np.maximum(*((o - m) ** 2 for o in other))
    found: Array = np.minimum.reduce(values) - r * far
    return found


def _root(grid: Array, flat: Array) -> Array:
    """Where functions (k, grid · d) that fall with the grid are zero, linear between, (k, d)."""
    values = flat.reshape(len(flat), len(grid), -1)
    above = values > 0.0
    at = np.clip(above.sum(axis=1), 1, len(grid) - 1)[:, None]
    before = np.take_along_axis(values, at - 1, axis=1)[:, 0]
    after = np.take_along_axis(values, at, axis=1)[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(before > after, before / (before - after), 0.0)
    found = grid[at[:, 0] - 1] + np.clip(part, 0.0, 1.0) * (grid[1] - grid[0])
    return np.where(above[:, 0], np.where(above[:, -1], 1.0, found), 0.0)


def _effects(box: _Box, up: Array, weights: Array, tail: float, unknown: Array) -> dict[str, Array]:
    """Elementary effects of trajectories, each (d, m); `up` (n, d, d) is the step at each move."""
    moves = _Box(*(x / STEP for x in _minus(box.part(slice(1, None)), box.part(slice(0, -1)))))
    sign = up.sum(axis=2)[:, :, None]
    moves = _Box(
        np.where(sign > 0, moves.low, -moves.high), np.where(sign > 0, moves.high, -moves.low)
    )
    # each trajectory moves each parameter once
    order = np.argmax(np.abs(up), axis=2)
    place = np.argsort(order, axis=1)[:, :, None]
    effect = _Box(*(np.take_along_axis(x, place, axis=1) for x in moves))
    spread = _variance_of_each(effect, weights)
    points = len(box.low)
    correction = np.sqrt(points / max(points - 1, 1))
    quantities = {
        "mu": tuple(_means(x, weights) for x in effect),
        "mu_star": tuple(_means(x, weights) for x in _size(effect)),
        "sigma": tuple(correction * np.sqrt(np.maximum(x, 0.0)) for x in spread),
    }
    found: dict[str, Array] = {}
    for name, (low, high) in quantities.items():
        found |= _interval(name, low, high, tail, unknown)
    return found


def _steps(method: str, names: tuple[str, ...], dataset: xr.Dataset) -> Array:
    """Direction of each move of the trajectories, (n, d, d): of move and parameter."""
    attributes = dataset[SAMPLE].attrs
    count, seed = int(attributes["sampling_count"]), int(attributes["sampling_seed"])
    points = design(method, len(names), count, seed).reshape(count, -1, len(names))
    return np.asarray(np.sign(np.diff(points, axis=1)))


def _names(*quantities: str) -> list[str]:
    return [f"{name}{end}" for name in quantities for end in ("", "_low", "_high")]


def _interval(
    name: str, low: Array, high: Array, tail: float, unknown: Array | bool
) -> dict[str, Array]:
    """The estimate and the ends of its interval, from bounds (1 + resamples, …).

    Percentiles of the bootstrap and their mirror images about the estimate: of the two, which err
    to different sides where the estimator is skewed, the farther one.
    """
    estimate = np.where(unknown, np.nan, low[0])
    at = (SAFE * tail, 1.0 - SAFE * tail)
    (low_0, low_1), (high_0, high_1) = (np.quantile(x[1:], at, axis=0) for x in (low, high))
    ends = (
        np.minimum.reduce([low_0, 2.0 * low[0] - low_1, low[0]]),
        np.maximum.reduce([high_1, 2.0 * high[0] - high_0, high[0]]),
    )
    return dict(zip(_names(name), (estimate, *ends), strict=True))


def _means(terms: Array, weights: Array) -> Array:
    """Weighted means over the points of terms (n, d, m), (resamples, d, m)."""
    flat = terms.reshape(len(terms), -1)
    found: Array = (weights @ flat / len(terms)).reshape(len(weights), *terms.shape[1:])
    return found


def _variance_of_each(box: _Box, weights: Array) -> tuple[Array, Array]:
    """Bounds of the variances over the points of values (n, d, m), each (resamples, d, m).

    Intervals of different widths: from the means of the squares and the squares of the means.
    """
    centre = 0.5 * (box.low.mean(axis=0) + box.high.mean(axis=0))
    box = _Box(box.low - centre, box.high - centre)
    squares = _square(box)
    low, high = (_means(x, weights) for x in box)
    least_mean = np.where((low <= 0.0) & (high >= 0.0), 0.0, np.minimum(low**2, high**2))
    most_mean = np.maximum(low**2, high**2)
    known = box.low == box.high
    lower = _means(squares.low, weights) - most_mean
    upper = _means(squares.high, weights) - least_mean
    return np.where(known.all(axis=0), upper, lower), upper


def _minus(a: _Box, b: _Box) -> _Box:
    return _Box(a.low - b.high, a.high - b.low)


def _square(a: _Box) -> _Box:
    ends = a.low**2, a.high**2
    across = (a.low <= 0.0) & (a.high >= 0.0)
    return _Box(np.where(across, 0.0, np.minimum(*ends)), np.maximum(*ends))


def _size(a: _Box) -> _Box:
    ends = np.abs(a.low), np.abs(a.high)
    across = (a.low <= 0.0) & (a.high >= 0.0)
    return _Box(np.where(across, 0.0, np.minimum(*ends)), np.maximum(*ends))
