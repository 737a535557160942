"""Sobol' indices and elementary effects of samples, and what failed cases do to them."""

import itertools

import numpy as np
import pytest
import xarray as xr
from scipy import stats

from demflow.model.outcome import Status
from demflow.sweep.analysis.sensitivity import sensitivity
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.designs import design


def sampled(values, d, count, method="saltelli", failed=(), seed=1):
    """A dataset with `values` at the points of a design."""
    y = np.asarray(values(design(method, d, count, seed)), dtype=float)
    status = np.full(len(y), Status.DONE, dtype=np.int8)
    status[list(failed)] = Status.FAILED
    y[list(failed)] = np.nan
    made_by = {
        "sampling_method": method,
        "sampling_count": count,
        "sampling_seed": seed,
        "sampled": " ".join("abcdefgh"[:d]),
    }
    dimensions = ("sample", "time")[: y.ndim]
    return xr.Dataset(
        {"y": (dimensions, y, {"units": "Pa"}), "status": ("sample", status)},
        {"sample": ("sample", np.arange(len(y)), made_by)},
    )


def bent(u):
    return u[:, 0] ** 2 + 3.0 * u[:, 1] * u[:, 2] - 0.5 * u[:, 1]


def test_indices_are_those_of_scipy():
    dataset = sampled(bent, 3, 64)
    found = sensitivity(dataset, "y")
    rows = dataset["y"].values.reshape(64, 5)
    known = stats.sobol_indices(
        func={"f_A": rows[None, :, 0], "f_B": rows[None, :, 1], "f_AB": rows.T[2:, None, :]}, n=64
    )
    np.testing.assert_allclose(found["first_order"], known.first_order, atol=1e-12)
    np.testing.assert_allclose(found["total"], known.total_order, atol=1e-12)
    for name in ("first_order", "total"):
        assert np.all(found[f"{name}_low"] <= found[name])
        assert np.all(found[name] <= found[f"{name}_high"])
    assert list(found["parameter"].values) == ["a", "b", "c"]


@pytest.mark.parametrize("seed", range(5))
def test_a_sum_of_squares_has_the_indices_of_its_parts(seed):
    weights = np.array([1.0, 2.0, 0.0])
    found = sensitivity(sampled(lambda u: u**2 @ weights, 3, 256, seed=seed), "y")
    truth = weights**2 / np.sum(weights**2)
    for name in ("first_order", "total"):
        assert np.all(found[f"{name}_low"] <= truth + 1e-12)
        assert np.all(truth <= found[f"{name}_high"] + 1e-12)
        assert np.all(found[f"{name}_high"] - found[f"{name}_low"] < 0.6)


def test_each_place_of_a_result_has_its_own_indices():
    dataset = sampled(lambda u: np.stack([u[:, 0], u[:, 1], 5.0 + 0.0 * u[:, 0]], axis=1), 2, 32)
    found = sensitivity(dataset, dataset["y"])
    assert found["total"].dims == ("parameter", "time")
    np.testing.assert_allclose(found["total"][:, 0], [1.0, 0.0], atol=0.3)
    np.testing.assert_allclose(found["total"][:, 1], [0.0, 1.0], atol=0.3)
    assert np.all(np.isnan(found["total"][:, 2]))  # a constant has no variance to be parted


@pytest.mark.slow
@pytest.mark.parametrize("failed", [(3,), (1, 9), (0, 1), (2, 5, 13)])
def test_bounds_hold_for_all_that_failed_cases_could_have_been_and_no_more(failed):
    dataset, limits = sampled(bent, 2 + 1, 4, failed=failed), (-1.0, 4.0)
    found = sensitivity(dataset, "y", limits=limits, resamples=1)
    low = {name: found[f"{name}_low"].values for name in ("first_order", "total")}
    high = {name: found[f"{name}_high"].values for name in ("first_order", "total")}
    reached = {name: [] for name in low}
    for guess in itertools.product(np.linspace(*limits, 11), repeat=len(failed)):
        y = dataset["y"].values.copy()
        y[list(failed)] = guess
        rows = y.reshape(4, 5)
        variance = rows[:, :2].var()
        for name, column in (("first_order", 1), ("total", 0)):
            ratio = 0.5 * ((rows[:, [column]] - rows[:, 2:]) ** 2).mean(axis=0) / variance
            value = np.clip(1.0 - ratio if name == "first_order" else ratio, 0.0, 1.0)
            assert np.all(low[name] - 1e-9 <= value)
            assert np.all(value <= high[name] + 0.02)  # the mean is tried at a few values
            reached[name].append(value)
        assert np.all(np.isnan(found["total"]))
    for name, values in reached.items():
        # one bootstrap sample widens the interval beyond the bounds of the sample itself
        assert np.all(np.max(values, axis=0) <= high[name] + 0.02)
        assert np.all(np.min(values, axis=0) >= low[name] - 0.02)
    assert int(found["unknown"]) == len(failed)


