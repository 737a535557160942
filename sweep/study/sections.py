"""What a place in a study file may hold: the common face of its sections, and values.

Every section reads nodes into plain values (SI, nested dicts), finds the parameter that
a path names, and builds what the scene holds. Reading never stops at a problem: it
is noted with its place, and a stand-in takes the place of the value.
"""

from __future__ import annotations

import dataclasses
import math
import re
import typing
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from demflow.model.parameters import bound_problem
from demflow.sweep.study.units import UnitError, example, nearest, parse_quantity
from demflow.sweep.study.yaml_source import Node, Place, Problem, Scalar, Sequence

# keys that stand beside `scene` in a study although a scene (or nothing else) holds them
BESIDE_SCENE = ("observe", "solver", "limits", "figures", "expect", "vary", "smoke")

KEPT = "files"  # folder beside a kept study, with copies of what it names


class NoParameter(LookupError):
    """A path that names nothing that an axis could vary. The text says why, if it is not plain."""


class NamedFile(NamedTuple):
    """A file that a study names."""

    path: Path
    content: bytes


@dataclass
class Reading:
    """What is gathered while a study is read."""

    supplied: set[str] = field(default_factory=set)  # parameters that an axis gives
    problems: list[Problem] = field(default_factory=list)
    places: dict[str, Place] = field(default_factory=dict)  # where each path is written
    unreadable: set[str] = field(default_factory=set)  # paths that hold a stand-in
    folder: Path = Path()  # what the study's file names are relative to
    files: dict[str, NamedFile] = field(default_factory=dict)  # by the name of their kept copy

    def report(self, place: Place, message: str, path: str | None = None) -> None:
        """Note a problem; `path` is the parameter that cannot be used because of it."""
        self.problems.append(Problem(*place, message))
        if path is not None:
            self.unreadable.add(path)

    def place(self, path: str) -> Place:
        """Where a path is written, or its nearest ancestor that is."""
        while path and path not in self.places:
            shorter = re.sub(r"\[\d+\]", "", path)  # line[3] was expanded from line
            path = shorter if shorter != path else path.rpartition(".")[0]
        return self.places.get(path, Place(1, 1))

    def spoilt(self, path: str) -> bool:
        """Whether the path, or something that contains it, could not be read."""
        parts = path.split(".")
        return any(".".join(parts[:k]) in self.unreadable for k in range(len(parts) + 1))


