"""Files with fracture traces or outlines → arrays: GeoJSON, shapefile, CSV and FracPaQ text.

`.geojson`, `.json`
    LineString and MultiLineString; of an outline Polygon and MultiPolygon.
`.shp`
    polylines; of an outline polygons. The `.prj` beside it says the unit.
`.csv`
    a trace a line by its ends (`x0, y0, x1, y1`, also `START_X …`), or a vertex a line
    (`trace, x, y`), told apart by the header.
`.txt`
    FracPaQ: a trace a line, `x y x y …`.

What is no line, not finite or in degrees is told with the number of the feature; whether a
line can be one trace is judged where the map is laid into a scene.
"""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from demflow.model.scene.trace_maps import MapFile

LARGEST_FILE = 200_000_000  # bytes
MOST_TOLD = 8  # faults that are told one by one

DEGREES = re.compile(r"CRS:?84$|EPSG:{1,2}(4326|4258|4269|4267|4230|4979|4937|4283|7844)$")

# headers of the four numbers of a straight trace, without what is no letter or digit
ENDS = (
    ("startx", "starty", "endx", "endy"),
    ("x0", "y0", "x1", "y1"),
    ("x1", "y1", "x2", "y2"),
    ("xstart", "ystart", "xend", "yend"),
    ("fromx", "fromy", "tox", "toy"),
)
TRACE_NAMES = ("trace", "traceid", "id", "fid", "line", "lineid", "fracture", "fractureid")
GEOGRAPHIC_NAMES = ("lon", "long", "longitude", "lat", "latitude")
LINES = {"LineString": 1, "MultiLineString": 2}  # depth of the lists around a polyline
RINGS = {"Polygon": 2, "MultiPolygon": 3}


class MapError(Exception):
    """A file that is no map, with everything that is wrong with it."""

    def __init__(self, problems: list[str]):
        more = len(problems) - MOST_TOLD
        told = problems[:MOST_TOLD] + ([f"and {more} faults more"] if more > 0 else [])
        self.problems = told
        super().__init__("; ".join(told))


class Found(NamedTuple):
    """The polylines of a file as they are read."""

    points: list[Any]  # of each: (k, 2) numbers
    feature: list[int]
    problems: list[str]
    unit: float | None = 1.0


def read_map(files: Mapping[str, bytes], *, rings: bool = False) -> MapFile:
    """The polylines, or with `rings` the outlines, of a file.

    Parameters
    ----------
    files : content by name, the map first; a `.prj` beside it may follow.

    Raises
    ------
    MapError : what is wrong, with the number of each feature (record, line), from 1.
    """
    name, content = next(iter(files.items()))
    reader = READERS.get(Path(name).suffix.lower())
    if reader is None:
        raise MapError([f"'{name}' is none of {', '.join(READERS)}, the maps that can be read"])
    if len(content) > LARGEST_FILE:
        raise MapError([f"'{name}' is larger than {LARGEST_FILE // 1_000_000} MB"])
    prj = next((text for other, text in files.items() if other.endswith(".prj")), b"")
    found = reader(content, prj.decode("utf-8", errors="replace"), rings)
    arrays: list[np.ndarray] = []
    features: list[int] = []
    problems = list(found.problems)
    for points, number in zip(found.points, found.feature, strict=True):
        try:
            array = np.array([point[:2] for point in points], dtype=float).reshape(-1, 2)
        except (TypeError, ValueError):
            problems.append(f"feature {number} holds coordinates that are no numbers")
            continue
        if not np.isfinite(array).all():
            vertex = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0]) + 1
            problems.append(f"vertex {vertex} of feature {number} is no finite number; mend it")
        elif len(array) < 2:
            problems.append(f"feature {number} has fewer than two vertices; remove it")
        else:
            arrays.append(array)
            features.append(number)
    if not arrays and not problems:
        problems.append("there is no " + ("outline" if rings else "trace") + " in the file")
    if problems:
        raise MapError(problems)
    vertices = np.concatenate(arrays)
    unit = found.unit
    if unit is None and (np.abs(vertices) > (180.0, 90.0)).any():
        unit = 1.0
    return MapFile(
        vertices,
        np.concatenate([[0], np.cumsum([len(array) for array in arrays])]).astype(np.int64),
        np.array(features, dtype=np.int64),
        hashlib.sha256(content).hexdigest(),
        unit,
    )


def _geojson(content: bytes, _prj: str, rings: bool) -> Found:
    try:
        tree = json.loads(content)
    except ValueError as error:
        raise MapError([f"it is no GeoJSON: {error}"]) from None
    kind = tree.get("type") if isinstance(tree, dict) else None
    if kind == "FeatureCollection":
        features = tree.get("features")
    elif kind is not None:
        features = [tree]
    else:
        features = None
    if not isinstance(features, list):
        raise MapError(["it is no GeoJSON: there is no FeatureCollection in it"])
    unit = _named_unit(tree.get("crs"))
    found = Found([], [], [], unit)
    for number, feature in enumerate(features, start=1):
        geometry = feature.get("geometry", feature) if isinstance(feature, dict) else None
        if not isinstance(geometry, dict):
            found.problems.append(f"feature {number} is empty; remove it")
            continue
        _add_geometry(found, geometry, number, RINGS if rings else LINES)
    return found


def _named_unit(crs: Any) -> float | None:
    """Metres per unit by a GeoJSON's `crs`; None without one. Raises MapError for degrees."""
    if not isinstance(crs, dict):
        return None
    name = str(crs.get("properties", {}).get("name", ""))
    if DEGREES.search(name):
        raise MapError([_in_degrees(name)])
    return 1.0


def _in_degrees(name: str) -> str:
    return (
        f"the map is in degrees ({name}); project it to metres first, for instance with "
        "`ogr2ogr -t_srs EPSG:326ZZ projected.geojson map.geojson`, ZZ the UTM zone of the place"
    )


