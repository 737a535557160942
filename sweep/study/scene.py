"""The grammar of `scene:`, with the forms that are shorter in a file than in the model.

Times by first, last and number per decade; probes along a line; pressures by side; an initial
pressure as a number, a field or a word. All the rest follows from the dataclasses of `model.scene`.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from demflow.model.parameters import SceneError, check_fields, parameter
from demflow.model.quantities import CASE
from demflow.model.scene import (
    OBSERVABLES,
    BiWing,
    Circle,
    CircularHole,
    Closure,
    Coupling,
    Excavation,
    FractureSet,
    Grains,
    Inflow,
    InitialField,
    MapFile,
    Polygon,
    PolygonalHole,
    Probe,
    RandomSet,
    Rectangle,
    RectangularHole,
    Refinement,
    Scene,
    Trace,
    TraceMap,
)
from demflow.sweep.study.blocks import (
    Block,
    Law,
    Listed,
    Named,
    Specials,
    Words,
    block_of,
    blocks_of,
)
from demflow.sweep.study.map_files import LARGEST_FILE, MapError, read_map
from demflow.sweep.study.sections import (
    NoFileError,
    NoParameter,
    Parameter,
    Reading,
    Section,
    join,
    shape,
)
from demflow.sweep.study.units import nearest
from demflow.sweep.study.yaml_source import Mapping, Node, Scalar

MOST_TIMES = 10_000  # output times of a case
MOST_PROBES = 10_000  # probes on one line

# the word in a study file for each member of a union of dataclasses
WORDS: dict[type, tuple[str, str]] = {
    Rectangle: ("shape", "rectangle"),
    Circle: ("shape", "circle"),
    Polygon: ("shape", "polygon"),
    CircularHole: ("shape", "circle"),
    RectangularHole: ("shape", "rectangle"),
    PolygonalHole: ("shape", "polygon"),
    BiWing: ("kind", "bi-wing"),
    FractureSet: ("kind", "set"),
    RandomSet: ("kind", "set"),
    Trace: ("kind", "trace"),
    TraceMap: ("kind", "traces"),
}


@dataclass(frozen=True)
class LogTimes:
    """Times that are evenly spaced in their logarithm, both ends included; anew where asked."""

    first: float = parameter("s", above=0, help="first output time")
    last: float = parameter("s", above=0, help="last output time")
    per_decade: int = parameter(at_least=1, at_most=1000, help="least number of times per decade")
    restart: tuple[float, ...] = parameter(
        "s",
        default=(),
        above=0,
        help="when the spacing begins anew with `first` after it, as where a rate changes",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.last <= self.first:
            raise SceneError([("last", "the last time must come after the first")])
        if any(length <= self.first for _, length in self._spans):
            told = "times increase, each by more than `first`, and `last` is later still"
            raise SceneError([("restart", told)])
        if sum(map(self._intervals, (length for _, length in self._spans))) >= MOST_TIMES:
            raise SceneError([("per_decade", f"more than {MOST_TIMES} output times")])

    @property
    def _spans(self) -> list[tuple[float, float]]:
        """Where the spacing begins, and how long it goes on."""
        starts = (0.0, *self.restart)
        ends = (*self.restart, self.last)
        return [(start, end - start) for start, end in zip(starts, ends, strict=True)]

    def _intervals(self, length: float) -> int:
        """Number of steps from the first time to the last."""
        decades = math.log10(length) - math.log10(self.first)
        return max(1, math.ceil(self.per_decade * decades - 1e-9))

    @property
    def times(self) -> tuple[float, ...]:
        """The times, s."""
        found: list[float] = []
        for (start, length), end in zip(self._spans, (*self.restart, self.last), strict=True):
            since = spaced(self.first, length, self._intervals(length) + 1, log=True)
            found += [float(f"{start + lag:.12g}") if start else lag for lag in since[:-1]]
            found.append(end)
        return tuple(found)


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


_CLOSED = ("closed", "sealed", "no-flow", "no_flow", "noflow", "no flow")


@dataclass(frozen=True)
class Sides(Named):
    """Sides of the region by name: a pressure that each keeps, or a block with its inflow."""

    def read(self, node: Node, path: str, reading: Reading) -> dict[str, Any]:
        """Values by name; a side that is said to be closed is told how."""
        shut = {
            name: one
            for name, one in (node.entries.items() if isinstance(node, Mapping) else ())
            if isinstance(one, Scalar) and one.text.casefold() in _CLOSED
        }
        for name, one in shut.items():
            told = f"a side is closed where boundaries has nothing on it: leave {name} out"
            reading.report(one.place, f"{join(path, name)}: {told}", join(path, name))
        if not isinstance(node, Mapping) or not shut:
            return super().read(node, path, reading)
        rest = {name: one for name, one in node.entries.items() if name not in shut}
        return super().read(Mapping(node.place, rest, node.keys), path, reading)

    def build(self, values: Any, path: str, problems: list[tuple[str, str]]) -> Any:
        """Pairs of a name and a pressure or an inflow, in the order of the file."""
        return tuple(
            (name, self.inner.build(value, join(path, name), problems))
            for name, value in values.items()
        )

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter of one of the sides; a pressure also of one that is not there."""
        if not parts:
            raise NoParameter
        found: Parameter = self.inner.find((values or {}).get(parts[0]), parts[1:])
        return found


