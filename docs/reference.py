"""Write the reference pages from the tables that the program itself uses.

`python docs/reference.py` writes `docs/reference/study.md` (every key of a study: the grammar that
reads it, and the stages whose results depend on it), `dataset.md` (every variable of a dataset),
`commands.md` (the command line), `studies.md` (what ships) and `equations.md` (whose each equation
is, and where it stands). A test holds the pages to what they are written from.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import itertools
import os
import re
import sys
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from demflow.model import quantities
from demflow.model.scene import OBSERVABLES, Scene
from demflow.model.stages import STAGES
from demflow.sweep.command import cli
from demflow.sweep.study import load as study_file
from demflow.sweep.study.blocks import Block, Forms, Law, Listed, Member, Named, OneOf, Words
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.expect import EXPECT
from demflow.sweep.study.load import load_study
from demflow.sweep.study.notes import TextFile
from demflow.sweep.study.scene import (
    SCENE,
    InitialForms,
    MapFiles,
    ProbeForms,
    Sides,
    Times,
    WordOr,
    WordOrBlock,
)
from demflow.sweep.study.schedules import Schedule
from demflow.sweep.study.schema import study_schema
from demflow.sweep.study.sections import Parameter, Section
from demflow.sweep.study.units import QUANTITY_PATTERN, example

FOLDER = Path(__file__).parent / "reference"
STUDIES = (*Path(__file__).parents[1].glob("studies/*.yaml"), *Path(__file__).parent.glob("*.yaml"))

_BOUNDS = {"above": ">", "at_least": "≥", "below": "<", "at_most": "≤"}
_HEAD = "| key | value | default | meaning | read by |\n|---|---|---|---|---|\n"


class Readers:
    """Which stages read which field of a scene, found by handing them scenes that watch."""

    def __init__(self) -> None:
        self.fields: dict[tuple[str, str], set[str]] = {}  # (class, field) -> stages
        self._stage = ""
        for path in sorted(STUDIES):
            study = load_study(path, smoke=True)
            for index in _some(study.shape):
                self._watch(case_at(study, index).scene)

    def of(self, cls: type, name: str) -> str:
        """The stages that read a field, in the order in which they run."""
        found = self.fields.get((cls.__qualname__, name), set())
        return ", ".join(f"*{s.name}*" for s in STAGES if s.name in found)

    def _watch(self, scene: Scene) -> None:
        watched = self._watching(scene)
        for stage in STAGES:
            if stage.wanted(scene):
                self._stage = stage.name
                for part in (*stage.reads.values(), *stage.options.values()):
                    self._whole(part(watched))
                if stage.legs is not None:
                    self._whole(stage.legs(watched))

    def _whole(self, value: Any) -> None:
        """A part that a stage is given as it is: it may read all of it."""
        if dataclasses.is_dataclass(value):
            for declared in dataclasses.fields(value):
                self._whole(getattr(value, declared.name))
        elif isinstance(value, tuple):
            for one in value:
                self._whole(one)

    def _watching(self, value: Any) -> Any:
        """A copy that notes what is read of it."""
        if isinstance(value, tuple) and type(value) is tuple:
            return tuple(self._watching(one) for one in value)
        if not dataclasses.is_dataclass(value) or isinstance(value, type):
            return value
        copy = object.__new__(self._class(type(value)))
        for declared in dataclasses.fields(value):
            inner = self._watching(getattr(value, declared.name))
            object.__setattr__(copy, declared.name, inner)
        return copy

    @functools.cache  # noqa: B019 (one for a whole run)
    def _class(self, cls: type) -> type:
        names = {declared.name for declared in dataclasses.fields(cls)}

        def noted(instance: Any, name: str) -> Any:
            if name in names:
                self.fields.setdefault((cls.__qualname__, name), set()).add(self._stage)
            return object.__getattribute__(instance, name)

        return type(cls.__name__, (cls,), {"__getattribute__": noted, "__slots__": ()})


def _some(shape: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Cases in which each value of each axis stands once at least."""
    for k in range(max(shape, default=1)):
        yield tuple(min(k, count - 1) for count in shape)


