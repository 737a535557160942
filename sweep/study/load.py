"""A study file → a frozen `Study`, checked completely: every error at once, each with its place.

This is the door: what comes through it is valid, in SI, and stays as it is. Besides
the syntax and the values, the scene itself is built: for every value of every axis and,
where there are few enough, for every combination, so that no case fails later for a
reason that could be seen here.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from demflow.model.parameters import parameter
from demflow.model.scene import OBSERVABLES
from demflow.sweep.study import yaml_source
from demflow.sweep.study.axes import (
    MAX_CASES,
    Axis,
    Draft,
    Located,
    count_cases,
    labelled,
    read_axes,
    read_drafts,
)
from demflow.sweep.study.blocks import block_of
from demflow.sweep.study.expect import EXPECT, Expectation
from demflow.sweep.study.fits import FitRequest, asks_for_models, read_fit
from demflow.sweep.study.measured import MeasuredTest, read_data
from demflow.sweep.study.notes import REPORT, Report
from demflow.sweep.study.overrides import overlaid
from demflow.sweep.study.samples import NAME as SAMPLED
from demflow.sweep.study.samples import cases_of, is_drawn, read_sample, sampled_axis
from demflow.sweep.study.scene import SCENE
from demflow.sweep.study.scenes import SceneBuilder
from demflow.sweep.study.sections import NamedFile, Reading, TooManyProblems, report_unknown
from demflow.sweep.study.units import describe, format_quantity
from demflow.sweep.study.variants import (
    VariantAxis,
    found_everywhere,
    read_variants,
    without_variants,
)
from demflow.sweep.study.where import kept_cases
from demflow.sweep.study.yaml_source import (
    Node,
    Place,
    Problem,
    Scalar,
    Source,
    StudyError,
    read_source,
)

__all__ = ["MAX_CASES", "Axis", "Figures", "Limits", "Problem", "Study", "StudyError", "load_study"]

DAY = 86400.0  # s
MOST_COMBINATIONS = 2_000  # checked one by one before anything runs
NAMED = ("wells", "fractures", "probes")
MANY_NAMES = 5  # of them, from which on fewer combinations are checked
KEYS = (
    *("study", "title", "scene", "vary", "observe", "solver"),
    *("sample", "where", "limits", "figures", "report", "expect", "smoke"),
    *("data", "fit"),
)
NAME_PATTERN = r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}"
RESERVED_NAMES = ("store",)  # results/store holds the products of all studies


@dataclass(frozen=True)
class Limits:
    """What one case may take before it is stopped and counted as failed.

    Memory is that of the worker that is at it; None stands for a worker's share of the machine
    (`sweep.execution.limits.in_force`). Compiling kernels, which happens once on a machine, is
    no case's time. Neither is part of any product's identity.
    """

    time: float | None = parameter(
        "s", default=DAY, above=0, help="time limit of a case, by default 24 h"
    )
    memory: float | None = parameter(
        "B",
        default=None,
        above=0,
        help="memory limit of a case, by default nine tenths of the machine's over its workers",
    )


@dataclass(frozen=True)
class Figures:
    """What is drawn beside the default figures."""

    maps: tuple[float, ...] = parameter(
        "s", default=(), above=0, help="times at which pressure maps are drawn"
    )
    compare: str | None = parameter(
        default=None,
        choices=("linear", "radial"),
        help="formula to compare with: linear (Eq. 24) or radial (Eq. 29)",
    )


LIMITS, FIGURES = block_of(Limits), block_of(Figures)


@dataclass(frozen=True)
class Study:
    """A study that can be run. `sweep.study.cases` turns it into scenes."""

    name: str
    title: str
    path: Path
    text: str
    sha256: str  # of the file
    smoke: bool  # whether its smoke block was applied
    axes: tuple[Axis, ...]
    values: Mapping[str, Any]  # of the scene, SI, without those of the axes; not to be changed
    limits: Limits
    figures: Figures
    report: Report = field(default_factory=Report)
    promised: tuple[Expectation, ...] = ()  # one for all cases, or one for each variant; or none
    files: Mapping[str, NamedFile] = field(default_factory=dict)  # by the name of their kept copy
    kept: np.ndarray | None = None  # bool of the shape: combinations that are cases; None: all
    data: Mapping[str, MeasuredTest] = field(default_factory=dict)
    fit: FitRequest | None = None

    def expectation(self, index: Sequence[int]) -> Expectation:
        """How the case at a position along each axis should end."""
        if len(self.promised) < 2:
            return self.promised[0] if self.promised else Expectation()
        number = next(number for number, axis in enumerate(self.axes) if axis.names)
        return self.promised[index[number]]

    @property
    def files_sha256(self) -> str:
        """One hash of what the files hold that the study names; empty where it names none."""
        each = sorted(hashlib.sha256(file.content).hexdigest() for file in self.files.values())
        return hashlib.sha256(" ".join(each).encode()).hexdigest() if each else ""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each axis."""
        return tuple(len(axis.values) for axis in self.axes)

    def leaves_out(self, index: Sequence[int]) -> bool:
        """Whether the case at a position along each axis is none by `where`."""
        return self.kept is not None and not self.kept[tuple(index)]


