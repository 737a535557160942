"""Weight and holes: what loads a rock beside its walls.

A grain weighs γ π r². What nothing holds, a floater in its pore, has its weight borne by the
nearest grain that carries load. A hole takes the packed grains that lie wholly in it, and their
forces with them: the polygon through the centres of those around, along which the rock ends and a
pressure acts, then has the hole's area, while without those whose centres lie in the hole it would
be wider by half a grain all around.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from demflow.model.mechanics.contact.grains import Array
from demflow.model.mechanics.motion.equilibrium import Specimen
from demflow.model.mechanics.specimen.cut import press_on, without
from demflow.model.mechanics.static.load_carrying import carrying, contacts_of
from demflow.model.outcome import ModelError
from demflow.model.products import Packing, StressState
from demflow.model.region import Hole, contains, distance_to_rim
from demflow.model.scene import Ground


def dug_out(packing: Packing, holes: tuple[Hole, ...]) -> list[Array]:
    """The grains that each hole takes, (n,) bool each.

    Raises ModelError for a hole that takes none.

    Parameters
    ----------
    packing : the packed grains as they came
    holes : dug between them
    """
    points = np.column_stack([packing.x, packing.y])
    found = []
    for hole in holes:
        own = points - np.array(hole.at)
        wholly = distance_to_rim(hole.shape, own) >= packing.radius
        found.append(contains(hole.shape, own) & wholly)
        if not found[-1].any():
            raise ModelError(
                f"no grain lies wholly in the hole {hole.name}; raise grains.count, or refine "
                "grains there"
            )
    return found


def weigh(specimen: Specimen, unit_weight: float) -> None:
    """Load every grain by its weight; `unit_weight` is γ of the grains over k_n, per mean radius.

    Loads of a weight before are taken away.
    """
    grains = specimen.grains
    n = len(grains.x)
    weight = unit_weight * np.pi * grains.radius**2
    carries = np.flatnonzero(carrying(n, contacts_of(specimen)))
    if not len(carries):
        raise ModelError("no grain carries load, so that none bears its weight; add grains")
    places = np.column_stack([grains.x, grains.y])
    bearer = carries[cKDTree(places[carries]).query(places)[1]]
    grains.load_y[:] = -np.bincount(bearer, weights=weight, minlength=n)


def least_pressure(specimen: Specimen) -> float:
    """The grains' weight over the width of the box: twice what lifts the top wall off."""
    return -float(specimen.grains.load_y.sum()) / float(specimen.box[1] - specimen.box[0])


def dig(specimen: Specimen, packing: Packing, ground: Ground) -> tuple[Specimen, Array]:
    """The specimen without what the holes take, weighed and pressed on; and the grains kept.

    Parameters
    ----------
    packing : the packed grains as they came
    specimen : of all grains of the packing, in the units of `rock.build_specimen`; it is spoilt.
    ground : over k_n.
    """
    holes = dug_out(packing, ground.holes)
    gone = np.any(holes, axis=0) if holes else np.zeros(len(packing.x), bool)
    if gone.all():
        raise ModelError("the holes leave no grain")
    loads = np.zeros((len(gone), 2))
    for hole, pressure in zip(holes, ground.pressures, strict=True):
        loads += press_on(specimen, hole, pressure)
    if gone.any():
        specimen = without(specimen, gone)
    weigh(specimen, ground.unit_weight * float(packing.radius.mean()))
    specimen.grains.load_x[:] += loads[~gone, 0]
    specimen.grains.load_y[:] += loads[~gone, 1]
    return specimen, ~gone


def with_holes(state: StressState, kept: Array) -> StressState:
    """The state of some grains with the numbers that they have among all; others have no place."""
    if kept.all():
        return state
    number = np.flatnonzero(kept)
    x, y = np.full((2, len(kept)), np.nan)
    x[kept], y[kept] = state.x, state.y
    return state._replace(
        x=x, y=y, contact_a=number[state.contact_a], contact_b=number[state.contact_b]
    )
