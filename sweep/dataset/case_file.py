"""The maps of one case as files for other programs: UGRID netCDF, and VTU with PVD for ParaView.

What programs that step through time look for differs from what `open_case` names: MDAL (QGIS) and
VTK know time by a dimension called `time`, MDAL and CDO by units with a date to count from.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from demflow.sweep.dataset.vtu import polygons_vtu, pvd
from demflow.sweep.errors import ResultsError
from demflow.sweep.store.durable import write_all_durably

EPOCH = "seconds since 1970-01-01 00:00:00"  # a date that programs need; it means nothing
SUFFIXES = (".nc", ".pvd", ".vtu")


def write_case(case: xr.Dataset, path: str | Path) -> list[Path]:
    """Write the maps of one case, as `open_case` returns them, for other programs.

    Parameters
    ----------
    case : maps with polygons and whatever was observed.
    path : the file; its suffix says which. `.nc`: netCDF with the polygons as a UGRID mesh and
        `time` in seconds since a date that means nothing (`elapsed_time` beside it is the study's).
        `.vtu`: polygons with their values at the last time, or those of a steady state. `.pvd`:
        the list of one `NAME_0000.vtu` a time.

    Returns
    -------
    The files that were written, the one that was asked for first.

    Raises
    ------
    ResultsError : an unknown suffix, or maps without polygons. OSError.
    """
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise ResultsError(f"{path}: its suffix is none of {', '.join(SUFFIXES)}")
    if "mesh" not in case.variables:
        raise ResultsError(f"{path} is not written: the case has no pores, hence no polygons")
    if path.suffix == ".nc":
        aside = path.with_name(f"{path.name}.partial")
        try:
            form = in_file_form(case)
            records = ["time"] if "time" in form.dims else []
            form.to_netcdf(aside, engine="netcdf4", unlimited_dims=records)
            write_all_durably({path: aside.read_bytes()})
        finally:
            aside.unlink(missing_ok=True)
        return [path]
    if path.suffix == ".vtu":
        last = case.isel(elapsed_time=-1) if "elapsed_time" in case.dims else case
        write_all_durably({path: _vtu(last)})
        return [path]
    times = case["elapsed_time"].values if "elapsed_time" in case.dims else np.zeros(1)
    names = [f"{path.stem}_{k:04d}.vtu" for k in range(len(times))]
    frames = [
        case.isel(elapsed_time=k) if "elapsed_time" in case.dims else case
        for k in range(len(times))
    ]
    made = {path.with_name(n): _vtu(f) for n, f in zip(names, frames, strict=True)}
    write_all_durably(made | {path: pvd(times, names)})
    return [path, *made]


def in_file_form(case: xr.Dataset) -> xr.Dataset:
    """The maps with the names and attributes that programs look for, ready for `to_netcdf`.

    What there is none of, as cracks, is left out: netCDF makes a dimension of size 0 a record
    dimension, which CDO then takes for time.
    """
    case = case.drop_dims([name for name, size in case.sizes.items() if size == 0])
    if "elapsed_time" not in case.dims:
        return case
    times = case["elapsed_time"]
    told = {
        "standard_name": "time",
        "axis": "T",
        "units": EPOCH,
        "calendar": "standard",
        "units_metadata": "leap_seconds: none",
        "long_name": "time since the start, counted from a date that means nothing",
    }
    beside = ("time", times.values, {**times.attrs})
    form = case.drop_vars("elapsed_time").rename_dims(elapsed_time="time")
    form = form.assign_coords(time=("time", times.values, told), elapsed_time=beside)
    for name in ("time", "elapsed_time"):
        form[name].encoding["_FillValue"] = None
    return form


def _vtu(case: xr.Dataset) -> bytes:
    """One time of a case as an unstructured grid of polygons."""
    faces = np.asarray(case["mesh_face_nodes"].values)
    nodes = np.stack([case["mesh_node_x"].values, case["mesh_node_y"].values], axis=1)
    area = {"area (m2)": _areas(nodes, faces)}  # programs take pores for convex to find it
    return polygons_vtu(nodes, faces, {**_fields(case, "domain"), **area})


def _areas(nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area of each polygon, (polygons,) m²; corners in order, −1 where there is none."""
    corners = np.where((faces >= 0)[..., None], nodes[faces], nodes[faces[:, :1]])
    x, y = np.moveaxis(corners - corners[:, :1], 2, 0)
    after = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    area: np.ndarray = 0.5 * np.abs((x * after[1] - after[0] * y).sum(axis=1))
    return area


def _fields(case: xr.Dataset, dimension: str) -> Mapping[str, Any]:
    """What the domains bear, by name with its unit."""
    fields: dict[str, Any] = {}
    for name, variable in case.variables.items():
        if variable.dims == (dimension,) and variable.dtype.kind in "fiub":
            unit = str(variable.attrs.get("units", "1"))
            shown = f"{name} ({unit})" if unit != "1" else str(name)
            fields[shown] = np.asarray(variable.values)
    return fields
