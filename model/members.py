"""What the members of a family share and differ in, and what comes out of all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from demflow.model.families import alike
from demflow.model.network.apertures import branch_apertures, open_pipes, stress_across
from demflow.model.outcome import ModelError, OutOfMemory
from demflow.model.products import Apertures, Network, Permeability, StressState, Walk
from demflow.model.quantities import FAILURE, checked
from demflow.model.region import Region
from demflow.model.scene import Fracture, Matrix, acting_lines


class Rock(NamedTuple):
    """What all members of a family share."""

    network: Network
    walked: Walk
    stress: StressState | None
    calibrated: Permeability | None
    region: Region
    matrix: Matrix
    viscosity: float

    def opened(self, fractures: tuple[Fracture, ...]) -> Apertures:
        """The open pipes of one member."""
        return open_pipes(
            self.network,
            self.walked,
            self.stress,
            self.calibrated,
            region=self.region,
            matrix=self.matrix,
            fractures=fractures,
            viscosity=self.viscosity,
        )

    def widths(self, members: list[tuple[Fracture, ...]]) -> Iterator[np.ndarray]:
        """Hydraulic apertures of the branches of each member, (e,) m."""
        lines = acting_lines(members[0], self.region)
        of_line = np.array([line.fracture for line in lines], dtype=np.int64)
        felt = stress_across(self.walked, self.stress, members[0], of_line)
        for fractures in members:
            given = [fracture.aperture or 0.0 for fracture in fractures]
            if all(isinstance(one, float | int) for one in given):
                own = np.array(given, dtype=float)[of_line]
            else:
                own = np.array(
                    [line.aperture or 0.0 for line in acting_lines(fractures, self.region)]
                )
            yield branch_apertures(self.walked, felt, fractures, of_line, own)


def check(fractures: tuple[Any, ...], members: tuple[tuple[Fracture, ...], ...]) -> None:
    """Raise ValueError where members are of another family.

    Parameters
    ----------
    fractures : what the family's fractures have in common, see `model.families.alike`
    members : the fractures of each
    """
    if any(alike(one) != fractures for one in members):
        raise ValueError("the members of a family differ in more than how wide fractures are")


def answered(of: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """What is observed of a member; words where nothing is.

    Raises `OutOfMemory`, which members of one rock need alike: it ends the run, and not for good.

    Parameters
    ----------
    of : gives what is observed, or raises `ModelError`
    """
    try:
        seen = of()
        checked(seen)
    except OutOfMemory:
        raise
    except ModelError as error:
        return {FAILURE: np.asarray(str(error))}
    return {**seen, FAILURE: np.asarray("")}


def stacked(found: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays of all members, one beside the other; NaN and no words where one has none.

    Parameters
    ----------
    found : arrays of each member by their names
    """
    names = {name: array for one in found for name, array in one.items()}
    stacked = {}
    for name, like in names.items():
        words = like.dtype.kind in "US"
        nothing = np.asarray("") if words else np.full(like.shape, np.nan)
        stacked[name] = np.array([one.get(name, nothing) for one in found])
    return stacked
