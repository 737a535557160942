"""Fractures as the scene names them: bi-wings, sets and single traces; barriers too."""

from __future__ import annotations

import math
from dataclasses import dataclass

from demflow.model.parameters import Problems, SceneError, check_fields, parameter
from demflow.model.region import Region, clip_segments
from demflow.model.scene.rock import FailureTest, Stress
from demflow.model.scene.topology import polyline_problems

__all__ = [
    "BiWing",
    "Fracture",
    "FractureSet",
    "Joint",
    "Trace",
    "fracture_problems",
    "joint_problems",
]

# Traces that one set may have: beyond, its spacing is a slip of the unit.
MOST_TRACES = 100_000


@dataclass(frozen=True, slots=True)
class Joint:
    """How a fracture yields: a smooth joint in the grains (Mas Ivars et al. 2011).

    It holds cement as long as its shear stress stays below cohesion + friction times its
    normal stress, and its tension below the tensile strength; then friction alone.
    """

    normal_stiffness: float = parameter("Pa/m", above=0, help="stress per closure")
    shear_stiffness: float = parameter("Pa/m", above=0, help="shear stress per slide")
    friction: float = parameter(at_least=0, help="friction coefficient")
    cohesion: float = parameter("Pa", default=0.0, at_least=0, help="cohesion of its cement")
    tensile_strength: float = parameter(
        "Pa", default=0.0, at_least=0, help="tensile strength of its cement"
    )
    dilation_angle: float = parameter(
        "rad", default=0.0, at_least=0, below=0.5 * math.pi, help="angle at which slip opens it"
    )

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, slots=True)
class _FractureProperties:
    """What a fracture does to flow, and under stress.

    Exactly one of the first three; none of them only where it is a mere joint.
    `permeability`: its pipes get the aperture of a medium of that permeability (the
    paper's meaning). `aperture`: a hydraulic aperture whose transmissivity along the
    trace is w³ / (12 μ) (the engineer's). `transmissibility_multiplier`: a barrier;
    the pipes that run across the trace keep this fraction of their conductance.
    `joint`: grains slide along it; without, a fracture is no plane of weakness.
    """

    name: str
    permeability: float | None = parameter(
        "m2", default=None, above=0, help="permeability of a medium with the fracture's aperture"
    )
    aperture: float | None = parameter(
        "m", default=None, above=0, help="hydraulic aperture; transmissivity w³ / (12 μ)"
    )
    transmissibility_multiplier: float | None = parameter(
        default=None, at_least=0, at_most=1, help="barrier: fraction of the flow that it lets cross"
    )
    pore_storage: str | None = parameter(
        default=None,
        choices=("matrix", "fracture"),
        help="who owns the storage of the pores along the trace; "
        "default: matrix for an aperture, fracture for a permeability",
    )
    joint: Joint | None = parameter(
        default=None, help="how its contacts slide where the scene names a stress; none: as grains"
    )

    @property
    def acts_on_flow(self) -> bool:
        """Whether it is more than a mere joint."""
        given = (self.permeability, self.aperture, self.transmissibility_multiplier)
        return any(value is not None for value in given)

    def _problems(self) -> list[tuple[str, str]]:
        given = [
            key
            for key in ("permeability", "aperture", "transmissibility_multiplier")
            if getattr(self, key) is not None
        ]
        if len(given) != 1 and not (self.joint is not None and not given):
            return [
                (
                    given[0] if given else "",
                    "give exactly one of permeability, aperture, transmissibility_multiplier",
                )
            ]
        return []


@dataclass(frozen=True, slots=True, kw_only=True)
class BiWing(_FractureProperties):
    """A straight fracture with two equal wings, as hydraulic fracturing makes from a well."""

    at: tuple[float, float] = parameter("m", help="centre")
    angle: float = parameter("rad", help="angle from the x axis, counter-clockwise")
    half_length: float = parameter("m", above=0, help="length of each wing")

    def __post_init__(self) -> None:
        check_fields(self)
        if problems := self._problems():
            raise SceneError(problems)

    @property
    def points(self) -> tuple[tuple[float, float], ...]:
        """The two tips, m."""
        dx = self.half_length * math.cos(self.angle)
        dy = self.half_length * math.sin(self.angle)
        return (self.at[0] - dx, self.at[1] - dy), (self.at[0] + dx, self.at[1] + dy)


