"""The cases of a dataset: its axes, which cases are done, what to call them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from demflow.model.outcome import Status
from demflow.sweep.study.units import parse_unit

Index = dict[str, int]  # axis -> position

# CF unit -> units for people, largest first: the first that leaves a value of at least 1,
# or of at least what _LEAST says (pressures stay in MPa, permeabilities in mD for long)
_LEAST = {"GPa": 2.0, "mD": 0.01}
_DISPLAY: dict[str, tuple[str, ...]] = {
    "Pa": ("GPa", "MPa", "kPa", "Pa"),
    "m2": ("mD", "nD"),
    "s": ("d", "h", "s"),
    "m": ("m", "mm", "um"),
    "N m-1": ("GN/m", "MN/m", "kN/m", "N/m"),
    "N/m": ("GN/m", "MN/m", "kN/m", "N/m"),
}
_SYMBOLS = {
    "um": "µm",
    "degree": "°",
    "degrees": "°",
    "deg": "°",
    "m2": "m²",
    "m3": "m³",
    "m3 s-1": "m³/s",
    "m3/s": "m³/s",
    "m3 s-1 Pa-1": "m³/(s Pa)",
    "m3 Pa-1": "m³/Pa",
    "1": "",
}


def axes(dataset: xr.Dataset) -> tuple[str, ...]:
    """Names of the study's axes, in order: the dimensions of `status`."""
    return tuple(str(d) for d in dataset["status"].dims)


def done(dataset: xr.Dataset) -> Iterator[Index]:
    """Index of every case that is done, in order."""
    names = axes(dataset)
    for position in np.argwhere(np.asarray(dataset["status"].values) == Status.DONE):
        yield dict(zip(names, map(int, position), strict=True))


def events(dataset: xr.Dataset, index: Index, dimension: str = "event") -> xr.Dataset:
    """What one case has along a ragged dimension, which holds all cases end to end.

    `index` gives the position of the case on every axis of the whole dataset.

    Parameters
    ----------
    dataset : as `open_results` gives it
    index : position of the case on every axis of the whole dataset
    dimension : the ragged one
    """
    count = dataset[f"{dimension}_count"]
    each = count.values.ravel()
    place = [index[axis] for axis in axes(dataset)]
    case = int(np.ravel_multi_index(place, count.shape)) if place else 0
    begin = int(each[:case].sum())
    own = dataset[[name for name in dataset.data_vars if dataset[name].dims == (dimension,)]]
    return own.isel({dimension: slice(begin, begin + int(each[case]))})


def display(unit: str, values: np.ndarray | float) -> tuple[float, str]:
    """A unit for people that suits all the values, and the factor to multiply by.

    The largest of the unit's prefixes in which the median magnitude is at least 1; units
    without a table stay as they are. `display("Pa", 5e6)` is (1e-6, "MPa").
    """
    choices = _DISPLAY.get(unit)
    if choices is None:
        return 1.0, _SYMBOLS.get(unit, unit)
    size = np.abs(np.asarray(values, dtype=float))
    size = size[np.isfinite(size) & (size > 0)]
    typical = float(np.median(size)) if size.size else 1.0
    for choice in choices:
        factor = float(1 / parse_unit(choice).factor)
        if typical * factor >= _LEAST.get(choice, 0.9995):
            break
    return factor, _SYMBOLS.get(choice, choice)


def with_unit(value: Any, unit: str, digits: int = 4) -> str:
    """A value as people write it: `with_unit(5e6, "Pa")` is `5 MPa`; a word stays a word.

    Parameters
    ----------
    value : in SI, or a word
    unit : SI unit
    digits : significant digits
    """
    if isinstance(value, str) or np.ndim(value) != 0 or not np.isrealobj(value):
        return str(value)
    size = float(value)
    factor, name = display(unit, size)
    space = "" if name in ("", "°") else " "
    return f"{plain_number(size * factor, digits)}{space}{name}"


def plain_number(value: float, digits: int = 4) -> str:
    """A number without computer notation: `plain_number(2e-5)` is `2×10⁻⁵`."""
    if 10**digits <= abs(value) < 1e7:  # such as 15067 s: in full rather than as a power
        return f"{value:.0f}"
    text = f"{value:.{digits}g}"
    if "e" not in text:
        return text
    mantissa, exponent = text.split("e")
    power = power_of_ten(int(exponent))
    return power if mantissa == "1" else f"{mantissa}×{power}"


def power_of_ten(exponent: int) -> str:
    """A power as people write it: `power_of_ten(-5)` is `10⁻⁵`."""
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def axis_title(name: str) -> str:
    """An axis's name in words: `fracture_angle` is `fracture angle`.

    A coordinate that is called as a variable is ends in `_`, which is no part of its name.
    """
    return name.rstrip("_").replace("_", " ")


def axis_value(dataset: xr.Dataset, axis: str, position: int) -> str:
    """One value of an axis with its unit; of an axis over several parameters, each of them.

    Parameters
    ----------
    dataset : as `open_results` gives it
    axis : name of the axis
    position : on the axis, from 0
    """

    def written(name: str) -> str:
        value = dataset[name].values[position].item()
        return with_unit(value, str(dataset[name].attrs.get("units", "1")))

    beside = _beside(dataset, axis)
    if beside:
        return ", ".join(f"{axis_title(name)} {written(name)}" for name in beside)
    return written(axis) if axis in dataset.coords else str(position)


def _beside(dataset: xr.Dataset, axis: str) -> list[str]:
    """Coordinates that say what the points of an axis over several parameters are."""
    of = dataset.variables
    return [str(n) for n in dataset.coords if of[n].dims == (axis,) and n != axis]


def case_title(dataset: xr.Dataset, index: Index) -> str:
    """What tells a case from its neighbours: `fracture angle 65°, stress yy 10 MPa`."""
    parts = [
        ("" if _beside(dataset, axis) else f"{axis_title(axis)} ")
        + axis_value(dataset, axis, position)
        for axis, position in index.items()
        if dataset.sizes[axis] > 1
    ]
    return ", ".join(parts)
