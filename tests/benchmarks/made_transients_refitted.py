"""Made transients with 1 % noise, of every reservoir model, and the intervals of their fits.

Of each model, 90 to 99 in a hundred of all true values have to lie in their 95 % intervals. Of a
single parameter, exact intervals give fewer than 90 or all of a hundred once in 57 times, and there
are 57 parameters: each of them is held to what chance gives exact intervals, all parameters taken
together, in 99 of a hundred runs of this check. What some of the data leave open is said to be so,
and such intervals may be wider. COUNT and MODELS (of the environment) make fewer transients, and
choose models.
"""

from __future__ import annotations

import os
import time
from typing import NamedTuple

import numpy as np
from scipy.stats import binom, qmc

from demflow.sweep.analysis.fitting import Fit, Free, fit
from demflow.sweep.analysis.reservoirs import MODELS, Superposed
from demflow.sweep.study.reservoir import PARAMETERS, Rock, parameters_of
from tests.benchmarks.result import Result

COUNT = int(os.environ.get("COUNT", "100"))  # transients of each model
CHOSEN = os.environ.get("MODELS", "").split()  # all, if none is named
NOISE = 0.01  # of the pressure change of each point
POINTS, FIRST, LAST = 40, 10.0, 1e6  # times, s
ROCK = Rock(porosity=0.2, viscosity=1e-3, compressibility=1e-9, well_radius=0.1, thickness=10.0)
RATE = 1e-3  # m³/s
INITIAL = 3e7  # Pa

# where the true values are drawn from, log-uniform but for skin and places
TRUTH = {
    "permeability": (1e-14, 3e-13),
    "skin_factor": (0.0, 8.0),
    "wellbore_storage": (1e-9, 1e-7),
    "distance": (15.0, 300.0),
    "ratio": (1.0, 8.0),
    "width": (30.0, 300.0),
    "offset": (0.1, 0.5),
    "radius": (50.0, 500.0),
    "area": (1e4, 1e6),
    "aspect": (1.0, 4.0),
    "half_length": (10.0, 100.0),
    "fracture_conductivity": (1e-13, 1e-10),
    "storativity_ratio": (0.02, 0.4),
    "interporosity_flow": (1e-8, 1e-5),
}
# what is sought: a factor of ten or more beyond
BOUNDS = {
    "permeability": (1e-16, 1e-11),
    "skin_factor": (-5.0, 30.0),
    "wellbore_storage": (1e-11, 1e-5),
    "distance": (1.0, 3e3),
    "ratio": (0.999, 50.0),
    "width": (2.0, 3e3),
    "offset": (0.02, 0.5),
    "radius": (2.0, 5e3),
    "area": (1e2, 1e8),
    "aspect": (0.999, 10.0),
    "half_length": (1.0, 1e3),
    "fracture_conductivity": (1e-15, 1e-8),
    "storativity_ratio": (1e-3, 0.95),
    "interporosity_flow": (1e-10, 1e-3),
}
FRACTURED = ("skin_factor",)  # the fracture takes its place


class Made(NamedTuple):
    """What came of one transient."""

    inside: dict[str, bool]
    determined: dict[str, bool]
    seconds: float


def sought(model: str) -> list[str]:
    """The parameters of a model that are fitted; the initial pressure is measured before."""
    names = ["permeability", "skin_factor", "wellbore_storage"]
    if MODELS[model].fractured:
        names.remove("skin_factor")
    fixed = ("offset_along", "offset_across")
    return names + [
        n for n in parameters_of(model) if n in TRUTH and n not in (*names, *fixed, "skin_factor")
    ]


def drawn(name: str, u: float) -> float:
    """A true value, from 0 to 1."""
    low, high = TRUTH[name]
    if name in ("skin_factor", "offset"):
        return low + (high - low) * u
    return low * (high / low) ** u


def one(model: str, u: np.ndarray, rng: np.random.Generator) -> Made:
    """Make a transient, add noise, fit it."""
    begin = time.process_time()
    names = sought(model)
    fixed = {n: PARAMETERS[n].default for n in parameters_of(model)} | {"initial_pressure": INITIAL}
    truth = {name: drawn(name, x) for name, x in zip(names, u, strict=True)}
    times = np.geomspace(FIRST, LAST, POINTS)
    well = Superposed(times, ((0.0, RATE),))

    def predict(values: dict[str, float]) -> np.ndarray:
        return well.pressure(MODELS[model], ROCK, {**fixed, **values})

    exact = predict(truth)
    scatter = NOISE * (INITIAL - exact)
    data = exact + rng.normal(0.0, scatter)
    weight = 1.0 / (INITIAL - data)
    free = [Free(name, *BOUNDS[name]) for name in names]
    found: Fit = fit(predict, data, free, weight=weight)
    return Made(
        {n: bool(found[n].low <= truth[n] <= found[n].high) for n in names},
        {n: found[n].determined for n in names},
        time.process_time() - begin,
    )


def of_model(model: str, count: int = COUNT) -> list[Made]:
    """Transients of one model, their true values spread evenly."""
    seed = sorted(MODELS).index(model)
    points = qmc.LatinHypercube(len(sought(model)), seed=seed).random(count)
    rng = np.random.default_rng(100 + seed)
    return [one(model, u, rng) for u in points]


def fewest(count: int, parameters: int) -> int:
    """True values inside that each of so many parameters has at least, in 99 of a hundred runs."""
    return int(binom.ppf(0.01 / parameters, count, 0.95))


def run() -> Result:
    """Of each model: how many of its true values are inside, in a hundred."""
    models = CHOSEN or list(MODELS)
    least = fewest(COUNT, sum(len(sought(model)) for model in models))
    lines, shares, lowest = [], {}, {}
    for model in models:
        made = of_model(model)
        cells, names = [], sought(model)
        for name in names:
            inside = sum(m.inside[name] for m in made)
            loose = sum(not m.determined[name] for m in made)
            lowest[f"{model} {name}"] = inside
            cells.append(f"{name} {inside}" + (f" ({loose} said to be open)" if loose else ""))
        inside = sum(lowest[f"{model} {name}"] for name in names)
        shares[model] = 100.0 * inside / (COUNT * len(names))
        seconds = sum(m.seconds for m in made)
        told = f"{model}: {shares[model]:.1f} %; {', '.join(cells)}"
        lines.append(f"{told}; {seconds:.0f} s of processor time")
    off = [name for name, inside in lowest.items() if inside < least]
    off += [name for name, share in shares.items() if not 90.0 <= share <= 99.0]
    lines.append(f"off: {', '.join(off) or 'none'}")
    worst = min(lowest, key=lambda name: lowest[name])
    return Result(
        f"of {COUNT} transients a model, {min(shares.values()):.1f} to "
        f"{max(shares.values()):.1f} % of the true values inside; of one parameter at least "
        f"{lowest[worst]} ({worst})",
        f"90 to 99 % of each model, at least {least} of each parameter",
        not off,
        "\n".join(lines),
    )
