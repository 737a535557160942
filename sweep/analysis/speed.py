"""Speed against error: what each solver costs and how far off it is, scene by scene.

The *time error* is measured against the exact solution of the same network. The *model error*,
of the network against the continuum's formula, is the same for every solver; it is taken from
the most exact one, packing by packing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.sweep.analysis.cases import axes
from demflow.sweep.analysis.compare import MapsOf, SceneOf, comparison_problem
from demflow.sweep.analysis.table import Table, table
from demflow.sweep.errors import ResultsError
from demflow.sweep.study.load import Study


class Roles(NamedTuple):
    """Which axis of a study says what; None where it has no such axis."""

    solver: str
    scene: str | None
    size: str | None


class Ladder(NamedTuple):
    """One solver on one scene and one size of network, from its loosest setting on."""

    scene: str
    grains: int
    method: str
    settings: tuple[str, ...]  # (s,) tolerance, or part of the limit that the step is
    seconds: np.ndarray  # (s,) median processor time over packings, NaN where none is done
    error: np.ndarray  # (s,) median time error over packings
    worst: np.ndarray  # (s,) largest
    refusal: str  # why the first setting that failed did so


class ModelSpread(NamedTuple):
    """How far the networks of one scene and size are from the continuum, packing by packing."""

    scene: str
    formula: str
    grains: int
    error: np.ndarray  # (packings,)


class SpeedError(NamedTuple):
    """What the figure shows."""

    scenes: tuple[str, ...]
    sizes: tuple[int, ...]
    ladders: list[Ladder]
    models: list[ModelSpread]


def roles_of(study: Study) -> Roles | None:
    """The axes of a study that compares solvers by their errors; None for another study."""
    solver = [axis.name for axis in study.axes if "solver.method" in axis.parameters]
    scene = [axis.name for axis in study.axes if axis.names]
    size = [axis.name for axis in study.axes if axis.parameters == ("grains.count",)]
    if not solver or solver == scene:
        return None
    return Roles(solver[0], next(iter(scene), None), next(iter(size), None))


def speed_against_error(
    dataset: xr.Dataset, study: Study, roles: Roles, scene_of: SceneOf, maps_of: MapsOf
) -> SpeedError:
    """Gather time errors and model errors of every scene, size and setting of a solver.

    Parameters
    ----------
    dataset : as `open_results` gives it
    study : the study, read and checked
    roles : which axes are sizes, settings and methods
    scene_of : the scene of the case at an index
    maps_of : the maps of the case at an index
    """
    values = next(axis for axis in study.axes if axis.name == roles.solver)
    settings = [dict(zip(values.parameters, point, strict=True)) for point in values.values]
    scenes = _words(dataset, roles.scene, study.title)
    sizes = _sizes(dataset, roles, scene_of)
    ladders, models = [], []
    for s, scene in enumerate(scenes):
        for g, grains in enumerate(sizes):
            at = {roles.scene: [s], roles.size: [g]}
            here = {axis: place for axis, place in at.items() if axis is not None}
            part = dataset.isel(here)
            ladders += _ladders(part, roles.solver, settings, scene, grains)
            found = _model_error(part, here, roles, scene_of, maps_of)
            if found is not None:
                models.append(ModelSpread(scene, found[0], grains, found[1]))
    return SpeedError(scenes, sizes, ladders, models)


def speed_tables(result: SpeedError) -> list[Table]:
    """All numbers of the figure: the solvers' errors in time, and those of the model."""
    in_time = [
        (ladder.scene, ladder.grains, ladder.method, setting, *numbers)
        for ladder in result.ladders
        for setting, *numbers in zip(
            ladder.settings, ladder.seconds, ladder.error, ladder.worst, strict=True
        )
    ]
    of_model = [
        (
            model.scene,
            model.formula,
            model.grains,
            len(model.error),
            model.error.mean(),
            model.error.std(ddof=1) if len(model.error) > 1 else np.nan,
        )
        for model in result.models
    ]
    return [
        table(
            "Time error of every solver, against the exact solution of the same network",
            ("scene", "grains", "solver", "setting", "seconds", "time error", "worst packing"),
            in_time,
        ),
        table(
            "Model error, against the continuum's formula",
            ("scene", "formula", "grains", "packings", "mean", "spread"),
            of_model,
        ),
    ]


