"""Products of cases → the labelled dataset, one netCDF-4 file with CF metadata.

The file is filled tile by tile, a few thousand cases at a time, so that memory does not
grow with their number. It is written aside and renamed. A case without a product is NaN
and has its status and its message. All of it follows from the study but `compute_time`, which
was measured: it alone differs between two runs that both start from nothing.
"""

from __future__ import annotations

import hashlib
import math
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import netCDF4
import numpy as np

from model.quantities import CASE, COORDINATES, MAPS, SWEEP, Quantity
from model.scene import Scene
from sweep.cases import Coordinate, coordinates
from sweep.durable import rename_durably, write_durably
from sweep.plan import Plan
from sweep.stages import Status
from sweep.store import DamagedError, MissingError, Store
from sweep.study import Study
from sweep.versions import installed

__all__ = [
    "CONVENTIONS",
    "COORDINATES",
    "MAPS",
    "Verdict",
    "collect",
    "collected_digest",
    "dataset_problem",
    "quantity_attributes",
    "verdict",
]

CONVENTIONS = "CF-1.11"
TILE_CASES = 4096  # cases that are held in memory at once
TILE_BYTES = 128_000_000  # or fewer, if their numbers are many
FIXED = {"row": ("x", "y"), "column": ("x", "y"), "component": ("xx", "yy", "xy")}
TEXT = str  # netCDF-4 strings


@dataclass(frozen=True)
class Verdict:
    """How a case ended."""

    status: Status
    message: str = ""


def verdict(plan: Plan, store: Store, stored: np.ndarray, case: int) -> Verdict:
    """How a case stands: done where all its products are there, else the first that is not.

    `stored` tells which runs of the plan have their product, (runs,) bool.
    """
    if case in plan.impossible:
        return Verdict(Status.FAILED, plan.impossible[case])
    for run in plan.case_runs(case):
        if stored[run]:
            continue
        failure = store.failure(plan.runs[run].id)
        if failure is not None:
            stage = plan.stage_of(run).name
            return Verdict(Status(failure["status"]), f"{stage}: {failure['message']}")
        return Verdict(Status.NOT_RUN, "not run yet; `demflow run` computes it")
    return Verdict(Status.DONE)


def collect(
    study: Study,
    plan: Plan,
    store: Store,
    scene_of: Callable[[int], Scene],
    verdicts: Sequence[Verdict],
    path: Path,
    digest: str,
) -> list[str]:
    """Write the dataset of a study.

    Parameters
    ----------
    study, plan, store : what was asked, what that means, and what is there.
    scene_of : the scene of a case by its index in the plan.
    verdicts : how each case ended, (cases,).
    path : the netCDF file to write.
    digest : what the dataset was made from (see `collected_digest`).

    Returns
    -------
    Messages about products that are damaged. They were set aside, nothing was written
    then: run again.
    """
    aside = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        labels = _labels(plan, scene_of)
        with netCDF4.Dataset(aside, "w", format="NETCDF4") as file:
            writer = _Writer(file, study, labels)
            for tile in _tiles(study.shape, _cases_in_memory(plan, store, verdicts)):
                writer.begin(tile)
                for case in tile.cases:
                    if verdicts[case].status is Status.DONE:
                        _take(case, plan, store, scene_of, writer)
                    spent = {"compute_time": _seconds(case, plan, store, writer)}
                    if "solver_time" in file.variables:
                        spent["solver_time"] = _solver_seconds(case, plan, store)
                    writer.end_case(case, verdicts[case], spent)
                writer.flush()
            writer.describe(plan, digest)
        if writer.damaged:
            return writer.damaged
        with open(aside, "rb+") as written:
            os.fsync(written.fileno())
            sha256 = hashlib.file_digest(written, "sha256").hexdigest()
        # between the two there is a dataset without a hash, which counts as none
        _hash_file(path).unlink(missing_ok=True)
        rename_durably(aside, path)
        write_durably(_hash_file(path), f"{sha256}  {path.name}\n".encode())
        return []
    finally:
        aside.unlink(missing_ok=True)


