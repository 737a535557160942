"""`dataset.demflow`, tables of results, and studies side by side."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from demflow import sweep
from demflow.model.outcome import Status
from demflow.sweep.accessor import Results, compare
from demflow.sweep.errors import ResultsError


def invented():
    times = np.geomspace(1.0, 1e3, 31)
    slopes = np.array([2.0, 5.0])
    change = slopes[:, None, None] * np.log(times / 0.1)
    return xr.Dataset(
        {
            "status": ("rate", np.array([Status.DONE, Status.INACCURATE], dtype=np.int8)),
            "porosity": ("rate", [0.2, 0.3], {"units": "1"}),
            "drop": ("rate", [1.0, 2.0], {"units": "Pa"}),
            "pressure_change": (("rate", "well", "elapsed_time"), change, {"units": "Pa"}),
        },
        {
            "rate": ("rate", [1e-5, 2e-5], {"units": "m3 s-1"}),
            "well": ["p"],
            "elapsed_time": ("elapsed_time", times, {"units": "s"}),
        },
        {"study": "invented"},
    )


def test_the_derivative_of_a_logarithm_is_its_slope():
    dataset = invented()
    assert isinstance(dataset.demflow, Results)
    found = dataset.demflow.derivative(smoothing=0.3)
    assert found.dims == ("rate", "well", "elapsed_time")
    np.testing.assert_allclose(found.isel(rate=0), 2.0, rtol=1e-9)
    np.testing.assert_allclose(found.isel(rate=1), 5.0, rtol=1e-9)
    assert found.attrs["units"] == "Pa"


def test_only_good_cases_keep_their_results():
    dataset = invented()
    kept = dataset.demflow.good()
    np.testing.assert_array_equal(kept["porosity"], [0.2, np.nan])
    assert np.isnan(kept["pressure_change"].isel(rate=1)).all()
    np.testing.assert_array_equal(dataset["porosity"], [0.2, 0.3])


def test_a_table_has_a_row_for_each_case_and_all_digits(tmp_path):
    dataset = invented()
    dataset["porosity"][0] = 0.1 + 0.2
    path = dataset.demflow.to_csv(tmp_path / "t.csv", ["porosity", "drop"])
    table = pd.read_csv(path)
    assert list(table.columns) == ["rate [m3 s-1]", "porosity", "drop [Pa]"]
    assert table["porosity"][0] == 0.1 + 0.2
    long = dataset.demflow.to_dataframe("pressure_change")
    assert len(long) == 2 * 31
    assert "elapsed_time [s]" in long
    every = dataset.demflow.to_dataframe()
    assert {"status", "porosity", "drop [Pa]"} <= set(every.columns)
    with pytest.raises(ResultsError, match="lie along the same dimensions"):
        dataset.demflow.to_dataframe(["porosity", "pressure_change"])
    with pytest.raises(ResultsError, match="has no permeability"):
        dataset.demflow.permeability()


def test_studies_stand_side_by_side(tmp_path):
    folders = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        invented().assign_attrs(study=name).to_netcdf(folder / "dataset.nc")
        folders.append(folder)
    tree = compare(*folders)
    assert set(tree.children) == {"one", "two"}
    both = tree.map_over_datasets(lambda ds: ds.demflow.good() if "status" in ds else ds)
    assert np.isnan(both["two"]["porosity"].values[1])
    lazy = sweep.open_results(folders[0], lazy=True)
    assert not lazy["pressure_change"].variable._in_memory
    np.testing.assert_array_equal(lazy["pressure_change"], invented()["pressure_change"])
    lazy.close()
    with pytest.raises(ResultsError, match="two of the studies are named one"):
        compare(folders[0], folders[0])
    with pytest.raises(ResultsError, match="does not exist"):
        compare(tmp_path / "three")
