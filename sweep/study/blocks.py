"""Blocks of a study file, derived from the dataclasses of the model.

A field's type says what is written there (a quantity, a word, a point, a block, named
blocks), its `parameter` metadata gives unit, bounds, choices and key. A field added to
a dataclass is a study key by that alone.
"""

from __future__ import annotations

import dataclasses
import re
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from demflow.model.parameters import SceneError
from demflow.sweep.study.schedules import Schedule
from demflow.sweep.study.sections import (
    NoParameter,
    Parameter,
    Reading,
    Section,
    hinted,
    join,
    report_unknown,
    shape,
    where,
)
from demflow.sweep.study.yaml_source import Mapping, Node, Scalar, Sequence

KindWords = dict[type, tuple[str, str]]
Specials = dict[type, dict[str, Section]]

LONGEST_NAME = 100  # bytes; files and datasets take some 250 of a whole path
NAME_RULE = f"letters, digits, '-' and '_', {LONGEST_NAME} at most"


def is_name(text: str) -> bool:
    """Whether a text can name a well, a fracture, a probe; dots belong to paths."""
    return re.fullmatch(r"\w[\w-]*", text) is not None and len(text.encode()) <= LONGEST_NAME


class Member(NamedTuple):
    """A key of a block."""

    key: str
    name: str  # of the dataclass field
    section: Section
    required: bool
    unwritten: bool = False  # a block that is there, by its defaults, where nothing is written


@dataclass(frozen=True)
class Block(Section):
    """A mapping with the keys of a dataclass."""

    cls: type
    members: dict[str, Member]

    def without(self, *keys: str) -> Block:
        """The block without some of its keys."""
        return Block(self.cls, {k: m for k, m in self.members.items() if k not in keys})

    def read(
        self, node: Node, path: str, reading: Reading, also: tuple[str, ...] = ()
    ) -> dict[str, Any]:
        """Values by key; `also` names keys that the caller reads."""
        if not isinstance(node, Mapping):
            keys = ", ".join(self.members)
            reading.report(node.place, f"{where(path)} is a mapping with the keys {keys}", path)
            found: dict[str, Any] = self.stand_in()
            return found
        values: dict[str, Any] = {}
        meant: set[str | None] = set()  # keys that misspelt ones stand for
        for key, value in node.entries.items():
            if key in also:
                continue
            if key not in self.members:
                valid = (*also, *self.members)
                meant.add(report_unknown(key, node.keys[key], valid, path, reading))
                continue
            inner = join(path, key)
            section = self.members[key].section
            reading.places[inner] = node.keys[key] if isinstance(value, Mapping) else value.place
            read = None if _empty(value) else section.read(value, inner, reading)
            if read is not None:
                values[key] = read
        for key, member in self.members.items():
            inner = join(path, key)
            if key in meant:
                reading.unreadable.add(inner)
            elif member.required and key not in values and inner not in reading.supplied:
                place = reading.place(inner if key in node.entries else path)
                message = f"{where(path)} lacks '{key}'{_meant(member.section)}"
                reading.report(place, message, inner)
            if member.required and inner in reading.unreadable:
                values.setdefault(key, member.section.stand_in())
        return values

    def build(self, values: Any, path: str, problems: list[tuple[str, str]], **more: Any) -> Any:
        """The dataclass; where it refuses the values, or lacks some, one that was not checked."""
        missing = {k: m for k, m in self.members.items() if m.required and k not in values}
        given = {
            member.name: member.section.build(values[key], join(path, key), problems)
            for key, member in self.members.items()
            if key in values
        } | more
        if missing:
            problems += [(join(path, key), "it is missing") for key in missing]
            given |= {member.name: member.section.stand_in() for member in missing.values()}
            return _unchecked(self.cls, given)
        try:
            return self.cls(**given)
        except SceneError as error:
            problems += [(join(path, inner), what) for inner, what in error.problems]
            return _unchecked(self.cls, given)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter at a path of keys."""
        member = self.members.get(parts[0]) if parts else None
        if member is None:
            raise NoParameter
        inner = values.get(parts[0])
        if inner is None and isinstance(member.section, Block | OneOf):
            if not member.unwritten:
                raise NoParameter(f"the scene has no {parts[0]}")
            inner = {}
        return member.section.find(inner, parts[1:])

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of its members, without optional blocks that are not there."""
        for key, member in self.members.items():
            if values.get(key) is not None or isinstance(member.section, Parameter | Law):
                yield from member.section.paths(values.get(key), join(path, key))

    def stand_in(self) -> Any:
        """Stand-ins for what is required."""
        return {k: m.section.stand_in() for k, m in self.members.items() if m.required}


