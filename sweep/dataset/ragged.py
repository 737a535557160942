"""What one case has many of and another none, such as events: laid end to end in the dataset.

A contiguous ragged array as CF has it (section 9.3.3): all values along one dimension, one case
after the other with the last axis of the study fastest, and the count of each case beside them.
"""

from __future__ import annotations

from typing import Any

import netCDF4
import numpy as np

from demflow.model.quantities import CASE, RAGGED
from demflow.sweep.dataset.labels import quantity_attributes
from demflow.sweep.dataset.tiles import Tile


def count_name(dimension: str) -> str:
    """The variable that says how many values each case has along a ragged dimension."""
    return f"{dimension}_count"


def ragged_dimension(name: str) -> str | None:
    """The dimension of a quantity of which each case has a number of its own, or None."""
    return next((d for d in CASE[name].dimensions if d in RAGGED), None)


class Ragged:
    """The values of all cases along ragged dimensions, appended tile by tile.

    Parameters
    ----------
    file : the dataset, open for writing.
    axes : the names of the study's axes.
    """

    def __init__(self, file: netCDF4.Dataset, axes: tuple[str, ...]):
        self.file, self.axes = file, axes
        self.taken: dict[str, dict[int, np.ndarray]] = {}  # variable -> case -> its values

    def add(self, case: int, name: str, values: np.ndarray) -> None:
        """Take the values (count,) of one case; cases come in their order.

        Parameters
        ----------
        case : number of the case
        name : of the variable
        values : (count,)
        """
        self.taken.setdefault(name, {})[case] = np.asarray(values, dtype=float)

    def flush(self, tile: Tile) -> None:
        """Write what the cases of a tile have.

        Raises ValueError where the quantities of one case disagree in how many there are.
        """
        for dimension in RAGGED:
            own = {n: v for n, v in self.taken.items() if ragged_dimension(n) == dimension}
            if own:
                self._append(tile, dimension, own)
        self.taken = {}

    def _append(self, tile: Tile, dimension: str, own: dict[str, dict[int, np.ndarray]]) -> None:
        counts = np.zeros(len(tile.cases), dtype=np.int32)
        for name, cases in own.items():
            for case, values in cases.items():
                known = next(len(other[case]) for other in own.values() if case in other)
                if len(values) != known:
                    raise ValueError(f"{name} has {len(values)} values in a case of {known}")
                counts[case - tile.cases.start] = known
        count = self._count(dimension)
        begin = self.file.dimensions[dimension].size
        ends = begin + np.cumsum(counts)
        for name, cases in own.items():
            variable = self._variable(name, dimension)
            for case, values in cases.items():
                end = ends[case - tile.cases.start]
                variable[end - len(values) : end] = values
        count[(*tile.at, ...)] = counts.reshape(tile.shape)

    def _count(self, dimension: str) -> netCDF4.Variable[Any]:
        """How many each case has: none, unless it is written."""
        name = count_name(dimension)
        if name not in self.file.variables:
            self.file.createDimension(dimension, None)
            variable = self.file.createVariable(name, "i4", self.axes, fill_value=False)
            variable.setncatts(quantity_attributes(RAGGED[dimension]))
            variable.setncattr("sample_dimension", dimension)
            variable[...] = 0
        found: netCDF4.Variable[Any] = self.file[name]
        return found

    def _variable(self, name: str, dimension: str) -> netCDF4.Variable[Any]:
        if name not in self.file.variables:
            variable = self.file.createVariable(name, "f8", (dimension,), fill_value=np.nan)
            variable.setncatts(quantity_attributes(CASE[name]))
        found: netCDF4.Variable[Any] = self.file[name]
        return found
