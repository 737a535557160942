"""Opening what a run has left, with words for every wrong way to ask."""

from __future__ import annotations

import os
import shutil

import numpy as np
import pytest

from demflow import sweep
from demflow.model import maps as model_maps
from demflow.sweep.dataset import open as results
from demflow.sweep.errors import ResultsError
from tests.sweep import toy_stages, toys

MAPS = {
    "x": np.array([0.5, 1.5]),
    "y": np.array([0.5, 0.5]),
    "volume": np.array([0.1, 0.2]),
    "pressure": np.arange(6.0).reshape(3, 2),
    "aperture": np.array([1e-5]),
    "mesh_node_x": np.array([0.0, 1.0, 2.0, 1.0, 0.0]),
    "mesh_node_y": np.array([0.0, 0.0, 0.5, 1.0, 1.0]),
    "mesh_face_nodes": np.array([[0, 1, 3, 4], [1, 2, 3, -1]]),
}


def open_toy(folder, **at):
    return results.case_of(folder, at, table=toys.TABLE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, forked_workers):
    base = tmp_path_factory.mktemp("opened")
    path = toys.write_study(base, seeds=(), rates=(1.0, toy_stages.RAISES))
    text = path.read_text()
    friction = "  aperture: {parameter: grains.friction, values: [0.25, 0.5]}\nobserve"
    path.write_text(text.replace("observe", friction, 1))
    return toys.run(path, base / "results").folder


@pytest.fixture
def maps(monkeypatch):
    seen = []

    def case_maps(scene, products, **_):
        seen.append((scene, products))
        return dict(MAPS)

    monkeypatch.setattr(model_maps, "case_maps", case_maps)
    return seen


@pytest.mark.slow
def test_the_maps_of_one_case(folder, maps):
    case = open_toy(folder, stress_yy=10e6, rate=1, aperture=np.float64(0.25))
    scene, products = maps[0]
    assert (scene.stress.yy, scene.wells[0].rate, scene.grains.friction) == (10e6, 1.0, 0.25)
    assert list(products) == ["pack", "stress", "flow", "observe"]
    assert isinstance(products["pack"], toy_stages.Packed)
    assert case.pressure.dims == ("elapsed_time", "domain")
    assert case.pressure.attrs["units"] == "Pa"
    assert list(case.elapsed_time.values) == [1.0, 10.0, 100.0]
    # a map keeps its name, an axis of that name stands beside it
    assert case.aperture.dims == ("pipe",)
    assert (case.axis_aperture, case.stress_yy, case.rate) == (0.25, 10e6, 1.0)


@pytest.mark.slow
def test_a_steady_map_has_no_time(folder, maps, monkeypatch):
    monkeypatch.setitem(MAPS, "pressure", np.arange(2.0))
    case = open_toy(folder, stress_yy=5e6, rate=1, aperture=0.25)
    assert case.pressure.dims == ("domain",)
    assert "elapsed_time" not in case.coords


def test_the_polygons_are_a_ugrid_mesh(folder, maps, tmp_path):
    case = open_toy(folder, stress_yy=5e6, rate=1, aperture=0.25)
    case.to_netcdf(tmp_path / "case.nc")
    with results.xr.open_dataset(tmp_path / "case.nc", mask_and_scale=False) as saved:
        mesh = saved["mesh"].attrs
        assert mesh["cf_role"] == "mesh_topology"
        assert mesh["topology_dimension"] == 2
        nodes = [saved[name] for name in mesh["node_coordinates"].split()]
        faces = saved[mesh["face_node_connectivity"]]
        assert faces.attrs["cf_role"] == "face_node_connectivity"
        assert faces.attrs["start_index"] == 0
        assert saved.pressure.attrs["mesh"] == "mesh"
        assert saved.pressure.attrs["location"] == "face"
        corners = faces.values[1][faces.values[1] != faces.attrs["_FillValue"]]
        assert [float(nodes[0][k]) for k in corners] == [1.0, 2.0, 1.0]


@pytest.mark.parametrize(
    ("at", "message"),
    [
        ({"stress_yy": 5e6, "rate": 1.0}, "aperture is left open; give one of 0.25, 0.5"),
        (
            {"stress_yy": 7e6, "rate": 1.0, "aperture": 0.5},
            "stress_yy = 7000000.0 is not there; give",
        ),
        ({"stress_yy": 5e6, "rate": 1.0001, "aperture": 0.5}, "rate = 1.0001 is not there"),
        (
            {"stress": 5e6, "rate": 1.0, "aperture": 0.5},
            "stress is no axis of the study; its axes are",
        ),
        ({"stress_yy": "high", "rate": 1.0, "aperture": 0.5}, "stress_yy = high is not there"),
        ({"stress_yy": None, "rate": 1.0, "aperture": 0.5}, "stress_yy = None is not there"),
        ({"stress_yy": 5e6, "rate": -1.0, "aperture": 0.5}, "no flow: the well is dry"),
    ],
)
def test_a_case_that_is_not_there_is_explained(folder, maps, at, message):
    with pytest.raises(ResultsError, match=message):
        open_toy(folder, **at)
    assert maps == []


def test_folders_without_results_are_explained(tmp_path):
    with pytest.raises(ResultsError, match="does not exist; `demflow run` writes it"):
        sweep.open_results(tmp_path)
    with pytest.raises(ResultsError, match="holds no results"):
        sweep.open_case(tmp_path)
    (tmp_path / "dataset.nc").write_bytes(b"no netCDF")
    with pytest.raises(ResultsError, match="cannot be read"):
        sweep.open_results(tmp_path)


def test_opening_a_case_writes_nothing_and_names_what_is_not_whole(folder, maps, tmp_path):
    case = {"stress_yy": 5e6, "rate": 1, "aperture": 0.25}
    root = shutil.copytree(folder.parent, tmp_path / "results")
    copy = root / folder.name
    for product in (root / "store").glob("*/*.product"):
        os.truncate(product, product.stat().st_size - 1)
    with pytest.raises(ResultsError, match=r"pack cannot be read: .*`demflow run` computes"):
        open_toy(copy, **case)
    shutil.rmtree(root / "store")
    with pytest.raises(ResultsError, match="no pack: it was not run; `demflow run`"):
        open_toy(copy, **case)
    assert not (root / "store").exists()
    (root / "store").mkdir()
    (root / "store" / "diary.txt").touch()
    with pytest.raises(ResultsError, match="holds no store of demflow"):
        open_toy(copy, **case)
    (copy / "study.yaml").write_text("study: [")
    with pytest.raises(ResultsError, match="bad YAML"):
        open_toy(copy, **case)
    (copy / "dataset.nc").unlink()
    with pytest.raises(ResultsError, match=r"dataset\.nc does not exist; `demflow run` writes it"):
        open_toy(copy, **case)


def test_the_dataset_can_be_saved_again_as_cf_asks(folder, tmp_path):
    dataset = sweep.open_results(folder)
    dataset.to_netcdf(tmp_path / "again.nc")
    again = sweep.open_results(tmp_path / "again.nc")
    assert again.identical(dataset)
    assert "_FillValue" not in again.elapsed_time.encoding or (
        again.elapsed_time.encoding["_FillValue"] is None
    )