@dataclass(frozen=True)
class OneOf(Section):
    """A block of several kinds; one of its keys (`shape`, `kind`) says which."""

    tag: str
    blocks: dict[str, Block | Forms]

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """Values by key, the tag included; a kind that is not known is read as the likeliest."""
        kinds = ", ".join(self.blocks)
        if not isinstance(node, Mapping):
            reading.report(node.place, f"{where(path)} lacks '{self.tag}', one of {kinds}", path)
            return None
        word = node.entries.get(self.tag)
        kind = word.text if isinstance(word, Scalar) else ""
        if kind not in self.blocks:
            if word is None:
                message = f"{where(path)} lacks '{self.tag}', one of {kinds}"
                reading.report(reading.place(path), message, path)
            else:
                message = f"{path}.{self.tag}: '{kind or 'this'}' is none of {kinds}"
                hint = hinted(kind, self.blocks, reading)
                reading.report(word.place, f"{message}{hint}", path)
            kind = self._likeliest(kind, node, reading)
        block = self.blocks[kind]
        return {self.tag: kind, **block.read(node, path, reading, also=(self.tag,))}

    def _likeliest(self, word: str, node: Mapping, reading: Reading) -> str:
        """The kind that a misspelt word, or the keys beside it, most likely stand for."""
        return reading.nearest(word, self.blocks) or max(
            self.blocks, key=lambda kind: len(self.blocks[kind].members.keys() & node.entries)
        )

    def build(self, values: Any, path: str, problems: list[tuple[str, str]], **more: Any) -> Any:
        """The dataclass of that kind; None where a kind was not given."""
        if self.tag not in values:
            problems.append((path, f"it lacks '{self.tag}', one of {', '.join(self.blocks)}"))
            return None
        return self.blocks[values[self.tag]].build(values, path, problems, **more)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter at a path of keys."""
        if parts == (self.tag,):
            raise NoParameter(f"'{self.tag}' decides which other keys there are")
        return self.blocks[values[self.tag]].find(values, parts)

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of the kind that is there."""
        yield from self.blocks[values[self.tag]].paths(values, path)


FORM = "which of the forms"  # no key: it has spaces


@dataclass(frozen=True)
class Forms(Section):
    """A block that can be written in several forms; the keys that are there say which."""

    blocks: tuple[Block, ...]

    @property
    def members(self) -> dict[str, Member]:
        """The keys of all forms."""
        return {key: member for block in self.blocks for key, member in block.members.items()}

    def read(
        self, node: Node, path: str, reading: Reading, also: tuple[str, ...] = ()
    ) -> dict[str, Any]:
        """Values by key, and the number of the form."""
        keys = set(node.entries) if isinstance(node, Mapping) else set()
        keys |= {one.removeprefix(f"{path}.").split(".")[0] for one in reading.supplied}
        number = self._known(keys)[0]
        return {FORM: number, **self.blocks[number].read(node, path, reading, also=also)}

    def build(self, values: Any, path: str, problems: list[tuple[str, str]], **more: Any) -> Any:
        """The dataclass of that form."""
        return self._form(values).build(values, path, problems, **more)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter of the form that is there, or of one that its keys fit as well."""
        others = (self.blocks[number] for number in self._known(set(values)))
        for block in (self._form(values), *others):
            try:
                return block.find(values, parts)
            except NoParameter as reason:
                if str(reason):
                    raise
        raise NoParameter

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of the form that is there."""
        yield from self._form(values).paths(values, path)

    def _form(self, values: Any) -> Block:
        found: Block = self.blocks[values.get(FORM, 0)]
        return found

    def _known(self, keys: set[str]) -> list[int]:
        """The forms by how many of the keys they know, most first; then in their order."""
        known = [len(keys & set(block.members)) for block in self.blocks]
        return sorted(range(len(known)), key=lambda number: -known[number])


@dataclass(frozen=True)
class Law(Section):
    """A number, or a law from which numbers are drawn; its first key says which law."""

    number: Parameter
    laws: dict[str, Block]  # by their first key
    what: str = "a law"  # for messages

    def read(self, node: Node, path: str, reading: Reading) -> Any:
        """A number, or values by key."""
        if not isinstance(node, Mapping):
            return self.number.read(node, path, reading)
        for key, block in self.laws.items():
            if key in node.entries:
                return block.read(node, path, reading)
        forms = (f"{{{', '.join(block.members)}}}" for block in self.laws.values())
        said = f"{where(path)} is a number, or {self.what} with the keys "
        reading.report(node.place, said + "; ".join(dict.fromkeys(forms)), path)
        return self.number.stand_in()

    def build(self, values: Any, path: str, problems: list[tuple[str, str]]) -> Any:
        """The number or the law."""
        block = self._law(values)
        return values if block is None else block.build(values, path, problems)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The number as a whole, or a parameter of the law that is there."""
        block = self._law(values)
        if not parts or block is None:
            return self.number.find(None, parts)
        return block.find(values, parts)

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of the law that is there, or its own."""
        block = self._law(values)
        if block is None:
            yield path
        else:
            yield from block.paths(values, path)

    def stand_in(self) -> Any:
        """Not a number."""
        return self.number.stand_in()

    def _law(self, values: Any) -> Block | None:
        if not isinstance(values, dict):
            return None
        # a law whose only key could not be read is still no number
        some = next(iter(self.laws.values()))
        return next((block for key, block in self.laws.items() if key in values), some)


