"""Open a case file as other programs do; run by a Python that has them. Prints JSON."""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

warnings.filterwarnings("ignore")  # uxarray says that it takes metres for a sphere


def by_xugrid(path: str) -> list[float]:
    """Sum of the pressure at each time."""
    import xugrid

    data = xugrid.open_dataset(path)
    return [float(data.pressure.isel(time=k).sum()) for k in range(data.sizes["time"])]


def by_uxarray(path: str) -> list[float]:
    """Sum of the pressure at each time."""
    import uxarray

    data = uxarray.open_dataset(path, path)
    return [float(data.pressure.isel(time=k).sum()) for k in range(data.sizes["time"])]


def by_vtk(path: str) -> list[float]:
    """Sum of the pressure at each time, by VTK's own reader of UGRID."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    reader = vtk.vtkNetCDFUGRIDReader()
    reader.SetFileName(path)
    reader.UpdateInformation()
    key = vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS()
    times = reader.GetOutputInformation(0).Get(key)
    sums = []
    for time in times:
        reader.UpdateTimeStep(time)
        sums.append(
            float(vtk_to_numpy(reader.GetOutput().GetCellData().GetArray("pressure")).sum())
        )
    return sums


def by_paraview_files(path: str) -> list[float]:
    """Sum of the pressure of each file that a PVD lists, every cell being a polygon."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    sums = []
    for frame in sorted(Path(path).parent.glob(f"{Path(path).stem}_*.vtu")):
        reader = vtk.vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(frame))
        reader.Update()
        grid = reader.GetOutput()
        types = {grid.GetCellType(k) for k in range(grid.GetNumberOfCells())}
        if types != {vtk.VTK_POLYGON}:
            raise ValueError(f"{frame}: cells of the kinds {types}")
        sums.append(float(vtk_to_numpy(grid.GetCellData().GetArray("pressure (Pa)")).sum()))
    return sums


if __name__ == "__main__":
    netcdf, pvd = sys.argv[1:]
    found: dict[str, object] = {}
    for reader, file in (
        (by_xugrid, netcdf), (by_uxarray, netcdf), (by_vtk, netcdf), (by_paraview_files, pvd),
    ):  # fmt: skip
        try:
            found[reader.__name__] = reader(file)
        except Exception as error:
            found[reader.__name__] = f"{type(error).__name__}: {error}"
    print(json.dumps(found))