class Section(ABC):
    """One place of the grammar: how it is read, addressed and built."""

    @abstractmethod
    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """Values (SI) of a node; reports every problem and puts stand-ins where one is."""

    def build(self, values: Any, path: str, problems: list[tuple[str, str]]) -> Any:
        """What the scene holds for these values; appends what is wrong with them."""
        return values

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter at a path below this section; raises NoParameter."""
        raise NoParameter

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """Every path that `find` accepts, for these values."""
        yield from ()

    def stand_in(self) -> Any:
        """Values that take the place of what could not be read: not a number, never true."""
        return None


@dataclass(frozen=True)
class Parameter(Section):
    """A value: a quantity, a whole number, a word, or a list of these."""

    declared: dataclasses.Field
    type: Any  # without None
    optional: bool

    @property
    def unit(self) -> str:
        """SI unit; "1" where there is none."""
        return self.declared.metadata.get("unit", "1")

    @property
    def help(self) -> str:
        """One line for a user."""
        return self.declared.metadata.get("help", "")

    @property
    def choices(self) -> tuple[str, ...] | None:
        """The words that are allowed, or None."""
        return self.declared.metadata.get("choices")

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """Value in SI."""
        before = len(reading.problems)
        value = self._value(node, self.type, self.unit, path, reading)
        if len(reading.problems) == before:
            what = bound_problem(self.declared, value)
            if what is not None:
                like = nearest(value, self.choices) if self.choices else None
                hint = f"; did you mean '{like}'?" if like else ""
                reading.report(node.place, f"{path}: {what}{hint}", path)
                return value if self.choices is None else self.choices[0]
        return value

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """Itself, at the end of a path."""
        if parts:
            raise NoParameter
        return self

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """Its own path."""
        yield path

    def stand_in(self) -> Any:
        """Not a number."""
        return _nothing(self.type)

    def _value(self, node: Node, kind: Any, unit: str, path: str, reading: Reading) -> Any:
        if typing.get_origin(kind) is tuple:
            return self._list(node, typing.get_args(kind), unit, path, reading)
        if not isinstance(node, Scalar):
            found = "a list" if isinstance(node, Sequence) else "a mapping"
            wanted = "a word" if kind is str else f"a single value, for instance {example(unit)}"
            reading.report(node.place, f"{path} is {wanted}, not {found}", path)
            return _nothing(kind)
        if kind is str:
            return node.text
        try:
            if kind is bool:
                return _truth(node.text, path)
            return whole(node.text, path) if kind is int else parse_quantity(node.text, unit, path)
        except UnitError as error:
            reading.report(node.place, str(error), path)
            return _nothing(kind)

    def _list(
        self, node: Node, kinds: tuple[Any, ...], unit: str, path: str, reading: Reading
    ) -> tuple[Any, ...]:
        endless = kinds[-1] is Ellipsis
        if not isinstance(node, Sequence) or not (endless or len(node.items) == len(kinds)):
            wanted = "a list" if endless else f"a list of {len(kinds)} values"
            reading.report(
                node.place, f"{path} is {wanted}, for instance {shape(kinds, unit)}", path
            )
            return () if endless else tuple(_nothing(kind) for kind in kinds)
        if endless:
            kinds, units = kinds[:1] * len(node.items), (unit,) * len(node.items)
        else:
            units = _units(kinds, unit)
        return tuple(
            self._value(item, kind, one, path, reading)
            for item, kind, one in zip(node.items, kinds, units, strict=True)
        )


def join(path: str, key: str) -> str:
    """A path one step deeper; either part may be empty."""
    return f"{path}.{key}" if path and key else path or key


def where(path: str) -> str:
    """A path as it is found from the top of the study."""
    if not path:
        return "scene"
    return path if path.split(".")[0] in BESIDE_SCENE else f"scene.{path}"


def report_unknown(
    key: str, place: Place, valid: tuple[str, ...], path: str, reading: Reading, at: str = ""
) -> str | None:
    """Report a key that does not exist, with the nearest that does, which is returned."""
    like = nearest(key, valid)
    hint = f"did you mean '{like}'?" if like else f"valid are {', '.join(valid)}"
    reading.report(place, f"unknown key '{key}' in {at or where(path)}; {hint}")
    return like


def _nothing(kind: Any) -> Any:
    """A stand-in of a type: no comparison with it is true."""
    if typing.get_origin(kind) is tuple:
        arguments = typing.get_args(kind)
        return () if arguments[-1] is Ellipsis else tuple(_nothing(one) for one in arguments)
    return "" if kind is str else math.nan


def whole(text: str, path: str) -> int:
    """A whole number; 300, 3e2 and 300.0 are the same."""
    value = parse_quantity(text, "1", path)
    if value != math.floor(value):
        raise UnitError(f"{text} is not a whole number; {path} is one, for instance 300")
    if abs(value) >= 2**63:
        raise UnitError(f"{text} is too large for {path}")
    return int(text) if re.fullmatch(r"[-+]?\d+", text) else int(value)


def _truth(text: str, path: str) -> bool:
    if text not in ("true", "false"):
        raise UnitError(f"{path}: '{text}' is neither true nor false")
    return text == "true"


def _units(kinds: tuple[Any, ...], unit: str) -> tuple[str, ...]:
    """Unit of each value of a list of fixed length: `s, m3/s` gives one to each."""
    units = tuple(unit.split(", "))
    return units if len(units) == len(kinds) else (unit,) * len(kinds)


def shape(kinds: tuple[Any, ...], unit: str) -> str:
    """A list of such values, as an example."""
    if kinds[-1] is Ellipsis:
        inner = typing.get_args(kinds[0])
        one = shape(inner, unit) if inner else example(unit)
        return f"[{one}, …]"
    return "[" + ", ".join(example(one) for one in _units(kinds, unit)) + "]"
