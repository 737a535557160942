"""Pictures of a study: `write_figures` draws what its dataset has the data for."""

from __future__ import annotations

import itertools
import math
import os
import re
import shutil
from collections.abc import Callable, Collection, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.model.scene import Scene, Well, holes_of
from demflow.sweep.analysis.cases import Index, axes, case_title, done
from demflow.sweep.analysis.cases import events as events_of
from demflow.sweep.analysis.compare import ComparisonError, MapsOf, SceneOf
from demflow.sweep.analysis.speed import Roles, roles_of, speed_against_error, speed_tables
from demflow.sweep.analysis.table import Table
from demflow.sweep.dataset.open import case_of
from demflow.sweep.errors import ResultsError
from demflow.sweep.figures.events import draw_events
from demflow.sweep.figures.failure import draw_failure
from demflow.sweep.figures.holes import draw_forces, draw_inflow
from demflow.sweep.figures.horner import draw_horner
from demflow.sweep.figures.maps import PANELS, draw_maps
from demflow.sweep.figures.measured import draw_measured
from demflow.sweep.figures.movement import draw_settlement, draw_slip
from demflow.sweep.figures.permeability import draw_permeability
from demflow.sweep.figures.rates import draw_rates
from demflow.sweep.figures.sensitivity import draw_sensitivity
from demflow.sweep.figures.speed import draw_speed
from demflow.sweep.figures.strength import draw_strength
from demflow.sweep.figures.style import FOR_REPORT, Form, house_style
from demflow.sweep.figures.traces import draw_traces_of
from demflow.sweep.figures.two_axes import draw_drawdown, draw_two_axes
from demflow.sweep.figures.wells import draw_well
from demflow.sweep.store.written import check_folder, replace_files
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import Study
from demflow.sweep.study.reservoir import Rock

__all__ = ["Figures", "Form", "maps_reader", "write_animations", "write_figures"]

MOST_MAPS = 4  # cases whose maps are read, for pictures and page
LONGEST_NAME = 80  # letters of a well in the name of a file


class Figures(NamedTuple):
    """What was drawn of a study."""

    paths: list[Path]  # PNG files, in the order of a report
    messages: list[str]  # what could not be drawn, and what of the user's was renamed


def maps_reader(dataset: xr.Dataset, results_dir: Path, study: Study) -> MapsOf:
    """What reads the maps of a case, and keeps those that figures and report both show.

    Parameters
    ----------
    dataset : the study's dataset.
    results_dir : the study's folder, where the maps of its cases are found.
    study : the study.
    """

    @lru_cache(maxsize=MOST_MAPS)
    def maps_at(position: tuple[tuple[str, int], ...]) -> xr.Dataset:
        values = {axis: dataset[axis].values[at].item() for axis, at in position}
        return case_of(results_dir, values, ends=False, study=study)

    return lambda index: maps_at(tuple(index.items()))


def write_figures(
    dataset: xr.Dataset,
    results_dir: Path,
    study: Study,
    form: Form = FOR_REPORT,
    maps_of: MapsOf | None = None,
) -> Figures:
    """Draw a study's figures into `results_dir/figures`, and tables of comparisons beside them.

    Parameters
    ----------
    dataset : the study's dataset.
    results_dir : the study's folder, where the maps of its cases are found.
    study : for the scenes of its cases and its `figures` block.
    form : what they are made for; other forms than the report's PNG go into a folder of their own
        in `figures/`, such as `figures/pdf-column/`.
    maps_of : reads the maps of a case, where others read them too.

    Returns
    -------
    The PNG files: each holds its caption as its PNG description; `NAME_*.csv` beside `NAME.png`
    are its tables. Figures of an earlier run that are not drawn again are removed, and no
    other file (see `sweep.store.written`). What cannot be drawn is a message: a comparison that the
    scenes do not allow, a map whose products are gone.

    Raises
    ------
    StoreError : `figures` is a link. OSError.
    """
    read = maps_of or maps_reader(dataset, Path(results_dir), study)
    return _replaced(
        Path(results_dir),
        form,
        lambda folder, messages: _draw(dataset, read, study, folder, messages, form),
    )


