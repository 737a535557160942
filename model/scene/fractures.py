"""Fractures as the scene names them: bi-wings, sets and single traces; barriers too."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, fields
from typing import Any

from demflow.model.parameters import Problems, SceneError, check_fields, parameter
from demflow.model.region import Region, clip_segments, contains, distance_to_rim, outer_shape
from demflow.model.scene.closure import Closure
from demflow.model.scene.distributions import Angle, Aperture, Length, LogNormal
from demflow.model.scene.random_sets import Drawing, expected, segments, window_problems
from demflow.model.scene.rock import FailureTest, Stress
from demflow.model.scene.topology import polyline_problems
from demflow.model.scene.trace_maps import LaidMap, MapFile, lay, pieces

__all__ = [
    "BiWing",
    "Fracture",
    "FractureSet",
    "Joint",
    "RandomSet",
    "Trace",
    "TraceMap",
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

    Exactly one kind; none only where it is a mere joint. `aperture`: a hydraulic aperture
    whose transmissivity along the trace is w³ / (12 μ); the trace has nodes of its own where it
    crosses pipes and other traces. `permeability` without a thickness: the matrix's pipes along
    it get the aperture of a medium of that permeability (the paper's meaning). `thickness` with
    `permeability`, or `resistance`: a barrier, in series with what it cuts, whatever the size of
    the grains. `transmissibility_multiplier`: the pipes that run across the trace keep this
    fraction of their conductance; what that is worth depends on the grains.
    `joint`: grains slide along it; without, a fracture is no plane of weakness.
    """

    name: str
    permeability: float | None = parameter(
        "m2",
        default=None,
        above=0,
        help="permeability of a medium with the fracture's aperture; with a thickness, of the "
        "barrier's own rock",
    )
    aperture: Aperture | None = parameter(
        "m",
        default=None,
        above=0,
        example="100 um",
        bare_at_most=0.1,
        help="hydraulic aperture; transmissivity w³ / (12 μ). One number, or a law by trace",
    )
    transmissibility_multiplier: float | None = parameter(
        default=None,
        at_least=0,
        at_most=1,
        help="barrier: fraction that the pipes across it keep; depends on the size of the grains, "
        "where thickness with permeability, or resistance, do not",
    )
    thickness: float | None = parameter(
        "m", default=None, above=0, help="barrier: thickness of the rock of its permeability"
    )
    resistance: float | None = parameter(
        "Pa s/m", default=None, above=0, help="barrier: pressure drop per flow through its area"
    )
    pore_storage: str | None = parameter(
        default=None,
        choices=("matrix", "fracture"),
        help="who owns the storage of the pores along a fracture of given permeability; "
        "default: fracture",
    )
    closure: Closure | None = parameter(
        default=None, help="how its aperture closes under the stress across it; none: not at all"
    )
    joint: Joint | None = parameter(
        default=None, help="how its contacts slide where the scene names a stress; none: as grains"
    )

    @property
    def course(self) -> tuple[Any, ...]:
        """What decides where it runs: all but what it is to flow and to the grains."""
        own = (getattr(self, f.name) for f in fields(self) if f.name not in _PROPERTIES)
        return (type(self).__name__, *own)

    @property
    def acts_on_flow(self) -> bool:
        """Whether it is more than a mere joint."""
        return bool(self._kinds)

    @property
    def part(self) -> str:
        """What it is to flow: trace, chain, barrier or multiplier; none where a mere joint."""
        parts = {
            "aperture": "trace",
            "permeability": "chain",
            "transmissibility_multiplier": "multiplier",
        }
        return parts.get(self._kinds[0], "barrier") if self._kinds else "none"

    def resistance_at(self, viscosity: float) -> float | None:
        """Resistance per area of a barrier that has one, μ thickness / k, Pa s/m."""
        if self.thickness is not None and self.permeability is not None:
            return viscosity * self.thickness / self.permeability
        return self.resistance

    @property
    def _kinds(self) -> list[str]:
        """The keys given that say what kind of fracture it is, thickness as one with its rock."""
        keys = ("permeability", "aperture", "transmissibility_multiplier", "resistance")
        given = [key for key in keys if getattr(self, key) is not None]
        return (
            ["thickness", *(g for g in given if g != "permeability")] if self.thickness else given
        )

    def _problems(self) -> list[tuple[str, str]]:
        if isinstance(self.aperture, LogNormal) and not isinstance(self, RandomSet | TraceMap):
            return [("aperture", "it is drawn for random sets and maps only; give one number")]
        given = self._kinds
        problems = []
        if len(given) > 1 or not (given or self.joint):
            what = "permeability, aperture, thickness with permeability, resistance, "
            what = f"give exactly one of {what}transmissibility_multiplier"
            problems.append((given[0] if given else "", what))
        elif self.thickness is not None and self.permeability is None:
            problems.append(("thickness", "a barrier of some thickness needs a permeability"))
        if self.closure is not None and self.part != "trace":
            problems.append(("closure", "closes an aperture; give one, or leave it out"))
        if self.pore_storage == "fracture" and self.part != "chain":
            what = "belongs to a fracture given by a permeability; another stores in its own volume"
            problems.append(("pore_storage", what))
        return problems