def load_study(path: str | Path, *, smoke: bool = False, alone: bool = False) -> Study:
    """Read and check a study file.

    Parameters
    ----------
    path : the YAML file.
    smoke : apply the overrides of its `smoke` block (they are checked in any case).
    alone : take a study without a scene, too, that fits reservoir models to its data.

    Raises
    ------
    StudyError : with every problem of the file, each at its line and column.
    """
    source = read_source(path)
    full, reading = _interpret(source, source.root, alone)
    problems = [*source.problems, *reading.problems]
    small = full
    override = source.root.entries.get("smoke")
    if override is not None and not (isinstance(override, Scalar) and override.empty):
        root, written, smoke_problems = overlaid(source.root, override)
        problems += smoke_problems
        small, reading = _interpret(source, root, alone)
        known = {(problem.line, problem.column, problem.message) for problem in problems}
        problems += [
            problem
            if Place(problem.line, problem.column) in written
            else replace(problem, message=f"with the smoke block: {problem.message}")
            for problem in reading.problems
            if (problem.line, problem.column, problem.message) not in known
        ]
    if problems or full is None or small is None:
        raise StudyError(path, problems)
    files = {**full.files, **small.files}
    return replace(small, smoke=True, files=files) if smoke else replace(full, files=files)


def _interpret(
    source: Source, root: yaml_source.Mapping, alone: bool
) -> tuple[Study | None, Reading]:
    """The study that a tree of nodes stands for, or None where there are problems."""
    reading = Reading(folder=source.path.parent)
    try:
        return _study_of(source, root, reading, alone), reading
    except TooManyProblems:
        return None, reading


def _study_of(
    source: Source, root: yaml_source.Mapping, reading: Reading, alone: bool
) -> Study | None:
    """The study that a tree of nodes stands for, or None; `reading` gets the problems."""
    entries = root.entries
    meant: set[str | None] = set()  # keys that misspelt ones stand for
    for key, place in root.keys.items():
        if key not in KEYS:
            meant.add(report_unknown(key, place, KEYS, "", reading, at="the study"))
    name = "" if "study" in meant else _name(entries.get("study"), reading)
    title = _title(entries.get("title"), reading) or name
    tests = read_data(entries.get("data"), reading)
    if "scene" not in entries and asks_for_models(entries.get("fit")):
        return _without_scene(source, root, name, title, tests, reading, alone)
    drafts = read_drafts(without_variants(entries.get("vary")), reading)
    variants = read_variants(root, reading)
    scenes = _scenes_of(root, variants, meant, reading)
    values = scenes[0]
    axes, count = _axes_of(root, drafts, variants, scenes, reading)
    if axes is None:
        return None
    kept = None
    if not reading.problems:
        kept = kept_cases(entries.get("where"), [located.axis for located in axes], reading)
    promised = _promised(entries.get("expect"), variants, reading)
    blocks = _blocks_of(root, reading)
    _check_scenes(values, axes, reading, kept, combine=count <= MAX_CASES)
    _check_figures(blocks["figures"], values, reading)
    _check_wells(tests, values, reading)
    fit = read_fit(entries.get("fit"), tests, values, reading)
    if reading.problems:
        return None
    return Study(
        name=name,
        title=title,
        path=source.path,
        text=source.text,
        sha256=source.sha256,
        smoke=False,
        axes=tuple(located.axis for located in axes),
        values=values,
        limits=blocks["limits"],
        figures=blocks["figures"],
        report=blocks["report"],
        promised=promised,
        files=reading.files,
        kept=kept,
        data=tests,
        fit=fit,
    )


