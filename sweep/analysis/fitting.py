"""Least squares with intervals that say what the data hold and what they do not.

Parameters are fitted on a scale from 0 to 1 between their bounds, logarithmic where these are
positive and far apart. Intervals are those of the linearised model where it is nearly linear, and
of the profile likelihood elsewhere or where asked; a parameter that may as well lie on a bound is
not determined, and is said to be so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import optimize, stats
from scipy.stats import qmc

from demflow.model.threads import one_blas_thread

CONFIDENCE = 0.95
FAR_APART = 3.0  # upper over lower bound from which on the scale is logarithmic
WIDE = 10.0  # an interval over such a factor tells no more than an order of magnitude
NEARLY_LINEAR = 0.02  # half width on the scale 0 to 1 up to which the Jacobian serves
CORRELATED = 0.95  # from which on a pair of parameters is told
AS_FORESEEN = 0.15  # part by which the sum of squares may rise otherwise at the ends of an interval
SCANNED, STARTS, KEPT = 128, 6, 2  # points tried, of them started from, of them followed to the end
BRIEF = 12  # steps of a start before it is judged
ROUGH = 1e-3  # share of the sum of squares to which a place is known that is only compared
ELSEWHERE = (0.08, 0.29, 0.5, 0.71, 0.92)  # places of each parameter from which others are sought
APART = 0.02  # on the scale 0 to 1: minima that lie nearer are one
_STEP = 1e-6  # of the scale 0 to 1, for the Jacobian
_HALVED = 16  # times that an end of a profile is looked for between two places
_ANEW = 5  # times that a better place than the best so far is gone on from
_FLAT = 1e-13  # curvature of the sum of squares that is round-off, parameters scaled alike
_FAILED = 1e3  # residual over the spread of the data where a model has no answer


class Free(NamedTuple):
    """A parameter that is fitted, between bounds."""

    name: str
    low: float
    high: float

    @property
    def logarithmic(self) -> bool:
        """Whether its scale is."""
        return self.low > 0.0 and self.high > FAR_APART * self.low

    def value(self, u: float) -> float:
        """From 0 to 1 to its value."""
        if self.logarithmic:
            found: float = self.low * (self.high / self.low) ** u
            return found
        return self.low + (self.high - self.low) * u

    def place(self, value: float) -> float:
        """From its value to 0 to 1."""
        if self.logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


class Estimate(NamedTuple):
    """One parameter as the data have it."""

    name: str
    value: float
    low: float  # ends of the 95 % interval; a bound where the data leave that side open
    high: float
    determined: bool
    why: str = ""  # what is not determined
    method: str = "jacobian"  # or profile
    another: float = math.nan  # value of a minimum elsewhere that fits as well


@dataclass(frozen=True)
class Fit:
    """What a model makes of data."""

    estimates: tuple[Estimate, ...]
    correlation: np.ndarray  # (p, p)
    fitted: np.ndarray  # (n,) the model at the best values
    residual: np.ndarray  # (n,) data − model
    scatter: float  # standard deviation of the residuals, p parameters taken off
    persistence: float  # correlation of neighbouring residuals, 0 where it is not significant
    effective: float  # number of independent data that n with such persistence are worth
    squares: float  # sum of the squares of the (weighted) residuals
    evaluations: int

    def bic(self, count: float) -> float:
        """Schwarz's criterion, of so many independent data."""
        mean = self.squares / len(self.residual)
        return count * math.log(mean) + (len(self.estimates) + 1) * math.log(count)

    def aic(self, count: float) -> float:
        """Akaike's criterion with the correction for few data."""
        p = len(self.estimates) + 1
        few = 2.0 * p * (p + 1) / (count - p - 1) if count > p + 1 else math.inf
        return count * math.log(self.squares / len(self.residual)) + 2 * p + few

    @property
    def values(self) -> dict[str, float]:
        """Best values by name."""
        return {one.name: one.value for one in self.estimates}

    def __getitem__(self, name: str) -> Estimate:
        """The parameter of a name."""
        return next(one for one in self.estimates if one.name == name)


Predict = Callable[[dict[str, float]], np.ndarray]
_Minimum = tuple[np.ndarray, float]  # place on the scale 0 to 1, sum of squares there


