"""What a place in a study file may hold: the common face of its sections, and values.

Every section reads nodes into plain values (SI, nested dicts), finds the parameter that
a path names, and builds what the scene holds. Reading never stops at a problem: it
is noted with its place, and a stand-in takes the place of the value.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import re
import typing
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from demflow.model.parameters import bound_problem
from demflow.sweep.study.units import (
    UnitError,
    bare,
    decimal_comma,
    example,
    in_unit_of,
    nearest,
    parse_quantity,
)
from demflow.sweep.study.yaml_source import MOST_TOLD, Node, Place, Problem, Scalar, Sequence

# keys that stand beside `scene` in a study although a scene (or nothing else) holds them
BESIDE_SCENE = (
    *("observe", "solver", "limits", "figures", "report", "expect"),
    *("vary", "sample", "where", "smoke", "data", "fit"),
)

KEPT = "files"  # folder beside a kept study, with copies of what it names


MOST_NOTED = 2_000  # problems after which reading stops


class TooManyProblems(Exception):
    """Enough is wrong with a study to stop reading it."""


class NoParameter(LookupError):
    """A path that names nothing that an axis could vary. The text says why, if it is not plain."""


class NoFileError(ValueError):
    """A file that a study names is not there."""


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
        """Note a problem; `path` is the parameter that cannot be used because of it.

        Raises TooManyProblems where going on would serve nobody.

        Parameters
        ----------
        place : where in the file
        message : words for whoever wrote the study
        path : parameter that cannot be used because of it
        """
        if len(self.problems) >= MOST_NOTED:
            raise TooManyProblems
        self.problems.append(Problem(*place, message))
        if path is not None:
            self.unreadable.add(path)

    def nearest(self, name: str, valid: Iterable[str]) -> str | None:
        """The valid name that a given one most likely stands for, as long as anyone reads that."""
        return nearest(name, valid) if len(self.problems) < MOST_TOLD else None

    def place(self, path: str) -> Place:
        """Where a path is written, or its nearest ancestor that is."""
        while path and path not in self.places:
            shorter = re.sub(r"\[\d+\]", "", path)  # line[3] was expanded from line
            path = shorter if shorter != path else path.rpartition(".")[0]
        return self.places.get(path, Place(1, 1))

    def content(self, name: str, most: int) -> bytes:
        """Content of a file that the study names, which is noted, or of its kept copy.

        Parameters
        ----------
        name : its path relative to the study
        most : bytes that it may have

        Raises NoFileError where there is none, ValueError where it is larger, OSError.
        """
        kept = kept_name(name)
        both = (self.folder / kept, self.folder / name)
        path = next((one for one in both if one.is_file()), None)
        if path is None:
            raise NoFileError(f"there is no such file in {self.folder.resolve()}")
        if path.stat().st_size > most:
            raise ValueError(f"it is larger than {most // 1_000_000} MB")
        found = path.read_bytes()
        self.files[kept] = NamedFile(path, found)
        return found

    def spoilt(self, path: str) -> bool:
        """Whether the path, or something that contains it, could not be read."""
        parts = path.split(".")
        return any(".".join(parts[:k]) in self.unreadable for k in range(len(parts) + 1))


def kept_name(text: str) -> str:
    """Where a copy of a file that a study names is kept beside the copy of the study."""
    digest = hashlib.sha256(text.encode()).hexdigest()[:12]
    return f"{KEPT}/{digest}-{Path(text).name}"


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

    declared: dataclasses.Field[Any]
    type: Any  # without None
    optional: bool

    @property
    def unit(self) -> str:
        """SI unit; "1" where there is none."""
        found: str = self.declared.metadata.get("unit", "1")
        return found

    @property
    def help(self) -> str:
        """One line for a user."""
        found: str = self.declared.metadata.get("help", "")
        return found

    @property
    def choices(self) -> tuple[str, ...] | None:
        """The words that are allowed, or None."""
        return self.declared.metadata.get("choices")

    @property
    def example(self) -> str:
        """A value as a study has it."""
        if self.type is int:
            return "100"
        return self.declared.metadata.get("example") or example(self.unit)

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """Value in SI."""
        before = len(reading.problems)
        value = self._value(node, self.type, self.unit, path, reading)
        if len(reading.problems) > before:
            return value
        for part, one in _leaves(node, value):
            what = self._bound_problem(part, one, reading)
            if what is not None:
                reading.report(part.place, f"{path}: {what}", path)
                return self.stand_in() if self.choices is None else self.choices[0]
        return value

    def _bound_problem(self, node: Node, value: Any, reading: Reading) -> str | None:
        """What is wrong with one value that was read, in the words of whoever wrote it."""
        if not isinstance(node, Scalar) or isinstance(value, str | bool):
            what = bound_problem(self.declared, value)
            hint = hinted(value, self.choices, reading) if what and self.choices else ""
            return what and f"{what}{hint}"
        if bound_problem(self.declared, value) is None:
            return None
        show = str if ", " in self.unit else in_unit_of(node.text, self.unit)
        what = bound_problem(self.declared, value, show)
        percent = self.type is float and self.unit == "1" and bare(node.text)
        if what and percent and bound_problem(self.declared, value / 100.0) is None:
            what += f"; did you mean {node.text.strip()} %?"
        return what

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
            return whole(node.text, path) if kind is int else self._number(node.text, unit, path)
        except UnitError as error:
            reading.report(node.place, str(error), path)
            return _nothing(kind)

    def _number(self, text: str, unit: str, path: str) -> float:
        """A quantity; a number without a unit is SI, where that can be meant. Raises UnitError."""
        one = self.declared.metadata.get("example") if unit == self.unit else None
        value = parse_quantity(text, unit, path, one)
        if not value or not bare(text):
            return value
        if unit == "rad":
            said = f"give {text} deg or {text} rad"
            raise UnitError(f"{path}: an angle of {text} lacks its unit; {said}")
        most = self.declared.metadata.get("bare_at_most")
        if most is not None and abs(value) > most:
            said = f"a number without a unit is in {unit}, and {value:g} {unit} is hardly meant"
            raise UnitError(f"{path}: {text} lacks its unit: {said}; for instance {self.example}")
        return value

    def _list(
        self, node: Node, kinds: tuple[Any, ...], unit: str, path: str, reading: Reading
    ) -> tuple[Any, ...]:
        endless = kinds[-1] is Ellipsis
        if not isinstance(node, Sequence) or not (endless or len(node.items) == len(kinds)):
            wanted = "a list" if endless else f"a list of {len(kinds)} values"
            message = f"{path} is {wanted}, for instance {shape(kinds, unit)}"
            if isinstance(node, Sequence) and len(node.items) > len(kinds):
                message += "; a comma parts values, decimals take a point"
            elif isinstance(node, Scalar) and (comma := decimal_comma(node.text)):
                message += f"; {comma}"
            reading.report(node.place, message, path)
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


def hinted(name: str, valid: Iterable[str], reading: Reading) -> str:
    """What may have been meant by a name that is not known, as the end of a message.

    Parameters
    ----------
    name : that is not known
    valid : names that there are
    reading : takes the problems that are met
    """
    like = reading.nearest(name, valid)
    return f"; did you mean '{like}'?" if like else ""


def report_unknown(
    key: str, place: Place, valid: tuple[str, ...], path: str, reading: Reading, at: str = ""
) -> str | None:
    """Report a key that does not exist, with the nearest that does, which is returned.

    Parameters
    ----------
    key : the key
    place : where in the file
    valid : names that there are
    path : of the block
    reading : takes the problems that are met
    at : where in the block, for messages
    """
    like = reading.nearest(key, valid)
    hint = f"did you mean '{like}'?" if like else f"valid are {', '.join(valid)}"
    if like is None and re.match(r"\d", key):  # {radius: 0,1 m} is two keys
        hint = "a comma parts keys, decimals take a point"
    reading.report(place, f"unknown key '{key}' in {at or where(path)}; {hint}")
    return like


def _leaves(node: Node, value: Any) -> Iterator[tuple[Node, Any]]:
    """The single values of a list of lists, each with its node."""
    if isinstance(node, Sequence) and isinstance(value, tuple):
        for item, part in zip(node.items, value, strict=True):
            yield from _leaves(item, part)
    else:
        yield node, value


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