def write_animations(dataset: xr.Dataset, results_dir: Path, study: Study, form: Form) -> Figures:
    """Write the pressure maps of a few cases in time into a folder of their own in `figures/`.

    Parameters
    ----------
    dataset : the study's dataset.
    results_dir : the study's folder, where the maps of its cases are found.
    study : for the scenes of its cases.
    form : its format gif or mp4.

    Returns
    -------
    The files, those of an earlier run replaced.

    Raises
    ------
    ResultsError : no case that would be drawn has maps at two times, or MP4 without ffmpeg.
    StoreError : `figures` is a link. OSError.
    """
    # what writes moving pictures takes a while to import, and few ask for it
    from demflow.sweep.figures.animation import check_kind, draw_animation, is_moving

    check_kind(form.format)
    read = maps_reader(dataset, Path(results_dir), study)

    def draw(folder: Path, _messages: list[str]) -> list[Path]:
        drawn: list[Path] = []
        with house_style(form):
            corners = representative_cases(dataset) if _any_done(dataset) else []
            for k, index in enumerate(corners):
                scene = case_at(study, [index[axis.name] for axis in study.axes]).scene
                if "pressure_map" in scene.observe and is_moving(read(index)):
                    title = f"{study.title}\n{case_title(dataset, index)}".strip()
                    path = folder / f"pressure_map_{k}.{form.format}"
                    broken = events_of(dataset, index) if "event_time" in dataset else None
                    drawn.append(draw_animation(read(index), path, scene, title, broken))
        if not drawn:
            raise ResultsError(
                "there is nothing to animate: no case that is done has maps of pressure at two "
                "times or more; give the study `observe: [pressure_map]` and times, and run it"
            )
        return drawn

    return _replaced(Path(results_dir), form, draw)


def _any_done(dataset: xr.Dataset) -> bool:
    return bool(np.any(dataset["status"].values == Status.DONE))


def _replaced(
    results_dir: Path, form: Form, draw: Callable[[Path, list[str]], list[Path]]
) -> Figures:
    """What is drawn into a folder aside takes the place of what an earlier run drew."""
    folder = results_dir / "figures"
    check_folder(folder)
    if form != FOR_REPORT:
        folder /= form.suffix
        check_folder(folder)
    aside = folder.with_name(f"figures.{os.getpid()}.partial")
    shutil.rmtree(aside, ignore_errors=True)
    try:
        aside.mkdir(parents=True)
        messages: list[str] = []
        drawn = draw(aside, messages)
        tables = sorted(aside.glob("*.csv"))
        messages += replace_files(folder, {path.name: path for path in [*drawn, *tables]})
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return Figures([folder / path.name for path in drawn], messages)


class _Sheet:
    """Figures drawn into a folder; what cannot be drawn is told, and the others go on."""

    def __init__(self, folder: Path, messages: list[str]):
        self.paths: list[Path] = []
        self._folder, self._messages = folder, messages

    def add(self, name: str, draw: Callable[..., Path | None], *given: Any, **named: Any) -> None:
        """Let a function draw into the file of that name."""
        try:
            path = draw(*given, path=self._folder / f"{name}.png", **named)
        except (ComparisonError, ResultsError) as error:
            self._messages.append(f"{name} was not drawn: {error}")
        else:
            self.paths += [path] if path is not None else []


