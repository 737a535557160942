"""Summaries of permeability tensors: principal values, direction, anisotropy, ensembles."""

from __future__ import annotations

import numpy as np
import xarray as xr


def principal_permeability(tensor: xr.DataArray) -> xr.Dataset:
    """Principal values and direction of tensors with dimensions (..., row, column).

    Returns
    -------
    Dataset over the other dimensions with `largest` and `smallest` (the unit of the tensor),
    `direction` (degrees from the x axis to the largest, in (−90, 90]) and `anisotropy`
    (largest over smallest). NaN where the tensor is.

    The tensor's symmetric part is taken; the skew part does no work.
    """
    kxx = tensor.isel(row=0, column=0, drop=True)
    kyy = tensor.isel(row=1, column=1, drop=True)
    kxy = 0.5 * (tensor.isel(row=0, column=1, drop=True) + tensor.isel(row=1, column=0, drop=True))
    mean, half = 0.5 * (kxx + kyy), 0.5 * (kxx - kyy)
    radius = (half**2 + kxy**2) ** 0.5
    largest = mean + radius
    # not mean − radius, which cancels where one direction hardly conducts
    smallest = (kxx * kyy - kxy**2) / largest
    direction = xr.apply_ufunc(np.degrees, 0.5 * xr.apply_ufunc(np.arctan2, kxy, half))
    unit = tensor.attrs.get("units", "m2")
    return xr.Dataset(
        {
            "largest": largest.assign_attrs(units=unit, long_name="largest permeability"),
            "smallest": smallest.assign_attrs(units=unit, long_name="smallest permeability"),
            "direction": direction.assign_attrs(
                units="degree", long_name="direction of the largest permeability"
            ),
            "anisotropy": (largest / smallest).assign_attrs(
                units="1", long_name="largest over smallest permeability"
            ),
        }
    )


def ensemble(values: xr.DataArray, axis: str) -> xr.Dataset:
    """Mean and spread along an ensemble axis, cases without a result left out.

    Returns `mean`, `spread` (standard deviation of the members, n − 1 in the divisor; NaN
    for one member), `least`, `greatest` and `members` (how many counted).
    """
    members = values.notnull().sum(axis)
    mean = values.mean(axis)
    squares = ((values - mean) ** 2).sum(axis)
    spread = (squares / (members - 1).where(members > 1)) ** 0.5
    result: dict[str, xr.DataArray] = {
        "mean": mean,
        "spread": spread,
        "least": values.min(axis),
        "greatest": values.max(axis),
    }
    unit = values.attrs.get("units", "1")
    named = {key: value.assign_attrs(units=unit) for key, value in result.items()}
    return xr.Dataset(named | {"members": members.assign_attrs(units="1")})