class _Problem:
    """Residuals on the scale 0 to 1, counted."""

    def __init__(
        self,
        predict: Predict,
        data: np.ndarray,
        free: Sequence[Free],
        step: float,
        weight: np.ndarray,
    ):
        self.predict, self.data, self.free, self.step = predict, data, tuple(free), step
        self.weight = weight
        self.spread = float(np.ptp(data)) or 1.0
        self.evaluations = 0

    def values(self, u: np.ndarray) -> dict[str, float]:
        return {one.name: one.value(float(x)) for one, x in zip(self.free, u, strict=True)}

    def residual(self, u: np.ndarray) -> np.ndarray:
        self.evaluations += 1
        try:
            found = self.predict(self.values(u))
        except (ValueError, OverflowError, FloatingPointError):
            found = np.full(self.data.shape, np.nan)
        off = self.weight * (self.data - found)
        return np.where(np.isfinite(off), off, _FAILED * self.spread)

    def solve(
        self,
        start: np.ndarray,
        held: int | None = None,
        evaluations: int = 60,
        gain: float = 0.0,
    ) -> tuple[np.ndarray, float]:
        """Best u and sum of squares from a start, one of the parameters held if asked.

        It ends where a step gains less than the share `gain` of the sum.
        """
        loose = np.ones(len(self.free), dtype=bool)
        if held is not None:
            loose[held] = False
        if not loose.any():
            return start, float(np.sum(self.residual(start) ** 2))
        whole = np.array(start, dtype=float)

        def some(part: np.ndarray) -> np.ndarray:
            whole[loose] = part
            return self.residual(whole)

        edge = min(self.step, 1e-9)
        found = optimize.least_squares(
            some,
            np.clip(whole[loose], edge, 1.0 - edge),
            bounds=(0.0, 1.0),
            diff_step=self.step,
            x_scale="jac",
            ftol=max(gain, 1e-10, 0.1 * self.step**2),  # what the step cannot see is not sought
            xtol=max(1e-9, 0.05 * self.step),
            gtol=1e-12,
            max_nfev=evaluations,
        )
        whole[loose] = found.x
        return whole.copy(), 2.0 * float(found.cost)

    def jacobian(self, u: np.ndarray) -> np.ndarray:
        """By central differences, one-sided at a bound; (n, p)."""
        columns = []
        for k in range(len(u)):
            step = 10.0 * self.step
            up, down = u.copy(), u.copy()
            up[k], down[k] = min(u[k] + step, 1.0), max(u[k] - step, 0.0)
            columns.append((self.residual(down) - self.residual(up)) / (up[k] - down[k]))
        return np.array(columns).T


@one_blas_thread()
def fit(
    predict: Predict,
    data: np.ndarray,
    free: Sequence[Free],
    *,
    start: Mapping[str, float] | None = None,
    level: str | None = None,
    profile: bool | None = None,
    step: float = _STEP,
    seed: int = 0,
    weight: np.ndarray | float = 1.0,
) -> Fit:
    """Fit a model to data.

    Parameters
    ----------
    seed : of the values to begin from
    predict : from values by name to the model's data, (n,).
    data : (n,), the same scatter everywhere.
    free : the parameters and their bounds.
    start : values to begin from; by default the best of some between the bounds.
    level : the parameter that is added to all data, if one is: it need not be searched for.
    profile : intervals by profile likelihood for all, for none, or (None) where the model is not
        nearly linear.
    step : of the Jacobian's differences, on the scale 0 to 1.
    weight : (n,), one over the scatter of each datum up to one factor.

    Raises
    ------
    ValueError : fewer data than parameters, or bounds that are none.
    """
    data = np.asarray(data, dtype=float)
    n, p = len(data), len(free)
    if not p:
        raise ValueError("nothing is left to fit")
    if n <= p:
        raise ValueError(f"{n} data cannot determine {p} parameters")
    if bad := [one.name for one in free if not one.low < one.high]:
        raise ValueError(f"the bounds of {', '.join(bad)} are not in order")
    weight = np.broadcast_to(np.asarray(weight, dtype=float), data.shape)
    problem = _Problem(predict, data, free, step, weight / weight.mean())
    starts = _starts(problem, level, seed)
    if start is not None:
        asked = [one.place(start[one.name]) if one.name in start else 0.5 for one in free]
        starts = [np.clip(asked, 0.0, 1.0)]
    if len(starts) > KEPT:
        brief = sorted((problem.solve(one, evaluations=BRIEF) for one in starts), key=_squares)
        starts = [one for one, _ in brief[:KEPT]]
    found = sorted((problem.solve(one) for one in starts), key=_squares)
    if start is None:
        found = _minima(problem, found)
    for _ in range(_ANEW):
        try:
            return _told(problem, found, profile)
        except _Better as better:
            found = _apart([problem.solve(better.place), *found])
    return _told(problem, found, False)