def _without_scene(
    source: Source,
    root: yaml_source.Mapping,
    name: str,
    title: str,
    tests: Mapping[str, MeasuredTest],
    reading: Reading,
    alone: bool,
) -> Study | None:
    """A study that only fits reservoir models to measured tests."""
    for key in ("vary", "observe", "solver", "sample", "where", "expect"):
        if key in root.entries:
            reading.report(root.keys[key], f"'{key}' is for a scene, and the study has none")
    if not alone:
        what = "the study has no scene, so that nothing is run; `demflow fit` fits its models"
        reading.report(Place(1, 1), what)
    fit = read_fit(root.entries.get("fit"), tests, None, reading)
    if reading.problems:
        return None
    return Study(
        *(name, title, source.path, source.text, source.sha256, False, (), {}, Limits(), Figures()),
        files=reading.files,
        data=tests,
        fit=fit,
    )


def _check_wells(
    tests: Mapping[str, MeasuredTest], values: dict[str, Any], reading: Reading
) -> None:
    """Report measured wells that the scene does not have."""
    for test in tests.values():
        wells = values.get("wells") or {}
        if test.well is not None and test.well not in wells and not reading.spoilt("wells"):
            path = f"data.{test.name}.well"
            hint = f"there are {', '.join(wells)}" if wells else "the scene has none"
            reading.report(reading.place(path), f"{path}: no well is called '{test.well}'; {hint}")


def _axes_of(
    root: yaml_source.Mapping,
    drafts: list[Draft],
    variants: VariantAxis | None,
    scenes: list[dict[str, Any]],
    reading: Reading,
) -> tuple[list[Located] | None, int]:
    """The axes in the order of the file, and how many cases they make; None: go no further."""
    vary, values = root.entries.get("vary"), scenes[0]
    drawn = [draft for draft in drafts if is_drawn(draft)]
    plain = [draft for draft in drafts if not is_drawn(draft)]
    sample = read_sample(root.entries.get("sample"), drawn, reading)
    count = count_cases(plain) * len(scenes) * (cases_of(sample, drawn) if sample else 1)
    if count > MAX_CASES:
        message = f"vary makes {count:,} cases; a study may have {MAX_CASES:,} at most"
        reading.report(root.keys["vary"], message)
    axes = read_axes(plain, values, reading, ends_only=count > MAX_CASES)
    found = {located.axis.name: located for located in axes}
    if sample is not None and count <= MAX_CASES:
        located = sampled_axis(sample, drawn, values, reading)
        if located is not None:
            found[SAMPLED] = located
    else:
        reading.unreadable.update(path for draft in drawn for path in draft.paths)
    if variants is not None:
        if not found_everywhere(drafts, variants, scenes, reading):
            return None, count
        found[variants.name] = variants.located(scenes)
    if drawn and SAMPLED in _names(vary):
        message = f"axis '{SAMPLED}': the sample has this name; take another"
        reading.report(root.keys["vary"], message)
    names = {draft.name for draft in drawn}
    order = dict.fromkeys(SAMPLED if name in names else name for name in _names(vary))
    return labelled([found[name] for name in order if name in found]), count


def _blocks_of(root: yaml_source.Mapping, reading: Reading) -> dict[str, Any]:
    """The blocks beside the scene that no case depends on."""
    blocks: dict[str, Any] = {}
    for key, block in (("limits", LIMITS), ("figures", FIGURES), ("report", REPORT)):
        node = root.entries.get(key)
        blocks[key] = block.cls()
        if node is not None and not (isinstance(node, Scalar) and node.empty):
            reading.places[key] = root.keys[key]
            problems: list[tuple[str, str]] = []
            blocks[key] = block.build(block.read(node, key, reading), key, problems)
            for path, what in problems:
                if not reading.spoilt(path):
                    reading.report(reading.place(path), f"{path}: {what}")
    return blocks


def _names(node: Node | None) -> list[str]:
    """The keys of a mapping, none where it is none."""
    return list(node.entries) if isinstance(node, yaml_source.Mapping) else []


def _name(node: Node | None, reading: Reading) -> str:
    rule = "letters, digits, '-', '_' and '.', not beginning with '.'"
    if node is None or (isinstance(node, Scalar) and node.empty):
        place = node.place if node is not None else Place(1, 1)
        reading.report(
            place, "the study lacks 'study', its name; results/<name> is where it writes"
        )
        return ""
    text = node.text if isinstance(node, Scalar) else "a list"
    if not isinstance(node, Scalar) or not re.fullmatch(NAME_PATTERN, text):
        shown = text if len(text) <= 40 else text[:37] + "..."
        message = f"study '{shown}' names a folder under results/: at most 100 {rule}"
        reading.report(node.place, message)
    elif text in RESERVED_NAMES:
        reading.report(node.place, f"results/{text} is used for something else; take another name")
    return text