def _add_geometry(
    found: Found, geometry: dict[str, Any], number: int, wanted: dict[str, Any]
) -> None:
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind not in wanted or not isinstance(coordinates, list):
        what = "empty" if kind is None else f"a {kind}, not a {' or '.join(wanted)}"
        found.problems.append(f"feature {number} is {what}; remove it")
        return
    polylines = [coordinates]
    for _ in range(wanted[kind] - 1):
        polylines = [inner for outer in polylines for inner in outer]
    found.points.extend(polylines)
    found.feature.extend([number] * len(polylines))


def _shapefile(content: bytes, prj: str, rings: bool) -> Found:
    try:
        import shapefile
    except ImportError:
        what = "reading a shapefile needs pyshp: pip install 'demflow[maps]', or save it as GeoJSON"
        raise MapError([what]) from None
    if re.match(r"\s*GEOG", prj):
        raise MapError([_in_degrees(prj.split('"')[1] if '"' in prj else "its .prj")])
    unit = _prj_unit(prj)
    found = Found([], [], [], unit)
    wanted, word = ((5, 15, 25), "polygon") if rings else ((3, 13, 23), "polyline")
    try:
        shapes = shapefile.Reader(shp=io.BytesIO(content)).iterShapes()
        for number, shape in enumerate(shapes, start=1):
            if shape.shapeType not in wanted:
                what = (
                    f"a {shape.shapeTypeName.lower()}, not a {word}" if shape.shapeType else "empty"
                )
                found.problems.append(f"feature {number} is {what}; remove it")
                continue
            stops = [*shape.parts, len(shape.points)]
            for a, b in itertools.pairwise(stops):
                found.points.append(shape.points[a:b])
                found.feature.append(number)
    except Exception as error:  # whatever pyshp meets in a damaged file
        raise MapError([f"it is no shapefile, or a damaged one: {error}"]) from None
    return found


def _prj_unit(prj: str) -> float | None:
    """Metres per unit by the last UNIT of a .prj; None without one."""
    units = re.findall(r'(?:LENGTH)?UNIT\["[^"]*",\s*([0-9.eE+-]+)', prj)
    return float(units[-1]) if units else None


def _text_of(content: bytes) -> str:
    return content.decode("utf-8-sig", errors="replace")


def _csv(content: bytes, _prj: str, rings: bool) -> Found:
    text = _text_of(content)
    head = text.lstrip().split("\n", 1)[0]
    delimiter = max(",;\t", key=head.count)
    rows = [row for row in csv.reader(io.StringIO(text), delimiter=delimiter) if any(row)]
    if not rows:
        raise MapError(["the file is empty"])
    names = [re.sub(r"[^a-z0-9]", "", cell.lower()) for cell in rows[0]]
    if any(name in GEOGRAPHIC_NAMES for name in names):
        raise MapError([_in_degrees("longitude and latitude")])
    ends = next((four for four in ENDS if set(four) <= set(names)), None)
    if ends is not None and not rings:
        columns = [names.index(name) for name in ends]
        numbers = list(_numbers(rows[1:], columns))
        found = Found([], [], [what for _, _, what in numbers if what])
        for number, values, what in numbers:
            if not what:
                found.points.append([values[:2], values[2:]])
                found.feature.append(number)
        return found
    group = next((names.index(name) for name in TRACE_NAMES if name in names), None)
    if "x" not in names or "y" not in names or (group is None and not rings):
        raise MapError(
            [
                "its first line names no columns that are known: either START_X, START_Y, END_X, "
                "END_Y (or x0, y0, x1, y1), or trace, x, y"
            ]
        )
    return _grouped(rows[1:], group, [names.index("x"), names.index("y")])


def _grouped(rows: list[list[str]], group: int | None, columns: list[int]) -> Found:
    """One vertex a line; lines of one trace follow each other."""
    found = Found([], [], [])
    seen: dict[str, int] = {}
    last: str | None = None
    for (number, values, what), row in zip(_numbers(rows, columns), rows, strict=True):
        name = row[group].strip() if group is not None and group < len(row) else ""
        if what:
            found.problems.append(what)
        elif name == last and found.points:
            found.points[-1].append(values)
        elif name in seen:
            what = f"line {number + 1} goes on with trace '{name}' after others"
            found.problems.append(f"{what}; keep its lines together")
        else:
            seen[name] = number
            found.points.append([values])
            found.feature.append(len(seen))
        last = name
    return found


def _numbers(rows: list[list[str]], columns: list[int]) -> Iterator[tuple[int, list[float], str]]:
    """Record, its numbers, and what is wrong with them, or nothing."""
    for number, row in enumerate(rows, start=1):
        values = [_number(row[k]) if k < len(row) else math.nan for k in columns]
        wrong = not all(map(math.isfinite, values))
        yield number, values, f"line {number + 1} lacks a finite number; mend it" if wrong else ""


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _fracpaq(content: bytes, _prj: str, _rings: bool) -> Found:
    found = Found([], [], [])
    for number, line in enumerate(_text_of(content).splitlines(), start=1):
        values = [_number(word) for word in line.split()]
        if not values:
            continue
        if len(values) % 2 or len(values) < 4:
            found.problems.append(
                f"line {number} has {len(values)} numbers; a trace is x y x y …, two each"
            )
            continue
        found.points.append([values[k : k + 2] for k in range(0, len(values), 2)])
        found.feature.append(number)
    return found


READERS: dict[str, Callable[[bytes, str, bool], Found]] = {
    ".geojson": _geojson,
    ".json": _geojson,
    ".shp": _shapefile,
    ".csv": _csv,
    ".txt": _fracpaq,
}
