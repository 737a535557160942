"""Permeabilities of many cases on one bonded rock, each under a stress of its own (stage *states*).

A state by unit loads takes little more time than to write it down, hash it and read it again, and
of thousands the contacts alone fill a disk. So what is observed of a few is found in one run, each
as it is alone, and no state is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from demflow.model.mechanics.loading.stress import load
from demflow.model.members import answered, stacked
from demflow.model.network.apertures import open_pipes
from demflow.model.observe import observe
from demflow.model.permeability import measure, measure_bar, measure_periodic
from demflow.model.products import Network, Packing, Permeability, UnitLoads, Walk

Given = Mapping[str, Mapping[str, Any]]  # what each stage of a case reads, by its name
MEASURES: Mapping[str, Callable[..., Any]] = {
    "measure": measure,
    "measure_bar": measure_bar,
    "measure_periodic": measure_periodic,
}


def states(
    packing: Packing,
    units: UnitLoads,
    network: Network,
    walked: Walk | None,
    calibrated: Permeability | None,
    *,
    members: tuple[Given, ...],
) -> dict[str, np.ndarray]:
    """What is observed of each of some members of a family, (members, …).

    To the bit what each gives by itself. Under the names of `model.quantities.CASE`; beside them
    `failure`, words for those that have no result.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    units : linear response of the packed, bonded grains
    network : pores and pipes of the matrix
    walked : where traces lie in the network, or None
    calibrated : permeability of the unstressed network, or None
    members : of each what its own stages read, from *stress* to *observe*, by their names
    """
    return stacked(
        [
            answered(partial(_observed, packing, units, network, walked, calibrated, given))
            for given in members
        ]
    )


def _observed(
    packing: Packing,
    units: UnitLoads,
    network: Network,
    walked: Walk | None,
    calibrated: Permeability | None,
    given: Given,
) -> dict[str, np.ndarray]:
    """What is observed of a member. Raises `ModelError` where nothing is."""
    stress = load(packing, units, **given["stress"])
    opened = open_pipes(network, walked, stress, calibrated, **given["open"])
    measured, bar, periodic = (
        of(network, opened, **given[name]) if name in given else None
        for name, of in MEASURES.items()
    )
    return observe(
        *(packing, stress, None, network, opened, measured, None, None, None),
        bar=bar,
        periodic=periodic,
        **given["observe"],
    )
