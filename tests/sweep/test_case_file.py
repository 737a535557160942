"""Files of one case for other programs: the names that they look for, the values of the maps."""

from __future__ import annotations

import struct
from xml.etree import ElementTree

import netCDF4
import numpy as np
import pytest
import shapely
import xarray as xr

from demflow import sweep
from demflow.model import maps as model_maps
from demflow.model.stages import run_stages
from demflow.sweep.command import cli
from demflow.sweep.dataset.open import _dataset, values_of
from demflow.sweep.dataset.vtu import polygons_vtu
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import load_study
from tests.sweep.conventions import complaints

STUDY = """
study: one
scene:
  region: {shape: circle, radius: 5 m}
  grains: {count: 60, porosity: 0.18, seed: 1}
  matrix: {permeability: 1 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  fractures: {f: {kind: trace, from: [-2 m, 0 m], to: [2 m, 1 m], aperture: 100 um}}
  wells: {producer: {at: [0 m, 0 m], radius: 0.5 m, rate: 1e-6 m3/s}}
  boundaries: {outer: 7 MPa}
  initial_pressure: 7 MPa
  times: [1 s, 10 s, 100 s]
vary:
  angle_of_nothing: {parameter: grains.friction, values: [0.4, 0.5]}
observe: [well_pressure, pressure_map, grain_map]
"""


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    path = tmp_path_factory.mktemp("case") / "one.yaml"
    path.write_text(STUDY)
    study = load_study(path)
    scene = case_at(study, (0,)).scene
    return _dataset(study, scene, model_maps.case_maps(scene, run_stages(scene)), (0,))


def test_a_case_tells_its_wells_fractures_and_pipes(case):
    assert list(case.well.values) == ["producer"]
    assert (float(case.well_x[0]), float(case.well_radius[0])) == (0.0, 0.5)
    assert list(case.fracture.values) == ["f"]
    ends = [float(case[f"trace_{end}_{axis}"][0]) for end in ("from", "to") for axis in "xy"]
    np.testing.assert_allclose(ends, [-2.0, 0.0, 2.0, 1.0])
    # a pipe lies between the two pores that it joins, nearer than either is to the other
    inner = case.to_domain.values >= 0
    a, b = case.from_domain.values[inner], case.to_domain.values[inner]
    pipe = np.stack([case.pipe_x.values[inner], case.pipe_y.values[inner]])
    pore = np.stack([case.x.values, case.y.values])
    apart = np.linalg.norm(pore[:, a] - pore[:, b], axis=0)
    crosses = apart > 0.0  # what runs along a trace within one pore joins no two
    a, b, pipe, apart = a[crosses], b[crosses], pipe[:, crosses], apart[crosses]
    for one in (a, b):
        assert np.median(np.linalg.norm(pipe - pore[:, one], axis=0) / apart) < 0.7
    assert case.x.attrs["standard_name"] == "projection_x_coordinate"
    assert {v.dtype.itemsize for v in case.variables.values() if v.dtype.kind == "i"} == {4}


def test_the_file_steps_through_time_by_the_names_that_programs_know(case, tmp_path):
    (path,) = sweep.write_case(case, tmp_path / "case.nc")
    with netCDF4.Dataset(path) as file:
        assert file["pressure"].dimensions == ("time", "domain")
        assert file["time"].units.startswith("seconds since ")
        assert (file["time"].standard_name, file["time"].axis) == ("time", "T")
        assert file.dimensions["time"].isunlimited()  # as CF's checker looks for before others
        assert file["mesh_face_nodes"].dtype == np.int32
        assert file["mesh_face_nodes"].start_index.dtype == np.int32  # UGRID: that of the indices
        assert file["mesh_face_nodes"]._FillValue == -1
        assert not any(v.dtype == np.int64 for v in file.variables.values())
        np.testing.assert_array_equal(file["elapsed_time"][:], [1.0, 10.0, 100.0])
        np.testing.assert_array_equal(file["pressure"][:], case.pressure.values)
    with xr.open_dataset(path) as decoded:
        assert decoded.time.dtype.kind == "M"
        np.testing.assert_array_equal(
            np.diff(decoded.time.values) / np.timedelta64(1, "s"), [9, 90]
        )
    assert list(tmp_path.iterdir()) == [path]


def test_what_there_is_none_of_is_no_record_dimension(case, tmp_path):
    none = case.assign(crack_x=("crack", np.empty(0)))
    (path,) = sweep.write_case(none, tmp_path / "case.nc")
    with netCDF4.Dataset(path) as file:
        assert [d for d in file.dimensions if file.dimensions[d].isunlimited()] == ["time"]
    steady = none.isel(elapsed_time=0, drop=True)
    (path,) = sweep.write_case(steady, tmp_path / "steady.nc")
    with netCDF4.Dataset(path) as file:
        assert not any(dimension.isunlimited() for dimension in file.dimensions.values())


