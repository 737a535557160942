"""How the hydraulic aperture of a fracture closes under the stress across it."""

from __future__ import annotations

from dataclasses import dataclass

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
    """Law of closure; exactly one of half_stress, stiffness, barton_bandis."""

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

    def __post_init__(self) -> None:
        check_fields(self)
        keys = ("half_stress", "stiffness", "barton_bandis")
        given = [key for key in keys if getattr(self, key) is not None]
        if len(given) != 1:
            what = "give exactly one of half_stress, stiffness, barton_bandis"
            raise SceneError([(given[0] if given else "", what)])
        if self.largest_closure is not None and self.stiffness is None:
            raise SceneError([("largest_closure", "belongs to a stiffness; give one")])