def _minima(problem: _Problem, found: list[_Minimum]) -> list[_Minimum]:
    """Minima of the sum of squares, the best first: what else may fit is looked for.

    A fault at the well and none within reach give the same pressures for another permeability.
    From the best place each parameter that is not sharp there is put elsewhere, the others fitted
    anew, and where that comes nearer to the data than on either side, all are let go.
    """
    for _ in range(_ANEW):
        best, squares = found[0]
        tried: list[_Minimum] = []
        vague = ~(_linearised(problem, best, squares).half <= NEARLY_LINEAR)
        for k in np.flatnonzero(vague).tolist():
            held = []
            for place in ELSEWHERE:
                at = best.copy()
                at[k] = place
                held.append(problem.solve(at, held=k, evaluations=BRIEF, gain=ROUGH))
            sums = [math.inf, *(found for _, found in held), math.inf]
            for number, (at, size) in enumerate(held):
                if size < sums[number] and size < sums[number + 2]:
                    tried.append(problem.solve(at, evaluations=2 * BRIEF))
        found = _apart([*found, *tried])
        if found[0][1] > (1.0 - 1e-3) * squares:
            break
    return found


def _apart(found: list[_Minimum]) -> list[_Minimum]:
    """Minima in their order, each but once."""
    kept: list[_Minimum] = []
    for u, squares in sorted(found, key=_squares):
        if all(np.max(np.abs(u - other)) > APART for other, _ in kept):
            kept.append((u, squares))
    return kept


def _squares(tried: _Minimum) -> float:
    return tried[1]


class _Better(Exception):
    """A place that was met on a profile and is better than the best so far."""

    def __init__(self, place: np.ndarray):
        self.place = place


def _starts(problem: _Problem, level: str | None, seed: int) -> list[np.ndarray]:
    """The best of some points between the bounds, apart from one another."""
    free = problem.free
    points = qmc.Sobol(len(free), seed=seed).random(SCANNED)
    names = [one.name for one in free]
    shift = names.index(level) if level in names else None
    rated = []
    for u in points:
        off = problem.residual(u)
        if shift is not None:
            mean = float(np.mean(off))
            one = free[shift]
            u[shift] = np.clip(one.place(max(one.value(u[shift]) + mean, one.low)), 0.0, 1.0)
            off = off - mean
        rated.append((float(off @ off), u))
    rated.sort(key=lambda one: one[0])
    chosen: list[np.ndarray] = []
    for _, u in rated:
        if all(np.max(np.abs(u - other)) > 0.1 for other in chosen):
            chosen.append(u)
        if len(chosen) == STARTS:
            break
    return chosen


class _Linear(NamedTuple):
    """What the model linearised at a minimum says of the parameters."""

    half: np.ndarray  # (p,) half widths of the intervals
    allowed: float  # sum of squares over the least, up to which a value counts as fitting
    correlation: np.ndarray  # (p, p)
    residual: np.ndarray  # (n,) weighted
    persistence: float
    effective: float


def _linearised(problem: _Problem, u: np.ndarray, squares: float) -> _Linear:
    n, p = len(problem.data), len(u)
    off = problem.residual(u)
    persistence = _persistence(off)
    effective = max(n * (1.0 - persistence) / (1.0 + persistence), p + 1.0)
    freedom = max(effective - p, 1.0)
    # the mean square per datum, not below what doubles round, and the variance of what so few
    # independent ones tell
    rounded = (np.finfo(float).eps * float(np.abs(problem.data).max(initial=0.0))) ** 2
    variance = max(squares / (n - p), rounded, 1e-300) * (n / effective)
    jacobian = problem.jacobian(u)
    size = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / np.where(size > 0.0, size, 1.0)
    curvature, axes = np.linalg.eigh(scaled.T @ scaled)
    inverse = (axes / np.maximum(curvature, _FLAT)) @ axes.T  # what is flat has no end
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation = np.sqrt(variance * np.diag(inverse)) / size
        deviation = np.where(size > 0.0, deviation, np.inf)
        root = np.sqrt(np.diag(inverse))
        correlation = inverse / np.outer(root, root)
    half = deviation * stats.t.ppf(0.5 + 0.5 * CONFIDENCE, freedom)
    allowed = float(variance * stats.f.ppf(CONFIDENCE, 1, freedom))
    return _Linear(half, allowed, correlation, off, persistence, effective)