@dataclass(frozen=True)
class WordOrBlock(Section):
    """A block, or the word that stands for the rest of it: `linear` for `{method: linear}`."""

    key: str
    block: Block

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """Values by key."""
        if isinstance(node, Scalar):
            word = self.block.members[self.key].section
            return {self.key: word.read(node, path, reading)}
        return self.block.read(node, path, reading)

    def build(self, values: Any, path: str, problems: list[tuple[str, str]]) -> Any:
        """The dataclass."""
        return self.block.build(values or {}, path, problems)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter at a path of keys; the block as a whole stands for its word."""
        return self.block.find(values or {}, parts or (self.key,))

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of its keys."""
        yield from self.block.paths(values or {}, path)


@dataclass(frozen=True)
class WordOr(Section):
    """One of a few words, or a value."""

    words: tuple[str, ...]
    value: Parameter

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """The word, or the value."""
        if isinstance(node, Scalar):
            if node.text in self.words:
                return node.text
            like = nearest(node.text, self.words)
            hint = f"did you mean '{like}'?" if like else f"valid are {', '.join(self.words)}"
            example = shape(typing.get_args(self.value.type), self.value.unit)
            reading.report(node.place, f"{path}: {hint} Or give {example}", path)
            return self.words[0]
        return self.value.read(node, path, reading)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter of the value."""
        return self.value.find(None, parts)

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """Its own path."""
        yield path


@dataclass(frozen=True)
class MapFiles(Section):
    """A file with a map, its name relative to the study; or a kept copy beside the study."""

    declared: dataclasses.Field[Any]
    rings: bool

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """The content of the file, as arrays."""
        try:
            if not isinstance(node, Scalar):
                raise MapError(["a file is named by its path relative to the study"])
            files = contents(node.text, reading)
            return _read_once(tuple(files.items()), self.rings)
        except (MapError, OSError) as error:
            found = error.problems if isinstance(error, MapError) else [str(error.strerror)]
            text = node.text if isinstance(node, Scalar) else "this"
            for what in found:
                reading.report(node.place, f"{path}: {text}: {what}", path)
            # what else is wrong with a map that could not be read is not known
            reading.unreadable.add(path.rpartition(".")[0])
            return self.stand_in()

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """Never: maps are as they are."""
        raise NoParameter("a file is no number; make scenes with other files variants")

    def stand_in(self) -> Any:
        """Two lines that meet every region."""
        far = 1e9
        cross = np.array([(-far, 0.0), (far, 0.0), (0.0, -far), (0.0, far)])
        return MapFile(cross, np.array([0, 2, 4]), np.array([1, 2]), "")


def contents(text: str, reading: Reading) -> dict[str, bytes]:
    """Content of a file that a study names, and of the .prj beside it, by their names."""
    named = Path(text)
    names = [named, named.with_suffix(".prj")] if named.suffix.lower() == ".shp" else [named]
    files: dict[str, bytes] = {}
    for name in names:
        try:
            files[name.name] = reading.content(str(name), LARGEST_FILE)
        except ValueError as error:
            if name == named or not isinstance(error, NoFileError):
                raise MapError([str(error)]) from None
    return files


@functools.lru_cache(maxsize=16)
def _read_once(files: tuple[tuple[str, bytes], ...], rings: bool) -> MapFile:
    return read_map(dict(files), rings=rings)


def spaced(first: float, last: float, count: int, *, log: bool) -> tuple[float, ...]:
    """Numbers from first to last, rounded so that 1e-5 is met where it is meant.

    Parameters
    ----------
    first : the first
    last : the last
    count : how many
    log : whether evenly by their logarithm
    """
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
    flow_in = block_of(Inflow)
    inflow = dict.fromkeys(flow_in.members, flow_in)
    initial = next(f for f in dataclasses.fields(Scene) if f.name == "initial_pressure")
    special: dict[str, Section] = {
        "initial_pressure": InitialForms(
            Parameter(initial, float, optional=True), block_of(InitialField)
        ),
        "coupling": WordOrBlock("method", block_of(Coupling)),
        "boundaries": Sides(Law(Parameter(pressure, float, optional=False), inflow, "a block")),
        "probes": Named(ProbeForms(block_of(Probe), block_of(ProbeLine))),
        "excavate": Listed(blocks_of(typing.get_args(Excavation), WORDS)),
        "times": Times(Parameter(time, tuple[float, ...], optional=False), block_of(LogTimes)),
        "observe": Words(tuple(OBSERVABLES), {name: one.needs for name, one in CASE.items()}),
    }
    mapped = {declared.name: declared for declared in dataclasses.fields(TraceMap)}
    point = Parameter(mapped["origin"], tuple[float, float], optional=False)
    around = next(f for f in dataclasses.fields(Refinement) if f.name == "around")
    place = Parameter(around, tuple[float, float], optional=False)
    closure: dict[str, Section] = {"closure": WordOrBlock("law", block_of(Closure))}
    within: Specials = {
        **dict.fromkeys((BiWing, FractureSet, RandomSet, Trace), closure),
        TraceMap: {
            **closure,
            "file": MapFiles(mapped["file"], rings=False),
            "area": MapFiles(mapped["area"], rings=True),
            "origin": WordOr(("centroid", "file"), point),
        },
        Grains: {
            "refine": Listed(block_of(Refinement, {"around": WordOr(("wells", "traces"), place)}))
        },
    }
    return block_of(Scene, special, WORDS, within)


SCENE = _scene()