@pytest.mark.slow
def test_the_checker_of_cf_finds_nothing(case, tmp_path):
    case.to_netcdf(tmp_path / "case.nc")
    # the checker of CF knows no roles but those of its own chapter 9; UGRID's are others
    found = complaints(tmp_path / "case.nc", tmp_path / "report.json")
    assert [said for said in found if "cf_role" not in said] == []


def arrays_of(content: bytes) -> dict[str, np.ndarray]:
    """Every array of a VTU file by its name, read as the format says."""
    head, _, rest = content.partition(b'<AppendedData encoding="raw">\n_')
    tree = ElementTree.fromstring(head + b"</VTKFile>")
    found = {}
    for array in tree.iter("DataArray"):
        at = int(array.attrib["offset"])
        (size,) = struct.unpack_from("<Q", rest, at)
        kind = {"Float64": "<f8", "Int64": "<i8", "UInt8": "u1"}[array.attrib["type"]]
        found[array.attrib["Name"]] = np.frombuffer(rest[at + 8 : at + 8 + size], kind)
    return found


def test_paraview_gets_true_polygons_a_time_each(case, tmp_path):
    listed, *frames = sweep.write_case(case, tmp_path / "case.pvd")
    sets = list(ElementTree.parse(listed).iter("DataSet"))
    assert [float(one.attrib["timestep"]) for one in sets] == [1.0, 10.0, 100.0]
    assert [one.attrib["file"] for one in sets] == [path.name for path in frames]
    for k, path in enumerate(frames):
        arrays = arrays_of(path.read_bytes())
        np.testing.assert_array_equal(arrays["pressure (Pa)"], case.pressure.values[k])
        np.testing.assert_array_equal(arrays["volume (m3)"], case.volume.values)
        assert set(arrays["types"]) == {7}
        corners = np.diff(arrays["offsets"], prepend=0)
        faces = case.mesh_face_nodes.values
        np.testing.assert_array_equal(corners, (faces >= 0).sum(axis=1))
        assert corners.max() > 4
        # the pores tile the circle, up to what grains in its rim cut off
        nodes = np.stack([case.mesh_node_x.values, case.mesh_node_y.values], axis=1)
        areas = [
            shapely.Polygon(nodes[face[face >= 0]]).area for face in case.mesh_face_nodes.values
        ]
        np.testing.assert_allclose(arrays["area (m2)"], areas, rtol=1e-12)
        np.testing.assert_array_equal(arrays["connectivity"], faces[faces >= 0])
    (last,) = sweep.write_case(case, tmp_path / "last.vtu")
    assert last.read_bytes() == frames[-1].read_bytes()


def test_a_name_is_no_markup():
    content = polygons_vtu(
        np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
        np.array([[0, 1, 2, -1]]),
        {'a "b" <c> & d': np.array([1.5])},
    )
    np.testing.assert_array_equal(arrays_of(content)['a "b" <c> & d'], [1.5])


@pytest.mark.parametrize("name", ["case.txt", "case", "case.vtk"])
def test_other_suffixes_are_refused(case, tmp_path, name):
    with pytest.raises(ResultsError, match=r"none of \.nc, \.pvd, \.vtu"):
        sweep.write_case(case, tmp_path / name)
    with pytest.raises(ResultsError, match="no polygons"):
        sweep.write_case(case.drop_vars("mesh"), tmp_path / "case.nc")


def test_values_on_the_command_line_take_units(tmp_path, monkeypatch, capsys):
    (tmp_path / "study.yaml").write_text(
        STUDY.replace("angle_of_nothing: {parameter: grains.friction, values: [0.4, 0.5]}",
                      "p: {parameter: initial_pressure, values: [7 MPa, 8 MPa]}")
    )  # fmt: skip
    monkeypatch.setattr("demflow.sweep.dataset.open._smoke", lambda folder: False)
    assert values_of(tmp_path, ["p=7 MPa"]) == {"p": 7e6}
    assert values_of(tmp_path, ["p=7e6"]) == {"p": 7e6}
    assert values_of(tmp_path, ["q=some word"]) == {"q": "some word"}
    with pytest.raises(ResultsError, match="no AXIS=VALUE"):
        values_of(tmp_path, ["p"])
    assert cli.main(["export", str(tmp_path / "nothing"), str(tmp_path / "x.nc")]) == 2
    assert "holds no results" in capsys.readouterr().err