def _told(problem: _Problem, minima: list[_Minimum], profile: bool | None) -> Fit:
    (u, squares), *others = minima
    n, p = len(problem.data), len(u)
    half, allowed, correlation, off, persistence, effective = _linearised(problem, u, squares)
    as_good = [] if profile is False else [m for m in others if m[1] < squares + allowed]
    estimates = []
    for k, one in enumerate(problem.free):
        low, high = u[k] - half[k], u[k] + half[k]
        with np.errstate(invalid="ignore", divide="ignore"):
            along = np.nan_to_num(correlation[:, k] * half / half[k], posinf=0.0, neginf=0.0)
        by_profile = profile
        if profile is None:
            by_profile = not (
                half[k] <= NEARLY_LINEAR
                and _foreseen(problem, u, half[k] * along, squares, allowed)
            )
        if by_profile:
            low = _end(problem, u, k, -1.0, squares, allowed, half[k], along=along)
            high = _end(problem, u, k, +1.0, squares, allowed, half[k], along=along)
        away = [at for at, _ in as_good if not low <= at[k] <= high]
        for at, size in as_good:  # an interval holds all that fits
            reach = 0.5 * NEARLY_LINEAR
            low = min(low, _end(problem, at, k, -1.0, squares, allowed, reach, size))
            high = max(high, _end(problem, at, k, +1.0, squares, allowed, reach, size))
        open_below, open_above = low <= 0.0, high >= 1.0
        low, high = max(low, 0.0), min(high, 1.0)
        ends = one.value(low), one.value(high)
        why, another = "", math.nan
        if open_below and open_above:
            why = "the data leave it anywhere between its bounds"
        elif open_below or open_above:
            side = "lower" if open_below else "upper"
            why = f"the data leave its {side} side open: they bound it from one side only"
        elif one.logarithmic and ends[1] > WIDE * ends[0]:
            why = "the data tell no more than its order of magnitude"
        elif away:
            why, another = "the data fit another value as well", one.value(float(away[0][k]))
        estimates.append(
            Estimate(
                *(one.name, one.value(u[k]), *ends, not why, why),
                "profile" if by_profile else "jacobian",
                another,
            )
        )
    residual = off / problem.weight
    return Fit(
        estimates=tuple(estimates),
        correlation=correlation,
        fitted=problem.data - residual,
        residual=residual,
        scatter=math.sqrt(squares / (n - p)),
        persistence=persistence,
        effective=effective,
        squares=squares,
        evaluations=problem.evaluations,
    )


def _foreseen(
    problem: _Problem, u: np.ndarray, step: np.ndarray, squares: float, allowed: float
) -> bool:
    """Whether the sum of squares rises to both ends of an interval as the Jacobian foresees it.

    `step` (p,) leads to an end, all parameters changing with the one as in a linear model. Beside a
    parameter that moves far, one with a narrow interval need not be linear.
    """
    for way in (-1.0, 1.0):
        at = u + way * step
        if np.any((at < 0.0) | (at > 1.0)):
            return False
        rise = float(np.sum(problem.residual(at) ** 2)) - squares
        if not abs(rise / max(allowed, 1e-300) - 1.0) <= AS_FORESEEN:
            return False
    return True


def _persistence(off: np.ndarray) -> float:
    """Correlation of neighbouring residuals, 0 where chance gives as much once in twenty times."""
    if len(off) < 8:
        return 0.0
    centred = off - off.mean()
    whole = float(centred @ centred)
    if whole == 0.0:
        return 0.0
    rho = float(centred[1:] @ centred[:-1]) / whole
    return min(rho, 0.98) if rho > 2.0 / math.sqrt(len(off)) else 0.0


