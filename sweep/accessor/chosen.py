"""What of a study's dataset is asked for: its variables, wells and cases, or a word why not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from demflow.sweep.analysis.cases import Index
from demflow.sweep.dataset.open import same_value
from demflow.sweep.errors import ResultsError


class Chosen:
    """A dataset and what may be chosen of it."""

    def __init__(self, dataset: xr.Dataset):
        self._dataset = dataset

    def _places(self, at: Mapping[str, Any]) -> Index:
        """Positions of values on axes of the study. Raises ResultsError where one is not there."""
        found: Index = {}
        for axis, value in at.items():
            if axis not in self._variable("status").dims:
                there = ", ".join(map(str, self._variable("status").dims)) or "none"
                raise ResultsError(f"{axis} is no axis of the study; they are {there}")
            values = self._dataset[axis].values
            places = [k for k, one in enumerate(values) if same_value(one, value)]
            if not places:  # the nearest one is not taken in silence
                told = ", ".join(str(one) for one in values)
                raise ResultsError(f"{axis} = {value} is not there; give one of {told}")
            found[axis] = places[0]
        return found

    def _numbers(self, of: str | xr.DataArray) -> xr.DataArray:
        """One number a case. Raises ResultsError for what has more."""
        values = self._variable(of) if isinstance(of, str) else of
        more = [str(d) for d in values.dims if d not in self._variable("status").dims]
        if more:
            raise ResultsError(
                f"{values.name} has more than one number a case, along {', '.join(more)}; choose, "
                f"as dataset.{values.name}.isel({more[0]}=-1)"
            )
        return values

    def _variable(self, name: str) -> xr.DataArray:
        if name not in self._dataset:
            there = ", ".join(map(str, self._dataset.data_vars))
            raise ResultsError(f"the dataset has no {name}; it has {there}")
        return self._dataset[name]

    def _check_well(self, well: str) -> None:
        """Raise ResultsError where there is no such well."""
        there = [str(name) for name in self._dataset["well"].values]
        if well not in there:
            raise ResultsError(f"there is no well {well}; there are {', '.join(there)}")

    def _check_told(self, well: str, rates: Sequence[tuple[float, float]]) -> None:
        """Raise ResultsError where rates told of a well are not those that it has."""
        when, new = np.array(rates, dtype=float).reshape(-1, 2).T
        if not len(when) or np.any(np.diff(when) <= 0.0):
            raise ResultsError("rates are pairs (time in s, rate in m³/s), times increasing")
        times = np.asarray(self._dataset["elapsed_time"].values, dtype=float)
        steps = np.append(0.0, new)[np.searchsorted(when, times)]
        at_change = np.isclose(times[:, None], when, rtol=1e-9, atol=0.0).any(axis=1)
        rate = self._variable("well_rate").sel(well=well)
        said = xr.DataArray(np.where(at_change, np.nan, steps), dims="elapsed_time")
        off = abs(rate.drop_vars("elapsed_time") - said) > 1e-6 * np.abs(new).max()
        at = off.any([name for name in off.dims if name != "elapsed_time"]).values
        if at.any():
            first = int(np.flatnonzero(at)[0])
            other = rate.isel(elapsed_time=first).where(off.isel(elapsed_time=first))
            raise ResultsError(
                f"rates say {float(said[first]):.6g} m3/s after {times[first]:.6g} s, where the "
                f"rate of {well} is {float(other.max()):.6g} m3/s; give its own, and choose cases "
                "that have them"
            )

    def _check_rates(
        self,
        change: xr.DataArray,
        instead: str = "take the dataset's own pressure_derivative, or plot_well with since= and "
        "until=",
    ) -> None:
        """Raise ResultsError where the rate of a well with a pressure change is not one."""
        if "well_rate" not in self._dataset:
            return
        rate = self._dataset["well_rate"].where(change.notnull())
        spread = rate.max("elapsed_time") - rate.min("elapsed_time")
        changes = spread > 1e-9 * abs(rate).max("elapsed_time")
        changing = changes.any([name for name in changes.dims if name != "well"])
        if bool(changing.any()):
            names = ", ".join(str(one) for one in self._dataset["well"].values[changing.values])
            raise ResultsError(
                f"the rate of {names} changes, and a derivative is of one flow period; {instead}"
            )


def last_period(
    times: np.ndarray,
    pressure: np.ndarray,
    change: np.ndarray,
    rate: np.ndarray,
    rates: Sequence[tuple[float, float]] | None,
) -> tuple[tuple[np.ndarray, np.ndarray], list[tuple[float, float]]]:
    """Times and pressures of a case's last flow period, from just before it, and all its rates.

    Raises ValueError where it has no pressure in that period.
    """
    known = [(0.0, float(rate[-1]))] if rates is None else list(rates)
    before = known[-2][1] if len(known) > 1 else 0.0
    begin, sign = known[-1][0], np.sign(known[-1][1] - before)
    now = (times > begin) & np.isfinite(pressure) & np.isfinite(change)
    if not now.any():
        raise ValueError("no pressure after the last change of the rate")
    first = float((pressure + sign * change)[now][0])
    return (np.append(begin, times[now]), np.append(first, pressure[now])), known
