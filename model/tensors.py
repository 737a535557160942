"""Permeabilities of many cases that differ in how wide their fractures are (the stage *tensors*).

Which places hang together, where pressures are imposed and in which order nodes are eliminated is
the same for all of them, and found once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from demflow.model.controls import Controls
from demflow.model.members import Rock, answered, check, stacked
from demflow.model.network.apertures import with_branches
from demflow.model.observe import observe, smallest_pore
from demflow.model.permeability import Bar, LinearRim, Repeated
from demflow.model.products import (
    Apertures,
    Network,
    Packing,
    Permeability,
    StressState,
    Walk,
)
from demflow.model.region import Rectangle, Region
from demflow.model.scene import Fracture, Matrix

# What is done at wells and sides where nothing of the flow is observed.
AT_REST = Controls(
    reference=0.0, initial=0.0, side_pressures=(), wells=(), times=(), transient=False
)


def tensors(
    packing: Packing,
    stress: StressState | None,
    network: Network,
    walked: Walk,
    calibrated: Permeability | None,
    *,
    region: Region,
    matrix: Matrix,
    viscosity: float,
    fractures: tuple[Any, ...],
    wanted: tuple[str, ...],
    members: tuple[tuple[Fracture, ...], ...],
) -> dict[str, np.ndarray]:
    """What is observed of each of some members of a family, (members, …).

    To the bit what each gives by itself. Under the names of `model.quantities.CASE`; beside them
    `failure`, words for those that have no result.

    Parameters
    ----------
    packing : grains at rest under the packing pressure
    stress : the stress on the rock, or None
    network : pores and pipes of the matrix
    walked : where traces lie in the network
    calibrated : permeability of the unstressed network, or None
    region : where the case lies, m
    matrix : pipes of the rock, or None
    viscosity : of the fluid, Pa s
    fractures : what the family's fractures have in common, see `model.families.alike`
    wanted : names of what is observed
    members : the fractures of each
    """
    check(fractures, members)
    family = _Family(Rock(network, walked, stress, calibrated, region, matrix, viscosity), wanted)
    base = family.rock.opened(members[0])
    state = observe(
        *(packing, stress, None, network, base, None, None, None, None),
        region=region,
        controls=AT_REST,
        wanted=wanted,
    )
    found: dict[bytes, dict[str, np.ndarray]] = {}  # by how wide branches are
    seen = []
    for one, width in zip(members, family.rock.widths(list(members)), strict=True):
        key = width.tobytes()
        if key not in found:
            found[key] = answered(partial(family.observed, base, one, width, state))
        seen.append(found[key])
    return stacked(seen)


class _Family:
    """Measures members, and keeps what those share whose same branches conduct."""

    def __init__(self, rock: Rock, wanted: tuple[str, ...]) -> None:
        self.rock, self.wanted = rock, wanted
        self.shared: dict[tuple[str, bytes], LinearRim | Bar | Repeated] = {}

    def observed(
        self,
        base: Apertures,
        fractures: tuple[Fracture, ...],
        width: np.ndarray,
        state: dict[str, np.ndarray],
    ) -> dict[str, np.ndarray]:
        """What is observed of a member whose branches are so wide, (e,) m.

        Of all that the others have in common with it `state` is what is observed. Raises
        `ModelError` where nothing is.
        """
        rock = self.rock
        if len(rock.walked.cut_branch):  # what a barrier is worth depends on what it cuts
            opened = rock.opened(fractures)
        else:
            opened = with_branches(base, rock.walked, width, rock.viscosity)
        seen = {**state, "smallest_pore": smallest_pore(opened, rock.network.inside)}
        for name, of in CONDITIONS.items():
            if name in self.wanted:
                key = name, (opened.branch_conductance > 0.0).tobytes()
                if key not in self.shared:
                    self.shared[key] = of(rock, opened)
                seen[name] = self.shared[key].measured(opened, viscosity=rock.viscosity)
        return seen


def _bar(rock: Rock, opened: Apertures) -> Bar:
    assert isinstance(rock.region, Rectangle)  # a scene sees to it
    return Bar(rock.network, opened, region=rock.region)


CONDITIONS: dict[str, Callable[[Rock, Apertures], LinearRim | Bar | Repeated]] = {
    "permeability": lambda rock, opened: LinearRim(rock.network, opened),
    "bar_permeability": _bar,
    "periodic_permeability": lambda rock, opened: Repeated(rock.network, opened),
}
