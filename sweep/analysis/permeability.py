"""Summaries of permeability tensors: principal values, direction, anisotropy, ensembles."""

from __future__ import annotations

import xarray as xr

from demflow.sweep.dataset.permeability import principal


def principal_permeability(tensor: xr.DataArray) -> xr.Dataset:
    """Principal values and direction of tensors with dimensions (..., row, column).

    Returns
    -------
    Dataset over the other dimensions with `largest` and `smallest` (the unit of the tensor),
    `direction` (degrees from the x axis to the largest, in (−90, 90]) and `anisotropy`
    (largest over smallest). NaN where the tensor is.

    The tensor's symmetric part is taken; the skew part does no work.
    """
    found = principal(tensor.transpose(..., "row", "column").values)
    outer = tensor.isel(row=0, column=0, drop=True)
    largest, smallest, direction, anisotropy = (outer.copy(data=one) for one in found.values())
    unit = tensor.attrs.get("units", "m2")
    return xr.Dataset(
        {
            "largest": largest.assign_attrs(units=unit, long_name="largest permeability"),
            "smallest": smallest.assign_attrs(units=unit, long_name="smallest permeability"),
            "direction": direction.assign_attrs(
                units="degree", long_name="direction of the largest permeability"
            ),
            "anisotropy": anisotropy.assign_attrs(
                units="1", long_name="largest over smallest permeability"
            ),
        }
    )


def ensemble(values: xr.DataArray, axis: str) -> xr.Dataset:
    """Mean and spread along an ensemble axis, cases without a result left out.

    Returns `mean`, `spread` (standard deviation of the members, n − 1 in the divisor; NaN
    for one member), `standard_error` (of the mean: spread / √n), `least`, `greatest` and
    `members` (how many counted).
    """
    members = values.notnull().sum(axis)
    mean = values.mean(axis)
    squares = ((values - mean) ** 2).sum(axis)
    spread = (squares / (members - 1).where(members > 1)) ** 0.5
    result: dict[str, xr.DataArray] = {
        "mean": mean,
        "spread": spread,
        "standard_error": spread / members**0.5,
        "least": values.min(axis),
        "greatest": values.max(axis),
    }
    unit = values.attrs.get("units", "1")
    named = {key: value.assign_attrs(units=unit) for key, value in result.items()}
    return xr.Dataset(named | {"members": members.assign_attrs(units="1")})