def _end(
    problem: _Problem,
    u: np.ndarray,
    k: int,
    way: float,
    squares: float,
    allowed: float,
    half: float,
    here: float | None = None,
    along: np.ndarray | float = 0.0,
) -> float:
    """Where the profile likelihood of a parameter leaves the interval; a bound or beyond if never.

    The others are fitted anew at each place; a place is sought by halving between one inside and
    one outside, from the linear guess. `here` is the sum of squares at u, where it is not the best;
    `along` (p,) is how all change with this one while the model is linear.
    """
    bound = 1.0 if way > 0 else 0.0
    room = abs(bound - u[k])
    if room < 1e-9:
        return bound

    gain = min(ROUGH, 0.01 * allowed / max(squares, 1e-300))

    def excess(reach: float) -> tuple[float, np.ndarray]:
        # on the line through the two last places of the profile
        slope = (at_inside - u) / inside if inside > 0.0 else way * along
        at = np.clip(at_inside + (reach - inside) * slope, 0.0, 1.0)
        at[k] = u[k] + way * reach
        best, found = problem.solve(at, held=k, evaluations=25, gain=gain)
        if found < squares - 0.1 * allowed:
            raise _Better(best)
        return (found - squares) / allowed - 1.0, best

    guess = half if math.isfinite(half) and half > 0.0 else 0.5 * room
    inside, at_inside = 0.0, u
    e_inside = -1.0 if here is None else (here - squares) / allowed - 1.0
    outside, e_outside = None, 0.0
    reach = min(guess, room)
    for _ in range(12):
        e, best = excess(reach)
        if e < 0.0:
            inside, at_inside, e_inside = reach, best, e
            if reach >= room:
                return bound
            reach = min(2.0 * reach, room)
        else:
            outside, e_outside = reach, e
            break
    if outside is None:
        return bound
    last = 0.0  # on which side the last place was
    for _ in range(_HALVED):
        # of a parabola through the minimum, from the end that is nearer; by half where it creeps
        root = math.sqrt(max(1.0 + e_inside, 0.0))
        share = (root - 1.0) / (root - math.sqrt(1.0 + e_outside))
        share = min(max(share, 0.1), 0.9) if last == 0.0 else 0.5
        reach = inside + share * (outside - inside)
        if outside - inside < 0.02 * outside:
            break
        e, best = excess(reach)
        if abs(e) < 0.02:
            break
        last = math.copysign(1.0, e) if last == 0.0 or last == math.copysign(1.0, e) else 0.0
        if e < 0.0:
            inside, at_inside, e_inside = reach, best, e
        else:
            outside, e_outside = reach, e
    result: float = u[k] + way * reach
    return result


def told_pairs(found: Fit) -> list[str]:
    """Pairs of parameters that the data tell together better than apart."""
    names = [one.name for one in found.estimates]
    rho = found.correlation
    return [
        f"{names[i]} and {names[j]} go together (correlation {rho[i, j]:+.3f})"
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(rho[i, j]) > CORRELATED
    ]


def shared_count(found: Mapping[str, Fit]) -> float:
    """Independent data by the model that leaves the least: what misfits is no measure of them."""
    return min(found.values(), key=lambda one: one.scatter).effective


def by_likelihood(found: Mapping[str, Fit]) -> dict[str, Fit]:
    """The models in the order of BIC, the likeliest first."""
    count = shared_count(found)
    return dict(sorted(found.items(), key=lambda one: one[1].bic(count)))


def choice(found: Mapping[str, Fit]) -> str:
    """A sentence on which of several models the data speak for, and how plainly."""
    count = shared_count(found)
    order = list(by_likelihood(found))
    best = order[0]
    if len(order) == 1:
        return f"only {best} was tried"
    second = order[1]
    lead = found[second].bic(count) - found[best].bic(count)
    by_aic = min(found, key=lambda name: found[name].aic(count))
    if lead < 2.0:
        told = f"the data do not tell {best} from {second} (BIC {lead:.1f} apart)"
    else:
        word = "somewhat" if lead < 6.0 else "plainly"
        told = f"the data speak {word} for {best} before {second} (BIC {lead:.1f} apart)"
    if by_aic != best:
        told += f"; AIC, which minds parameters less, prefers {by_aic}"
    return told + "; no model that was not tried is excluded"
