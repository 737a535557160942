"""Δp and the Bourdet derivative: exactness, flow periods, noise, odd spacing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demflow.model.transient import (
    SMOOTHING,
    bourdet_derivative,
    flow_periods,
    log_time,
    pressure_change,
)


@given(
    steps=st.lists(st.floats(1e-3, 2.0), min_size=1, max_size=40),
    a=st.floats(-10, 10),
    b=st.floats(-10, 10),
    smoothing=st.floats(0, 1),
)
def test_exact_for_logarithms_at_any_spacing(steps, a, b, smoothing):
    times = np.exp(np.cumsum(steps))
    if len(times) < 2:
        assert np.all(np.isnan(bourdet_derivative(times, a + b * np.log(times))))
        return
    result = bourdet_derivative(times, a + b * np.log(times), smoothing=smoothing)
    np.testing.assert_allclose(result, b, atol=1e-8)


@given(steps=st.lists(st.floats(1e-2, 0.5), min_size=3, max_size=40), c=st.floats(-3, 3))
def test_exact_for_parabolas_in_log_time_ends_included(steps, c):
    x = np.cumsum(steps)
    values, exact = 1 + 2 * x + c * x**2, 2 + 2 * c * x
    result = bourdet_derivative(np.exp(x), values)
    np.testing.assert_allclose(result[1:-1], exact[1:-1], atol=1e-7)
    if exact.min() * exact.max() > 0.0:  # else an end may take the slope beside it
        np.testing.assert_allclose(result, exact, atol=1e-7)


@pytest.mark.parametrize("power", [1.0, 0.5, 0.25])
def test_slopes_of_flow_regimes_are_kept(power):
    times = np.geomspace(1e-2, 1e6, 161)
    derivative = bourdet_derivative(times, 3 * times**power)
    np.testing.assert_allclose(derivative, 3 * power * times**power, rtol=0.02)
    slope = np.diff(np.log(derivative[3:-3])) / np.diff(np.log(times[3:-3]))
    np.testing.assert_allclose(slope, power, rtol=1e-9)


def test_is_the_formula_of_bourdet_inside():
    """Against the definition written as a loop."""
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.uniform(0.02, 0.09, 60))
    values = rng.normal(size=60)
    L = 0.15
    result = bourdet_derivative(np.exp(x), values, smoothing=L)
    checked = 0
    for i in range(60):
        left = [j for j in range(i) if x[i] - x[j] >= L]
        right = [j for j in range(i + 1, 60) if x[j] - x[i] >= L]
        if left and right:
            j, k = left[-1], right[0]
            h1, h2 = x[i] - x[j], x[k] - x[i]
            m1, m2 = (values[i] - values[j]) / h1, (values[k] - values[i]) / h2
            assert result[i] == pytest.approx((m1 * h2 + m2 * h1) / (h1 + h2), rel=1e-9)
            checked += 1
    assert checked > 40


def test_smoothing_quietens_noise():
    rng = np.random.default_rng(1)
    times = np.geomspace(1, 1e4, 400)
    noisy = 5 + 2 * np.log(times) + rng.normal(scale=0.01, size=400)
    rough, smooth = (bourdet_derivative(times, noisy, smoothing=L)[20:-20] for L in (0.0, 0.3))
    assert np.std(smooth) < 0.2 * np.std(rough)
    assert abs(np.mean(smooth) - 2) < 0.01


def test_each_flow_period_starts_anew():
    """A drawdown and its build-up, each logarithmic in the time since its own start."""
    times = np.concatenate([np.geomspace(1, 100, 30), 100 + np.geomspace(0.5, 300, 40)])
    drawdown = times <= 100
    pressure = np.where(drawdown, 7e6 - 4e4 * np.log(times), np.nan)
    at_shut_in = pressure[29]
    later = ~drawdown
    pressure[later] = at_shut_in + 1e5 + 2e4 * np.log(times[later] - 100)
    start, sign = flow_periods([(0.0, 2e-5), (100.0, 0.0)])
    change = pressure_change(times, pressure, start, [7e6, at_shut_in], sign)
    np.testing.assert_allclose(change[drawdown], 4e4 * np.log(times[drawdown]), atol=1e-6)
    np.testing.assert_allclose(change[later], 1e5 + 2e4 * np.log(times[later] - 100), rtol=1e-10)
    derivative = bourdet_derivative(times, change, start)
    np.testing.assert_allclose(derivative, np.where(drawdown, 4e4, 2e4), rtol=1e-6)


def test_injection_and_production_give_positive_changes():
    times = np.geomspace(1, 10, 5)
    for rate in (2e-5, -2e-5):
        start, sign = flow_periods([(0.0, rate)])
        pressure = 7e6 - rate * 1e10 * np.log1p(times)
        assert np.all(pressure_change(times, pressure, start, [7e6], sign) > 0)


def test_flow_periods_skip_what_is_no_change():
    start, sign = flow_periods([(0.0, 0.0), (5.0, 1.0), (9.0, 1.0), (12.0, 0.5), (20.0, 2.0)])
    np.testing.assert_array_equal(start, [5, 12, 20])
    np.testing.assert_array_equal(sign, [1, -1, 1])


def test_nan_where_nothing_is_defined():
    times = np.array([1.0, 5.0, 6.0, 7.0, 10.0, 11.0])
    start = [5.0, 10.0]
    pressure = np.arange(6.0)
    change = pressure_change(times, pressure, start, [1.0, 4.0], [1, -1])
    np.testing.assert_array_equal(np.isnan(change), [True, True, False, False, False, False])
    # t = t_{k+1} still belongs to the period before; the last period has one time only
    np.testing.assert_array_equal(
        np.isnan(bourdet_derivative(times, change, start)), [True, True, False, False, False, True]
    )
    assert np.all(np.isnan(bourdet_derivative(times, change, [])))


def test_leading_axes_are_independent():
    times = np.geomspace(1, 1e3, 25)
    start, sign = flow_periods([(0.0, 1.0)])
    pressure = -np.random.default_rng(0).normal(size=(2, 3, 25)).cumsum(axis=-1)
    change = pressure_change(times, pressure, start, np.zeros((2, 3, 1)), sign)
    together = bourdet_derivative(times, change, start)
    assert together.shape == (2, 3, 25)
    np.testing.assert_array_equal(together[1, 2], bourdet_derivative(times, change[1, 2], start))


def test_refuses_nonsense():
    with pytest.raises(ValueError, match="negative"):
        bourdet_derivative([1.0, 2.0], [1.0, 2.0], smoothing=-SMOOTHING)
    with pytest.raises(ValueError, match="increase"):
        bourdet_derivative([2.0, 1.0], [1.0, 2.0])


RADIAL = 3e4  # Pa per natural-log unit of time and unit of rate


def radial(rate_changes, times):
    """Fall of the pressure of a well in radial flow, the sum of what each change of rate did."""
    fall, before = np.zeros_like(times), 0.0
    for begin, rate in rate_changes:
        acts = times > begin
        fall[acts] += (rate - before) * RADIAL * (np.log(times[acts] - begin) + 12.0)
        before = rate
    return fall


@pytest.mark.parametrize(
    "rate_changes",
    [
        ((0.0, 1.0), (1e3, 0.0)),
        ((0.0, 0.5), (4e2, 2.0), (1e3, 0.0)),
        ((0.0, 2.0), (7e2, 0.5), (1e3, 0.0)),
        ((0.0, 1.0), (2e2, 0.0), (6e2, 1.0), (1e3, 0.0)),
    ],
)
def test_a_build_up_in_radial_flow_shows_the_slope_of_its_drawdown(rate_changes):
    """From long before Δt = t_p to long after: the rate before the shut-in times the slope."""
    since = np.geomspace(1e-2, 1e5, 141)
    times = 1e3 + since
    start, sign = flow_periods(rate_changes)
    at_start = -radial(rate_changes, start)
    change = pressure_change(times, -radial(rate_changes, times), start, at_start, sign)
    x = log_time(times, rate_changes)
    last = rate_changes[-2][1]
    by_equivalent = bourdet_derivative(times, change, start, x=x)
    np.testing.assert_allclose(by_equivalent, last * RADIAL, rtol=1e-6)
    by_time = bourdet_derivative(times, change, start)
    assert by_time[np.searchsorted(since, 3e3)] < 0.75 * last * RADIAL


def test_equivalent_time_is_that_of_agarwal():
    times = 50.0 + np.geomspace(1e-3, 1e6, 30)
    since = times - 50.0
    expected = np.log(50.0 * since / (50.0 + since))
    np.testing.assert_allclose(log_time(times, [(0.0, 3.0), (50.0, 0.0)]), expected, rtol=1e-12)
    flowing = log_time(times, [(0.0, 3.0), (50.0, 1.0)])
    np.testing.assert_allclose(flowing, np.log(since), rtol=1e-12)


def test_rates_of_both_signs_leave_the_time_as_it_is():
    """An injection that all but undid the production would turn the equivalent time back."""
    times = 60.0 + np.geomspace(1e-2, 1e4, 60)
    x = log_time(times, [(0.0, 1.0), (50.0, -0.02), (60.0, 0.0)])
    assert np.all(np.diff(x) > 0.0)


@pytest.mark.parametrize(
    "rate_changes",
    [
        ((0.0, 1.0), (1e3, 2.5)),
        ((0.0, 1.0), (2e2, 0.0), (6e2, 1.6), (1e3, 0.4)),
        ((0.0, 1.0), (4e2, 2.0), (1e3, 0.0)),
    ],
)
def test_by_superposition_every_period_shows_the_slope_of_the_drawdown(rate_changes):
    """What the last change of rate does by itself, however long it lasts."""
    times = 1e3 + np.geomspace(1e-2, 1e3, 101)
    start, sign = flow_periods(rate_changes)
    at_start = -radial(rate_changes, start)
    change = pressure_change(times, -radial(rate_changes, times), start, at_start, sign)
    x = log_time(times, rate_changes, "superposition")
    slope = bourdet_derivative(times, change, start, x=x)
    step = abs(rate_changes[-1][1] - rate_changes[-2][1])
    np.testing.assert_allclose(slope, step * RADIAL, rtol=1e-6)


def test_the_abscissae_differ_where_they_should():
    times = 50.0 + np.geomspace(1e-3, 1e2, 30)
    flowing, shut = [(0.0, 1.0), (50.0, 1.5)], [(0.0, 1.0), (50.0, 0.0)]
    by = {word: log_time(times, flowing, word) for word in ("equivalent", "elapsed")}
    np.testing.assert_array_equal(by["equivalent"], by["elapsed"])
    assert np.all(log_time(times, flowing, "superposition") > by["elapsed"])
    closed = log_time(times, shut, "superposition")
    np.testing.assert_array_equal(closed, log_time(times, shut))
    np.testing.assert_array_equal(log_time(times, shut, "elapsed"), np.log(times - 50.0))
    with pytest.raises(ValueError, match="none of equivalent, elapsed, superposition"):
        log_time(times, shut, "horner")


@pytest.mark.parametrize("power", [1.0, 0.5])
def test_a_gap_in_the_times_leaves_the_slope_beside_it(power):
    """Three decades without a time; the points before and after know their own side."""
    times = np.concatenate([np.geomspace(1.0, 10.0, 21), np.geomspace(1e4, 1e6, 41)])
    derivative = bourdet_derivative(times, times**power)
    np.testing.assert_allclose(derivative, power * times**power, rtol=0.15)


def test_the_first_of_uneven_times_keeps_the_sign():
    """A storage line: Δp doubles between points that hardly differ in time from one another."""
    times = np.array([1.0, 10.0, 11.0, 12.0, 30.0, 31.0, 300.0])
    assert np.all(bourdet_derivative(times, times) > 0.0)