@dataclass(frozen=True)
class Named(Section):
    """A mapping of names that the user chooses to blocks of one sort, or to quantities."""

    inner: Any  # Block, OneOf, ProbeForms; or a Parameter, then built as (name, value)

    def read(self, node: Node, path: str, reading: Reading) -> dict[str, Any]:
        """Values by name; what cannot be read at all is left out."""
        if not isinstance(node, Mapping):
            reading.report(node.place, f"{where(path)} is a mapping of names", path)
            return {}
        values: dict[str, Any] = {}
        for name, value in node.entries.items():
            inner = join(path, name)
            reading.places[inner] = (
                value.place if isinstance(self.inner, Parameter | Law) else node.keys[name]
            )
            if not isinstance(self.inner, Parameter | Law) and not is_name(name):
                message = f"'{name}' is no name; use {NAME_RULE}"
                reading.report(node.keys[name], message, inner)
            if _empty(value):
                reading.report(value.place, f"{where(inner)} is empty", inner)
                read = self.inner.stand_in()
            else:
                read = self.inner.read(value, inner, reading)
            if read is not None:
                values[name] = read
        return values

    def build(self, values: Any, path: str, problems: list[tuple[str, str]]) -> Any:
        """A tuple, in the order of the file."""
        if isinstance(self.inner, Parameter):
            return tuple(values.items())
        made: list[Any] = []
        for name, value in values.items():
            one = self.inner.build(value, join(path, name), problems, name=name)
            made += one if isinstance(one, list) else [one]
        return tuple(one for one in made if one is not None)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter of one of the names."""
        if not parts:
            raise NoParameter
        if isinstance(self.inner, Parameter):
            return self.inner.find(None, parts[1:])
        if parts[0] not in (values or {}):
            raise NoParameter
        found: Parameter = self.inner.find(values[parts[0]], parts[1:])
        return found

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of every name."""
        for name, value in values.items():
            yield from self.inner.paths(value, join(path, name))

    def stand_in(self) -> Any:
        """None of them."""
        return {}


@dataclass(frozen=True)
class Listed(Section):
    """A list of blocks of one sort."""

    inner: Block | OneOf

    def read(self, node: Node, path: str, reading: Reading) -> dict[str, Any]:
        """Values by number; one block alone is a list of one."""
        items = node.items if isinstance(node, Sequence) else (node,)
        found = {}
        for number, item in enumerate(items):
            inner = join(path, str(number))
            reading.places[inner] = item.place
            read = self.inner.read(item, inner, reading)
            if read is not None:
                found[str(number)] = read
        return found

    def build(self, values: Any, path: str, problems: list[tuple[str, str]]) -> Any:
        """A tuple of them."""
        made = (self.inner.build(value, join(path, n), problems) for n, value in values.items())
        return tuple(one for one in made if one is not None)

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """The parameter of one of them, by its number from 0."""
        if not parts or parts[0] not in (values or {}):
            raise NoParameter
        return self.inner.find(values[parts[0]], parts[1:])

    def paths(self, values: Any, path: str) -> Iterator[str]:
        """The paths of every one."""
        for number, value in (values or {}).items():
            yield from self.inner.paths(value, join(path, number))

    def stand_in(self) -> Any:
        """None of them."""
        return {}


@dataclass(frozen=True)
class Words(Section):
    """A list of words out of a fixed choice."""

    choices: tuple[str, ...]
    brought: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)  # by which words

    def read(self, node: Node, path: str, reading: Reading) -> tuple[str, ...]:
        """The words that are known."""
        if not isinstance(node, Sequence):
            wanted = f"{path} is a list of {', '.join(self.choices)}"
            reading.report(node.place, wanted, path)
            return ()
        words: list[str] = []
        for item in node.items:
            text = item.text if isinstance(item, Scalar) else "this"
            if text not in self.choices:
                hint = (
                    self._with(text)
                    or hinted(text, self.choices, reading)
                    or f"; valid are {', '.join(self.choices)}"
                )
                reading.report(item.place, f"{path}: unknown word '{text}'{hint}", path)
            elif text in words:
                reading.report(item.place, f"{path}: '{text}' is named twice", path)
            else:
                words.append(text)
        return tuple(words)

    def _with(self, text: str) -> str:
        """Which words bring one that is no choice of its own, as the end of a message."""
        words = self.brought.get(text, ())
        return f"; it comes with {' or '.join(words)}" if words else ""

    def find(self, values: Any, parts: tuple[str, ...]) -> Parameter:
        """Never: what is observed is the same for all cases."""
        raise NoParameter("all cases of a study observe the same")

    def stand_in(self) -> Any:
        """No word."""
        return ()


