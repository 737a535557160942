"""The size from which on a permeability is that of the rock: found where it is, and only there."""

import numpy as np
import pytest
import xarray as xr

from demflow.sweep.analysis.representative import size_effect

SIZES = np.array([8.0, 1.0, 4.0, 2.0])  # in no order


def tensors(mean, spread, members=400, seed=0):
    """Isotropic tensors with ln k normal about a mean, by size."""
    rng = np.random.default_rng(seed)
    logs = np.log(mean)[:, None] + np.asarray(spread)[:, None] * rng.standard_normal((4, members))
    values = np.zeros((4, members, 2, 2))
    values[..., 0, 0], values[..., 1, 1] = np.exp(logs), 2.0 * np.exp(logs)
    size = xr.DataArray(SIZES, dims="size")
    return xr.DataArray(values, dims=("size", "seed", "row", "column")), size


@pytest.mark.parametrize(
    ("mean", "spread", "wanted"),
    [
        ([1e-14, 3e-14, 1.05e-14, 1.1e-14], [0.05, 0.5, 0.1, 0.15], 2.0),
        ([1e-14, 3e-14, 1.05e-14, 1.1e-14], [0.05, 0.5, 0.1, 0.30], 4.0),
        ([1e-14, 1e-14, 1.0e-14, 1.0e-14], [0.05, 0.1, 0.1, 0.1], 1.0),
        ([1e-14, 1e-14, 1.0e-14, 1.0e-14], [0.05, 0.1, 0.4, 0.1], None),  # unsteady on the way
        ([4e-14, 1e-14, 3.0e-14, 2.0e-14], [0.05, 0.1, 0.1, 0.1], None),  # it goes on growing
        ([1e-14, 1e-14, 1.0e-14, 1.0e-14], [0.5, 0.1, 0.1, 0.1], None),
    ],
)
def test_the_least_size_from_which_all_agree(mean, spread, wanted):
    found = size_effect(*tensors(mean, spread), ["seed"])
    assert found.representative == wanted
    order = np.argsort(SIZES)
    np.testing.assert_array_equal(found.size, SIZES[order])
    error = np.asarray(spread)[order] / 20.0
    for i, factor in ((0, 1.0), (1, 2.0)):
        off = np.log(found.mean[:, i]) - np.log(factor * np.asarray(mean)[order])
        assert (np.abs(off) < 4.0 * error).all()
        assert (np.abs(found.spread[:, i] - np.asarray(spread)[order]) < 3.0 * error).all()


def test_cases_without_a_result_do_not_count():
    values, size = tensors([1e-14] * 4, [0.1] * 4, members=6)
    values[0, :5] = np.nan
    values[1, 2] = 0.0  # nothing conducts
    found = size_effect(values, size, ["seed"])
    assert found.members.tolist() == [5, 6, 6, 1]
    assert np.isnan(found.spread[-1]).all()
    assert found.representative is None  # one realisation shows no spread
