"""Whether what one case found is good: bounds that no sound result exceeds.

A solver that ended is no proof that its numbers mean anything. What is judged are the measures
that every case records of itself; the bounds are wide, so that what exceeds them is broken and not
merely rough, and narrow enough that nothing beyond them should be read as a result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np


class Bound(NamedTuple):
    """What a measure may come to at most, and what it means to exceed it."""

    most: float
    says: str


# By the names of `model.quantities.CASE`.
BOUNDS: dict[str, Bound] = {
    "mass_balance_error": Bound(1e-6, "the volumes let in, produced and stored do not add up"),
    "mass_imbalance": Bound(1e-3, "the volume balanced only after the solver put it right"),
    "flow_balance_error": Bound(0.1, "the flows recorded do not explain what is stored"),
    "residual": Bound(0.1, "the pressures do not solve the flow equation"),
    "range_error": Bound(0.1, "pressures or flows leave the range that the maximum principle sets"),
}


def verdict(found: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """Why what a case found is not good, one sentence for each measure; empty where it is.

    Parameters
    ----------
    found : measures by their names in `model.quantities.CASE`, single numbers; those that a case
        has not got are not judged. One that is no number is beyond any bound.

    A solver that estimates its error and says that it missed the tolerance is not good either;
    one that makes no estimate (NaN) is not judged by it.
    """
    told = []
    for name, bound in BOUNDS.items():
        value = float(found.get(name, 0.0))
        if not value <= bound.most:
            told.append(f"{name} is {value:.2g}, above {bound.most:g}: {bound.says}")
    met = float(found.get("tolerance_met", math.nan))
    if met == 0.0:
        error = float(found.get("estimated_error", math.nan))
        told.append(f"the tolerance was not met, the error in time is estimated at {error:.2g}")
    return tuple(told)
