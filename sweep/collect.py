"""Products of cases → the labelled dataset, one netCDF-4 file with CF metadata.

The file is filled tile by tile, a few thousand cases at a time, in memory or, beyond a size,
on disk, so that memory does not grow with their number. It is written aside and renamed. A case
without a product is NaN and has its status and its message. All of it follows from the study but
`compute_time` and `stage_time`, which were measured: they alone differ between two runs that
both start from nothing.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import netCDF4
import numpy as np

from model.quantities import CASE, COORDINATES, MAPS, SWEEP, Quantity
from model.scene import Scene
from sweep.cases import Coordinate, coordinates
from sweep.durable import naming, rename_durably, write_durably
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
BUFFER_BYTES = 256_000_000  # a dataset of up to this size is made in memory
TILE_CASES = 2048  # cases that are held in memory at once
TILE_BYTES = 16_000_000  # or fewer, if their numbers are many
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
    source = _Source(plan, store)
    each = _bytes_of_a_case(plan, store, verdicts)

    def fill(file: netCDF4.Dataset) -> None:
        writer = _Writer(file, study, _labels(plan, scene_of), source.stages)
        for tile in _tiles(study.shape, max(1, min(TILE_CASES, TILE_BYTES // each))):
            writer.begin(tile)
            for case in tile.cases:
                if verdicts[case].status is Status.DONE:
                    writer.add(case, source.result(case))
                writer.end_case(case, verdicts[case], source.spent(case))
            writer.flush()
        writer.describe(plan, digest, source.origins)

    if each * len(plan.cases) <= BUFFER_BYTES:
        _make_in_memory(path, fill, source.damaged)
    else:
        _make_on_disk(path, fill, source.damaged)
    return source.damaged


def _make_in_memory(
    path: Path, fill: Callable[[netCDF4.Dataset], None], damaged: list[str]
) -> None:
    """Make a dataset in memory and put it in place, unless a product was found damaged.

    So the netCDF library never meets a disk that fails: it crashes where its last write does.
    """
    file = netCDF4.Dataset(path, "w", format="NETCDF4", memory=1)
    try:
        fill(file)
    finally:
        content = file.close()
    if not damaged:
        with _hash_beside(path, hashlib.sha256(content).hexdigest()):
            write_durably(path, content)


def _make_on_disk(path: Path, fill: Callable[[netCDF4.Dataset], None], damaged: list[str]) -> None:
    """Do the same on disk, for a dataset of any size. Raises OSError."""
    aside = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        try:
            with netCDF4.Dataset(aside, "w", format="NETCDF4") as file:
                fill(file)
                file.sync()  # what cannot be written is told here, and not on closing
        except (RuntimeError, PermissionError) as error:  # its words for whatever happened
            if type(error) not in (RuntimeError, PermissionError):
                raise
            why = f"netCDF cannot write it ({error}); most often the disk is full"
            raise OSError(errno.EIO, why, str(path)) from error
        if damaged:
            return
        with open(aside, "rb+") as written, naming(path):
            os.fsync(written.fileno())
            sha256 = hashlib.file_digest(written, "sha256").hexdigest()
        with _hash_beside(path, sha256):
            rename_durably(aside, path)
    finally:
        with suppress(OSError):
            aside.unlink()


@contextmanager
def _hash_beside(path: Path, sha256: str) -> Iterator[None]:
    """Record the hash of a dataset that takes its place while a `with` block runs.

    Until it has, the hash of the earlier one stands there too, so that whenever this ends
    a whole dataset is known as one.
    """
    line = f"{sha256}  {path.name}\n"
    earlier = "".join(f"{known}  {path.name}\n" for known in _known_hashes(path)[:2])
    write_durably(_hash_file(path), (line + earlier).encode())
    yield
    write_durably(_hash_file(path), line.encode())


def _known_hashes(path: Path) -> list[str]:
    try:
        lines = _hash_file(path).read_text(errors="replace").splitlines()
    except FileNotFoundError:
        return []
    return [line.partition(" ")[0] for line in lines]


def dataset_problem(path: Path) -> str | None:
    """What is wrong with the dataset at `path` by the hash beside it, None if nothing is."""
    recorded = _known_hashes(path)
    if not recorded:
        return f"there is no hash in {_hash_file(path).name} beside it"
    with open(path, "rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    return None if found in recorded else "the data differ from what was written"


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
    comment = {"comment": quantity.comment} if quantity.comment else {}
    return {**unit, "long_name": quantity.long_name, **comment, **dict(quantity.constants)}


class _Layout(NamedTuple):
    """What a case has along the dimensions of the dataset."""

    times: tuple[float, ...]  # s
    names: dict[str, tuple[str, ...]]  # dimension -> names, in the order of the stages' results


@dataclass(frozen=True)
class _Labels:
    """Coordinates of the dataset that the scenes give: times, and names of things."""

    times: np.ndarray  # (times,) s, of all cases
    names: dict[str, dict[str, tuple[float, float]]]  # dimension -> name -> place
    observed: tuple[str, ...]
    seeds: tuple[int, ...]
    layouts: list[_Layout]  # the different ones
    layout_of: np.ndarray  # (cases,) index of each case's own; −1 where it cannot be


def _labels(plan: Plan, scene_of: Callable[[int], Scene]) -> _Labels:
    """What all scenes together name. Cases may differ in times, wells, sides and probes."""
    names: dict[str, dict[str, tuple[float, float]]] = {"well": {}, "boundary": {}, "probe": {}}
    observed: dict[str, None] = {}
    seeds: set[int] = set()
    layouts: dict[tuple[Any, ...], int] = {}
    layout_of = np.full(len(plan.cases), -1, dtype=np.int32)
    for case in range(len(plan.cases)):
        if case in plan.impossible:
            continue
        scene = scene_of(case)
        observed |= dict.fromkeys(scene.observe)
        seeds.add(scene.grains.seed)
        own = {
            "well": {well.name: well.at for well in scene.wells},
            "boundary": {side: (math.nan, math.nan) for side, _ in scene.boundaries},
            "probe": {probe.name: probe.at for probe in scene.probes},
        }
        for dimension, places in own.items():
            for name, at in places.items():
                names[dimension].setdefault(name, at)
        key = (scene.times, *(tuple(places) for places in own.values()))
        layout_of[case] = layouts.setdefault(key, len(layouts))
    times = {key[0] for key in layouts}
    every = np.unique(np.concatenate([np.array(t, dtype=float) for t in times] or [np.empty(0)]))
    found = [_Layout(key[0], dict(zip(names, key[1:], strict=True))) for key in layouts]
    return _Labels(every, names, tuple(observed), tuple(sorted(seeds)), found, layout_of)


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


def _bytes_of_a_case(plan: Plan, store: Store, verdicts: Sequence[Verdict]) -> int:
    """About the bytes of one case in the dataset: the size of the first product, or little."""
    for case, ended in enumerate(verdicts):
        if ended.status is Status.DONE:
            with suppress(FileNotFoundError):  # it is missed when it is read
                return store.path(plan.runs[int(plan.cases[case, -1])].id).stat().st_size
    return 1000


@dataclass
class _Source:
    """Reads what the stages left in the store, and notes where it comes from."""

    plan: Plan
    store: Store
    damaged: list[str] = field(default_factory=list)
    origins: dict[str, set[str]] = field(default_factory=dict)  # versions and machines met

    def __post_init__(self) -> None:
        wanted = self.plan.wanted()
        self.rows = [row for row in range(len(self.plan.stages)) if wanted[row]]
        self.stages = tuple(self.plan.stages[row].name for row in self.rows)
        self.times = np.full((len(self.plan.runs), 2), np.nan)  # s by the clock, of the processor
        self.met = np.zeros(len(self.plan.runs), dtype=bool)  # runs whose times were looked up

    def result(self, case: int) -> Mapping[str, np.ndarray]:
        """What the last stage of a case found; nothing where that is damaged."""
        run = int(self.plan.cases[case, -1])
        try:
            stored = self.store.get(self.plan.runs[run].id)
        except (DamagedError, MissingError) as error:
            self.damaged.append(str(error))
            return {}
        self._note(run, stored.meta)
        return stored.arrays

    def spent(self, case: int) -> dict[str, np.ndarray]:
        """Times of a case in s, under their names in `model.quantities.SWEEP`."""
        times = np.full((len(self.plan.stages), 2), np.nan)
        caused = np.zeros(len(self.plan.stages), dtype=bool)
        for row in self.rows:
            run = int(self.plan.cases[case, row])
            if run >= 0:
                if not self.met[run]:
                    self._look_up(run)
                times[row] = self.times[run]
                caused[row] = self.plan.runs[run].case == case
        solver = [row for row in self.rows if self.plan.stages[row].name == "flow"]
        return {
            "compute_time": np.nansum(times[caused, 0]),
            "stage_time": times[self.rows, 0],
            "solver_time": times[solver, 1].sum() if solver else np.asarray(math.nan),
        }

    def _look_up(self, run: int) -> None:
        identity = self.plan.runs[run].id
        try:
            self._note(run, self.store.meta(identity))
        except MissingError:
            self._note(run, self.store.failure(identity) or {})
        except DamagedError as error:
            self.damaged.append(str(error))

    def _note(self, run: int, meta: Mapping[str, Any]) -> None:
        self.met[run] = True
        self.times[run] = meta.get("seconds", math.nan), meta.get("cpu_seconds", math.nan)
        for name, number in meta.get("versions", {}).items():
            self.origins.setdefault(f"{name}_version", set()).add(number)
        if "machine" in meta:
            self.origins.setdefault("machine", set()).add(meta["machine"])


def _blank(shape: tuple[int, ...]) -> np.ndarray:
    """Empty words."""
    return np.full(shape, "", dtype=object)


@dataclass
class _Writer:
    """Fills the file, tile by tile."""

    file: netCDF4.Dataset
    study: Study
    labels: _Labels
    stages: tuple[str, ...]  # those that some case runs
    blocks: dict[str, np.ndarray] = field(default_factory=dict)  # variable -> (cases of tile, …)

    def __post_init__(self) -> None:
        self.places: dict[tuple[str, int], list[tuple[str, np.ndarray]]] = {}
        self.axes = tuple(axis.name for axis in self.study.axes)
        for axis in self.study.axes:
            self.file.createDimension(axis.name, len(axis.values))
            for coordinate in coordinates(axis):
                self._axis_coordinate(axis.name, coordinate)
        self._status()
        for name, quantity in SWEEP.items():
            unasked = quantity.needs and not set(quantity.needs) & set(self.labels.observed)
            if not unasked and (self.stages or "stage" not in quantity.dimensions):
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
        self.message = _blank((len(tile.cases),))
        self.blocks = {}

    def add(self, case: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Take the numbers of one case."""
        for name, array in arrays.items():
            if CASE[name].text:
                self._block(name, CASE[name])[case - self.tile.cases.start] = str(array)
                continue
            target = self._block(name, CASE[name])[case - self.tile.cases.start, ...]
            where = self._where(name, int(self.labels.layout_of[case]))
            _place(target, np.asarray(array, dtype=float), where)

    def end_case(self, case: int, ended: Verdict, spent: Mapping[str, np.ndarray]) -> None:
        """Take how a case ended, and the times that it took."""
        k = case - self.tile.cases.start
        self.status[k], self.message[k] = int(ended.status), ended.message
        for name, seconds in spent.items():
            if name in self.file.variables:
                self._block(name, SWEEP[name])[k] = seconds

    def _block(self, name: str, quantity: Quantity) -> np.ndarray:
        """Room for a variable in the cases of the tile."""
        if name not in self.blocks:
            sizes = self._variable(name, quantity).shape[len(self.axes) :]
            shape = (len(self.tile.cases), *sizes)
            self.blocks[name] = _blank(shape) if quantity.text else np.full(shape, np.nan)
        return self.blocks[name]

    def flush(self) -> None:
        """Write the cases that were taken."""
        at, shape = self.tile.at, self.tile.shape
        for name, block in {**self.blocks, "message": self.message}.items():
            # netCDF4 takes a single string only at a bare ellipsis
            place = (*at, ...) if shape or block.dtype != object else ...
            self.file[name][place] = block.reshape(shape + block.shape[1:])
        self.file["status"][(*at, ...)] = self.status.reshape(shape)

    def describe(self, plan: Plan, digest: str, origins: Mapping[str, set[str]]) -> None:
        """Write what the dataset is, where it comes from, and what made it."""
        study = self.study
        now = datetime.now(UTC).isoformat(timespec="seconds")
        made_by = {name: ", ".join(sorted(met)) for name, met in sorted(origins.items())}
        counted = zip(plan.stages, plan.counts(), strict=True)
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
            "demflow_digest": digest,
            "stage_versions": ", ".join(f"{s.name} {s.version}" for s in plan.stages),
            "stage_runs": f"{', '.join(f'{s.name} {n}' for s, n in counted)} "
            f"behind {len(plan.cases)} cases",
            "demflow_version": installed("demflow"),  # where nothing was done
            **made_by,
            "netCDF4_version": installed("netCDF4"),
            "xarray_version": installed("xarray"),
        }
        self.file.setncatts(attributes)

    def _variable(self, name: str, quantity: Quantity) -> netCDF4.Variable:
        """The variable of a quantity, made when it is first needed."""
        if name in self.file.variables:
            return self.file[name]
        dimensions = tuple(d for d in quantity.dimensions if self._dimension(d))
        kind, fill = (TEXT, False) if quantity.text else ("f8", math.nan)
        variable = self.file.createVariable(name, kind, (*self.axes, *dimensions), fill_value=fill)
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
        if name == "stage":
            return self._words(name, self.stages)
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

    def _where(self, name: str, layout: int) -> list[tuple[str, np.ndarray]]:
        """Positions of a case's own times and names along the dimensions of a variable."""
        if (name, layout) not in self.places:
            own = self.labels.layouts[layout]
            kept = [d for d in CASE[name].dimensions if d in self.file.dimensions]
            self.places[name, layout] = [(d, self._positions(d, own)) for d in kept]
        return self.places[name, layout]

    def _positions(self, dimension: str, own: _Layout) -> np.ndarray:
        if dimension == "elapsed_time":
            return np.searchsorted(self.labels.times, np.array(own.times, dtype=float))
        if dimension in FIXED:
            return np.arange(len(FIXED[dimension]))
        every = list(self.labels.names[dimension])
        return np.array([every.index(name) for name in own.names[dimension]], dtype=int)


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
