"""How the hydraulic aperture of a fracture closes under the stress across it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from demflow.model.parameters import SceneError, check_fields, parameter

__all__ = ["BartonBandis", "Closure"]


@dataclass(frozen=True, slots=True)
class BartonBandis:
    """Roughness and strength of the walls (Barton, Bandis & Bakhtar 1985)."""

    jrc: float = parameter(above=0, at_most=20, help="joint roughness coefficient, JRC")
    jcs: float = parameter("Pa", above=0, help="joint wall compressive strength, JCS")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True)
class Closure:
    """Law of closure; exactly one of none, half_stress, stiffness, barton_bandis, table.

    Where the fracture is a joint too, the stress across it is that of the joint's contacts, and
    what slip along a dilating joint, or tension, opens is added.
    """

    law: str | None = parameter(
        default=None, choices=("none",), help="none: its aperture stays as it is at every stress"
    )

    half_stress: float | None = parameter(
        "Pa", default=None, above=0, help="normal stress that halves the aperture"
    )
    stiffness: float | None = parameter(
        "Pa/m", default=None, above=0, help="normal stiffness without stress; linear by itself"
    )
    largest_closure: float | None = parameter(
        "m", default=None, above=0, help="with a stiffness: closure that no stress exceeds"
    )
    barton_bandis: BartonBandis | None = parameter(
        default=None, help="from the roughness and strength of the walls"
    )

    table: tuple[tuple[float, float], ...] | None = parameter(
        "Pa, m",
        default=None,
        help="measured apertures at rising normal stresses, from 0 on; linear between, and as the "
        "last beyond; its apertures are scaled so that the first is the fracture's own",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        keys = ("half_stress", "stiffness", "barton_bandis", "table")
        given = [key for key in keys if getattr(self, key) is not None]
        given += ["law"] * (self.law is not None)
        if len(given) != 1:
            what = "give none, or exactly one of half_stress, stiffness, barton_bandis, table"
            raise SceneError([(given[0] if given else "", what)])
        if self.table is not None:
            self._check_table(self.table)
        if self.largest_closure is not None and self.stiffness is None:
            raise SceneError([("largest_closure", "belongs to a stiffness; give one")])

    @property
    def closes(self) -> bool:
        """Whether stress does anything to the aperture."""
        return self.law is None

    def _check_table(self, table: tuple[tuple[float, float], ...]) -> None:
        """Raise SceneError where a table says no aperture of each stress."""
        what = None
        stress, aperture = [s for s, _ in table], [w for _, w in table]
        if len(table) < 2 or stress[0] != 0.0:
            what = "give at least two rows [stress, aperture], the first at a stress of 0"
        elif any(b <= a for a, b in pairwise(stress)):
            what = "the stresses must increase"
        elif not all(math.isfinite(w) and w > 0.0 for w in aperture):
            what = "the apertures must be above 0"
        elif any(b > a for a, b in pairwise(aperture)):
            what = "the apertures must not grow with stress"
        if what is not None:
            raise SceneError([("table", what)])
