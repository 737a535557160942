"""Changes of rate that the pressure shows by itself."""

import numpy as np
import pytest

from demflow.sweep.analysis.breaks import clock_shift, find_breaks

RATES = ((0.0, 1.0), (2e4, 0.0), (5e4, 0.6), (8e4, 0.0))


def record(rates, times, noise, seed):
    fall, before = np.zeros_like(times), 0.0
    for start, rate in rates:
        since = np.maximum(times - start, 0.0)
        fall += (rate - before) * (np.log1p(since / 5.0) + 3.0 * -np.expm1(-since / 20.0))
        before = rate
    return 3e7 - 1e5 * fall + np.random.default_rng(seed).normal(0.0, noise, len(times))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [0.0, 300.0, 3000.0])
def test_every_change_is_found_and_no_other(seed, noise):
    times = np.linspace(10.0, 1.1e5, 900)
    found = find_breaks(times, record(RATES, times, noise, seed))
    step = times[1] - times[0]
    assert len(found) == 3
    for one, (start, _) in zip(found, RATES[1:], strict=True):
        assert abs(one.time - start) <= 2.0 * step
        assert one.confidence >= 0.999
        assert times[one.place] == one.time


def test_times_may_be_even_in_the_logarithm():
    times = np.concatenate(
        [start + np.geomspace(1.0, 2e4, 60) for start in (0.0, 2e4 + 1, 4e4 + 2)]
    )
    rates = ((0.0, 1.0), (2e4 + 1, 0.0), (4e4 + 2, 1.0))
    found = find_breaks(times, record(rates, times, 200.0, 1))
    assert [one.place for one in found] == pytest.approx([59, 119], abs=2)


@pytest.mark.parametrize("seed", range(5))
def test_one_rate_has_no_break(seed):
    for times in (np.linspace(10.0, 1e5, 400), np.geomspace(1.0, 1e5, 400)):
        assert find_breaks(times, record(((0.0, 1.0),), times, 500.0, seed)) == []
    assert find_breaks(times[:5], times[:5]) == []


def test_rates_of_another_clock_are_told():
    times = np.linspace(10.0, 1.1e5, 900)
    found = find_breaks(times, record(RATES, times, 300.0, 0))
    assert clock_shift(found, RATES, times) is None
    early = tuple((max(start - 3600.0, 0.0), rate) for start, rate in RATES)
    assert clock_shift(found, early, times) == pytest.approx(3600.0, abs=200.0)
    assert clock_shift(found[:1], RATES, times) is None
    for start, shift in ((2e4 - 3600.0, 3600.0), (2e4 - 400.0, None)):  # of 30 points, of 3
        told = clock_shift(found[:1], ((0.0, 1.0), (start, 0.0)), times)
        assert told == (shift and pytest.approx(shift, abs=200.0))