def _draw(
    dataset: xr.Dataset,
    maps_of: MapsOf,
    study: Study,
    folder: Path,
    messages: list[str],
    form: Form,
) -> list[Path]:
    """Draw the figures into a folder; returns them, in the order of a report."""
    if not _any_done(dataset):
        return []

    def scene_of(index: Index) -> Scene:
        return case_at(study, [index[axis.name] for axis in study.axes]).scene

    sheet = _Sheet(folder, messages)
    roles = roles_of(study)
    seeds = {a.name for a in study.axes if a.parameters == ("grains.seed",)}
    with house_style(form):
        if roles is not None and "time_error" in dataset:
            sheet.add("speed_vs_error", _speed, dataset, study, roles, scene_of, maps_of)
            return sheet.paths
        if kind := study.figures.compare:
            sheet.add(f"compare_{kind}", _compare, dataset, kind, scene_of, maps_of)
        _wells(sheet, dataset, scene_of, seeds)
        for name, plain in zip(study.data, _file_names(list(study.data)), strict=True):
            sheet.add(f"measured_{plain}", draw_measured, dataset, study.data[name])
        sheet.add("events", draw_events, dataset)
        sheet.add("slip", draw_slip, dataset)
        sheet.add("settlement", draw_settlement, dataset)
        _of_maps(sheet, dataset, study, scene_of, maps_of)
        # a sample has no order either
        sheet.add("permeability", draw_permeability, dataset, ensembles=seeds | {"sample"})
        sheet.add("permeability_over", draw_two_axes, dataset)
        if "network_nodes_i" in dataset:
            index = representative_cases(dataset)[0]
            title = _title(study, dataset, index)
            sheet.add("traces", _traces, dataset, maps_of, index, title)
        sheet.add("sensitivity", draw_sensitivity, dataset)
        sheet.add("strength", draw_strength, dataset, ensembles=seeds)
        sheet.add("stress_strain", draw_failure, dataset, maps_of, ensembles=seeds)
    return sheet.paths


def _title(study: Study, dataset: xr.Dataset, index: Index) -> str:
    """Study and case, as they stand over a map."""
    return f"{study.title}\n{case_title(dataset, index)}".strip()


def _traces(
    dataset: xr.Dataset, maps_of: MapsOf, index: Index, title: str, path: Path
) -> Path | None:
    return draw_traces_of(dataset, maps_of(index), title, path)


def _of_maps(
    sheet: _Sheet, dataset: xr.Dataset, study: Study, scene_of: SceneOf, maps_of: MapsOf
) -> None:
    """Draw pressures, the forces around what is excavated, and what flows into it."""
    corners = representative_cases(dataset)
    most = PANELS if len(corners) == 1 else PANELS // 2

    def pressure(index: Index, path: Path) -> Path:
        broken = events_of(dataset, index) if "event_time" in dataset else None
        title, scene = _title(study, dataset, index), scene_of(index)
        return draw_maps(maps_of(index), scene, title, path, study.figures.maps, most, broken)

    seen: list[np.ndarray] = []

    def forces(index: Index, path: Path) -> Path | None:
        maps = maps_of(index)
        force = maps["normal_force"].values
        if any(np.array_equal(force, one) for one in seen):
            return None  # what differs moves no grain
        seen.append(force)
        return draw_forces(maps, scene_of(index), _title(study, dataset, index), path)

    # the first and the last corner: the report's page draws the others itself
    for k, index in enumerate(corners[:: max(len(corners) - 1, 1)]):
        if "pressure_map" in scene_of(index).observe:
            sheet.add(f"pressure_map_{k}", pressure, index)
    holes: set[str] = set()
    for k, index in enumerate(corners):
        scene = scene_of(index)
        holes |= {hole.name for hole in holes_of(scene.excavate)}
        if scene.excavate and scene.stress is not None and "grain_map" in scene.observe:
            sheet.add(f"forces_{k}", forces, index)
    seeds = {a.name for a in study.axes if a.parameters == ("grains.seed",)}
    sheet.add("inflow", draw_inflow, dataset, holes, ensembles=seeds)


