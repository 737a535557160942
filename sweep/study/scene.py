"""The grammar of `scene:`, with the forms that are shorter in a file than in the model.

Times by first, last and number per decade; probes along a line; pressures by side; an initial
pressure as a number, a field or a word. All the rest follows from the dataclasses of `model.scene`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from demflow.model.parameters import SceneError, check_fields, parameter
from demflow.model.scene import (
    OBSERVABLES,
    BiWing,
    Circle,
    FractureSet,
    InitialField,
    Polygon,
    Probe,
    Rectangle,
    Scene,
    Trace,
)
from demflow.sweep.study.blocks import Block, Named, Words, block_of
from demflow.sweep.study.sections import NoParameter, Parameter, Reading, Section
from demflow.sweep.study.yaml_source import Mapping, Node, Scalar

MOST_TIMES = 10_000  # output times of a case
MOST_PROBES = 10_000  # probes on one line

# the word in a study file for each member of a union of dataclasses
WORDS: dict[type, tuple[str, str]] = {
    Rectangle: ("shape", "rectangle"),
    Circle: ("shape", "circle"),
    Polygon: ("shape", "polygon"),
    BiWing: ("kind", "bi-wing"),
    FractureSet: ("kind", "set"),
    Trace: ("kind", "trace"),
}


@dataclass(frozen=True)
class LogTimes:
    """Times that are evenly spaced in their logarithm, both ends included."""

    first: float = parameter("s", above=0, help="first output time")
    last: float = parameter("s", above=0, help="last output time")
    per_decade: int = parameter(at_least=1, at_most=1000, help="least number of times per decade")

    def __post_init__(self) -> None:
        check_fields(self)
        if self.last <= self.first:
            raise SceneError([("last", "the last time must come after the first")])
        if self.intervals >= MOST_TIMES:
            raise SceneError([("per_decade", f"more than {MOST_TIMES} output times")])

    @property
    def intervals(self) -> int:
        """Number of steps from the first time to the last."""
        decades = math.log10(self.last) - math.log10(self.first)
        return max(1, math.ceil(self.per_decade * decades - 1e-9))

    @property
    def times(self) -> tuple[float, ...]:
        """The times, s."""
        return spaced(self.first, self.last, self.intervals + 1, log=True)


@dataclass(frozen=True)
class ProbeLine:
    """Probes at even distances on a straight line, both ends included."""

    start: tuple[float, float] = parameter("m", key="from", help="position of the first probe")
    end: tuple[float, float] = parameter("m", key="to", help="position of the last probe")
    count: int = parameter(at_least=1, at_most=MOST_PROBES, help="number of probes")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Times(Section):
    """A list of times, or first, last and number per decade."""

    listed: Parameter
    spaced: Block

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """A tuple of times, or the values of the spacing."""
        if isinstance(node, Mapping):
            return self.spaced.read(node, path, reading)
        times = self.listed.read(node, path, reading)
        if len(times) > MOST_TIMES:
            reading.report(node.place, f"{path}: more than {MOST_TIMES} output times", path)
        return times

    def build(self, values: Any, path: str, problems: list[tuple[str, str]]) -> Any:
        """The times, s."""
        if isinstance(values, tuple):
            return values
        before = len(problems)
        spacing = self.spaced.build(values, path, problems)
        return spacing.times if len(problems) == before else (math.nan,)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """Never: times are a dimension of the dataset."""
        raise NoParameter("all cases of a study share their output times")

    def stand_in(self) -> Any:
        """A time that is none."""
        return (math.nan,)


@dataclass(frozen=True)
class ProbeForms(Section):
    """A probe at a point, or several on a line."""

    point: Block
    line: Block

    def form(self, keys: Any) -> Block:
        """The form that these keys belong to."""
        return self.line if any(key in keys for key in ("from", "to", "count")) else self.point

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """Values of the form that the keys belong to."""
        return self.form(node.entries if isinstance(node, Mapping) else ()).read(
            node, path, reading
        )

    def build(self, values: Any, path: str, problems: list[tuple[str, str]], **more: Any) -> Any:
        """One probe, or the list of those on the line, `name[0]`, `name[1]`, …"""
        form = self.form(values)
        if form is self.point:
            return form.build(values, path, problems, **more)
        before = len(problems)
        line = form.build(values, path, problems)
        if len(problems) > before:
            return []
        (x0, y0), (x1, y1), steps = line.start, line.end, max(line.count - 1, 1)
        return [
            Probe(
                name=f"{more['name']}[{k}]",
                at=(x0 + (x1 - x0) * (k / steps), y0 + (y1 - y0) * (k / steps)),
            )
            for k in range(line.count)
        ]

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter of the form that is there."""
        if parts == ("count",):
            raise NoParameter("all cases of a study share their probes")
        return self.form(values).find(values, parts)

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of the form that is there."""
        inner = self.form(values).paths(values, path)
        yield from (one for one in inner if not one.endswith(".count"))


@dataclass(frozen=True)
class InitialForms(Section):
    """One pressure everywhere, a linear field, or the word `steady`."""

    number: Parameter
    field: Block
    word: str = "steady"

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """A pressure, the word, or the values of the field."""
        if isinstance(node, Scalar) and node.text == self.word:
            return self.word
        return self._form(node if isinstance(node, Mapping) else None).read(node, path, reading)

    def build(self, values: Any, path: str, problems: list[tuple[str, str]]) -> Any:
        """What the scene holds."""
        return self._form(values).build(values, path, problems)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter of the form that is there."""
        return self._form(values).find(values, parts)

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of the form that is there."""
        yield from self._form(values).paths(values, path)

    def stand_in(self) -> Any:
        """Not a number."""
        return self.number.stand_in()

    def _form(self, values: Any) -> Block | Parameter:
        return self.field if isinstance(values, Mapping | dict) else self.number


def spaced(first: float, last: float, count: int, *, log: bool) -> tuple[float, ...]:
    """Numbers from first to last, rounded so that 1e-5 is met where it is meant."""
    if count == 1:
        return (first,)
    steps = [k / (count - 1) for k in range(1, count - 1)]
    if log:
        inner = [float(f"{first ** (1 - s) * last**s:.12g}") for s in steps]
    else:
        inner = [float(f"{first + (last - first) * s:.15g}") for s in steps]
    return (first, *inner, last)


def _scene() -> Block:
    time = dataclasses.fields(LogTimes)[0]
    pressure = parameter("Pa", help="pressure at this side of the region")
    initial = next(f for f in dataclasses.fields(Scene) if f.name == "initial_pressure")
    special: dict[str, Section] = {
        "initial_pressure": InitialForms(
            Parameter(initial, float, optional=True), block_of(InitialField)
        ),
        "boundaries": Named(Parameter(pressure, float, optional=False)),
        "probes": Named(ProbeForms(block_of(Probe), block_of(ProbeLine))),
        "times": Times(Parameter(time, tuple[float, ...], optional=False), block_of(LogTimes)),
        "observe": Words(tuple(OBSERVABLES)),
    }
    return block_of(Scene, special, WORDS)


SCENE = _scene()