def _title(node: Node | None, reading: Reading) -> str:
    if node is None:
        return ""
    if not isinstance(node, Scalar):
        reading.report(node.place, "title is a line of text; quote it if it holds ': ' or '['")
        return ""
    return "" if node.empty else node.text


def _scenes_of(
    root: yaml_source.Mapping,
    variants: VariantAxis | None,
    meant: set[str | None],
    reading: Reading,
) -> list[dict[str, Any]]:
    """Values of the scene, of each variant where there are some."""
    if variants is None:
        return [_scene_values(root, meant, reading)]
    known = {*reading.problems}
    scenes = [_scene_values(variants.points[0].tree, meant, reading)]
    known |= {*reading.problems}
    for point in variants.points[1:]:
        inner = Reading(supplied=reading.supplied, folder=reading.folder, files=reading.files)
        try:
            scenes.append(_scene_values(point.tree, meant, inner))
        finally:
            reading.problems += [problem for problem in inner.problems if problem not in known]
        reading.unreadable |= inner.unreadable
        known |= {*inner.problems}
    return scenes


def _promised(
    node: Node | None, variants: VariantAxis | None, reading: Reading
) -> tuple[Expectation, ...]:
    """What is expected of all cases, or of each variant: its own words go before the study's."""

    def read(node: Node | None, path: str) -> dict[str, Any]:
        if node is None or (isinstance(node, Scalar) and node.empty):
            return {}
        if isinstance(node, Scalar):  # `expect: failed` is short for its status
            node = yaml_source.Mapping(node.place, {"status": node}, {"status": node.place})
        given = EXPECT.read(node, path, reading)
        if isinstance(node, yaml_source.Mapping):  # `time_error: null` takes a bound back
            given |= {key: None for key in node.entries if key in EXPECT.members} | given
        return given

    common = read(node, "expect")
    points = variants.points if variants is not None else ()
    own = [read(point.expect, "expect") for point in points]
    if not common and not any(own):
        return ()
    built = [EXPECT.build({**common, **one}, "expect", []) for one in own or [{}]]
    return tuple(built)


def _scene_values(
    root: yaml_source.Mapping, meant: set[str | None], reading: Reading
) -> dict[str, Any]:
    """Values of the scene, with those that stand beside it in a study."""
    scene = root.entries.get("scene")
    inside = SCENE.without("observe", "solver")
    reading.places[""] = root.keys.get("scene", Place(1, 1))
    if scene is None or (isinstance(scene, Scalar) and scene.empty):
        reading.unreadable.add("")
        if "scene" not in meant:
            reading.report(reading.places[""], "the study lacks 'scene', what is to be modelled")
        values: dict[str, Any] = inside.stand_in()
    else:
        values = inside.read(scene, "", reading)
    for key in ("observe", "solver"):
        node = root.entries.get(key)
        if node is None or (isinstance(node, Scalar) and node.empty):
            continue
        reading.places[key] = node.place if key == "observe" else root.keys[key]
        values[key] = SCENE.members[key].section.read(node, key, reading)
    if "observe" not in values:
        reading.unreadable.add("observe")
        values["observe"] = ()
        if "observe" not in meant:
            message = f"the study lacks 'observe', a list out of {', '.join(OBSERVABLES)}"
            reading.report(Place(1, 1), message)
    return values