@pytest.mark.slow
def test_bounds_close_in_on_the_indices_as_the_limits_do():
    dataset = sampled(bent, 3, 128, failed=(4,))
    whole = sensitivity(sampled(bent, 3, 128), "y")
    value = float(bent(design("saltelli", 3, 128, 1))[4])
    widths = []
    for reach in (1.0, 0.1, 1e-3):
        found = sensitivity(dataset, "y", limits=(value - reach, value + reach))
        widths.append((found["total_high"] - found["total_low"]).values)
    assert np.all(np.diff(widths, axis=0) <= 1e-12)
    np.testing.assert_allclose(found["total_high"], whole["total_high"].clip(0, 1), atol=0.03)


def test_effects_of_a_plane_are_its_slopes():
    slopes = np.array([3.0, -2.0, 0.0])
    dataset = sampled(lambda u: u @ slopes + 1.0, 3, 6, "morris")
    found = sensitivity(dataset, "y")
    np.testing.assert_allclose(found["mu"], slopes, atol=1e-12)
    np.testing.assert_allclose(found["mu_star"], np.abs(slopes), atol=1e-12)
    np.testing.assert_allclose(found["sigma"], 0.0, atol=1e-6)
    assert found["mu"].attrs["units"] == "Pa"


def test_effects_of_a_product_vary_and_failed_cases_bound_them():
    whole = sensitivity(sampled(lambda u: u[:, 0] * u[:, 1], 2, 40, "morris"), "y")
    # the effect of one is the other, at 0.125, 0.375, 0.625 or 0.875
    np.testing.assert_allclose(whole["mu"], 0.5, atol=0.1)
    np.testing.assert_allclose(whole["sigma"], np.sqrt(5.0 / 64.0), atol=0.06)
    failed = sampled(lambda u: u[:, 0] * u[:, 1], 2, 40, "morris", failed=(7, 30))
    found = sensitivity(failed, "y", limits=(0.0, 1.0))
    for name in ("mu", "mu_star", "sigma"):
        assert np.all(np.isnan(found[name]))
        assert np.all(found[f"{name}_low"] <= whole[f"{name}"])
        assert np.all(whole[f"{name}"] <= found[f"{name}_high"])


def test_failed_cases_are_not_passed_over():
    dataset = sampled(bent, 3, 16, failed=(4, 11))
    with pytest.raises(ResultsError, match="2 of 80 cases have no good y"):
        sensitivity(dataset, "y")
    found = sensitivity(dataset, "y", limits="observed")
    assert found.attrs["limits_of_unknown_values"] == "observed"
    inaccurate = sampled(bent, 3, 16)
    inaccurate["status"][3] = Status.INACCURATE
    with pytest.raises(ResultsError, match="1 of 80 cases"):
        sensitivity(inaccurate, "y")


def test_what_has_no_such_sample_is_refused():
    with pytest.raises(ResultsError, match="its sample is sobol"):
        sensitivity(sampled(bent, 3, 16, "sobol"), "y")
    dataset = sampled(bent, 3, 16)
    with pytest.raises(ResultsError, match="it has no sample"):
        sensitivity(dataset.drop_vars("sample"), "y")
    with pytest.raises(ResultsError, match="a part of the sample"):
        sensitivity(dataset.isel(sample=slice(40)), "y")
    left = dataset.copy(deep=True)
    left["status"][0] = Status.LEFT_OUT
    with pytest.raises(ResultsError, match="where leaves samples out"):
        sensitivity(left, "y", limits=(0, 1))
    with pytest.raises(ResultsError, match="give the least first"):
        sensitivity(sampled(bent, 3, 16, failed=(2,)), "y", limits=(1.0, 0.0))