class StudyPage:
    """Every block of a study with its keys."""

    def __init__(self) -> None:
        self.readers = Readers()
        self.parts: list[str] = []
        self.documented: dict[tuple[type, tuple[str, ...]], str] = {}  # -> its heading

    def text(self) -> str:
        """The page."""
        self._study()
        self._block("scene", SCENE.without("observe", "solver"))
        self._observe()
        self._section("solver", SCENE.members["solver"].section)
        for key, block in (
            ("limits", study_file.LIMITS),
            ("figures", study_file.FIGURES),
            ("report", study_file.REPORT),
            ("expect", EXPECT),
        ):
            self._block(key, block)
        return "\n".join(self.parts)

    def _study(self) -> None:
        schema = study_schema()
        rows = [f"| `{key}` | {_described(one)} |\n" for key, one in schema["properties"].items()]
        self.parts.append(
            "# Keys of a study\n\n"
            "Written from the grammar that reads studies; `demflow check` holds a file to it, "
            "and `demflow schema` gives the same to editors. A quantity carries its unit "
            "(`5 mD`, `7 MPa`, `20 deg`, `1 bbl/day`); the unit in the tables is that of a bare "
            "number. *Read by* names the stages that run anew where the value changes; a value "
            "without one changes what is made of their results. What a key may hold can be varied: "
            "its path below `scene` is the `parameter` of an axis.\n\n"
            "| key | meaning |\n|---|---|\n" + "".join(rows)
        )
        self.parts += _beside_scene(schema)

    def _observe(self) -> None:
        rows = []
        for word, stages in OBSERVABLES.items():
            gives = [
                f"`{name}`" for name, one in {**quantities.CASE, **quantities.MAPS}.items()
                if word in one.needs
            ]  # fmt: skip
            run = ", ".join(f"*{one}*" for one in stages or ("pack",))
            rows.append(f"| `{word}` | {', '.join(gives)} | {run} |\n")
        self.parts.append(
            "## observe\n\nA list of what is wanted; it decides what is run.\n\n"
            "| word | variables that it adds | stages that it needs |\n|---|---|---|\n"
            + "".join(rows)
        )

    def _section(self, path: str, section: Section, note: str = "", readers: str = "") -> None:
        """The blocks that stand below a place, `readers` those of the place as a whole."""
        if isinstance(section, Block):
            self._block(path, section, note, readers)
        if not isinstance(section, Named | Times | ProbeForms):
            readers = ""  # a block is noted itself; these forms make something else of theirs
        for suffix, inner, told in _inside(section):
            if not isinstance(inner, Parameter):
                told = ", ".join(one for one in (note, told) if one)
                self._section(f"{path}{suffix}", inner, told, readers)

    def _block(self, path: str, block: Block, note: str = "", readers: str = "") -> None:
        """A block, once, however many places it may stand at."""
        title = f"{path} {note}".strip()
        kind = (block.cls, tuple(block.members))
        if kind in self.documented:
            return
        self.documented[kind] = title
        document = (block.cls.__doc__ or "").strip().splitlines()
        rows = [self._row(key, one, block.cls, readers) for key, one in block.members.items()]
        self.parts.append(
            f"## {title}\n\n{_prose(document[0] if document else '')}\n\n{_HEAD}{''.join(rows)}"
        )
        for key, member in block.members.items():
            of = self.readers.of(block.cls, member.name)
            plain = isinstance(member.section, Block)
            self._section(f"{path}.{key}", member.section, readers="" if plain else of)

    def _row(self, key: str, member: Member, cls: type, readers: str) -> str:
        parameter = _parameter(member.section)
        default = "*required*" if member.required else ""
        if parameter is not None and not member.required:
            default = _shown(parameter.declared.default)
        told = _prose(parameter.help) if parameter is not None else ""
        read = self.readers.of(cls, member.name) or readers
        return f"| `{key}` | {_value(member.section)} | {default} | {told} | {read} |\n"


# what the grammar of scenes documents itself
_OF_SCENES = ("scene", "observe", "solver", "limits", "figures", "report", "expect")


