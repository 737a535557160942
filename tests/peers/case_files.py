"""Open case files as other programs do; run by a Python that has one or more of them.

`case_files.py FOLDER READER …` reads every `NAME.nc` or `NAME.pvd` of a folder by each reader and
prints one JSON object: what each told of each case, or the error that it raised.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

warnings.filterwarnings("ignore")  # uxarray says that it takes metres for a sphere
Told = dict[str, Any]


def by_cf_checker(path: Path) -> Told:
    """What the compliance checker finds against CF 1.11, whatever its weight."""
    from compliance_checker.runner import CheckSuite, ComplianceChecker

    if not CheckSuite.checkers:
        CheckSuite.load_all_available_checkers()
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.json")
        ComplianceChecker.run_checker(
            str(path), ["cf:1.11"], 0, "normal", output_format=["json"], output_filename=str(report)
        )
        found = json.loads(report.read_text())["cf:1.11"]
    levels = ("high_priorities", "medium_priorities", "low_priorities")
    return {"messages": [m for level in levels for check in found[level] for m in check["msgs"]]}


def by_ugrid_checker(path: Path) -> Told:
    """What the checker of UGRID's conformance document finds."""
    from ugrid_checks.check import check_dataset

    checker = check_dataset(str(path), print_summary=False)
    log = checker.logger
    return {"messages": [checker.checking_report()] if log.N_FAILURES + log.N_WARNINGS else []}


def by_xugrid(path: Path) -> Told:
    """Sum of the values at each time; the last is drawn.

    By the function that `.plot` leads to: that itself squeezes the one face of a mesh away.
    """
    import xugrid

    data = xugrid.open_dataset(path)
    draw = xugrid.plot.pcolormesh
    return _steps(data, lambda field, axes: draw(field.ugrid.grid, field.ugrid.obj, ax=axes))


def by_uxarray(path: Path) -> Told:
    """Sum of the values at each time; the last is drawn as on a map, its metres as degrees."""
    import uxarray
    from cartopy.crs import PlateCarree

    data = uxarray.open_dataset(str(path), str(path))
    return _steps(
        data,
        lambda field, axes: axes.add_collection(field.to_polycollection()),
        projection=PlateCarree(),
    )


def by_mdal(path: Path) -> Told:
    """Sum of the values at each time, and these in hours, by MDAL in QGIS; one is drawn."""
    from qgis.core import QgsMeshDatasetIndex, QgsMeshLayer

    _qgis()
    layer = QgsMeshLayer(str(path), "case", "mdal")
    source = layer.dataProvider()
    if not layer.isValid():
        raise ValueError(layer.error().message())
    faces = source.faceCount()
    groups = {
        source.datasetGroupMetadata(QgsMeshDatasetIndex(k, 0)).name(): k
        for k in range(source.datasetGroupCount())
    }
    group = groups.get("pore pressure", groups.get("pore volume for unit depth"))
    sums, hours = [], []
    for k in range(source.datasetCount(group)):
        index = QgsMeshDatasetIndex(group, k)
        values = source.datasetValues(index, 0, faces)
        sums.append(sum(values.value(i).scalar() for i in range(faces)))
        hours.append(source.datasetMetadata(index).time())
    return {"sums": sums, "hours": hours, "drawn": _drawn_by_qgis(layer, group)}


def by_cdo(path: Path) -> Told:
    """Sum of the values at each time, by CDO."""
    import subprocess

    def told(*command: str) -> list[str]:
        words = subprocess.run(["cdo", "-s", *command], capture_output=True, text=True, check=True)
        return words.stdout.split()

    name = "pressure" if "pressure" in told("showname", str(path)) else "volume"
    values = told("outputf,%.17g,1", "-fldsum", f"-selname,{name}", str(path))
    return {"sums": list(map(float, values))}