def ladders_of(dataset: xr.Dataset) -> list[Ladder]:
    """Error in time and processor time of each solver that a study compares, from its dataset.

    Medians over all axes but that of the solvers.

    Parameters
    ----------
    dataset : as `open_results` gives it, of one scene and size

    Raises
    ------
    ResultsError : the study measures no time error, or no axis sets the solver's method.
    """
    if not {"time_error", "solver_time"} <= set(dataset.data_vars):
        raise ResultsError("the dataset has no time_error and solver_time: observe time_error")
    if "solver_method" not in dataset.coords or dataset["solver_method"].ndim != 1:
        raise ResultsError("no axis of the study sets solver.method")
    solver = str(dataset["solver_method"].dims[0])
    beside = [n for n in dataset.coords if str(n).startswith("solver_")]
    settings = [
        {f"solver.{str(n).removeprefix('solver_')}": dataset[n].values[k].item() for n in beside}
        for k in range(dataset.sizes[solver])
    ]
    return _ladders(dataset, solver, settings, "", 0)


def _words(dataset: xr.Dataset, axis: str | None, otherwise: str) -> tuple[str, ...]:
    return tuple(map(str, dataset[axis].values)) if axis else (otherwise,)


def _sizes(dataset: xr.Dataset, roles: Roles, scene_of: SceneOf) -> tuple[int, ...]:
    if roles.size is not None:
        return tuple(int(count) for count in dataset[roles.size].values)
    return (scene_of({axis: 0 for axis in axes(dataset)}).grains.count or 0,)


def _setting(point: dict[str, object], knob: str) -> str:
    value = point.get(knob, "default")
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def _ladders(
    part: xr.Dataset, solver: str, settings: list[dict[str, object]], scene: str, grains: int
) -> list[Ladder]:
    """One ladder for each solver, in the order of the study."""
    methods = dict.fromkeys(str(one["solver.method"]) for one in settings)
    found = []
    for method in methods:
        own = [k for k, one in enumerate(settings) if one["solver.method"] == method]
        rungs = part.isel({solver: own}).transpose(solver, ...)
        status = rungs["status"].values.reshape(len(own), -1)
        failed = np.flatnonzero(status != Status.DONE)
        messages = rungs["message"].values.reshape(-1)
        knob = "solver.safety_factor" if method == "explicit" else "solver.tolerance"
        shown = tuple(_setting(settings[k], knob) for k in own)
        error = rungs["time_error"].values.reshape(len(own), -1)
        found.append(
            Ladder(
                scene,
                grains,
                method,
                shown,
                _median(rungs["solver_time"].values.reshape(len(own), -1), status),
                _median(error, status),
                error.max(axis=1),
                str(messages[failed[0]]).removeprefix("flow: ") if len(failed) else "",
            )
        )
    return found


def _median(values: np.ndarray, status: np.ndarray) -> np.ndarray:
    """Median over packings of each setting, NaN where some packing is not done."""
    done = np.all(status == Status.DONE, axis=1)
    return np.where(done, np.median(values, axis=1), np.nan)


def _model_error(
    part: xr.Dataset, here: dict[str, list[int]], roles: Roles, scene_of: SceneOf, maps_of: MapsOf
) -> tuple[str, np.ndarray] | None:
    """Formula, and error of each packing, by the solver that is most exact; None without one."""

    def whole(index: dict[str, int]) -> dict[str, int]:
        return {a: places[index[a]] for a, places in chosen.items()} | {
            a: k for a, k in index.items() if a not in chosen
        }

    error = part["time_error"].transpose(roles.solver, ...).values
    error = error.reshape(len(error), -1).max(axis=1)
    if np.isnan(error).all():
        return None
    best = int(np.nanargmin(error))
    chosen = {**here, roles.solver: [best]}
    cases = part.isel({roles.solver: [best]})
    scene = scene_of(whole({axis: 0 for axis in axes(cases)}))
    # with the special functions of closed forms, which few studies need
    from demflow.sweep.analysis.linear_flow import compare_linear
    from demflow.sweep.analysis.radial_flow import compare_radial

    if comparison_problem(scene, "linear") is None:
        linear = compare_linear(cases, lambda i: scene_of(whole(i)), lambda i: maps_of(whole(i)))
        return "Eq. 24", linear.rms
    if comparison_problem(scene, "radial") is None:
        radial = compare_radial(cases, lambda i: scene_of(whole(i)), None)
        return "Eq. 29", np.abs(radial.error).mean(axis=1)
    return None