def _beside_scene(schema: Any) -> Iterator[str]:
    """A section for each key beside `scene` that is a block, from the schema for editors."""
    for key, one in schema["properties"].items():
        if key in _OF_SCENES:
            continue
        inner = one.get("additionalProperties")
        named = f"{key}.NAME" if isinstance(inner, dict) else key
        forms = _alternatives(inner if isinstance(inner, dict) else one)
        blocks = [form for form in forms if "properties" in form]
        if not blocks:
            continue
        yield f"## {key}\n\n{_described(one)}\n"
        for form in blocks:
            required = ", ".join(f"`{word}`" for word in form.get("required", ()))
            told = f"`{named}` with {required}:\n\n" if required else ""
            rows = "".join(_schema_rows("", form))
            yield f"{told}| key | value | meaning |\n|---|---|---|\n{rows}"


def _schema_rows(path: str, block: Any) -> Iterator[str]:
    """The keys of a block and of the blocks inside it, by their paths."""
    for key, one in block["properties"].items():
        forms = _alternatives(one)
        value = " or ".join(dict.fromkeys(filter(None, map(_schema_value, forms))))
        told = next((form["description"] for form in (one, *forms) if "description" in form), "")
        yield f"| `{path}{key}` | {value} | {_prose(told)} |\n"
        for form in forms:
            if "properties" in form:
                yield from _schema_rows(f"{path}{key}.", form)


def _alternatives(schema: Any) -> list[Any]:
    """The forms that a schema allows, without that which is empty."""
    for word in ("oneOf", "anyOf"):
        if word in schema:
            forms = [form for one in schema[word] for form in _alternatives(one)]
            return [form for form in forms if form.get("type") != "null"]
    return [schema]


def _schema_value(schema: Any) -> str:
    """What may be written for one form of a schema."""
    if "enum" in schema:
        return " or ".join(f"`{word}`" for word in schema["enum"])
    kind = schema.get("type")
    if kind == "array" and isinstance(schema.get("items"), dict):
        forms = map(_schema_value, _alternatives(schema["items"]))
        return f"list of {' or '.join(dict.fromkeys(filter(None, forms)))}".removesuffix(" of ")
    if kind == "string":
        return "quantity" if schema.get("pattern") == QUANTITY_PATTERN else "text"
    words = {"integer": "whole number", "number": "number", "object": "block", "boolean": "`true`"}
    return words.get(kind, "") if isinstance(kind, str) else ""


def _parameter(section: Section) -> Parameter | None:
    """The parameter that a section reads where one value is given."""
    if isinstance(section, Parameter):
        return section
    for name in ("number", "value", "listed", "inner"):
        inner = getattr(section, name, None)
        if isinstance(inner, Parameter):
            return inner
    if isinstance(section, Sides):
        return _parameter(section.inner)
    if isinstance(section, WordOrBlock):
        return _parameter(section.block.members[section.key].section)
    if isinstance(section, MapFiles | TextFile):
        return Parameter(section.declared, str, optional=False)
    return None


def _value(section: Section) -> str:
    """What may be written there."""
    if isinstance(section, Sides):
        return f"{_form(section.inner.number)} for each name, or blocks, below"
    for kinds, text in _BELOW.items():
        if isinstance(section, kinds) and not isinstance(
            getattr(section, "inner", None), Parameter
        ):
            return text
    if isinstance(section, WordOrBlock):
        return f"{_value(section.block.members[section.key].section)}, or a block, below"
    parameter = _parameter(section)
    if parameter is None:
        raise TypeError(f"no reference for {type(section).__name__}")
    text = _form(parameter)
    if isinstance(section, WordOr):
        return " or ".join([*(f"`{one}`" for one in section.words), text])
    if isinstance(section, Named):
        return f"{text} for each name"
    if isinstance(section, InitialForms):
        text += f", `{section.word}`"
    return text if isinstance(section, Parameter) else f"{text}, or a block, below"


_BELOW: dict[Any, str] = {
    Block | OneOf | Forms: "a block, below",
    Named: "blocks by names of your own, below",
    Listed: "a list of blocks, below",
    Words: "a list of words",
    ProbeForms: "a block, below",
    MapFiles | TextFile: "path of a file, relative to the study",
}


