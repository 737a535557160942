"""Maps of traces from files: every format gives the same arrays, every fault its number."""

import io
import json
import shutil

import numpy as np
import pytest
import shapefile

from demflow import sweep
from demflow.model.scene import RandomSet, TraceMap
from demflow.sweep.command.cli import main
from demflow.sweep.plan.identity import encode
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.map_files import MapError, read_map

LINES = [
    [(0.5, 1.25), (2.0, 1.0), (3.5, 2.0)],
    [(1.0, 0.0), (1.5, 3.0)],
    [(-2.0, -1.0), (0.0, 0.5)],
]
NAN = float("nan")
UTM = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32632"}}


def geojson(geometries, crs=UTM):
    features = [{"type": "Feature", "properties": {}, "geometry": one} for one in geometries]
    tree = {"type": "FeatureCollection", "features": features}
    return json.dumps(tree | ({"crs": crs} if crs else {})).encode()


def line_strings(lines):
    return [{"type": "LineString", "coordinates": line} for line in lines]


def shape_file(lines, kind=shapefile.POLYLINE):
    shp, shx, dbf = io.BytesIO(), io.BytesIO(), io.BytesIO()
    with shapefile.Writer(shp=shp, shx=shx, dbf=dbf, shapeType=kind) as writer:
        writer.field("name", "C")
        for line in lines:
            (writer.poly if kind == shapefile.POLYGON else writer.line)([line])
            writer.record("x")
    return shp.getvalue()


def by_rows(lines, head, rows):
    return ("\n".join([head, *rows]) + "\n").encode()


STRAIGHT = [[line[0], line[-1]] for line in LINES]
VERTICES = [f"{k},{x},{y}" for k, line in enumerate(LINES) for x, y in line]
ENDS = [f"{k},{a[0]},{a[1]},{b[0]},{b[1]}" for k, (a, b) in enumerate(STRAIGHT)]
FORMATS = {
    "a.geojson": (geojson(line_strings(LINES)), LINES),
    "b.json": (geojson([{"type": "MultiLineString", "coordinates": LINES}]), LINES),
    "c.shp": (shape_file(LINES), LINES),
    "d.csv": (by_rows(LINES, "trace,x,y", VERTICES), LINES),
    "e.csv": (by_rows(LINES, "FID,START_X,START_Y,END_X,END_Y", ENDS), STRAIGHT),
    "f.csv": (by_rows(LINES, "id,x0,y0,x1,y1", ENDS).replace(b",", b";"), STRAIGHT),
    "g.txt": (
        "\n".join("\t".join(f"{x}\t{y}" for x, y in line) + "\t\t\t" for line in LINES).encode(),
        LINES,
    ),
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_traces(name):
    content, lines = FORMATS[name]
    found = read_map({name: content})
    np.testing.assert_array_equal(found.vertices, np.concatenate(lines))
    assert np.diff(found.first).tolist() == [len(line) for line in lines]
    assert found.feature.tolist() == ([1, 1, 1] if name == "b.json" else [1, 2, 3])


def test_outlines_are_read_from_polygons():
    ring = [(0.0, 0.0), (0.0, 4.0), (5.0, 4.0), (5.0, 0.0), (0.0, 0.0)]
    geometry = {"type": "Polygon", "coordinates": [ring]}
    for name, content in (
        ("a.geojson", geojson([geometry])),
        ("a.shp", shape_file([ring], shapefile.POLYGON)),
        ("a.csv", b"x,y\n" + "\n".join(f"{x},{y}" for x, y in ring).encode()),
    ):
        found = read_map({name: content}, rings=True)
        np.testing.assert_array_equal(found.vertices, ring)


def test_the_unit_is_what_the_file_says():
    foot = b'PROJCS["x",GEOGCS["y",UNIT["Degree",0.0174]],UNIT["Foot_US",0.3048006096012192]]'
    shp = shape_file(LINES)
    assert read_map({"a.shp": shp, "a.prj": foot}).unit == 0.3048006096012192
    assert read_map({"a.shp": shp}).unit is None
    assert read_map({"a.geojson": geojson(line_strings(LINES), crs=None)}).unit is None
    far = [[(500.0, 1.0), (501.0, 2.0)]]
    assert read_map({"a.geojson": geojson(line_strings(far), crs=None)}).unit == 1.0


DEGREES = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.geojson", geojson(line_strings(LINES), DEGREES), "in degrees"),
        ("a.csv", by_rows([], "trace,lon,lat", VERTICES), "in degrees"),
        ("a.geojson", geojson([*line_strings(LINES), {"type": "Point"}]), "feature 4 is a Point"),
        ("a.geojson", geojson([{"type": "Polygon", "coordinates": []}]), "feature 1 is a Polygon"),
        ("a.geojson", geojson([None]), "feature 1 is empty"),
        ("a.geojson", geojson(line_strings([LINES[0], [(1, 2)]])), "feature 2 has fewer than two"),
        (
            "a.geojson",
            geojson(line_strings([[(1, 2), (3, float("nan"))]])),
            "vertex 2 of feature 1",
        ),
        ("a.geojson", geojson(line_strings([[("a", 2), (3, 4)]])), "feature 1 holds coordinates"),
        ("a.geojson", geojson([]), "no trace in the file"),
        ("a.geojson", b"{", "no GeoJSON"),
        ("a.geojson", b"[1]", "no GeoJSON"),
        ("a.shp", b"12345", "no shapefile"),
        ("a.shp", shape_file([LINES[0] + LINES[0][:1]], shapefile.POLYGON), "not a polyline"),
        ("a.csv", b"a,b\n1,2\n", "names no columns"),
        ("a.csv", b"x0,y0,x1,y1\n1,2,3,4\n1,2,,4\n", "line 3 lacks"),
        ("a.csv", b"trace,x,y\n1,0,0\n2,0,1\n2,1,1\n1,3,3\n", "line 5 goes on with trace '1'"),
        ("a.txt", b"1 2 3 4\n1 2 3\n", "line 2 has 3 numbers"),
        ("a.dxf", b"", "none of .geojson"),
    ],
)
def test_faults_are_told_with_their_number(name, content, said):
    with pytest.raises(MapError, match=said.replace("'", ".")):
        read_map({name: content})


