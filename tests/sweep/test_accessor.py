"""`dataset.demflow`, tables of results, and studies side by side."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure

from demflow import sweep
from demflow.model.outcome import Status
from demflow.sweep.accessor import Results, compare
from demflow.sweep.analysis.reservoirs import MODELS, Superposed
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.reservoir import Rock


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


def test_an_ensemble_has_the_mean_of_what_is_done_and_its_standard_error():
    """Over many draws of members, the mean lies as far off as the standard error says."""
    chance = np.random.default_rng(4)
    status = np.where(chance.random((400, 40)) < 0.8, Status.DONE, Status.FAILED)
    drop = chance.normal(3.0, 0.7, (400, 40))
    drop[status != Status.DONE] = 1e9
    axes = ("angle", "packing")
    dataset = xr.Dataset({"status": (axes, status), "drop": (axes, drop, {"units": "Pa"})})
    found = dataset.demflow.ensemble("drop", "packing")
    off = (found["mean"] - 3.0) / found["standard_error"]
    assert float((off**2).mean()) == pytest.approx(1.0, abs=0.25)
    assert (found["members"] == (status == Status.DONE).sum(axis=1)).all()
    assert found["standard_error"].attrs["units"] == "Pa"
    with pytest.raises(ResultsError, match="lies along angle, packing, not along 'seed'"):
        dataset.demflow.ensemble("drop", "seed")


def test_a_derivative_is_of_one_flow_period():
    dataset = with_rates()
    dataset.demflow.derivative()
    late = dataset["elapsed_time"] > 100.0
    built = dataset.assign(well_rate=dataset["well_rate"].where(~late, 0.0))
    with pytest.raises(ResultsError, match="the rate of p changes"):
        built.demflow.derivative()


def with_rates():
    """Two good cases, and a derivative that is the slope of the change."""
    dataset = invented().assign(status=("rate", np.full(2, Status.DONE, dtype=np.int8)))
    return dataset.assign(
        pressure_derivative=dataset.demflow.derivative(),
        well_rate=(dataset["rate"] * xr.ones_like(dataset["pressure_change"])),
    )


def test_a_well_is_drawn_on_axes_of_the_callers_in_units_of_the_callers():
    dataset = with_rates()
    ax = Figure().subplots()
    assert dataset.demflow.plot_well("p", ax, rate=1e-5, time="min", pressure="bar") is ax
    change, derivative = ax.lines
    times = dataset["elapsed_time"].values
    np.testing.assert_allclose(change.get_xdata(), times / 60.0)
    np.testing.assert_allclose(change.get_ydata(), 2.0 * np.log(times / 0.1) / 1e5)
    np.testing.assert_allclose(derivative.get_ydata(), 2.0 / 1e5, rtol=1e-9)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert "(min)" in ax.get_xlabel()
    assert "(bar)" in ax.get_ylabel()
    dataset.demflow.plot_well("p", ax, time="min", pressure="bar")  # both cases beside it
    assert len(ax.lines) == 6
    assert len({line.get_label() for line in ax.lines[2:]}) == 4


def test_a_flow_period_is_drawn_by_itself():
    dataset = with_rates()
    late = dataset["elapsed_time"] > 100.0
    built = dataset.assign(well_rate=dataset["well_rate"].where(~late, 0.0))
    ax = Figure().subplots()
    with pytest.raises(ResultsError, match="since= and until= of one flow period"):
        built.demflow.plot_well("p", ax, rate=1e-5)
    built.demflow.plot_well("p", ax, rate=1e-5, until=100.0)
    built.demflow.plot_well("p", ax, rate=1e-5, since=100.0, time="s")
    times = dataset["elapsed_time"].values
    np.testing.assert_allclose(ax.lines[2].get_xdata(), times[times > 100.0] - 100.0)
    for wrong, told in (
        ({"well": "q"}, "there are p"),
        ({"angle": 1.0}, "is no axis"),
        ({"rate": 1.1e-5}, "is not there"),
        ({"time": "bar"}, "no unit of a time"),
        ({"since": 1e9}, "no time lies after"),
    ):
        with pytest.raises(ResultsError, match=told):
            built.demflow.plot_well(**({"well": "p", "ax": ax} | wrong))


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
    with pytest.raises(ResultsError, match="no variable is named"):
        dataset.demflow.to_csv(path, [])
    with pytest.raises(ResultsError, match="has no permeability"):
        dataset.demflow.permeability()


def test_events_bear_the_values_of_their_case():
    counts = xr.Variable(("rate", "seed"), [[2, 0], [1, 3]], {"sample_dimension": "event"})
    dataset = xr.Dataset(
        {
            "status": (("rate", "seed"), np.zeros((2, 2), dtype=int)),
            "event_count": counts,
            "event_time": ("event", np.arange(6.0), {"units": "s"}),
            "event_x": ("event", np.arange(6.0), {"units": "m"}),
        },
        {"rate": ("rate", [1e-6, 2e-6], {"units": "m3 s-1"}), "seed": [7, 8]},
    )
    table = dataset.demflow.to_dataframe(["event_time", "event_x"])
    assert list(table.columns) == [
        *("rate [m3 s-1]", "seed", "event", "event_time [s]", "event_x [m]")
    ]
    assert table["rate [m3 s-1]"].tolist() == [1e-6, 1e-6, 2e-6, 2e-6, 2e-6, 2e-6]
    assert table["seed"].tolist() == [7, 7, 7, 8, 8, 8]
    with pytest.raises(ResultsError, match="holds some of them only"):
        dataset.isel(seed=0).demflow.to_dataframe("event_time")
    assert len(dataset.isel(rate=0, seed=0).demflow.to_dataframe("status")) == 1


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


def test_regimes_are_a_row_for_each_stretch_of_each_good_case():
    dataset = with_rates()
    found = dataset.demflow.regimes("p")
    assert list(found.columns) == ["rate", "regime", "start", "end", "level", "confidence"]
    assert found["regime"].tolist() == ["radial", "radial"]
    np.testing.assert_allclose(found["level"], [2.0, 5.0], rtol=1e-9)
    assert found["rate"].tolist() == [1e-5, 2e-5]
    later = dataset.demflow.regimes("p", since=30.0)
    assert later["end"].max() == pytest.approx(970.0)
    failed = dataset.assign(status=("rate", np.array([Status.DONE, Status.FAILED], dtype=np.int8)))
    assert len(failed.demflow.regimes("p")) == 1
    with pytest.raises(ResultsError, match="there is no well q"):
        dataset.demflow.regimes("q")


def test_a_computed_test_is_fitted_as_a_gauge_s():
    rock = Rock(0.2, 1e-3, 1e-9, 0.1)
    told = {"wellbore_storage": 1e-9, "drift": 0.0, "initial_pressure": 2e7}
    dataset = with_rates().isel(elapsed_time=slice(1, None))
    times = dataset["elapsed_time"].values
    pressures = [
        Superposed(times, ((0.0, rate),)).pressure(
            MODELS["homogeneous"], rock, {**told, "permeability": k, "skin_factor": 3.0}
        )
        for rate, k in ((1e-5, 2e-14), (2e-5, 7e-14))
    ]
    pressure = xr.zeros_like(dataset["pressure_change"]) + np.array(pressures)[:, None]
    dataset = dataset.assign(
        porosity=("rate", [0.2, 0.2]), well_pressure=pressure, pressure_change=2e7 - pressure
    )
    options = {
        "free": {"permeability": (1e-16, 1e-12), "skin_factor": (-3.0, 20.0)},
        "known": {"wellbore_storage": 1e-9},
        **{"viscosity": 1e-3, "compressibility": 1e-9, "well_radius": 0.1},
    }
    found = dataset.demflow.fit("p", "homogeneous", **options, rate=2e-5)
    assert found["permeability"].value == pytest.approx(7e-14, rel=1e-4)
    assert found["skin_factor"].value == pytest.approx(3.0, rel=1e-3)
    first = dataset.isel(rate=[0]).demflow.fit("p", "homogeneous", **options)
    assert first["permeability"].value == pytest.approx(2e-14, rel=1e-4)
    for wrong, what in (
        ({"model": "closed_box", "rate": 2e-5}, "there is no model closed_box"),
        ({"rate": 3e-5}, "rate = 3e-05 is not there"),
        ({}, "2 cases are chosen"),
        ({"rate": 1e-5, "rates": [(0.0, 5e-5)]}, "rate"),
        ({"model": "fault", "rate": 2e-5}, "distance must be fitted or known"),
        ({"rate": 2e-5, "known": {"distance": 3.0}}, "homogeneous has no distance"),
    ):
        with pytest.raises(ResultsError, match=what):
            dataset.demflow.fit("p", **({"model": "homogeneous"} | options | wrong))