def _check_scenes(
    values: dict[str, Any],
    located: list[Located],
    reading: Reading,
    kept: np.ndarray | None,
    *,
    combine: bool,
) -> None:
    """Build the scenes and report what is wrong with them at the place that causes it."""
    axes = [one.axis for one in located]
    builder = SceneBuilder(values, axes)
    whole = not any(
        path.split(".")[0] == "region" or path in ("", "wells", "boundaries", "probes", "fractures")
        for path in reading.unreadable
    )
    owner = {path: number for number, axis in enumerate(axes) for path in axis.parameters}
    variants = next((number for number, axis in enumerate(axes) if axis.names), None)
    shape = [len(axis.values) for axis in axes]
    # the first of all cases, from which others are told apart
    origin = (0,) * len(axes) if kept is None else tuple(map(int, np.argwhere(kept)[0]))
    at_origin: set[tuple[str, str]] = set()
    seen: set[tuple[str, str]] = set()
    named = sum(len(values.get(key) or ()) for key in NAMED)
    lines = (one.get("count", 1) for one in (values.get("probes") or {}).values())
    named += sum(count for count in lines if isinstance(count, int))
    most = MOST_COMBINATIONS // (1 + named // MANY_NAMES)
    # wells, fractures and probes of which a part could not be read
    partly = {_named_in(path) for path in reading.unreadable} - {""}
    for index in _indices(shape, origin, combine, most):
        if kept is not None and not kept[index]:
            continue
        moved = [number for number, k in enumerate(index) if k != origin[number]]
        for problem in builder.problems(index, whole=whole, unreadable=reading.unreadable):
            path, what = problem
            if reading.spoilt(path) or problem in at_origin or _named_in(path) in partly:
                continue
            if len(moved) > 1 and problem in seen:
                continue
            seen.add(problem)
            if index == origin:
                at_origin.add(problem)
            if path in owner:
                place = located[owner[path]].places[index[owner[path]]]
            elif variants is not None and index[variants] and path.split(".")[0] in owner:
                place = located[variants].places[index[variants]]
            elif len(moved) == 1:
                place = located[moved[0]].places[index[moved[0]]]
            else:
                place = reading.place(path)
            settings = " and ".join(setting(axes[number], index[number]) for number in moved)
            suffix = f" (where {settings})" if settings else ""
            reading.report(place, f"{path}: {what}{suffix}" if path else f"{what}{suffix}")


def _named_in(path: str) -> str:
    """`wells.p` of a path in a well, a fracture or a probe; "" of any other."""
    parts = path.split(".")
    return ".".join(parts[:2]) if parts[0] in NAMED and len(parts) > 2 else ""


def _indices(
    shape: list[int], origin: tuple[int, ...], combine: bool, most: int
) -> Iterator[tuple[int, ...]]:
    """The first of all, each value of each axis alone, then combinations while they are few.

    All combinations up to the most; else those of two axes, if these are few enough. Of an axis
    longer than half of that, values are taken at even distances and at its end.
    """
    yield origin
    for number, length in enumerate(shape):
        stride = -(-length // max(most // 2, 2))
        for k in sorted({*range(0, length, stride), length - 1} - {origin[number]}):
            yield (*origin[:number], k, *origin[number + 1 :])
    if not combine:
        return
    if math.prod(shape) <= most:
        for index in itertools.product(*map(range, shape)):
            if sum(k != at for k, at in zip(index, origin, strict=True)) > 1:
                yield index
        return
    pairs = list(itertools.combinations(range(len(shape)), 2))
    if sum((shape[a] - 1) * (shape[b] - 1) for a, b in pairs) <= most:
        for a, b in pairs:
            others = ([k for k in range(shape[n]) if k != origin[n]] for n in (a, b))
            for i, j in itertools.product(*others):
                yield tuple(i if k == a else j if k == b else at for k, at in enumerate(origin))


def setting(axis: Axis, k: int) -> str:
    """A point of an axis in words: `stress_yy = 5 MPa`."""
    if axis.names:
        return f"{axis.name} = {axis.names[k]}"
    shown = map(describe, axis.values[k], axis.units)
    if axis.sampled:
        drawn = ", ".join(f"{n} = {v}" for n, v in zip(axis.labels, shown, strict=True))
        return f"{axis.name} = {k} ({drawn})"
    return f"{axis.name} = {', '.join(shown)}"


def _check_figures(figures: Figures, values: dict[str, Any], reading: Reading) -> None:
    """Figures that the study cannot draw."""
    if figures.maps and not reading.spoilt("figures.maps"):
        place = reading.place("figures.maps")
        if min(figures.maps) <= 0:
            reading.report(place, "figures.maps: times must be positive")
        if "pressure_map" not in values["observe"] and not reading.spoilt("observe"):
            reading.report(
                place, "figures.maps: pressure maps are drawn where pressure_map is observed"
            )
        times = SCENE.members["times"].section.build(values.get("times", ()), "times", [])
        for time in figures.maps:
            if times and (time < times[0] or time > times[-1]):
                ends = " to ".join(format_quantity(end, "s") for end in (times[0], times[-1]))
                reading.report(
                    place, f"figures.maps: {format_quantity(time, 's')} is not in times, {ends}"
                )
    region = values.get("region") or {}
    wanted = {"linear": "rectangle", "radial": "circle"}.get(figures.compare or "")
    shape = region.get("shape")
    if wanted and shape and shape != wanted:
        message = f"figures.compare: {figures.compare} is the flow in a {wanted}, not in a {shape}"
        reading.report(reading.place("figures.compare"), message)