def test_many_faults_are_told_as_few():
    with pytest.raises(MapError) as caught:
        read_map({"a.txt": b"1 2 3\n" * 100})
    assert len(caught.value.problems) == 9
    assert caught.value.problems[-1] == "and 92 faults more"


STUDY = """
study: mapped
scene:
  region: {shape: rectangle, width: 6 m, height: 6 m}
  grains: {count: 150, porosity: 0.17}
  matrix: {aperture: 20 um}
  fluid: {viscosity: 1 cP, bulk_modulus: 2 GPa}
  fractures:
    outcrop: {kind: traces, file: maps/one.geojson, snap: 1 mm, origin: [1 m, 1 m], aperture: 50 um}
    random: {kind: set, length: {power_law: 2.2, from: 0.5 m, to: 4 m}, seed: 1,
             angle: {von_mises: 10, mean: 60 deg}, aperture: {log_normal: 0.5, median: 80 um}}
  boundaries: {left: 1 MPa, right: 0 Pa}
vary:
  density: {parameter: fractures.random.intensity, values: [0.5 1/m, 1 1/m]}
  middle:  {parameter: fractures.random.aperture.median, values: [40 um, 80 um]}
observe: [permeability, boundary_flow, fracture_network]
"""


@pytest.fixture
def study(tmp_path):
    folder = tmp_path / "mine"
    (folder / "maps").mkdir(parents=True)
    (folder / "maps" / "one.geojson").write_bytes(geojson(line_strings(LINES)))
    path = folder / "study.yaml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def test_a_study_reads_its_map_beside_it_and_varies_its_laws(study, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # the path is relative to the study, not to where one stands
    loaded = sweep.load_study(study)
    mapped, random = case_at(loaded, (1, 0)).scene.fractures
    assert isinstance(mapped, TraceMap)
    laid = {tuple(vertex) for vertex in mapped.laid.vertices}
    assert laid > {(x - 1.0, y - 1.0) for line in LINES for x, y in line}  # and where two cross
    assert isinstance(random, RandomSet)
    assert (random.intensity, random.aperture.median) == (1.0, 4e-5)
    assert random.angle.mean == pytest.approx(np.pi / 3)