def _inside(section: Section) -> Iterator[tuple[str, Section, str]]:
    """What stands in a section that is no block: what its path adds, it, and which form it is."""
    if isinstance(section, OneOf):
        for word, block in section.blocks.items():
            yield "", block, f"with `{section.tag}: {word}`"
    elif isinstance(section, Forms):
        for number, block in enumerate(section.blocks):
            yield "", block, f"form {number + 1} of {len(section.blocks)}"
    elif isinstance(section, WordOrBlock):
        yield "", section.block, ""
    elif isinstance(section, Named | Listed):
        yield ".NAME" if isinstance(section, Named) else "[]", section.inner, ""
    elif isinstance(section, Law):
        words: dict[int, list[str]] = {}
        for word, block in section.laws.items():
            words.setdefault(id(block), []).append(f"`{word}`")
        for block in {id(block): block for block in section.laws.values()}.values():
            yield "", block, f"{section.what} with {' or '.join(words[id(block)])}"
    else:
        for name, told in _FORMS.items():
            if hasattr(section, name):
                yield "", getattr(section, name), told


_FORMS = {
    "spaced": "evenly in the logarithm",
    "point": "at a point",
    "line": "along a line",
    "field": "a linear field",
}


def _form(parameter: Parameter) -> str:
    """The kind, unit and bounds of a value."""
    if parameter.choices:
        return " or ".join(f"`{one}`" for one in parameter.choices)
    meta = parameter.declared.metadata
    bounds = " and ".join(
        f"{sign} {meta[word]:g}" for word, sign in _BOUNDS.items() if meta.get(word) is not None
    )
    kind = _kind(parameter.type, parameter.unit)
    if isinstance(parameter, Schedule):
        kind += ", or a file of them"
    return ", ".join(one for one in (kind, bounds) if one)


def _kind(kind: Any, unit: str) -> str:
    arguments = typing.get_args(kind)
    if arguments and arguments[-1] is Ellipsis:
        return f"list of {_kind(arguments[0], unit)}"
    if arguments:
        units = unit.split(", ")
        units = units if len(units) == len(arguments) else [unit] * len(arguments)
        return f"`[{', '.join(example(one) for one in units)}]`"
    plain = {str: "text", bool: "`true` or `false`", int: "whole number"}
    if kind in plain:
        return plain[kind]
    return "number" if unit == "1" else f"{unit}, as `{example(unit)}`"