_PROPERTIES = frozenset(field.name for field in fields(_FractureProperties))


def _ends(at: tuple[float, float], angle: float, half: float) -> tuple[tuple[float, float], ...]:
    """The tips of a straight line about its centre, m."""
    dx, dy = half * math.cos(angle), half * math.sin(angle)
    return (at[0] - dx, at[1] - dy), (at[0] + dx, at[1] + dy)


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
        return _ends(self.at, self.angle, self.half_length)


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
    """A single fracture: from point to point, by its centre, or with bends through its vertices."""

    start: tuple[float, float] | None = parameter("m", default=None, key="from", help="one end")
    end: tuple[float, float] | None = parameter("m", default=None, key="to", help="other end")
    at: tuple[float, float] | None = parameter(
        "m", default=None, help="centre, with angle and length instead of from and to"
    )
    angle: float | None = parameter(
        "rad", default=None, help="angle from the x axis, counter-clockwise"
    )
    length: float | None = parameter("m", default=None, above=0, help="whole length")
    vertices: tuple[tuple[float, float], ...] | None = parameter(
        "m", default=None, help="ends and bends in order, instead of from and to"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        problems = self._problems()
        forms: tuple[dict[str, object], ...] = (
            {"from": self.start, "to": self.end},
            {"at": self.at, "angle": self.angle, "length": self.length},
            {"vertices": self.vertices},
        )
        given = [form for form in forms if any(value is not None for value in form.values())]
        if len(given) != 1:
            problems.append(("", "give either from and to, or at, angle and length, or vertices"))
        elif lacking := [key for key, value in given[0].items() if value is None]:
            problems.append(("", f"lacks {' and '.join(lacking)}"))
        elif self.vertices is not None:
            problems += [("vertices", what) for what in polyline_problems(self.vertices)]
        elif self.start is not None and self.start == self.end:
            problems.append(("to", "the fracture has zero length"))
        if problems:
            raise SceneError(problems)

    @property
    def points(self) -> tuple[tuple[float, float], ...]:
        """Its ends and bends in order, m."""
        if self.start is not None and self.end is not None:
            return self.start, self.end
        if self.at is not None and self.angle is not None and self.length is not None:
            return _ends(self.at, self.angle, 0.5 * self.length)
        return self.vertices or ()


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomSet(_FractureProperties):
    """Straight fractures drawn at random, as many as an intensity, a density or a count says.

    Length and angle are one number or a law; `random_sets.segments` says how they are drawn.
    """

    seed: int = parameter(default=1, at_least=0, help="seed of all that is drawn")
    intensity: float | None = parameter(
        "1/m", default=None, above=0, help="length of fractures per area, P21"
    )
    density: float | None = parameter(
        "1/m2", default=None, above=0, help="centres of fractures per area, P20"
    )
    count: int | None = parameter(
        default=None, at_least=0, at_most=MOST_TRACES, help="fractures with centres in the region"
    )
    length: Length = parameter("m", above=0, help="length of each fracture, or a law of them")
    angle: Angle = parameter(
        "rad", help="angle from the x axis, counter-clockwise, or a law of the angles"
    )
    least_spacing: float | None = parameter(
        "m", default=None, above=0, help="least distance between the centres of two fractures"
    )
    within: float | None = parameter(
        "m",
        default=None,
        above=0,
        help="radius around the origin in which the set is drawn, so that regions of several "
        "sizes cut the same set; default: around the region",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        problems = self._problems()
        given = [key for key in ("intensity", "density", "count") if getattr(self, key) is not None]
        if len(given) != 1:
            what = "give exactly one of intensity, density, count"
            problems.append((given[0] if given else "", what))
        if self.count is not None and self.within is not None:
            problems.append(("within", "count is of the region alone; give a density instead"))
        if problems:
            raise SceneError(problems)

    @property
    def drawing(self) -> Drawing:
        """What decides where its fractures lie."""
        return Drawing(**{one.name: getattr(self, one.name) for one in fields(Drawing)})


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceMap(_FractureProperties):
    """Traces as somebody mapped them, from a file."""

    file: MapFile = parameter(help="traces: GeoJSON, shapefile, CSV or FracPaQ text")
    area: MapFile | None = parameter(default=None, help="file of the mapped area's outline")
    unit: float | None = parameter(
        "m",
        default=None,
        above=0,
        help="length of one unit of the file's coordinates; default: 1 m, or what the file says",
    )
    origin: str | tuple[float, float] = parameter(
        "m",
        default="file",
        help="where the scene's origin lies: file (its own), centroid, or a point of the map",
    )
    crop: float | None = parameter(
        "m", default=None, above=0, help="side of the square around the origin that is kept"
    )
    simplify: float | None = parameter(
        "m", default=None, above=0, help="how far vertices that are left out may lie beside"
    )
    snap: float | None = parameter(
        "m", default=None, above=0, help="ends that near to another trace are joined to it"
    )
    seed: int | None = parameter(
        default=None, at_least=0, help="seed of apertures that are drawn; 1"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        problems = self._problems()
        if self.unit is None and self.file.unit is None:
            what = "the map may be in degrees: it names no reference system and its coordinates "
            what += "would be such; project it to metres, or say unit: 1 m where it is in metres"
            raise SceneError([*problems, ("unit", what)])
        try:
            laid = self.laid
        except SceneError as error:
            problems += error.problems
        else:
            if len(laid.first) - 1 > MOST_TRACES:
                problems.append(("file", f"more than {MOST_TRACES} traces; crop the map"))
        if problems:
            raise SceneError(problems)

    @property
    def laid(self) -> LaidMap:
        """The map in the coordinates of the scene. Raises SceneError where it has faults."""
        unit = self.file.unit if self.unit is None else self.unit
        if unit is None:
            raise SceneError([("unit", "the unit of the map is not known")])
        return lay(self.file, self.area, unit, self.origin, self.crop, self.simplify, self.snap)


Fracture = BiWing | FractureSet | RandomSet | Trace | TraceMap


def fracture_problems(fractures: tuple[Fracture, ...], region: Region) -> Problems:
    """What is wrong with where fractures lie."""
    for fracture in fractures:
        for key, what in _placement_problems(fracture, region):
            yield f"fractures.{fracture.name}.{key}", what


def _placement_problems(fracture: Fracture, region: Region) -> Problems:
    if isinstance(fracture, FractureSet):
        gap = fracture.spacing if fracture.gap is None else fracture.gap
        count = region.area / (fracture.spacing * (fracture.length + gap))
        if count > MOST_TRACES:
            yield "spacing", f"about {count:.2g} fractures in the region, more than {MOST_TRACES}"
    elif isinstance(fracture, RandomSet):
        yield from _drawing_problems(fracture, region)
    elif isinstance(fracture, TraceMap):
        yield from _map_problems(fracture, region)
    elif not _meets(fracture.points, region):
        key = "at"
        if isinstance(fracture, Trace) and fracture.at is None:
            key = "from" if fracture.vertices is None else "vertices"
        yield key, "the fracture lies outside the region, or along its rim"


@functools.lru_cache(maxsize=256)  # the cases of a study mostly differ in something else
def _meets(points: tuple[tuple[float, float], ...], region: Region) -> bool:
    """Whether a polyline has a part within the region."""
    return len(clip_segments(region, points[:-1], points[1:])[0]) > 0


def _drawing_problems(fracture: RandomSet, region: Region) -> Problems:
    """What is wrong with a random set in a region; it is drawn to see whether it has room."""
    region = outer_shape(region)
    yield from window_problems(fracture.drawing, region)
    key = next(k for k in ("intensity", "density", "count") if getattr(fracture, k) is not None)
    if not (count := expected(fracture.drawing, region)) <= MOST_TRACES:
        yield key, f"about {count:.2g} fractures around the region, more than {MOST_TRACES}"
    elif fracture.least_spacing is not None:
        try:
            segments(fracture.drawing, region)
        except SceneError as error:
            yield from error.problems


def _map_problems(fracture: TraceMap, region: Region) -> Problems:
    """What is wrong with where a map lies."""
    laid = fracture.laid
    inside = laid.vertices[contains(region, laid.vertices)]
    if len(inside) and distance_to_rim(region, inside).max() > 0.0:
        return  # quicker than the parts of all traces
    _, a = pieces(laid.first)
    if len(clip_segments(region, laid.vertices[a], laid.vertices[a + 1])[0]):
        return
    what = "no trace lies in the region; origin: centroid puts the map's centre there"
    if len(laid.vertices):
        (left, bottom), (right, top) = laid.vertices.min(axis=0), laid.vertices.max(axis=0)
        what = f"({left:.7g}, {bottom:.7g}) to ({right:.7g}, {top:.7g}) m, so that {what}"
        what = f"the map reaches from {what}"
    yield "origin", what


def joint_problems(
    fractures: tuple[Fracture, ...], stress: Stress | None, test: FailureTest | None
) -> Problems:
    """What is wrong with joints and the loads on them, taken together.

    Parameters
    ----------
    fractures : the fractures of the scene
    stress : stress on the rock, or None
    test : test to failure, or None
    """
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