def dataset_problem(path: Path) -> str | None:
    """What is wrong with the dataset at `path` by the hash beside it, None if nothing is."""
    try:
        recorded = _hash_file(path).read_text(errors="replace").partition(" ")[0]
    except FileNotFoundError:
        return f"there is no {_hash_file(path).name} beside it"
    with open(path, "rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    return None if found == recorded else "the data differ from what was written"


def _hash_file(path: Path) -> Path:
    return path.with_name(path.name + ".sha256")  # as `sha256sum --check` reads it


def collected_digest(path: Path) -> str | None:
    """Return what the dataset at `path` was made from, None where there is no whole dataset."""
    if not path.exists() or dataset_problem(path):
        return None
    with suppress(OSError, AttributeError, RuntimeError), netCDF4.Dataset(path) as file:
        return str(file.getncattr("demflow_digest"))
    return None


def quantity_attributes(quantity: Quantity) -> dict[str, str | float]:
    """CF attributes of a quantity; what is a name has no unit."""
    unit = {"units": quantity.unit} if quantity.unit else {}
    return {**unit, "long_name": quantity.long_name, **dict(quantity.constants)}


@dataclass(frozen=True)
class _Labels:
    """Coordinates of the dataset that the scenes give: times, and names of things."""

    times: np.ndarray  # (times,) s, of all cases
    names: dict[str, dict[str, tuple[float, float]]]  # dimension -> name -> place
    observed: tuple[str, ...]
    seeds: tuple[int, ...]


def _labels(plan: Plan, scene_of: Callable[[int], Scene]) -> _Labels:
    """What all scenes together name. Cases may differ in times, wells, sides and probes."""
    times: set[tuple[float, ...]] = set()
    names: dict[str, dict[str, tuple[float, float]]] = {"well": {}, "boundary": {}, "probe": {}}
    observed: dict[str, None] = {}
    seeds: set[int] = set()
    for case in range(len(plan.cases)):
        if case in plan.impossible:
            continue
        scene = scene_of(case)
        times.add(scene.times)
        observed |= dict.fromkeys(scene.observe)
        seeds.add(scene.grains.seed)
        for well in scene.wells:
            names["well"].setdefault(well.name, well.at)
        for side, _ in scene.boundaries:
            names["boundary"].setdefault(side, (math.nan, math.nan))
        for probe in scene.probes:
            names["probe"].setdefault(probe.name, probe.at)
    every = np.unique(np.concatenate([np.array(t, dtype=float) for t in times] or [np.empty(0)]))
    return _Labels(every, names, tuple(observed), tuple(sorted(seeds)))


@dataclass(frozen=True)
class _Tile:
    """Cases that lie side by side in the dataset: all of the last axes, a part of one."""

    cases: range
    at: tuple[int | slice, ...]  # where they lie among the axes
    shape: tuple[int, ...]  # of the block that `at` selects


def _tiles(shape: tuple[int, ...], most: int) -> Iterator[_Tile]:
    """Cut the cases of a study (the last axis runs fastest) into tiles of at most `most`."""
    if not shape:
        yield _Tile(range(1), (), ())
        return
    # axes behind `cut` are whole in a tile, those before it stand still
    cut = len(shape) - 1
    while cut > 0 and math.prod(shape[cut:]) <= most:
        cut -= 1
    inner = math.prod(shape[cut + 1 :])
    step = max(1, min(shape[cut], most // inner))
    for number, outer in enumerate(np.ndindex(*shape[:cut])):
        for start in range(0, shape[cut], step):
            stop = min(start + step, shape[cut])
            first = (number * shape[cut] + start) * inner
            yield _Tile(
                range(first, first + (stop - start) * inner),
                (*outer, slice(start, stop), *(slice(None) for _ in shape[cut + 1 :])),
                (stop - start, *shape[cut + 1 :]),
            )


def _cases_in_memory(plan: Plan, store: Store, verdicts: Sequence[Verdict]) -> int:
    """How many cases a tile may hold, from the size of the first product."""
    for case, ended in enumerate(verdicts):
        if ended.status is Status.DONE:
            size = store.path(plan.runs[int(plan.cases[case, -1])].id).stat().st_size
            return max(1, min(TILE_CASES, TILE_BYTES // max(size, 1)))
    return TILE_CASES


def _take(
    case: int, plan: Plan, store: Store, scene_of: Callable[[int], Scene], writer: _Writer
) -> None:
    """Read what the last stage of a case found, and hand it to the writer."""
    identity = plan.runs[int(plan.cases[case, -1])].id
    try:
        stored = store.get(identity)
    except (DamagedError, MissingError) as error:
        writer.damaged.append(str(error))
        return
    writer.versions_met(stored.meta.get("versions", {}))
    writer.add(case, scene_of(case), stored.arrays)


def _seconds(case: int, plan: Plan, store: Store, writer: _Writer) -> float:
    """Time spent in the stage runs that this case is the first to want."""
    total = 0.0
    for run in plan.case_runs(case):
        if plan.runs[run].case != case:
            continue
        identity = plan.runs[run].id
        try:
            total += store.meta(identity)["seconds"]
        except MissingError:
            total += (store.failure(identity) or {}).get("seconds", 0.0)
        except DamagedError as error:
            writer.damaged.append(str(error))
    return total


def _solver_seconds(case: int, plan: Plan, store: Store) -> float:
    """Processor time of the flow stage of a case, whichever case caused it to run."""
    for run in plan.case_runs(case):
        if plan.stage_of(run).name == "flow":
            with suppress(MissingError, DamagedError):
                return float(store.meta(plan.runs[run].id).get("cpu_seconds", math.nan))
    return math.nan


@dataclass
class _Writer:
    """Fills the file, tile by tile."""

    file: netCDF4.Dataset
    study: Study
    labels: _Labels
    damaged: list[str] = field(default_factory=list)
    blocks: dict[str, np.ndarray] = field(default_factory=dict)  # variable -> (cases of tile, …)
    versions: dict[str, set[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.axes = tuple(axis.name for axis in self.study.axes)
        for axis in self.study.axes:
            self.file.createDimension(axis.name, len(axis.values))
            for coordinate in coordinates(axis):
                self._axis_coordinate(axis.name, coordinate)
        self._status()
        for name, quantity in SWEEP.items():
            if not quantity.needs or set(quantity.needs) & set(self.labels.observed):
                self._variable(name, quantity)
        for name, quantity in CASE.items():
            # what was asked for is there, be it NaN in every case
            timeless = quantity.transient and len(self.labels.times) == 0
            if set(quantity.needs) & set(self.labels.observed) and not timeless:
                self._variable(name, quantity)

    def begin(self, tile: _Tile) -> None:
        """Take the next cases."""
        self.tile = tile
        self.status = np.zeros(len(tile.cases), dtype=np.int8)
        self.message = np.full(len(tile.cases), "", dtype=object)
        self.blocks = {}

    def add(self, case: int, scene: Scene, arrays: Mapping[str, np.ndarray]) -> None:
        """Take the numbers of one case."""
        for name, array in arrays.items():
            variable = self._variable(name, CASE[name])
            sizes = variable.shape[len(self.axes) :]
            if name not in self.blocks:
                self.blocks[name] = np.full((len(self.tile.cases), *sizes), np.nan)
            dimensions = CASE[name].dimensions
            target = self.blocks[name][case - self.tile.cases.start, ...]
            _place(target, np.asarray(array, dtype=float), self._where(dimensions, scene))

    def end_case(self, case: int, ended: Verdict, spent: Mapping[str, float]) -> None:
        """Take how a case ended, and the times that it took."""
        k = case - self.tile.cases.start
        self.status[k], self.message[k] = int(ended.status), ended.message
        for name, seconds in spent.items():
            times = self.blocks.setdefault(name, np.full(len(self.tile.cases), np.nan))
            times[k] = seconds

    def flush(self) -> None:
        """Write the cases that were taken."""
        at, shape = self.tile.at, self.tile.shape
        for name, block in self.blocks.items():
            self.file[name][(*at, ...)] = block.reshape(shape + block.shape[1:])
        self.file["status"][(*at, ...)] = self.status.reshape(shape)
        message = self.message.reshape(shape)
        # netCDF4 takes a single string only at a bare ellipsis
        self.file["message"][(*at, ...) if shape else ...] = message

    def versions_met(self, versions: Mapping[str, str]) -> None:
        """Note which versions computed a case."""
        for name, number in versions.items():
            self.versions.setdefault(name, set()).add(number)

    def describe(self, plan: Plan, digest: str) -> None:
        """Write what the dataset is, where it comes from, and what made it."""
        study = self.study
        now = datetime.now(UTC).isoformat(timespec="seconds")
        made_by = {name: ", ".join(sorted(met)) for name, met in sorted(self.versions.items())}
        attributes = {
            "Conventions": CONVENTIONS,
            "title": study.title,
            "history": f"{now} demflow {installed('demflow')}: collected from stored stage runs",
            "source": "demflow: distinct-element packing and pore-network flow in two dimensions",
            "study": study.name,
            "study_text": study.text,
            "study_sha256": study.sha256,
            "study_smoke": "yes" if study.smoke else "no",
            "seed": ", ".join(map(str, self.labels.seeds)),
            "demflow_version": installed("demflow"),
            "demflow_digest": digest,
            "stage_versions": ", ".join(f"{s.name} {s.version}" for s in plan.stages),
            "machine": platform.machine(),
            **{f"{name}_version": met for name, met in made_by.items() if name != "demflow"},
            "netCDF4_version": installed("netCDF4"),
            "xarray_version": installed("xarray"),
        }
        self.file.setncatts(attributes)

    def _variable(self, name: str, quantity: Quantity) -> netCDF4.Variable:
        """The variable of a quantity, made when it is first needed."""
        if name in self.file.variables:
            return self.file[name]
        dimensions = tuple(d for d in quantity.dimensions if self._dimension(d))
        variable = self.file.createVariable(
            name, "f8", (*self.axes, *dimensions), fill_value=math.nan
        )
        variable.setncatts(quantity_attributes(quantity))
        beside = [name for axis in self.study.axes for name in _beside(coordinates(axis))]
        beside += ["probe_x", "probe_y"] if "probe" in dimensions else []
        if beside:
            variable.setncattr("coordinates", " ".join(beside))
        return variable

    def _dimension(self, name: str) -> bool:
        """Make a dimension and its coordinate; False where the study has no such thing."""
        if name in self.file.dimensions:
            return True
        if name == "elapsed_time":
            return self._numbers(name, name, self.labels.times)
        if name in FIXED:
            return self._words(name, FIXED[name])
        places = self.labels.names[name]
        made = self._words(name, tuple(places))
        if name == "probe" and made:
            for k, beside in enumerate(("probe_x", "probe_y")):
                self._numbers(beside, name, np.array([at[k] for at in places.values()]))
        return made

    def _numbers(self, name: str, dimension: str, values: np.ndarray) -> bool:
        if not len(values):
            return False
        if dimension not in self.file.dimensions:
            self.file.createDimension(dimension, len(values))
        variable = self.file.createVariable(name, "f8", (dimension,), fill_value=False)
        variable.setncatts(quantity_attributes(COORDINATES[name]))
        variable[:] = values
        return True

    def _words(self, name: str, words: Sequence[str]) -> bool:
        if not words:
            return False
        self.file.createDimension(name, len(words))
        variable = self.file.createVariable(name, TEXT, (name,), fill_value=False)
        variable.setncatts(quantity_attributes(COORDINATES[name]))
        variable[:] = np.array(words, dtype=object)
        return True

    def _axis_coordinate(self, dimension: str, coordinate: Coordinate) -> None:
        values = coordinate.values
        words = values.dtype.kind == "U"
        kind = TEXT if words else values.dtype
        variable = self.file.createVariable(coordinate.name, kind, (dimension,), fill_value=False)
        if coordinate.unit:
            variable.setncattr("units", coordinate.unit)
        variable.setncattr("long_name", coordinate.long_name)
        variable[:] = values.astype(object) if words else values

    def _status(self) -> None:
        flags = self.file.createVariable("status", "i1", self.axes, fill_value=False)
        flags.setncatts(
            {
                "long_name": "how the case ended",
                "standard_name": "status_flag",
                "flag_values": np.array([int(s) for s in Status], dtype=np.int8),
                "flag_meanings": " ".join(s.name.lower() for s in Status),
            }
        )
        message = self.file.createVariable("message", TEXT, self.axes, fill_value=False)
        message.setncattr("long_name", "why the case has no result, and what to try")

    def _where(self, dimensions: tuple[str, ...], scene: Scene) -> list[tuple[str, np.ndarray]]:
        """Positions of a case's own times and names along the dimensions of the dataset."""
        found = []
        for name in dimensions:
            if name not in self.file.dimensions:
                continue
            if name == "elapsed_time":
                own = np.searchsorted(self.labels.times, np.array(scene.times, dtype=float))
            elif name in FIXED:
                own = np.arange(len(FIXED[name]))
            else:
                every = list(self.labels.names[name])
                own = np.array([every.index(n) for n in _names(scene, name)], dtype=int)
            found.append((name, own))
        return found


def _names(scene: Scene, dimension: str) -> list[str]:
    """Names that a scene has along a dimension, in the order in which stages return them."""
    if dimension == "well":
        return [well.name for well in scene.wells]
    if dimension == "boundary":
        return [side for side, _ in scene.boundaries]
    return [probe.name for probe in scene.probes]


def _place(target: np.ndarray, array: np.ndarray, where: list[tuple[str, np.ndarray]]) -> None:
    """Put an array of one case where its labels lie.

    A steady case beside transient ones has no times: its value holds at all of them.
    """
    if not target.shape:
        target[...] = array
        return
    index = [own for _, own in where]
    if array.ndim == target.ndim - 1 and where[-1][0] == "elapsed_time":
        index[-1] = np.arange(target.shape[-1])
        array = array[..., None]
    target[np.ix_(*index)] = array


def _beside(found: tuple[Coordinate, ...]) -> list[str]:
    """Coordinates that lie along an axis without being its own."""
    return [coordinate.name for coordinate in found[1:]]