def test_the_file_decides_the_identity_and_its_place_does_not(study, tmp_path):
    def identity(path):
        return encode(case_at(sweep.load_study(path), (0, 0)).scene.fractures)

    before = identity(study)
    shutil.copytree(study.parent, tmp_path / "theirs")
    assert identity(tmp_path / "theirs" / "study.yaml") == before
    moved = [[(x, y + 0.125) for x, y in line] for line in LINES]
    (study.parent / "maps" / "one.geojson").write_bytes(geojson(line_strings(moved)))
    assert identity(study) != before


def test_check_tells_what_is_mapped_and_drawn(study, capsys):
    assert main(["check", str(study)]) == 0
    valid, mapped, random = capsys.readouterr().out.splitlines()
    assert "valid, 4 cases" in valid
    assert "a map of 3 traces, 5.5 by 4 m with 1 m a unit" in mapped
    assert "3 traces in the region" in mapped
    length = sum(np.hypot(*np.diff(line, axis=0).T).sum() for line in LINES)
    assert f"P21 {length / 36:.3g} 1/m" in mapped
    assert "shorter than a pore (0.49 m)" in mapped
    assert random.startswith("fractures.random:")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "maps/one.geojson",
            "maps/two.geojson",
            "9:35: fractures.outcrop.file: maps/two.geojson: ",
        ),
        ("[1 m, 1 m]", "centre", "did you mean 'centroid'?"),
        ("[1 m, 1 m]", "[90 m, 90 m]", "no trace lies in the region"),
        ("{von_mises: 10,", "{mises: 10,", "a law with the keys {von_mises, mean}; {uniform}"),
        ("from: 0.5 m, ", "", "lacks 'from'"),
        ("to: 4 m", "to: 0.1 m", "largest length must be above the least"),
        ("kind: set, length", "kind: set, spacings: 1 m, length", "unknown key 'spacings'"),
        ("values: [40 um, 80 um]", "values: [40 mD]", "is a length"),
    ],
)
def test_what_is_wrong_is_told_at_its_place(study, old, new, said):
    study.write_text(STUDY.replace(old, new), encoding="utf-8")
    with pytest.raises(sweep.study.load.StudyError) as caught:
        sweep.load_study(study)
    assert said in str(caught.value)


def test_faults_of_the_map_are_told_at_its_file(study):
    doubled = line_strings([*LINES, LINES[1]])
    (study.parent / "maps" / "one.geojson").write_bytes(geojson(doubled))
    with pytest.raises(sweep.study.load.StudyError) as caught:
        sweep.load_study(study)
    assert "fractures.outcrop.file: features 2 and 4 lie on each other" in str(caught.value)


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_results_stay_readable_without_the_map(study, tmp_path):
    dataset = sweep.run(study, workers=1, results=tmp_path / "results")
    assert np.all(dataset["status"].values == 0)
    cross = 1.0  # the first two traces of the map, whatever the set adds
    assert np.all(dataset["network_nodes_x"].values >= cross)
    assert np.all(np.diff(dataset["network_traces"].values, axis=0) > 0)
    share = dataset["fracture_flow_share"].values
    assert share.shape == (2, 2)
    assert np.all((share >= 0) & np.isfinite(share))
    half = dataset["oda_permeability"].values
    assert dataset["oda_permeability"].dims[-2:] == ("row", "column")
    assert np.all(half[:, 0, 0, 0] < half[:, 1, 0, 0])  # wider apertures
    shutil.rmtree(study.parent)
    case = sweep.open_case(tmp_path / "results" / "mapped", density=0.5, middle=4e-5)
    assert case.sizes["pipe"] > 0
