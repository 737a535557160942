"""`demflow fit`: from a study with data to parameters with intervals, a figure and a file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from demflow.sweep.analysis.breaks import clock_shift, find_breaks
from demflow.sweep.analysis.fitting import (
    Estimate,
    Fit,
    by_likelihood,
    choice,
    shared_count,
    told_pairs,
)
from demflow.sweep.analysis.periods import longest_period, transient
from demflow.sweep.analysis.regimes import Regime, detect_regimes
from demflow.sweep.analysis.reservoirs import MODELS, Superposed, fit_model
from demflow.sweep.analysis.thinning import thinned
from demflow.sweep.dataset.folder import FITS, check_free
from demflow.sweep.errors import ResultsError
from demflow.sweep.store.durable import write_durably
from demflow.sweep.study.fits import Bounds, FitRequest
from demflow.sweep.study.load import Study, load_study
from demflow.sweep.study.measured import MeasuredTest
from demflow.sweep.study.reservoir import parameters_of

NETWORK = "network"  # the name of the scene among the models
SMOOTHING, MOST_OF_PERIOD = 0.3, 300  # L and points of the derivative whose regimes are told
MOST_SEARCHED = 20_000  # points of a record whose pressure is searched for changes of rate
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Fitted:
    """What was fitted, the likeliest model first."""

    study: Study
    request: FitRequest
    test: MeasuredTest
    time: np.ndarray  # (n,) s, of the data that were fitted
    pressure: np.ndarray  # (n,) Pa
    rates: tuple[tuple[float, float], ...]
    fits: dict[str, Fit]
    choice: str
    folder: Path
    figure: Path | None = None

    @property
    def best(self) -> Fit:
        """Of the likeliest model."""
        return next(iter(self.fits.values()))

    def shown(self, one: Estimate) -> tuple[float, float, float, str]:
        """Value and interval of a parameter in the unit that the study writes, and that unit."""
        value, low, high = (self.in_unit(one.name, x) for x in (one.value, one.low, one.high))
        return value, low, high, self._bounds(one.name).shown[0]

    def in_unit(self, name: str, value: float) -> float:
        """A value of a parameter in the unit that the study writes."""
        return value / self._bounds(name).shown[1]

    def _bounds(self, name: str) -> Bounds:
        return next(one for one in self.request.free if one.name == name)


def fit_study(
    path: str | Path,
    results: str | Path = "results",
    *,
    smoke: bool = False,
    figure: bool = True,
    tell: Tell | None = None,
) -> Fitted:
    """Fit what a study asks for to its measured test; figure and numbers go to `fit/`.

    Parameters
    ----------
    path : a study with the blocks `data` and `fit`.
    results : folder under which the results of all studies lie.
    smoke : apply the study's smoke block.
    figure : whether to draw data and model.
    tell : called with what was noted about the data, and how far a long fit is.

    Raises
    ------
    StudyError : the study is invalid. ResultsError : it asks for no fit, or a model has no
    answer between the bounds. StoreError, OSError : the folder cannot be used.
    """
    study = load_study(path, smoke=smoke, alone=True)
    request = study.fit
    if request is None:
        raise ResultsError(f"{path} has no block 'fit', which says what is fitted to which data")
    test = study.data[request.to]
    folder = Path(results) / study.name
    check_free(folder, study)
    hear = tell or (lambda message: None)
    for note in test.notes:
        hear(f"data.{test.name}: {note}")
    for note in _of_rates(test):
        hear(f"data.{test.name}: {note}")
    if request.models:
        time, pressure, rates, fits = _by_models(request, test)
    else:
        from demflow.sweep.fitting.network import fit_network

        time, pressure, rates, found = fit_network(study, request, test, Path(results), hear)
        fits = {NETWORK: found}
    ordered = by_likelihood(fits)
    fitted = Fitted(
        *(study, request, test, time, pressure, rates, ordered, choice(ordered)),
        folder=folder / FITS,
    )
    fitted.folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(summary(fitted), indent=1, ensure_ascii=False, allow_nan=False)
    write_durably(fitted.folder / "fit.json", text.encode())
    if not figure:
        return fitted
    from demflow.sweep.figures.fits import draw_fit

    (first, best) = next(iter(ordered.items()))
    title = f"{study.title}: {MODELS[first].title if first in MODELS else 'the network'}"
    drawn = draw_fit(time, pressure, best.fitted, rates, title, fitted.folder / "fit.png")
    return Fitted(**{**fitted.__dict__, "figure": drawn})


def _of_rates(test: MeasuredTest) -> list[str]:
    """What the pressure says of the rates: their times where none are given, or another clock."""
    if len(test.time) > MOST_SEARCHED:
        return []
    breaks = find_breaks(test.time, test.pressure)
    if test.rate_changes is None:
        told = ", ".join(f"{one.time:.4g} s ({one.confidence:.3f})" for one in breaks) or "none"
        return [f"no rates are given; changes that the pressure shows (with confidence): {told}"]
    shift = clock_shift(breaks, test.rate_changes, test.time)
    if shift is None:
        return []
    word = "later" if shift > 0 else "earlier"
    return [f"the pressure answers {abs(shift):.4g} s {word} than the rates change: two clocks?"]


def _by_models(
    request: FitRequest, test: MeasuredTest
) -> tuple[np.ndarray, np.ndarray, tuple[tuple[float, float], ...], dict[str, Fit]]:
    if test.rate_changes is None:
        what = (
            "has no rates, without which there is nothing to fit; give `rates: [[time, rate], …]`"
        )
        raise ResultsError(f"data.{test.name} {what}")
    rates = test.rate_changes
    try:
        Superposed(test.time, rates)
    except ValueError as error:
        raise ResultsError(f"data.{test.name}: {error}; see its rates") from None
    fits, record = {}, (test.time, test.pressure)
    for name in request.models:
        own = parameters_of(name)
        free = {one.name: (one.low, one.high) for one in request.free if one.name in own}
        known = {key: value for key, value in request.known.items() if key in own}
        try:
            fits[name] = fit_model(
                name, request.rock, record, rates, free, known, profile=request.profile
            )
        except ValueError as error:
            raise ResultsError(f"fit of {name} to data.{test.name}: {error}") from None
    return test.time, test.pressure, rates, fits


def regimes(fitted: Fitted) -> tuple[float, list[Regime]]:
    """Flow regimes that the record shows in its longest period, and when that begins, s.

    Parameters
    ----------
    fitted : the record is part of it
    """
    period = longest_period(fitted.time, fitted.rates)
    few = thinned(fitted.time, fitted.pressure, fitted.rates, MOST_OF_PERIOD)
    time, pressure = fitted.time[few], fitted.pressure[few]
    period = period._replace(members=period.members[few])
    if np.count_nonzero(period.members) < 3:
        return period.start, []
    found = transient(time, pressure, fitted.rates, period, SMOOTHING)
    return period.start, detect_regimes(time[period.members] - period.start, *found)


def _told_regimes(fitted: Fitted) -> str:
    start, found = regimes(fitted)
    shown = ", ".join(
        f"{one.name} {one.start:.3g} to {one.end:.3g} s ({one.confidence:.2f})" for one in found
    )
    after = f"regimes since {start:.4g} s, with confidence (derivative by superposition time, "
    return f"{after}L = {SMOOTHING}): {shown or 'none that lasts'}"


def told(fitted: Fitted) -> list[str]:
    """What was found, line by line."""
    lines = []
    count = shared_count(fitted.fits)
    for name, one in fitted.fits.items():
        lines.append(
            f"{name}: {len(one.residual)} points, scatter {one.scatter:.4g} Pa, "
            + (f"AIC {one.aic(count):.1f}" if math.isfinite(one.aic(count)) else "too few for AIC")
            + f", BIC {one.bic(count):.1f}"
        )
        width = max(len(e.name) for e in one.estimates)
        for e in one.estimates:
            value, low, high, unit = fitted.shown(e)
            word = "" if unit == "1" else f" {unit}"
            digits = 5  # and more where the interval is as narrow as they are
            if 0.0 < high - low < 1e-3 * abs(value):
                digits = min(2 + math.ceil(math.log10(abs(value) / (high - low))), 15)
            ends = f"[{low:.{digits}g}, {high:.{digits}g}]"
            line = f"  {e.name.ljust(width)}  {value:.{digits}g}{word}  {ends}"
            why = e.why
            if math.isfinite(e.another):
                why = f"the data fit {fitted.in_unit(e.name, e.another):.5g}{word} as well"
            lines.append(f"{line}  not determined: {why}" if why else line)
        lines += [f"  {pair}" for pair in told_pairs(one)]
        if one.persistence > 0.0:
            lines.append(
                f"  neighbouring residuals go together ({one.persistence:.2f}): the model leaves a "
                f"trend, and the intervals are those of {one.effective:.0f} independent points"
            )
    if len(fitted.fits) > 1:
        lines.append(fitted.choice)
    return [*lines, _told_regimes(fitted)]


def summary(fitted: Fitted) -> dict[str, Any]:
    """The same for a machine: SI."""
    count = shared_count(fitted.fits)

    def one(found: Fit) -> dict[str, Any]:
        return {
            "parameters": {
                e.name: {
                    "value": e.value,
                    "low": e.low,
                    "high": e.high,
                    "unit": _bounds(fitted.request, e.name).unit,
                    "determined": e.determined,
                    "why": e.why,
                    "interval": e.method,
                }
                for e in found.estimates
            },
            "correlation": [[_finite(x) for x in row] for row in found.correlation.tolist()],
            "scatter": found.scatter,
            "persistence": found.persistence,
            "effective_points": found.effective,
            "aic": _finite(found.aic(count)),
            "bic": _finite(found.bic(count)),
            "evaluations": found.evaluations,
        }

    start, found = regimes(fitted)
    return {
        "study": fitted.study.name,
        "data": fitted.test.name,
        "points": len(fitted.time),
        "confidence": 0.95,
        "models": {name: one(found) for name, found in fitted.fits.items()},
        "choice": fitted.choice,
        "regimes": {"since": start, "smoothing": SMOOTHING, "found": [r._asdict() for r in found]},
        "notes": list(fitted.test.notes),
    }


def _bounds(request: FitRequest, name: str) -> Bounds:
    return next(one for one in request.free if one.name == name)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
