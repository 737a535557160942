"""The layout of a dataset in netCDF, with CF metadata, and the numbers put in their places."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import netCDF4
import numpy as np

from demflow.model.outcome import Status
from demflow.model.quantities import (
    CASE,
    COORDINATES,
    ENSEMBLE,
    PRINCIPAL,
    STOPPED,
    SWEEP,
    Quantity,
)
from demflow.sweep.dataset.labels import CONVENTIONS, FIXED, Labels, Layout, quantity_attributes
from demflow.sweep.dataset.permeability import members_of, principal
from demflow.sweep.dataset.ragged import Ragged, ragged_dimension
from demflow.sweep.dataset.tiles import Tile
from demflow.sweep.dataset.verdict import Verdict
from demflow.sweep.plan.graph import Plan
from demflow.sweep.printable import printable
from demflow.sweep.store.origins import sources_told
from demflow.sweep.store.versions import installed
from demflow.sweep.study.cases import Coordinate, coordinates
from demflow.sweep.study.expect import JUDGED, beyond_bounds
from demflow.sweep.study.load import Study

TEXT = str  # netCDF-4 strings


@dataclass
class Writer:
    """Fills the file, tile by tile."""

    file: netCDF4.Dataset
    study: Study
    labels: Labels
    stages: tuple[str, ...]  # those that some case runs
    blocks: dict[str, np.ndarray] = field(default_factory=dict)  # variable -> (cases of tile, …)
    added: tuple[int, Set[str]] = (-1, frozenset())  # the last case with numbers, and their names

    def __post_init__(self) -> None:
        self.ragged = Ragged(self.file, tuple(axis.name for axis in self.study.axes))
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
            absent = quantity.transient and len(self.labels.times) == 0
            absent |= any(self.labels.names.get(d) == () for d in quantity.dimensions)
            if set(quantity.needs) & set(self.labels.observed) and not absent:
                self._variable(name, quantity)

    def begin(self, tile: Tile) -> None:
        """Take the next cases."""
        self.tile = tile
        self.status = np.zeros(len(tile.cases), dtype=np.int8)
        self.message = _blank((len(tile.cases),))
        self.blocks = {}

    def add(self, case: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Take the numbers of one case."""
        self.added = case, arrays.keys()
        for name, array in arrays.items():
            if name == STOPPED:
                continue  # it is the case's message
            if ragged_dimension(name) is not None:
                self.ragged.add(case, name, array)
                continue
            if CASE[name].text:
                self._block(name, CASE[name])[case - self.tile.cases.start] = str(array)
                continue
            target = self._block(name, CASE[name])[case - self.tile.cases.start, ...]
            where = self._where(name, int(self.labels.layout_of[case]))
            _place(target, np.asarray(array, dtype=float), where)

    def end_case(self, case: int, ended: Verdict, spent: Mapping[str, np.ndarray]) -> Verdict:
        """Take how a case ended, and the times that it took; how it ended by its numbers too.

        Parameters
        ----------
        case : number of the case
        ended : how it ended
        spent : times that it took, s, by name
        """
        k = case - self.tile.cases.start
        if ended.status is Status.DONE and (beyond := self._beyond(case)):
            ended = Verdict(Status.INACCURATE, "; ".join(beyond))
        self.status[k], self.message[k] = int(ended.status), ended.message
        for name, seconds in spent.items():
            if name in self.file.variables:
                self._block(name, SWEEP[name])[k] = seconds
        return ended

    def _beyond(self, case: int) -> list[str]:
        """What of the numbers of a case is beyond the bounds of a good result."""
        expected = self.study.expectation(self._index(case))
        k = case - self.tile.cases.start
        has = self.added[1] if case == self.added[0] else ()
        met = {name: float(self.blocks[name][k]) for name in JUDGED if name in has}
        return beyond_bounds(expected, met)

    def _index(self, case: int) -> tuple[int, ...]:
        """Where a case lies along each axis."""
        return tuple(int(k) for k in np.unravel_index(case, self.study.shape)) if self.axes else ()

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
        self.ragged.flush(self.tile)

    def summarise(self) -> None:
        """Write what all cases together say of the permeability, once they are written."""
        if "permeability" not in self.file.variables:
            return
        tensor = np.ma.filled(self.file["permeability"][...], math.nan)
        for name, values in principal(tensor).items():
            self._variable(name, PRINCIPAL[name])[...] = values
        for number, axis in enumerate(self.study.axes):
            if axis.seeds:
                along = tuple(name for name in self.axes if name != axis.name)
                for name, values in members_of(tensor, number).items():
                    variable = self._variable(name, ENSEMBLE[name], along)
                    variable.setncattr("ensemble", axis.name)
                    variable[...] = values
                return

    def describe(self, plan: Plan, digest: str, origins: Mapping[str, set[str]]) -> None:
        """Write what the dataset is, where it comes from, and what made it.

        Parameters
        ----------
        plan : all distinct stage runs of the study
        digest : of the study’s text
        origins : versions and machines that made it
        """
        study = self.study
        now = datetime.now(UTC).isoformat(timespec="seconds")
        made_by = {name: ", ".join(sorted(met)) for name, met in sorted(origins.items())}
        counted = zip(plan.stages, plan.counts(), strict=True)
        attributes = {
            "Conventions": CONVENTIONS,
            "title": printable(study.title),
            "history": f"{now} demflow {installed('demflow')}: collected from stored stage runs",
            "source": "demflow: distinct-element packing and pore-network flow in two dimensions",
            "study": study.name,
            "study_text": study.text,
            "study_sha256": study.sha256,
            **({"study_files_sha256": told} if (told := study.files_sha256) else {}),
            "study_smoke": "yes" if study.smoke else "no",
            "seed": ", ".join(map(str, self.labels.seeds)),
            "demflow_digest": digest,
            "plan_sha256": plan.digest(),
            "stage_versions": ", ".join(f"{s.name} {s.version}" for s in plan.stages),
            "stage_runs": f"{', '.join(f'{s.name} {n}' for s, n in counted)} "
            f"behind {plan.count} cases",
            "demflow_version": installed("demflow"),  # where nothing was done
            **({"stage_sources": told} if (told := sources_told(plan.stages)) else {}),
            **made_by,
            "netCDF4_version": installed("netCDF4"),
            "xarray_version": installed("xarray"),
        }
        self.file.setncatts(attributes)

    def _variable(
        self, name: str, quantity: Quantity, axes: tuple[str, ...] | None = None
    ) -> netCDF4.Variable[Any]:
        """The variable of a quantity, made when it is first needed, by default along all axes."""
        axes = self.axes if axes is None else axes
        if name in self.file.variables:
            found: netCDF4.Variable[Any] = self.file[name]
            return found
        dimensions = tuple(d for d in quantity.dimensions if self._dimension(d))
        kind, fill = (TEXT, False) if quantity.text else ("f8", math.nan)
        variable = self.file.createVariable(name, kind, (*axes, *dimensions), fill_value=fill)
        variable.setncatts(quantity_attributes(quantity))
        along = [axis for axis in self.study.axes if axis.name in axes]
        beside = [name for axis in along for name in _beside(coordinates(axis))]
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
        made = self._words(name, self.labels.names[name])
        if name == "probe" and made:
            self._probe_places()
        return made

    def _probe_places(self) -> None:
        """Where the probes lie, along the axes that move them."""
        names = self.labels.names["probe"]
        known = np.full((len(self.labels.probes) + 1, len(names), 2), math.nan)
        for k, places in enumerate(self.labels.probes):
            for name, at in places.items():
                known[k, names.index(name)] = at
        # an index of −1, of a case that cannot be, finds the row of NaN at the end
        at = known[self.labels.probes_of].reshape(*self.study.shape, len(names), 2)
        along = list(self.axes)
        for number in reversed(range(len(along))):
            high, low = np.fmax.reduce(at, axis=number), np.fmin.reduce(at, axis=number)
            if np.array_equal(high, low, equal_nan=True):
                at = high
                del along[number]
        for k, name in enumerate(("probe_x", "probe_y")):
            variable = self.file.createVariable(name, "f8", (*along, "probe"), fill_value=False)
            variable.setncatts(quantity_attributes(COORDINATES[name]))
            variable[...] = at[..., k]

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
        variable.setncatts(dict(coordinate.attributes))
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

    def _positions(self, dimension: str, own: Layout) -> np.ndarray:
        if dimension == "elapsed_time":
            return np.searchsorted(self.labels.times, np.array(own.times, dtype=float))
        if dimension in FIXED:
            return np.arange(len(FIXED[dimension]))
        every = self.labels.names[dimension]
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


def _blank(shape: tuple[int, ...]) -> np.ndarray:
    """Empty words."""
    return np.full(shape, "", dtype=object)
