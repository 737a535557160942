"""What permeability tensors say: principal values and directions, and means of ensembles."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def principal(tensor: Array) -> dict[str, Array]:
    """Principal values of tensors (…, 2, 2), each (…,), by their names in `model.quantities`.

    `permeability_largest` and `permeability_smallest` in the unit of the tensor,
    `permeability_direction` in degrees from the x axis to the largest, in (−90, 90], and
    `permeability_anisotropy`, largest over smallest. NaN where the tensor is. The symmetric part
    is taken; the skew part does no work.
    """
    kxx, kyy = tensor[..., 0, 0], tensor[..., 1, 1]
    kxy = 0.5 * (tensor[..., 0, 1] + tensor[..., 1, 0])
    mean, half = 0.5 * (kxx + kyy), 0.5 * (kxx - kyy)
    largest = mean + np.hypot(half, kxy)
    with np.errstate(divide="ignore", invalid="ignore"):
        # not mean − radius, which cancels where one direction hardly conducts
        smallest = (kxx * kyy - kxy**2) / largest
        anisotropy = largest / smallest
    return {
        "permeability_largest": largest,
        "permeability_smallest": smallest,
        "permeability_direction": np.degrees(0.5 * np.arctan2(kxy, half)),
        "permeability_anisotropy": anisotropy,
    }


def members_of(tensor: Array, axis: int) -> dict[str, Array]:
    """Mean, standard error and number of the members along an axis of tensors (…, 2, 2).

    Members without a tensor are left out of all three; the error of fewer than two is NaN.
    """
    there = np.isfinite(tensor).all(axis=(-2, -1))
    count = there.sum(axis=axis).astype(float)
    known = np.where(there[..., None, None], tensor, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        each = count[..., None, None]
        mean = known.sum(axis=axis) / each
        off = np.where(there[..., None, None], tensor - np.expand_dims(mean, axis), 0.0)
        error = np.sqrt((off**2).sum(axis=axis) / (each - 1.0) / each)
    error = np.where(each > 1.0, error, np.nan)
    return {"permeability_mean": mean, "permeability_error": error, "ensemble_members": count}
