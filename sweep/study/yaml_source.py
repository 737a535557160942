"""YAML as a tree whose every key and value knows its line and column.

A study needs mappings, lists and plain words only. What could surprise (duplicate
keys, anchors, tags, several documents, characters that nobody sees) or exhaust (size, depth) is
refused here, and scalars stay text: what a text means is decided where its unit is known. So
the parser's events are all that is taken of it, and it need not agree on what a number is.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

from demflow.sweep.printable import printable, shortened

LARGEST_FILE = 1_000_000  # bytes
DEEPEST_NESTING = 20
MOST_TOLD = 100  # problems of one study; who has more looks for one cause
LONGEST_MESSAGE = 1000  # characters; it may quote what is written

# libyaml where it is there, as in every wheel: some thirty times faster
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# Controls of the terminal, lone surrogates, and marks that turn the direction of writing.
UNSEEN = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


class Place(NamedTuple):
    """A position in the study file, counted from 1."""

    line: int
    column: int


@dataclass(frozen=True, order=True)
class Problem:
    """One thing wrong with a study, and where. `str` gives `file:line:column: message`."""

    line: int
    column: int
    message: str
    path: str = ""

    def __str__(self) -> str:
        return f"{self.path}:{self.line}:{self.column}: {self.message}"


class StudyError(Exception):
    """A study that cannot be run. `problems` holds what is wrong with it, in file order.

    Where that is more than a hundred things, the first hundred; `count` says how many there are.
    """

    def __init__(self, path: str | Path, problems: list[Problem], count: int | None = None):
        self.path = printable(str(path))
        found = sorted({_told(problem, self.path) for problem in problems})
        self.problems, self.count = found[:MOST_TOLD], count or len(found)
        lines = [str(problem) for problem in self.problems]
        if self.count > len(lines):
            lines.append(f"{self.path}: … and {self.count - len(lines):,} more problems")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (self.path, self.problems, self.count))


def _told(problem: Problem, path: str) -> Problem:
    """A problem as a message that can be shown, whatever it quotes."""
    message = printable(shortened(problem.message, LONGEST_MESSAGE))
    return replace(problem, path=path, message=message)


@dataclass(frozen=True)
class Scalar:
    """A word, a number or a quantity, as it is written; `quoted` where it stood in quotes."""

    place: Place
    text: str
    quoted: bool = False

    @property
    def empty(self) -> bool:
        """Whether nothing (or `null`) is written here."""
        return not self.quoted and self.text in ("", "~", "null", "Null", "NULL")


@dataclass(frozen=True)
class Sequence:
    """A list."""

    place: Place
    items: tuple[Node, ...]


@dataclass(frozen=True)
class Mapping:
    """Keys and values, in the order of the file; `keys` holds the place of each key."""

    place: Place
    entries: dict[str, Node]
    keys: dict[str, Place] = field(default_factory=dict)


Node = Scalar | Sequence | Mapping


START = Place(1, 1)


class Source(NamedTuple):
    """A study file as it was read."""

    path: Path
    text: str
    sha256: str
    root: Mapping
    problems: list[Problem]  # of a kind that lets reading go on: duplicate keys, tags, anchors


def read_source(path: str | Path) -> Source:
    """Read a study file into a tree with positions.

    Raises
    ------
    StudyError : no such file, not a file, larger than 1 MB, not UTF-8, not YAML, nested
        deeper than 20 levels, empty, or not a mapping.
    """
    path = Path(path)
    content = _content(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = content[: error.start]
        column = error.start - (before.rfind(b"\n") + 1)
        place = Place(before.count(b"\n") + 1, column + 1)
        raise _refusal(path, f"the file is not UTF-8 text ({error.reason})", place) from None
    problems: list[Problem] = []
    root = _compose(path, text, problems)
    if root is None or (isinstance(root, Scalar) and root.empty):
        raise _refusal(path, "the study is empty; it needs the keys study, scene and observe")
    if not isinstance(root, Mapping):
        kind = "a list" if isinstance(root, Sequence) else "a single word"
        raise _refusal(path, f"a study is a mapping of keys to values, not {kind}", root.place)
    return Source(path, text, hashlib.sha256(content).hexdigest(), root, problems)


def _refusal(path: Path, message: str, place: Place = START) -> StudyError:
    return StudyError(path, [Problem(*place, message)])


def _content(path: Path) -> bytes:
    try:
        if not path.exists():
            raise _refusal(path, "there is no such file")
        if not path.is_file():  # a device or a pipe could be read for ever
            kind = "a folder" if path.is_dir() else "a device"
            raise _refusal(path, f"this is {kind}, not a study file")
        with path.open("rb") as stream:
            content = stream.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise _refusal(path, f"the file cannot be read: {reason}") from None
    if len(content) > LARGEST_FILE:
        raise _refusal(path, f"the file is larger than {LARGEST_FILE // 1_000_000} MB")
    return content


def _compose(path: Path, text: str, problems: list[Problem]) -> Node | None:
    """The first document as a tree, or None if there is none."""
    composer = _Composer(problems)
    root: Node | None = None
    try:
        events = iter(yaml.parse(text, Loader=LOADER))
        for event in events:
            if not isinstance(event, DocumentStartEvent):
                continue
            if root is not None:
                raise _refusal(path, "a study is one document; remove '---'", _place(event))
            root = composer.node(next(events), events, 1)
    except _TooDeep as error:
        raise _refusal(path, f"nested deeper than {DEEPEST_NESTING} levels", error.place) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = Place(mark.line + 1, mark.column + 1) if mark else START
        said = ", ".join(str(part) for part in (error.problem, error.context) if part)
        hints = [hint for mark, hint in _HINTS.items() if mark in said]
        raise _refusal(path, "; ".join(["bad YAML: " + said, *hints[:1]]), place) from None
    except yaml.YAMLError as error:
        before = text[: getattr(error, "position", 0)]
        place = Place(before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1)
        said = getattr(error, "reason", "") or "it cannot be read"
        raise _refusal(path, f"bad YAML: {said}", place) from None
    return root


_HINTS = {  # to the parser's words
    "cannot start any token": "indent with spaces, not with tabs, and quote a text that begins "
    "with @, ` or %",
    "expected key": "check the indentation here and above: keys of one level begin in one column",
    "mapping values are not allowed": "check the indentation, or quote a text that holds ': '",
    "',' or '}'": "a ',' or the closing '}' is missing",
    "',' or ']'": "a ',' or the closing ']' is missing",
    "expected ':'": "a key is followed by ': ' and its value",
}


class _TooDeep(Exception):
    def __init__(self, place: Place):
        self.place = place


@dataclass
class _Composer:
    """Builds nodes from the parser's events; keeps the first of two equal keys."""

    problems: list[Problem]

    def node(self, event: Any, events: Iterator[Any], depth: int) -> Node:
        place = _place(event)
        if depth > DEEPEST_NESTING:
            raise _TooDeep(place)
        if isinstance(event, AliasEvent):
            self._problem(place, f"aliases are not allowed; write out what '*{event.anchor}' means")
            return Scalar(place, "")
        if event.anchor is not None:
            self._problem(place, f"anchors are not allowed; remove '&{event.anchor}'")
        if event.tag is not None:
            self._problem(place, f"tags are not allowed; remove '{event.tag}'")
        if isinstance(event, ScalarEvent):
            return self._scalar(place, event)
        if isinstance(event, SequenceStartEvent):
            return Sequence(place, tuple(self._items(events, depth)))
        assert isinstance(event, MappingStartEvent)
        return self._mapping(place, events, depth)

    def _scalar(self, place: Place, event: Any) -> Scalar:
        unseen = UNSEEN.search(event.value)
        if unseen is not None:
            code, name = ord(unseen[0]), unicodedata.name(unseen[0], "")
            name = name.lower() or ("half a character" if code >= 0xD800 else "a control character")
            self._problem(place, f"the text holds U+{code:04X} ({name}), which nobody sees")
            return Scalar(place, UNSEEN.sub("", event.value), quoted=True)
        # libyaml gives plain scalars the empty style, the parser in Python None
        return Scalar(place, event.value, quoted=bool(event.style))

    def _items(self, events: Iterator[Any], depth: int) -> Iterator[Node]:
        for event in events:
            if isinstance(event, SequenceEndEvent):
                return
            yield self.node(event, events, depth + 1)

    def _mapping(self, place: Place, events: Iterator[Any], depth: int) -> Mapping:
        mapping = Mapping(place, {})
        first: dict[str, Place] = {}
        for event in events:
            if isinstance(event, MappingEndEvent):
                break
            key = self.node(event, events, depth + 1)
            value = self.node(next(events), events, depth + 1)
            if not isinstance(key, Scalar):
                self._problem(key.place, "a key must be a word")
                continue
            # files keep names normalised: é is one name, however its accent was typed
            same = unicodedata.normalize("NFC", key.text)
            if same in first:
                what = f"duplicate key '{key.text}'; it stands in line {first[same].line} already"
                self._problem(key.place, what)
            else:
                first[same] = key.place
                mapping.entries[key.text] = value
                mapping.keys[key.text] = key.place
        return mapping

    def _problem(self, place: Place, message: str) -> None:
        self.problems.append(Problem(*place, message))


def _place(event: Any) -> Place:
    return Place(event.start_mark.line + 1, event.start_mark.column + 1)
