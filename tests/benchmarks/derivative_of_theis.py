"""The derivative of a line source, its build-up and its periods at other rates, at uneven times."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from demflow.model.analytic.radial import line_source
from demflow.model.transient import bourdet_derivative, flow_periods, log_time, pressure_change
from tests.benchmarks.result import Result

PER_DECADE, FIRST, LAST = 20, 1.0, 1e6  # t_D
PRODUCTION = 3e4  # t_D before the last period
DRAWS = 100
# abscissa and rates; the last period is judged
PERIODS: dict[str, tuple[str, tuple[tuple[float, float], ...]]] = {
    "drawdown": ("equivalent", ((0.0, 1.0),)),
    "build-up": ("equivalent", ((0.0, 1.0), (PRODUCTION, 0.0))),
    "second rate": ("superposition", ((0.0, 1.0), (PRODUCTION, 2.5))),
    "build-up after three rates": (
        "superposition",
        ((0.0, 1.0), (0.3 * PRODUCTION, 0.0), (0.5 * PRODUCTION, 1.6), (PRODUCTION, 0.0)),
    ),
}


def spread_times(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Times since the last change: even in log, at random in their cells, or these with a gap."""
    count = int(np.log10(LAST / FIRST) * PER_DECADE)
    place = 0.5 if kind == "even" else rng.uniform(0.0, 1.0, count)
    since = FIRST * (LAST / FIRST) ** ((np.arange(count) + place) / count)
    if "gap" in kind:
        begin = np.exp(rng.uniform(np.log(10 * FIRST), np.log(LAST / 100)))
        since = since[(since < begin) | (since > 10 * begin)]
    return since


def exact_slope(rates: tuple[tuple[float, float], ...], since: np.ndarray) -> np.ndarray:
    """dΔp/dx of the last period: dp/d ln t of a line source is exp(−1 / 4t) / 2."""
    start, rate = np.array(rates).T
    step = np.diff(rate, prepend=0.0)
    ratio = step / step[-1]
    age = start[-1] + since[:, None] - start
    grows = ratio / age
    rise = np.sum(0.5 * np.exp(-0.25 / age) * grows, axis=1)
    return rise / grows.sum(axis=1) * abs(step[-1])


def errors(
    by: str, rates: tuple[tuple[float, float], ...], since: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of the last period: inside, and at ends and beside gaps."""

    def pressure(times: np.ndarray) -> np.ndarray:
        fall, before = np.zeros_like(times), 0.0
        for start, rate in rates:
            acts = times > start
            fall[acts] += (rate - before) * line_source(1.0, times[acts] - start)
            before = rate
        return -fall

    times = rates[-1][0] + since
    starts, sign = flow_periods(rates)
    change = pressure_change(times, pressure(times), starts, pressure(starts), sign)
    x = log_time(times, rates, by)
    slope = bourdet_derivative(times, change, starts, x=x)
    error = np.abs(slope / exact_slope(rates, since) - 1.0)
    far = np.diff(np.log(since)) > 0.5 * np.log(10.0)
    edge = np.r_[True, far] | np.r_[far, True]
    return error[~edge], error[edge]


def run() -> Result:
    """Largest error over all draws, inside and at edges."""
    rng = np.random.default_rng(1)
    worst = np.zeros(2)
    lines = []
    measure: Callable[[np.ndarray], float] = np.max
    for name, (by, rates) in PERIODS.items():
        for kind in ("even", "uneven", "uneven with a gap"):
            found = [errors(by, rates, spread_times(kind, rng)) for _ in range(DRAWS)]
            here = np.array([[measure(one) for one in each] for each in found]).max(axis=0)
            worst = np.maximum(worst, here)
            lines.append(f"{name}, {kind}: {here[0]:.2%} inside, {here[1]:.2%} at ends and gaps")
    return Result(
        f"off by {worst[0]:.2%} at most inside, {worst[1]:.2%} at ends and gaps",
        "≤ 0.5 % inside, ≤ 2 % at ends and gaps",
        bool(worst[0] <= 0.005 and worst[1] <= 0.02),
        "\n".join(lines),
    )