def block_of(
    cls: type,
    special: dict[str, Section] | None = None,
    words: KindWords | None = None,
    within: Specials | None = None,
) -> Block:
    """The grammar of a dataclass.

    Parameters
    ----------
    cls : the dataclass.
    special : sections of fields whose type does not say it all.
    words : for the members of unions, the key that says which (`kind`) and its word; members of
        one word are forms of it.
    within : `special` of dataclasses that stand in fields of this one.
    """
    hints = typing.get_type_hints(cls)
    members = {}
    for declared in dataclasses.fields(cls):
        if declared.name == "name":  # the key under which the block stands
            continue
        key = declared.metadata.get("key") or declared.name
        section = (special or {}).get(declared.name) or _section(
            declared, hints[declared.name], words or {}, within or {}
        )
        required = (
            declared.default is dataclasses.MISSING
            and declared.default_factory is dataclasses.MISSING
        )
        unwritten = dataclasses.is_dataclass(declared.default)
        members[key] = Member(key, declared.name, section, required, unwritten)
    return Block(cls, members)


def _section(
    declared: dataclasses.Field[Any], hint: Any, words: KindWords, within: Specials
) -> Section:
    kinds = _alternatives(hint)
    optional = type(None) in kinds
    kinds = tuple(kind for kind in kinds if kind is not type(None))
    if all(dataclasses.is_dataclass(kind) for kind in kinds):
        return blocks_of(kinds, words, within)
    laws = [block_of(typing.cast(type, kind)) for kind in kinds if dataclasses.is_dataclass(kind)]
    if laws:
        number = next(kind for kind in kinds if not dataclasses.is_dataclass(kind))
        forms = {next(iter(block.members)): block for block in laws}
        return Law(Parameter(declared, number, optional), forms)
    arguments = typing.get_args(kinds[0])
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        inner = _alternatives(arguments[0])
        if all(dataclasses.is_dataclass(kind) for kind in inner):
            return Named(blocks_of(inner, words, within))
    if kinds[0] == tuple[tuple[float, float], ...] and declared.metadata["unit"][:3] == "s, ":
        return Schedule(declared, kinds[0], optional)
    return Parameter(declared, kinds[0], optional)


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """The members of a union, or the type alone."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return typing.get_args(hint)
    return (hint,)


def blocks_of(
    kinds: tuple[Any, ...], words: KindWords, within: Specials | None = None
) -> Block | OneOf:
    """The grammar of a dataclass, or of a block that is one of several, by its tag.

    Parameters
    ----------
    kinds : the dataclasses
    words : what values may be words
    within : sections of members that are not read by their type
    """
    within = within or {}
    blocks = [block_of(kind, within.get(kind), words, within) for kind in kinds]
    if len(kinds) == 1:
        return blocks[0]
    (tag,) = {words[kind][0] for kind in kinds}
    forms: dict[str, list[Block]] = {}
    for kind, block in zip(kinds, blocks, strict=True):
        forms.setdefault(words[kind][1], []).append(block)
    return OneOf(
        tag,
        {word: one[0] if len(one) == 1 else Forms(tuple(one)) for word, one in forms.items()},
    )


def _unchecked(cls: type[Any], given: dict[str, Any]) -> Any:
    """An instance that skips its own checks, so that checks across blocks can go on."""
    instance = object.__new__(cls)
    for declared in dataclasses.fields(cls):
        value = given.get(declared.name, declared.default)
        object.__setattr__(instance, declared.name, value)
    return instance


def _empty(node: Node) -> bool:
    return isinstance(node, Scalar) and node.empty


def _meant(section: Section) -> str:
    """What a missing key is for, with an example."""
    if isinstance(section, Law):
        return _meant(section.number)
    if isinstance(section, Parameter):
        if section.choices:
            return f" ({section.help}), one of {', '.join(section.choices)}"
        arguments = typing.get_args(section.type)
        shown = shape(arguments, section.unit) if arguments else section.example
        return f" ({section.help}), for instance {shown}"
    if isinstance(section, Block):
        return f", a mapping with the keys {', '.join(section.members)}"
    if isinstance(section, OneOf):
        return f", a mapping with '{section.tag}', one of {', '.join(section.blocks)}"
    return ""
