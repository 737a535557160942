"""Parameters of random sets lie inside their 95 % intervals in at least 93 % of 1,000 seeds."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
from scipy import special, stats

from demflow.model.region import Rectangle, contains
from demflow.model.scene import (
    Exponential,
    LengthPower,
    LogNormal,
    PowerLaw,
    RandomSet,
    Uniform,
    VonMises,
    lines_of,
)
from demflow.model.scene.random_sets import segments
from tests.benchmarks.result import Result

SEEDS, LEAST = 1000, 0.93
REGION = Rectangle(12.0, 10.0)
Z = 1.959964
DENSITY, INTENSITY = 2.0, 1.8
POWER, NORMAL = PowerLaw(2.2, 0.5, 20.0), LogNormal(0.7, 0.8)
MEAN = Exponential(0.9)
MISES, FLAT = VonMises(6.0, 1.0), Uniform((0.2, 1.7))


def drawn(seed: int, **changed: Any) -> RandomSet:
    """A set of some 240 fractures with centres in the region."""
    given = {"name": "s", "seed": seed, "density": DENSITY, "aperture": 1e-4}
    return RandomSet(**{**given, **changed})


def seen(one: RandomSet) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start, end and length of the fractures whose centres lie in the region."""
    start, end = segments(one.drawing, REGION)
    within = contains(REGION, 0.5 * (start + end))
    start, end = start[within], end[within]
    return start, end, np.hypot(*(end - start).T)


def near(mean: float, wanted: float, variance: float, n: int) -> bool:
    """Whether the score interval of a parameter holds it: the mean of its statistic is near."""
    return bool(abs(mean - wanted) <= Z * math.sqrt(variance / n))


def normal(values: np.ndarray, law: LogNormal) -> tuple[bool, bool]:
    """Median by Student's interval, deviation by that of χ²."""
    x = np.log(values)
    n, s = len(x), x.std(ddof=1)
    median = abs(x.mean() - math.log(law.median)) <= stats.t.ppf(0.975, n - 1) * s / math.sqrt(n)
    low, high = stats.chi2.ppf((0.025, 0.975), n - 1)
    return bool(median), bool(low <= (n - 1) * s**2 / law.deviation**2 <= high)


def power_law(length: np.ndarray) -> bool:
    """ln ℓ is a truncated exponential: its mean against that of the law, with its variance."""
    rate, span = POWER.exponent - 1.0, math.log(POWER.largest / POWER.least)
    tail = span / math.expm1(rate * span)
    variance = 1.0 / rate**2 - tail * (span + tail)
    x = np.log(length / POWER.least)
    return near(x.mean(), 1.0 / rate - tail, variance, len(x))


def angles(start: np.ndarray, end: np.ndarray, about: float) -> np.ndarray:
    """Angles of fractures, within a quarter turn of one."""
    turn = np.arctan2(*(end - start).T[::-1]) - about
    return about + (turn + math.pi) % (2.0 * math.pi) - math.pi


def inside(seed: int) -> dict[str, bool]:
    """Which parameters the intervals of one seed hold."""
    found: dict[str, bool] = {}
    start, end, length = seen(drawn(seed, length=POWER, angle=MISES))
    low = stats.chi2.ppf(0.025, 2 * len(length)) / 2
    high = stats.chi2.ppf(0.975, 2 * len(length) + 2) / 2
    found["density"] = low <= DENSITY * REGION.area <= high
    found["power law: exponent"] = power_law(length)
    turn = angles(start, end, MISES.mean) - MISES.mean
    ratio = special.i1e(MISES.concentration) / special.i0e(MISES.concentration)
    across = ratio / MISES.concentration
    found["von Mises: mean"] = near(np.sin(turn).mean(), 0.0, across, len(turn))
    along = 1.0 - across - ratio**2
    found["von Mises: concentration"] = near(np.cos(turn).mean(), ratio, along, len(turn))

    start, end, length = seen(drawn(seed, length=NORMAL, angle=FLAT))
    names = "log-normal lengths: median", "log-normal lengths: deviation"
    found |= dict(zip(names, normal(length, NORMAL), strict=True))
    turn = angles(start, end, 0.5 * sum(FLAT.limits))
    width, reach = FLAT.limits[1] - FLAT.limits[0], 0.05 ** (1.0 / len(turn))
    found["uniform: least"] = bool((FLAT.limits[1] - turn.min()) / width >= reach)
    found["uniform: largest"] = bool((turn.max() - FLAT.limits[0]) / width >= reach)

    *_, length = seen(drawn(seed, length=MEAN, angle=0.4))
    low, high = stats.chi2.ppf((0.025, 0.975), 2 * len(length))
    found["exponential: mean"] = bool(low <= 2.0 * length.sum() / MEAN.mean <= high)

    law = LogNormal(0.5, 8e-5)
    one = drawn(seed, density=None, intensity=INTENSITY, length=MEAN, angle=FLAT, aperture=law)
    lines = lines_of((one,), REGION)
    names = "log-normal apertures: median", "log-normal apertures: deviation"
    apertures = np.array([line.aperture for line in lines])
    found |= dict(zip(names, normal(apertures, law), strict=True))
    cut = np.array([line.length for line in lines])
    error = math.sqrt((cut**2).sum()) / REGION.area
    found["intensity"] = bool(abs(cut.sum() / REGION.area - INTENSITY) <= Z * error)
    return found


def exact() -> list[str]:
    """What is no matter of chance: counts, least spacings, apertures by length; what is wrong."""
    wrong = []
    power = LengthPower(0.6, 1e-4, 2.0)
    for seed in range(20):
        one = drawn(seed, density=None, count=150, length=0.8, angle=FLAT, least_spacing=0.3)
        start, end, length = seen(one)
        apart = np.hypot(*(0.5 * ((start + end)[:, None] - (start + end))).T)
        if len(length) != 150 or apart[~np.eye(150, dtype=bool)].min() < 0.3:
            wrong.append(f"count or least spacing, seed {seed}")
        one = drawn(seed, length=POWER, angle=MISES, aperture=power)
        whole = np.hypot(*np.subtract(*segments(one.drawing, REGION)).T)
        for line in lines_of((one,), REGION):
            wanted = 1e-4 * (whole[line.trace] / 2.0) ** 0.6
            if not math.isclose(line.aperture or 0.0, wanted, rel_tol=1e-12):
                wrong.append(f"aperture by length, seed {seed}")
    return wrong


def run() -> Result:
    """Count over the seeds."""
    held: Counter[str] = Counter()
    for seed in range(SEEDS):
        held.update(name for name, holds in inside(seed).items() if holds)
    wrong = exact()
    lines = [f"{name}: {100 * held[name] / SEEDS:.1f} %" for name in inside(0)]
    least = min(held[name] for name in inside(0)) / SEEDS
    return Result(
        f"inside in {100 * least:.1f} % at the least, {len(wrong)} exact properties missed",
        f"≥ {100 * LEAST:.0f} %, 0 missed",
        least >= LEAST and not wrong,
        "\n".join(lines + wrong),
    )