def _shown(default: Any) -> str:
    if default is None or default is dataclasses.MISSING:
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{default:g}`" if isinstance(default, int | float) else f"`{default}`"


def _described(schema: Any) -> str:
    return _prose(schema.get("description", ""))


def _prose(text: str) -> str:
    """A text inside a cell of a table."""
    return text.replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def dataset_page() -> str:
    """Every variable that a result can hold."""
    parts = [
        "# Variables of a dataset\n\n"
        "`dataset.nc`, and what `demflow.open_results` returns: one value or array per case; the "
        "axes of the study come before the dimensions named here. *Observed* names the words of "
        "`observe` that bring a variable; one without is always there, where its stage ran.\n"
    ]
    for title, table in (
        ("Of each case", quantities.CASE),
        ("Principal permeability", quantities.PRINCIPAL),
        ("Of ensembles", quantities.ENSEMBLE),
        ("Of the run", quantities.SWEEP),
        ("Of each case, as many as it has", quantities.RAGGED),
        ("Coordinates", quantities.COORDINATES),
        ("Of one case: `demflow.open_case`", quantities.MAPS),
    ):
        rows = [_quantity_row(name, one) for name, one in table.items()]
        parts.append(
            f"## {title}\n\n| variable | unit | dimensions | meaning | observed |\n"
            f"|---|---|---|---|---|\n{''.join(rows)}"
        )
    return "\n".join(parts)


def _quantity_row(name: str, one: quantities.Quantity) -> str:
    told = _prose(one.long_name + (f" ({one.comment})" if one.comment else ""))
    needs = ", ".join(f"`{word}`" for word in one.needs)
    dimensions = ", ".join(f"`{word}`" for word in one.dimensions)
    return f"| `{name}` | {one.unit} | {dimensions} | {told} | {needs} |\n"


def commands_page() -> str:
    """The command line."""
    os.environ["COLUMNS"] = "100"  # what help is folded to
    parser = cli.parser()
    (commands,) = (
        action for action in parser._actions if hasattr(action, "choices") and action.choices
    )
    parts = [f"# Commands\n\n```text\n{parser.format_help().strip()}\n```\n"]
    for name, one in commands.choices.items():
        parts.append(f"## demflow {name}\n\n```text\n{one.format_help().strip()}\n```\n")
    return "\n".join(parts)


def studies_page() -> str:
    """The studies that come with demflow: what each asks, and what it varies."""
    parts = [
        "# Studies to start from\n\n"
        "Each file under `studies/` answers one question; copy the nearest to yours.\n"
    ]
    for path in sorted(STUDIES):
        if path.parent.name != "studies":
            continue
        study = load_study(path)
        lines = itertools.takewhile(lambda line: line.startswith("#"), study.text.splitlines())
        asked = " ".join(line.lstrip("# ") for line in lines)
        count = int(np.prod(study.shape)) if study.kept is None else int(study.kept.sum())
        axes = "; ".join(
            f"`{axis.name}` ({len(axis.values)}: {', '.join(f'`{p}`' for p in axis.parameters)})"
            if axis.parameters
            else f"`{axis.name}` ({len(axis.values)} variants)"
            for axis in study.axes
        )
        varied = f"{count} cases: {axes}." if axes else "One case."
        parts.append(f"## {path.name}\n\n*{_prose(study.title)}.* {_prose(asked)}\n\n{varied}\n")
    return "\n".join(parts)


# "Potyondy & Cundall (2004)", "Terzaghi 1923"; Eq. 24 of the paper
_NAME = r"(?:van |de |von )?[A-Z][\w’'-]+"
_CITED = re.compile(
    rf"{_NAME}(?:(?:, | & | and ){_NAME})*,? \(?(?:18|19|20)\d\d\b|Eqs? \d+|Eq\. \d+"
)


def equations_page() -> str:
    """Where each equation stands in the code, and whose it is, as its docstring says."""
    rows = []
    model = Path(__file__).parents[1] / "model"
    for path in sorted(model.rglob("*.py")):
        place = path.relative_to(model.parent).as_posix()
        tree = ast.parse(path.read_text(encoding="utf-8"))
        parts = [one for one in tree.body if isinstance(one, ast.FunctionDef | ast.ClassDef)]
        for part in (tree, *parts):
            text = " ".join((ast.get_docstring(part) or "").split())
            cited = [one.replace("Eqs ", "Eq. ").replace("(", "") for one in _CITED.findall(text)]
            if cited:
                name = "" if part is tree else f" `{part.name}`"
                first = _first_sentence(ast.get_docstring(part) or "")
                sources = "; ".join(dict.fromkeys(cited))
                rows.append(f"| {_prose(first)} | {sources} | `{place}`{name} |")
    return (
        "# Equations, their sources and their places\n\n"
        "What the docstrings of the model cite; equations by number alone are those of the paper "
        "(see [The model](../model.md)). The docstring at the place has the formula, its symbols "
        "and units.\n\n| what | source | place |\n|---|---|---|\n" + "\n".join(rows) + "\n"
    )


def _first_sentence(text: str) -> str:
    """The first line of a docstring, or two where it is broken."""
    first = " ".join(text.split("\n\n")[0].split())
    end = re.search(r"\.(?= [A-Z]|$)", first)
    return first[: end.start() + 1] if end else first


def pages() -> dict[str, str]:
    """The text of each page by its file's name."""
    return {
        "study.md": StudyPage().text(),
        "dataset.md": dataset_page(),
        "commands.md": commands_page(),
        "studies.md": studies_page(),
        "equations.md": equations_page(),
    }


def main() -> int:
    """Write the pages; with `--check` say which are not as they would be."""
    stale = []
    FOLDER.mkdir(exist_ok=True)
    for name, content in pages().items():
        path = FOLDER / name
        if not path.is_file() or path.read_text(encoding="utf-8") != content:
            stale.append(name)
            if "--check" not in sys.argv:
                path.write_text(content, encoding="utf-8")
    if stale and "--check" in sys.argv:
        print(f"not as the tables have it: {', '.join(stale)}; `make docs` writes them anew")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