def _wells(
    sheet: _Sheet, dataset: xr.Dataset, scene_of: SceneOf, ensembles: Collection[str]
) -> None:
    """Draw the transients of every well."""

    def well_of(index: Index, name: str) -> Well | None:
        if int(dataset["status"].isel(index)) != Status.DONE:
            return None  # what is left out, or failed, may be no scene at all
        return next((well for well in scene_of(index).wells if well.name == name), None)

    def rock_of(index: Index, well: Well) -> Rock | None:
        scene = scene_of(index)
        porosity = float(dataset["porosity"].isel(index))
        viscosity = scene.fluid.viscosity if scene.fluid is not None else math.nan
        stored = scene.stores(porosity) / porosity
        return Rock(porosity, viscosity, stored, well.radius)

    if "pressure_change" in dataset:
        wells = list(map(str, dataset["well"].values))
        for name, plain in zip(wells, _file_names(wells), strict=True):
            sheet.add(f"well_pressure_{plain}", draw_well, dataset, name, well_of)
            sheet.add(f"horner_{plain}", draw_horner, dataset, name, well_of, rock_of=rock_of)
            sheet.add(f"drawdown_over_{plain}", draw_drawdown, dataset, name)
    if "well_rate" in dataset and "elapsed_time" in dataset["well_rate"].dims:
        first = scene_of(next(done(dataset)))
        held = [one.name for one in first.wells if one.rate is None and one.schedule is None]
        if held:
            flow = dataset["well_rate"].sel(well=held)
            sheet.add("well_rate", draw_rates, dataset, flow, "rate", ensembles=ensembles)


def _file_names(names: Sequence[str]) -> list[str]:
    """Names from a study as parts of file names, different from each other on any system."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:LONGEST_NAME]
        taken = {other.lower() for other in found}
        free = (f"{plain}{'_' * (k > 0)}{k or ''}" for k in itertools.count())
        found.append(next(one for one in free if one.lower() not in taken))
    return found


def representative_cases(dataset: xr.Dataset) -> list[Index]:
    """Up to four cases that are done: the corners of the first two axes that vary.

    The other axes stay at their first value. Where no corner is done, the first case that is.
    """
    ends = {axis: [0] for axis in axes(dataset)}
    for axis in [a for a in axes(dataset) if dataset.sizes[a] > 1][:2]:
        ends[axis] = [0, dataset.sizes[axis] - 1]
    corners = [dict(zip(ends, at, strict=True)) for at in itertools.product(*ends.values())]
    good = [c for c in corners if int(dataset["status"].isel(c)) == Status.DONE]
    return (good or [next(done(dataset))])[:MOST_MAPS]


def _speed(
    dataset: xr.Dataset,
    study: Study,
    roles: Roles,
    scene_of: SceneOf,
    maps_of: MapsOf,
    path: Path,
) -> Path:
    """Draw what the solvers of a study cost and how exact they are, with its tables beside it."""
    found = speed_against_error(dataset, study, roles, scene_of, maps_of)
    for what, content in zip(("by_solver", "of_model"), speed_tables(found), strict=True):
        content.write_csv(path.with_name(f"speed_vs_error_{what}.csv"))
    return draw_speed(found, path)


def _compare(
    dataset: xr.Dataset, kind: str, scene_of: SceneOf, maps_of: MapsOf, path: Path
) -> Path:
    """Draw the comparison that the study asks for, with its tables beside it."""
    # with the special functions of closed forms, which no other figure needs
    from demflow.sweep.analysis.linear_flow import compare_linear, linear_tables
    from demflow.sweep.analysis.radial_flow import compare_radial, radial_tables
    from demflow.sweep.figures.comparisons import draw_linear, draw_radial

    tables: list[Table]
    if kind == "linear":
        linear = compare_linear(dataset, scene_of, maps_of)
        tables = linear_tables(linear)
        drawn = draw_linear(linear, path)
    else:
        mapped = all("pressure_map" in scene_of(index).observe for index in done(dataset))
        radial = compare_radial(dataset, scene_of, maps_of if mapped else None)
        tables = radial_tables(radial)
        drawn = draw_radial(radial, path)
    for what, content in zip(("by_time", "by_case"), tables, strict=True):
        content.write_csv(path.with_name(f"compare_{kind}_{what}.csv"))
    return drawn
