"""What is dug into the rock, and its weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from demflow.model.parameters import Problems, check_fields, parameter
from demflow.model.region import (
    Circle,
    Hole,
    Pierced,
    Polygon,
    Rectangle,
    Region,
    Shape,
    bounding_box,
    outer_shape,
    tightest,
)
from demflow.model.scene.rock import Stress

__all__ = [
    "CircularHole",
    "Excavation",
    "Ground",
    "PolygonalHole",
    "RectangularHole",
    "ground_problems",
    "holes_of",
]

SOLID = 0.85  # about what of a packing is grains, by which its weight is guessed beforehand


@dataclass(frozen=True, slots=True, kw_only=True)
class _Dug:
    """A hole, dug after the rock was loaded. Its rim is a side that boundaries can name."""

    side: str | None = parameter(
        default=None, key="name", help="name of its side, for boundaries; default hole[0], hole[1]"
    )
    pressure: float = parameter(
        "Pa", default=0.0, help="pressure on the grains at its rim, beyond that of the pores there"
    )

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def place(self) -> tuple[tuple[float, float], Shape]:
        """Where the origin of its shape lies (m), and the shape."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class CircularHole(_Dug):
    """A round hole: a tunnel, a shaft, a wellbore."""

    at: tuple[float, float] = parameter("m", help="centre")
    radius: float = parameter("m", above=0, help="radius")

    @property
    def place(self) -> tuple[tuple[float, float], Shape]:
        """Where the origin of its shape lies (m), and the shape."""
        return self.at, Circle(self.radius)


@dataclass(frozen=True, slots=True, kw_only=True)
class RectangularHole(_Dug):
    """A hole of two level and two upright walls: a drift, a stope."""

    at: tuple[float, float] = parameter("m", help="centre")
    width: float = parameter("m", above=0, help="extent along x")
    height: float = parameter("m", above=0, help="extent along y")

    @property
    def place(self) -> tuple[tuple[float, float], Shape]:
        """Where the origin of its shape lies (m), and the shape."""
        return self.at, Rectangle(self.width, self.height)


@dataclass(frozen=True, slots=True, kw_only=True)
class PolygonalHole(_Dug):
    """A hole of any outline."""

    vertices: tuple[tuple[float, float], ...] = parameter("m", help="corners, in order")

    def __post_init__(self) -> None:
        check_fields(self)
        Polygon(self.vertices)  # which tells what is wrong with an outline

    @property
    def place(self) -> tuple[tuple[float, float], Shape]:
        """Where the origin of its shape lies (m), and the shape."""
        return (0.0, 0.0), Polygon(self.vertices)


Excavation = CircularHole | RectangularHole | PolygonalHole


@dataclass(frozen=True, slots=True)
class Ground:
    """Weight of the grains and holes between them, as the mechanics sees them."""

    unit_weight: float  # N/m³ of the grains themselves, density times gravity
    holes: tuple[Hole, ...]
    pressures: tuple[float, ...]  # Pa, on the rim of each hole

    def over(self, stiffness: float) -> Ground:
        """The same over a contact stiffness."""
        pressures = tuple(pressure / stiffness for pressure in self.pressures)
        return Ground(self.unit_weight / stiffness, self.holes, pressures)


def holes_of(excavations: Sequence[Excavation]) -> tuple[Hole, ...]:
    """The holes, each with the name of its side."""
    return tuple(
        Hole(one.side or f"hole[{number}]", *one.place) for number, one in enumerate(excavations)
    )


def ground_problems(
    excavations: Sequence[Excavation],
    gravity: float | None,
    rock: Region,
    *,
    density: float,
    stress: Stress | None,
    tested: bool,
) -> Problems:
    """What is wrong with holes and weight; `rock` is the region with the holes.

    Parameters
    ----------
    excavations : holes
    gravity : m/s², or None
    rock : the region with the holes
    density : of the grains, kg/m³
    stress : stress on the rock, or None
    tested : whether a test to failure is asked for
    """
    if gravity is not None and stress is None:
        yield "gravity", "grains bear their weight only under a stress; add one"
    elif gravity is not None and stress is not None:
        _, _, bottom, top = bounding_box(rock)
        half = 0.5 * SOLID * density * gravity * (top - bottom)
        if half >= stress.components[1]:
            what = f"half of the rock's weight, {half:.3g} Pa, is more than the vertical stress of "
            what += f"{stress.components[1]:.3g} Pa, which holds at mid-height; raise the stress"
            yield "gravity", what
    for number, one in enumerate(excavations):
        if one.pressure != 0.0 and stress is None:
            yield f"excavate.{number}.pressure", "a rim bears a pressure only under a stress"
    if tested and (excavations or gravity is not None):
        name = "excavate" if excavations else "gravity"
        yield name, "a test to failure is one of the whole packing, without weight and holes"
    if not isinstance(rock, Pierced):
        return
    names = [hole.name for hole in rock.holes]
    for number, name in enumerate(names):
        if name in (*outer_shape(rock).sides, "outer", *names[:number]):
            yield f"excavate.{number}.name", f"another side is called {name}"
    room, name, other = tightest(rock)
    if room <= 0.0:
        what = "it reaches beyond the region" if other == "outer" else f"it meets {other}"
        yield f"excavate.{names.index(name)}", what
