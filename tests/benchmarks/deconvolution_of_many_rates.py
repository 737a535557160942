"""Deconvolution of records under several rates with noise, against the known unit response."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from demflow.sweep.analysis.deconvolution import deconvolve
from demflow.sweep.analysis.reservoirs import MODELS, Superposed, unit_response
from demflow.sweep.study.reservoir import PARAMETERS, Rock, parameters_of
from tests.benchmarks.result import Result

RUNS = 100
RATE_NOISE, PRESSURE_NOISE = 0.01, 0.001  # of each rate; of the largest change of pressure
WITHIN, DECADES = 0.05, 3.0
ROCK = Rock(porosity=0.2, viscosity=1e-3, compressibility=1e-9, well_radius=0.1, thickness=10.0)
INITIAL = 3e7  # Pa
PERIODS, LENGTH = 7, 1e6  # s in all
PER_PERIOD = 60  # points
MODELS_TRIED = (
    "homogeneous",
    "fault",
    "channel",
    "closed_circle",
    "infinite_conductivity_fracture",
)


class Run(NamedTuple):
    """One record: how many decades on end lie within the bound, and the worst error there is."""

    model: str
    decades: float
    middle: float  # median relative error


def one(model: str, rng: np.random.Generator) -> Run:
    """Make a record with noise in rates and pressures, deconvolve it, and compare."""
    draws = {
        "permeability": 10 ** rng.uniform(-13.6, -12.8),
        "skin_factor": 0.0 if MODELS[model].fractured else rng.uniform(0.0, 5.0),
        "wellbore_storage": 10 ** rng.uniform(-9.5, -8.5),
        "distance": rng.uniform(30.0, 200.0),
        "width": rng.uniform(60.0, 300.0),
        "radius": rng.uniform(150.0, 600.0),
        "half_length": rng.uniform(10.0, 60.0),
        "initial_pressure": INITIAL,
    }
    values = {n: draws.get(n, PARAMETERS[n].default) for n in parameters_of(model)}
    lengths = rng.uniform(0.5, 1.5, PERIODS)
    ends = np.cumsum(lengths) / lengths.sum() * LENGTH
    starts = np.concatenate([[0.0], ends[:-1]])
    rates = rng.uniform(0.3, 1.0, PERIODS) * 1e-3
    rates[[2, PERIODS - 1]] = 0.0  # two build-ups
    times = np.concatenate(
        [a + np.geomspace(3.0, b - a, PER_PERIOD) for a, b in zip(starts, ends, strict=True)]
    )
    true_rates = tuple(zip(starts.tolist(), rates.tolist(), strict=True))
    exact = Superposed(times, true_rates).pressure(MODELS[model], ROCK, values)
    error = PRESSURE_NOISE * float(np.max(INITIAL - exact))
    measured = exact + rng.normal(0.0, error, len(times))
    told = rates * (1.0 + RATE_NOISE * rng.normal(size=PERIODS))
    found = deconvolve(
        times,
        measured,
        tuple(zip(starts.tolist(), told.tolist(), strict=True)),
        pressure_error=error,
        rate_error=RATE_NOISE,
        initial_pressure=INITIAL,
        initial_error=error,
    )
    step = 1e-3
    above, below = (
        unit_response(MODELS[model], ROCK, values, found.time * np.exp(way * step))
        for way in (1.0, -1.0)
    )
    known = (above - below) / (2.0 * step)
    off = np.abs(found.derivative / known - 1.0)
    width = np.log10(found.time[1] / found.time[0])
    best = longest = 0
    for good in off <= WITHIN:
        longest = longest + 1 if good else 0
        best = max(best, longest)
    return Run(model, max(best - 1, 0) * width, float(np.median(off)))


def run() -> Result:
    """How many records give the derivative within the bound over enough decades on end."""
    rng = np.random.default_rng(5)
    begin = time.process_time()
    runs = [one(MODELS_TRIED[k % len(MODELS_TRIED)], rng) for k in range(RUNS)]
    lines = []
    for model in MODELS_TRIED:
        own = [each for each in runs if each.model == model]
        good = sum(each.decades >= DECADES for each in own)
        lines.append(
            f"{model}: {good} of {len(own)}; decades on end within {WITHIN:.0%}: least "
            f"{min(each.decades for each in own):.1f}, median "
            f"{np.median([each.decades for each in own]):.1f}; median error "
            f"{np.median([each.middle for each in own]):.1%}"
        )
    lines.append(f"{time.process_time() - begin:.0f} s of processor time, loaded")
    good = sum(each.decades >= DECADES for each in runs)
    return Result(
        f"{good} of {RUNS} within {WITHIN:.0%} over ≥ {DECADES:g} decades",
        f"≥ 90 of {RUNS}",
        bool(good >= 90),
        "\n".join(lines),
    )