def by_vtk(path: Path) -> Told:
    """Times of a PVD file; of each VTU the sum of the values and the area of every cell."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    times, sums, areas = [], [], []
    for one in ElementTree.parse(path).iter("DataSet"):
        reader = vtk.vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(path.with_name(one.attrib["file"])))
        reader.Update()
        grid = reader.GetOutput()
        times.append(float(one.attrib["timestep"]))
        fields = grid.GetCellData()
        values = fields.GetArray("pressure (Pa)") or fields.GetArray("volume (m3)")
        sums.append(float(vtk_to_numpy(values).sum()))
        if not areas:
            areas = [_area(grid.GetCell(k)) for k in range(grid.GetNumberOfCells())]
            stored = vtk_to_numpy(fields.GetArray("area (m2)")).tolist()
    return {"times": times, "sums": sums, "areas": areas, "stored_areas": stored}


def _area(cell: Any) -> float:
    """Area of a polygon from VTK's triangles: its own filter of sizes takes it for convex."""
    import vtk

    if cell.GetCellType() != vtk.VTK_POLYGON:
        raise ValueError(f"a cell of the kind {cell.GetCellType()}")
    corners, points = vtk.vtkIdList(), vtk.vtkPoints()
    points.SetDataTypeToDouble()
    if not cell.Triangulate(0, corners, points):
        raise ValueError("a polygon that VTK cannot cut into triangles")
    total = 0.0
    for k in range(0, points.GetNumberOfPoints(), 3):
        total += vtk.vtkTriangle.TriangleArea(*(points.GetPoint(k + n) for n in range(3)))
    return total


def _steps(data: Any, draw: Callable[[Any, Any], Any], projection: Any = None) -> Told:
    """Sums by time of what lies on the faces, and the part of a picture that a drawing colours."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    values = data["pressure"] if "pressure" in data else data["volume"]
    steps = (
        [values.isel(time=k) for k in range(data.sizes["time"])] if "time" in values.dims else []
    )
    times = [str(time) for time in data["time"].values] if steps else []
    figure = Figure(figsize=(2, 2))
    canvas, axes = FigureCanvasAgg(figure), figure.add_axes((0, 0, 1, 1), projection=projection)
    axes.set_axis_off()
    draw(steps[-1] if steps else values, axes)
    axes.autoscale()
    canvas.draw()
    white = (255, 255, 255)
    pixels = bytes(canvas.buffer_rgba())
    coloured = sum(tuple(pixels[k : k + 3]) != white for k in range(0, len(pixels), 4))
    return {
        "sums": [float(step.sum()) for step in steps or [values]],
        "times": times,
        "drawn": 4.0 * coloured / len(pixels),
    }


def _drawn_by_qgis(layer: Any, group: int) -> float:
    """The part of a picture that a layer colours."""
    from qgis.core import QgsMapRendererParallelJob, QgsMapSettings
    from qgis.PyQt.QtCore import QSize
    from qgis.PyQt.QtGui import QColor

    settings = layer.rendererSettings()
    settings.setActiveScalarDatasetGroup(group)
    layer.setRendererSettings(settings)
    wanted = QgsMapSettings()
    wanted.setLayers([layer])
    wanted.setExtent(layer.extent())
    wanted.setOutputSize(QSize(80, 80))
    wanted.setBackgroundColor(QColor(255, 255, 255))
    job = QgsMapRendererParallelJob(wanted)
    job.start()
    job.waitForFinished()
    picture = job.renderedImage()
    spots = [(i, k) for i in range(80) for k in range(80)]
    return sum(picture.pixelColor(i, k) != QColor(255, 255, 255) for i, k in spots) / len(spots)


def _qgis(started: list[Any] = []) -> None:  # noqa: B006
    """Start QGIS without a window, once."""
    if not started:
        os.environ["QT_QPA_PLATFORM"] = "offscreen"
        from qgis.core import QgsApplication

        application = QgsApplication([], False)
        application.initQgis()
        started.append(application)


READERS = {
    reader.__name__.removeprefix("by_"): reader
    for reader in (by_cf_checker, by_ugrid_checker, by_xugrid, by_uxarray, by_mdal, by_cdo, by_vtk)
}


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    found: dict[str, dict[str, Told]] = {}
    for word in sys.argv[2:]:
        for case in sorted(folder.glob("*.pvd" if word == "vtk" else "*.nc")):
            try:
                told = READERS[word](case)
            except Exception as error:
                told = {"error": f"{type(error).__name__}: {error}"}
            found.setdefault(word, {})[case.stem] = told
    print(json.dumps(found))
