"""What a run has left: the dataset of a study, and the maps of one case."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.model.products import build
from demflow.model.quantities import COORDINATES, MAPS, TESTS, X_NAME, Y_NAME
from demflow.model.scene import Scene
from demflow.sweep.dataset import DATASET_FILE, STUDY_FILE
from demflow.sweep.dataset.file import attributes, recorded_at
from demflow.sweep.dataset.labels import CONVENTIONS, quantity_attributes
from demflow.sweep.errors import ResultsError
from demflow.sweep.plan.families import passed_over
from demflow.sweep.plan.graph import make_plan
from demflow.sweep.plan.table import MODEL, stage_table
from demflow.sweep.store.origins import as_made
from demflow.sweep.store.products import DamagedError, MissingError, Store, StoreError
from demflow.sweep.store.versions import installed
from demflow.sweep.study.cases import case_at, coordinates
from demflow.sweep.study.load import Study, StudyError, load_study
from demflow.sweep.study.units import UnitError, parse_quantity, to_degrees

_WITH_NUMBERS = (Status.DONE, Status.STOPPED, Status.INACCURATE)


def open_results(folder: str | Path, *, lazy: bool = False) -> xr.Dataset:
    """Return the dataset of a study, loaded into memory.

    Parameters
    ----------
    folder : `results/<study>`, or its `dataset.nc`.
    lazy : leave the numbers on disk until they are asked for; the file then stays open until
        `dataset.close()`.

    Raises ResultsError where no dataset lies there.
    """
    path = Path(folder)
    path = path / DATASET_FILE if path.is_dir() or path.suffix != ".nc" else path
    if lazy:
        return _without_fill_values(_open(path))
    with _opened(path) as dataset:
        return _without_fill_values(dataset.load())


@contextmanager
def _opened(path: Path) -> Iterator[xr.Dataset]:
    """The dataset at a path. Raises ResultsError where it is not there or cannot be read."""
    try:
        with _open(path) as dataset:
            yield dataset
    except OSError as error:
        raise ResultsError(f"{path} cannot be read: {error}") from error


def _open(path: Path) -> xr.Dataset:
    if not path.is_file():
        raise ResultsError(f"{path} does not exist; `demflow run` writes it")
    try:
        return xr.open_dataset(path, engine="netcdf4", decode_times=False)
    except OSError as error:
        raise ResultsError(f"{path} cannot be read: {error}") from error


def open_case(folder: str | Path, /, **at: Any) -> xr.Dataset:
    """Return the maps of one case: pores, pipes, grains and pressure, or a test's curves.

    Parameters
    ----------
    folder : `results/<study>`.
    at : a value for every axis of the study, as the dataset's coordinates have it (SI,
        angles in degrees). The nearest value is not taken in silence.

    Returns
    -------
    The variables of `model.quantities.MAPS` as far as observed, and `TESTS` of a test to
    failure; the polygons of the domains are the UGRID mesh `mesh`, its faces the domains. The
    case's values on the axes are coordinates under the names of the axes, or as `axis_…` where
    a map has that name (`aperture`).

    Raises ResultsError where an axis is left open, a value is none of the axis's, or the
    case is not there or not whole. Nothing is written, but a damaged file is set aside.
    """
    return case_of(Path(folder), at)


def case_of(
    folder: Path,
    at: Mapping[str, Any],
    table: str = MODEL,
    *,
    ends: bool = True,
    study: Study | None = None,
) -> xr.Dataset:
    """Do what `open_case` does, with any table of stages.

    Parameters
    ----------
    folder : of the study’s results
    at : value on each axis
    table : the table of stages, as `module:name`
    ends : whether with the domains that pipes join, see `model.maps.case_maps`
    study : the one whose results these are, where it is known already
    """
    study = study or _study(folder)
    try:
        store = Store.open(folder.resolve().parent / "store", create=False)
    except StoreError as error:
        raise ResultsError(f"the results in {folder} cannot be opened: {error}") from error
    index = _index(study, at)
    scene = case_at(study, index).scene
    told = _attributes(folder / DATASET_FILE)
    made, runs = told.get("stage_sources", ""), told.get("stage_runs", "")
    plan = make_plan([scene], as_made(stage_table(table), made))
    products: dict[str, Any] = {}
    counted = dict(one.split() for one in runs.partition(" behind")[0].split(", ") if one)
    without = {  # stages that it has of its own where no family takes their place
        plan.stages[row].name
        for k, stage in enumerate(plan.stages)
        if stage.family is not None and stage.family(scene) and int(counted.get(stage.name, 0))
        for row in passed_over(plan.stages, k)
    }
    for run in (plan.runs[last] for last in plan.cases[0] if last >= 0):
        stage = plan.stages[run.stage]
        try:
            products[stage.name] = build(stage.returns, store.get(run.id).arrays)
        except MissingError:
            if stage.name in without:
                # its family was answered without; of these, maps show grains and pipes alone
                ended = recorded_at(folder / DATASET_FILE, index)
                if ended is not None and ended.status not in _WITH_NUMBERS:
                    raise ResultsError(f"the case has no results: {ended.message}") from None
                if stage.name in ("stress", "open"):
                    parents = [products.get(name) for name in stage.parents]
                    products[stage.name] = stage.run(*parents, **stage.given(scene))
                continue
            failure = store.failure(run.id)
            why = failure["message"] if failure else "it was not run; `demflow run` computes it"
            raise ResultsError(f"the case has no {stage.name}: {why}") from None
        except (DamagedError, OSError) as error:
            why = f"{error}; `demflow run` computes what is damaged again"
            raise ResultsError(f"the case's {stage.name} cannot be read: {why}") from error
    from demflow.model.maps import case_maps  # physics, which numbers of a study do not need

    return _dataset(study, scene, case_maps(scene, products, ends=ends), index)


def values_of(folder: Path, settings: Sequence[str]) -> dict[str, Any]:
    """Values on axes from texts as `rate=1e-5` or `angle=65 deg`, as `open_case` takes them.

    Raises ResultsError where a text is none.
    """
    study = _study(folder)
    units = {axis.name: axis.units[0] for axis in study.axes if len(axis.units) == 1}
    at: dict[str, Any] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise ResultsError(f"{setting!r} is no AXIS=VALUE")
        at[name] = text
        unit = units.get(name, "1")
        with suppress(ValueError):
            bare = float(text)  # in degrees, as the dataset has it, where it is an angle
            at[name] = bare
            continue
        with suppress(UnitError):
            value = parse_quantity(text, unit)
            at[name] = to_degrees(value) if unit == "rad" else value
    return at


def _study(folder: Path) -> Study:
    """The study whose results lie in a folder. Raises ResultsError."""
    if not (folder / STUDY_FILE).is_file():
        raise ResultsError(f"{folder} holds no results: there is no {STUDY_FILE} in it")
    try:
        changed = (folder / STUDY_FILE).stat().st_mtime_ns
        return _loaded(folder / STUDY_FILE, _smoke(folder), changed)
    except StudyError as error:
        raise ResultsError(f"the results in {folder} cannot be opened: {error}") from error


@lru_cache(maxsize=4)
def _loaded(path: Path, smoke: bool, changed: int) -> Study:  # noqa: ARG001 -- a part of the key
    """A study, read once as long as its file does not change."""
    return load_study(path, smoke=smoke)


def _smoke(folder: Path) -> bool:
    path = folder / DATASET_FILE
    if not path.is_file():
        raise ResultsError(f"{path} does not exist; `demflow run` writes it")
    return _attributes(path).get("study_smoke") == "yes"


def _attributes(path: Path) -> dict[str, str]:
    """Attributes of a dataset, read once as long as its file does not change."""
    return _told(path, path.stat().st_mtime_ns) if path.is_file() else {}


@lru_cache(maxsize=4)
def _told(path: Path, changed: int) -> dict[str, str]:  # noqa: ARG001 -- a part of the key
    return attributes(path)


def _index(study: Study, at: Mapping[str, Any]) -> tuple[int, ...]:
    """Position of a case along each axis, from the values of the axes."""
    names = [axis.name for axis in study.axes]
    problems = [
        f"{name} is no axis of the study; its axes are {', '.join(names) or 'none'}"
        for name in at
        if name not in names
    ]
    index = []
    for axis in study.axes:
        values = coordinates(axis)[0].values
        valid = ", ".join(_shown(v) for v in values)
        if axis.name not in at:
            problems.append(f"{axis.name} is left open; give one of {valid}")
            continue
        found = [k for k, value in enumerate(values) if same_value(value, at[axis.name])]
        if not found:
            problems.append(f"{axis.name} = {at[axis.name]} is not there; give one of {valid}")
            continue
        index.append(found[0])
    if problems:
        raise ResultsError("; ".join(problems))
    return tuple(index)


def same_value(value: Any, given: Any) -> bool:
    """Equal up to the last digits, which units and decimal notation take or give."""
    if isinstance(given, xr.DataArray | np.ndarray | np.generic) and given.size == 1:
        given = given.item()
    if isinstance(value, np.str_) or not isinstance(given, int | float):
        return isinstance(given, str) and str(value) == given
    return bool(np.isclose(float(value), float(given), rtol=1e-9, atol=0.0, equal_nan=True))


def _shown(value: Any) -> str:
    return str(value) if isinstance(value, np.str_) else f"{float(value):.12g}"


def _dataset(
    study: Study, scene: Scene, maps: dict[str, np.ndarray], index: tuple[int, ...]
) -> xr.Dataset:
    variables: dict[str, Any] = {}
    for name, quantity in {**MAPS, **TESTS}.items():
        if name in maps:
            array = _narrow(np.asarray(maps[name]))
            # a steady study has no times
            dimensions = quantity.dimensions[len(quantity.dimensions) - array.ndim :]
            variables[name] = (dimensions, array, quantity_attributes(quantity))
            if dimensions[-1] == "domain":
                variables[name][2].update(mesh="mesh", location="face")
    if "mesh_face_nodes" in maps:
        variables |= _mesh(maps)
    scalars: dict[str, Any] = {}
    for axis, k in zip(study.axes, index, strict=True):
        own = coordinates(axis)[0]
        name = f"axis_{axis.name}" if axis.name in variables else axis.name
        unit = {"units": own.unit} if own.unit else {}
        scalars[name] = ((), own.values[k], {**unit, "long_name": own.long_name})
    if "elapsed_time" in {d for v in variables.values() for d in v[0]}:
        attributes = quantity_attributes(COORDINATES["elapsed_time"])
        scalars["elapsed_time"] = ("elapsed_time", np.array(scene.times), attributes)
    scalars |= {name: variables.pop(name) for name in _PLACES if name in variables}
    attributes = {
        "Conventions": f"{CONVENTIONS} UGRID-1.0",
        "title": f"{study.title}: one case",
        "history": f"opened by demflow {installed('demflow')} from stored stage runs",
        "study": study.name,
        "study_sha256": study.sha256,
    }
    return _without_fill_values(xr.Dataset(variables, scalars, attributes))


# what labels domains, pipes, wells and fractures
_PLACES = ("x", "y", "pipe_x", "pipe_y", "well", "fracture")


def _narrow(array: np.ndarray) -> np.ndarray:
    """Integers of 32 bits, which MDAL, VTK and CDO read; what is larger stays."""
    if array.dtype.kind != "i" or np.any(np.abs(array) > np.iinfo(np.int32).max):
        return array
    return array.astype(np.int32)


def _without_fill_values(dataset: xr.Dataset) -> xr.Dataset:
    """Let no coordinate get a fill value where the dataset is saved again: CF forbids it."""
    for coordinate in dataset.coords.values():
        coordinate.encoding["_FillValue"] = None
    return dataset


def _mesh(maps: dict[str, np.ndarray]) -> dict[str, Any]:
    """The polygons of the domains as a UGRID mesh."""
    topology = {
        "cf_role": "mesh_topology",
        "topology_dimension": 2,
        "long_name": "polygons of the domains",
        "node_coordinates": "mesh_node_x mesh_node_y",
        "face_node_connectivity": "mesh_face_nodes",
        "face_dimension": "domain",
        "face_coordinates": "x y",
    }
    faces = {
        "cf_role": "face_node_connectivity",
        "long_name": "corners of the domains",
        "start_index": np.int32(0),  # of the type of the indices
        "_FillValue": np.int32(-1),
    }
    node = {"units": "m"}
    return {
        "mesh": ((), np.int32(0), topology),
        "mesh_node_x": (
            ("mesh_node",),
            maps["mesh_node_x"],
            {**node, "standard_name": X_NAME, "long_name": "x of a corner of domains"},
        ),
        "mesh_node_y": (
            ("mesh_node",),
            maps["mesh_node_y"],
            {**node, "standard_name": Y_NAME, "long_name": "y of a corner of domains"},
        ),
        "mesh_face_nodes": (("domain", "mesh_corner"), _narrow(maps["mesh_face_nodes"]), faces),
    }