@dataclass(frozen=True, slots=True, kw_only=True)
class FractureSet(_FractureProperties):
    """Parallel natural fractures over the whole region.

    Rows lie `spacing` apart, one of them through the origin. Along a row, fractures of
    `length` follow each other with a `gap` between them (default: the spacing), and
    every second row is shifted by half a period.
    """

    angle: float = parameter("rad", help="angle from the x axis, counter-clockwise")
    length: float = parameter("m", above=0, help="length of each fracture")
    spacing: float = parameter("m", above=0, help="distance between rows, across the fractures")
    gap: float | None = parameter(
        "m", default=None, above=0, help="distance between the fractures of a row"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if problems := self._problems():
            raise SceneError(problems)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace(_FractureProperties):
    """A single fracture: straight from point to point, or with bends through its vertices."""

    start: tuple[float, float] | None = parameter("m", default=None, key="from", help="one end")
    end: tuple[float, float] | None = parameter("m", default=None, key="to", help="other end")
    vertices: tuple[tuple[float, float], ...] | None = parameter(
        "m", default=None, help="ends and bends in order, instead of from and to"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        problems = self._problems()
        if (self.vertices is None) == (self.start is None and self.end is None):
            problems.append(("", "give either both from and to, or vertices"))
        elif self.vertices is not None:
            problems += [("vertices", what) for what in polyline_problems(self.vertices)]
        elif self.start is None or self.end is None:
            problems.append(("", f"lacks {'from' if self.start is None else 'to'}"))
        elif self.start == self.end:
            problems.append(("to", "the fracture has zero length"))
        if problems:
            raise SceneError(problems)

    @property
    def points(self) -> tuple[tuple[float, float], ...]:
        """Its ends and bends in order, m."""
        if self.start is not None and self.end is not None:
            return self.start, self.end
        return self.vertices or ()


Fracture = BiWing | FractureSet | Trace


def fracture_problems(fractures: tuple[Fracture, ...], region: Region) -> Problems:
    """What is wrong with where fractures lie."""
    for fracture in fractures:
        path = f"fractures.{fracture.name}"
        if isinstance(fracture, FractureSet):
            gap = fracture.spacing if fracture.gap is None else fracture.gap
            count = region.area / (fracture.spacing * (fracture.length + gap))
            if count > MOST_TRACES:
                what = f"about {count:.2g} fractures in the region, more than {MOST_TRACES}"
                yield f"{path}.spacing", what
        elif len(clip_segments(region, fracture.points[:-1], fracture.points[1:])[0]) == 0:
            key = "vertices"
            if isinstance(fracture, BiWing):
                key = "at"
            elif fracture.vertices is None:
                key = "from"
            yield f"{path}.{key}", "the fracture lies outside the region"


def joint_problems(
    fractures: tuple[Fracture, ...], stress: Stress | None, test: FailureTest | None
) -> Problems:
    """What is wrong with joints and the loads on them, taken together."""
    joints = [fracture for fracture in fractures if fracture.joint is not None]
    if stress is None and test is None:
        what = "a joint acts only where the scene names a stress or a test"
        yield from ((f"fractures.{fracture.name}.joint", what) for fracture in joints)
    if not joints or stress is None:
        return
    if stress.method == "static":
        yield "stress.method", "static knows no joints; take explicit or auto"
    if abs(stress.components[2]) > 0.0:
        what = "rock with joints is loaded along the axes only; leave the angle out and turn "
        what += "fractures, wells and probes by minus the angle instead"
        yield "stress.angle", what
