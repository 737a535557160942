"""The axes of a study: which parameters vary, over which values.

Reading goes in two steps. The parameters that axes give are wanted before the scene is
read (a block may leave out what an axis supplies); their values are read after it,
once it is known what each path names.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from dataclasses import replace as with_changes
from typing import Any, NamedTuple

from demflow.model import quantities
from demflow.sweep.study.blocks import LONGEST_NAME
from demflow.sweep.study.points_file import read_points
from demflow.sweep.study.scene import SCENE, spaced
from demflow.sweep.study.sections import (
    NoParameter,
    Parameter,
    Reading,
    hinted,
    report_unknown,
    whole,
)
from demflow.sweep.study.units import UnitError, example, parse_quantity, to_degrees
from demflow.sweep.study.yaml_source import Mapping, Node, Place, Scalar, Sequence

MAX_CASES = 100_000

SPACING = ("from", "to", "count", "spacing", "distribution", "file", "columns")  # no values
_KEYS = ("parameter", "parameters", "values", *SPACING)
SOURCES = ("values", "file", "distribution")  # of points, instead of evenly spaced ones

# names that the dataset uses itself
RESERVED = frozenset(
    name
    for table in (
        *(quantities.CASE, quantities.PRINCIPAL, quantities.ENSEMBLE),
        *(quantities.SWEEP, quantities.COORDINATES),
    )
    for key, quantity in table.items()
    for name in (key, *quantity.dimensions)
) | {"status", "message", "event_count", "domain", "pipe", "grain", "contact", "crack"}
# arguments of the methods by which points of a dataset are selected by their names
SELECTION = frozenset({"indexers", "method", "tolerance", "drop", "missing_dims"})


@dataclass(frozen=True)
class Axis:
    """One dimension of a study: each point gives one value to each of its parameters."""

    name: str
    parameters: tuple[str, ...]  # paths inside the scene
    values: tuple[tuple[Any, ...], ...]  # one tuple per point, one SI entry per parameter
    units: tuple[str, ...]  # SI unit of each parameter, rad for angles
    labels: tuple[str, ...]  # name of each parameter as a coordinate, unique in the study
    long_names: tuple[str, ...]  # what each parameter means
    names: tuple[str, ...] = ()  # of the points, where these are variants of the scene
    sampled: tuple[tuple[str, Any], ...] = ()  # what made the points, where they are a sample

    @property
    def seeds(self) -> bool:
        """Whether its points differ in seeds alone: an ensemble, whose order means nothing."""
        return bool(self.parameters) and all(p.split(".")[-1] == "seed" for p in self.parameters)


class Draft(NamedTuple):
    """An axis of which only the paths have been read."""

    name: str
    place: Place
    paths: tuple[str, ...]
    path_places: tuple[Place, ...]
    node: Mapping


class Located(NamedTuple):
    """An axis and where each of its values is written."""

    axis: Axis
    places: tuple[Place, ...]


def read_drafts(vary: Node | None, reading: Reading) -> list[Draft]:
    """The axes of `vary` and the parameters that they name, which `reading` then knows."""
    if vary is None or (isinstance(vary, Scalar) and vary.empty):
        return []
    if not isinstance(vary, Mapping):
        reading.report(vary.place, "vary is a mapping of axis names to axes")
        return []
    drafts: list[Draft] = []
    owner: dict[str, str] = {}
    for name, node in vary.entries.items():
        place = vary.keys[name]
        _check_name(name, place, reading)
        if not isinstance(node, Mapping):
            message = f"vary.{name} is a mapping such as {{parameter: stress.yy, values: [5 MPa]}}"
            reading.report(node.place, message)
            continue
        before = len(reading.problems)
        for key, key_place in node.keys.items():
            if key not in _KEYS:
                report_unknown(key, key_place, _KEYS, f"vary.{name}", reading)
        paths: list[str] = []
        places: list[Place] = []
        for item in _path_nodes(name, place, node, reading):
            path = item.text
            if path in owner:
                twice = "itself" if owner[path] == name else f"axis '{owner[path]}'"
                reading.report(item.place, f"axis '{name}' varies '{path}', as {twice} does")
                continue
            owner[path] = name
            paths.append(path)
            places.append(item.place)
        reading.supplied.update(paths)
        _check_one_source(name, node, reading)
        if len(reading.problems) == before:
            drafts.append(Draft(name, place, tuple(paths), tuple(places), node))
        else:
            reading.unreadable.update(paths)
    return drafts


def count_cases(drafts: list[Draft]) -> int:
    """How many cases axes make, before their values are read; one that is wrong counts as 1."""
    return math.prod(map(_length, drafts))


def _length(draft: Draft) -> int:
    entries = draft.node.entries
    listed, count = entries.get("values"), entries.get("count")
    if isinstance(listed, Sequence):
        return max(1, len(listed.items))
    if listed is None and isinstance(count, Scalar):
        with suppress(UnitError):
            number = whole(count.text, "count")
            return number if 1 <= number <= MAX_CASES else 1
    return 1


def read_axes(
    drafts: list[Draft], values: dict[str, Any], reading: Reading, *, ends_only: bool = False
) -> list[Located]:
    """The axes whose every parameter exists, with values in SI.

    `ends_only`: of evenly spaced values the first and the last alone, where the study makes too
    many cases and is only checked for further problems.

    `values` are those of the scene. Of a value that could not be read a stand-in is kept, so
    that checks across blocks can go on.

    Parameters
    ----------
    drafts : axes of which only the paths have been read
    values : values of the scene by their paths, SI
    reading : takes the problems that are met
    ends_only : of evenly spaced values the first and the last alone
    """
    axes = []
    for draft in drafts:
        found = [
            find(draft, path, place, values, reading)
            for path, place in zip(draft.paths, draft.path_places, strict=True)
        ]
        parameters = [parameter for parameter in found if parameter is not None]
        whole = len(parameters) == len(found)
        points = _points(draft, parameters, reading, ends_only) if whole else None
        if points is None:  # what it should give is not there
            reading.unreadable.update(draft.paths)
            continue
        _check_distinct(draft.name, points, reading)
        axis = Axis(
            name=draft.name,
            parameters=draft.paths,
            values=tuple(values for values, _ in points),
            units=tuple(parameter.unit for parameter in parameters),
            labels=(),
            long_names=tuple(
                long_name(path, one) for path, one in zip(draft.paths, parameters, strict=True)
            ),
        )
        axes.append(Located(axis, tuple(place for _, place in points)))
    return axes


def _check_one_source(name: str, node: Mapping, reading: Reading) -> None:
    """Report an axis that has its points in two ways."""
    given = [key for key in SOURCES if key in node.entries]
    spacing = [key for key in ("from", "to", "count", "spacing") if key in node.entries]
    if len(given) > 1:
        message = f"axis '{name}' has {given[0]} already; remove {given[1]}"
        reading.report(node.keys[given[1]], message)
    elif spacing and given and given[0] != "values":
        message = f"axis '{name}' has {given[0]} already; remove {', '.join(spacing)}"
        reading.report(node.keys[spacing[0]], message)
    if "columns" in node.entries and "file" not in node.entries:
        reading.report(node.keys["columns"], f"axis '{name}': columns are those of a file")
    if "distribution" in given and "parameters" in node.entries:
        message = f"axis '{name}': a distribution is that of one parameter"
        reading.report(node.keys["parameters"], message)


def _check_name(name: str, place: Place, reading: Reading) -> None:
    if not (name.isascii() and name.isidentifier() and not name.startswith("_")):
        message = f"axis '{name}': a name is a letter followed by letters, digits and '_'"
        reading.report(place, message)
    elif len(name) > LONGEST_NAME:
        reading.report(place, f"axis '{name}': a name has at most {LONGEST_NAME} letters")
    elif name in SELECTION:
        what = f"'{name}' cannot be told from an argument of xarray's sel; try '{name}_axis'"
        reading.report(place, f"axis '{name}': {what} or the like")
    elif name in RESERVED:
        reading.report(
            place,
            f"axis '{name}': the dataset uses this name itself; try '{name}_axis' or the like",
        )


def _path_nodes(name: str, place: Place, node: Mapping, reading: Reading) -> list[Scalar]:
    """The words under `parameter` or `parameters`."""
    one, several = node.entries.get("parameter"), node.entries.get("parameters")
    if (one is None) == (several is None):
        message = f"axis '{name}' needs either 'parameter' or 'parameters'"
        reading.report(place if one is None else node.keys["parameters"], message)
        return []
    items: tuple[Node, ...] = (one,) if one is not None else ()
    if several is not None:
        items = several.items if isinstance(several, Sequence) else ()
        if not items:
            message = f"axis '{name}': parameters is a list of paths such as [stress.xx, stress.yy]"
            reading.report(several.place, message)
    words = [item for item in items if isinstance(item, Scalar) and not item.empty]
    if len(words) < len(items):
        message = f"axis '{name}': a parameter is a path such as stress.yy"
        reading.report(items[0].place, message)
        return []
    return words


def find(
    draft: Draft, path: str, place: Place, values: dict[str, Any], reading: Reading
) -> Parameter | None:
    """The parameter at a path, or None after reporting why there is none.

    Parameters
    ----------
    draft : the axis that varies it
    path : of the parameter
    place : where in the file
    values : values of the scene by their paths, SI
    reading : takes the problems that are met
    """
    name = draft.name
    parts = tuple(path.split("."))
    try:
        return SCENE.find(values, parts)
    except NoParameter as reason:
        if reading.spoilt(path):  # its block has a problem already
            return None
        if str(reason):
            reading.report(place, f"axis '{name}': '{path}' cannot vary: {reason}")
            return None
    valid = sorted(SCENE.paths(values, ""))
    short = path.removeprefix("scene.")
    like = short if short in valid else reading.nearest(path, valid)
    if like is None:  # the head may be right where the tail is not
        like = next(iter(sorted(p for p in valid if p.startswith(parts[0] + "."))), None)
    hint = f"did you mean '{like}'?" if like else "a path starts inside scene, as in stress.yy"
    reading.report(place, f"axis '{name}': '{path}' names no parameter of this scene; {hint}")
    return None


Point = tuple[tuple[Any, ...], Place]


def _points(
    draft: Draft, parameters: list[Parameter], reading: Reading, ends_only: bool
) -> list[Point] | None:
    """The values of an axis and their places."""
    entries = draft.node.entries
    spacing = [key for key in ("from", "to", "count", "spacing") if key in entries]
    if "file" in entries:
        return read_points(draft.name, draft.node, draft.paths, parameters, reading)
    if "values" not in entries:
        if "parameters" in entries or not spacing:
            reading.report(draft.place, f"axis '{draft.name}' lacks 'values'")
            return None
        return _spaced_points(draft, parameters[0], reading, ends_only)
    if spacing:
        message = f"axis '{draft.name}' has values already; remove {', '.join(spacing)}"
        reading.report(draft.node.keys[spacing[0]], message)
    listed = entries["values"]
    if not isinstance(listed, Sequence) or not listed.items:
        what = "is empty" if isinstance(listed, Sequence) else "is a list"
        reading.report(listed.place, f"axis '{draft.name}': values {what}; give at least one value")
        return None
    points: list[Point] = []
    for item in listed.items:
        nodes: tuple[Node, ...] = (item,)
        if "parameters" in entries:
            if not isinstance(item, Sequence) or len(item.items) != len(parameters):
                message = (
                    f"axis '{draft.name}': each point is a list of {len(parameters)} values, "
                    f"one for each of {', '.join(draft.paths)}"
                )
                reading.report(item.place, message)
                continue
            nodes = item.items
        before = len(reading.problems)
        values = tuple(
            _value(node, parameter, path, reading)
            for node, parameter, path in zip(nodes, parameters, draft.paths, strict=True)
        )
        if len(reading.problems) == before:
            points.append((values, item.place))
    return points or None


def _value(node: Node, parameter: Parameter, path: str, reading: Reading) -> Any:
    """A value of a parameter; `null` leaves an optional one out."""
    if parameter.optional and isinstance(node, Scalar) and node.empty:
        return None
    return parameter.read(node, path, reading)


def _spaced_points(
    draft: Draft, parameter: Parameter, reading: Reading, ends_only: bool
) -> list[Point] | None:
    """Evenly spaced values from … to."""
    entries, name = draft.node.entries, draft.name
    missing = [key for key in ("from", "to", "count") if key not in entries]
    if missing:
        reading.report(draft.place, f"axis '{name}' lacks {', '.join(map(repr, missing))}")
        return None
    if parameter.type not in (float, int):
        message = f"axis '{name}': {draft.paths[0]} is no quantity; list its values instead"
        reading.report(draft.node.keys["from"], message)
        return None
    before = len(reading.problems)
    first, last = (parameter.read(entries[k], draft.paths[0], reading) for k in ("from", "to"))
    count = _count(entries["count"], name, reading)
    if ends_only:
        count = min(count, 2)
    log = _spacing(entries.get("spacing"), name, reading) == "log"
    if len(reading.problems) > before:
        return None
    if log and not (first > 0 and last > 0):
        reading.report(entries["from"].place, f"axis '{name}': log spacing needs positive ends")
        return None
    if parameter.unit == "rad":  # in degrees, so that 0, 30, 60 deg are met as if listed
        degrees = spaced(to_degrees(first), to_degrees(last), count, log=log)
        inner = [parse_quantity(f"{value!r} deg", "rad") for value in degrees]
    else:
        inner = list(spaced(first, last, count, log=log))
    if parameter.type is int:
        if any(value != math.floor(value) for value in inner):
            message = f"axis '{name}': the spacing of {draft.paths[0]} gives no whole numbers"
            reading.report(entries["count"].place, message)
            return None
        inner = [int(value) for value in inner]
    places = [entries["from"].place] + [entries["to"].place] * (count - 1)
    return [((value,), place) for value, place in zip(inner, places, strict=True)]


def _count(node: Node, name: str, reading: Reading) -> int:
    try:
        count = whole(node.text if isinstance(node, Scalar) else "a list", "count")
        if not 1 <= count <= MAX_CASES:
            raise UnitError(f"{count} is not between 1 and {MAX_CASES}")
    except UnitError as error:
        reading.report(node.place, f"axis '{name}': count: {error}")
        return 1
    return count


def _spacing(node: Node | None, name: str, reading: Reading) -> str:
    word = "linear" if node is None else node.text if isinstance(node, Scalar) else "a list"
    if node is not None and word not in ("linear", "log"):
        hint = hinted(word, ("linear", "log"), reading)
        reading.report(
            node.place, f"axis '{name}': spacing '{word}' is neither linear nor log{hint}"
        )
    return word


def _check_distinct(name: str, points: list[Point], reading: Reading) -> None:
    first: dict[tuple[Any, ...], Place] = {}
    for values, place in points:
        if values in first:
            line, column = first[values]
            message = f"axis '{name}': the value stands twice, first at {line}:{column}"
            reading.report(place, message)
        first.setdefault(values, place)


def long_name(path: str, parameter: Parameter) -> str:
    """What a parameter means, with the name of its well or fracture."""
    parts = path.split(".")
    meaning = (parameter.help or example(parameter.unit)).split(";")[0]
    owner = parts[1] if len(parts) == 3 else parts[1] if parts[0] == "boundaries" else ""
    return f"{owner}: {meaning}" if owner else meaning


def labelled(axes: list[Located]) -> list[Located]:
    """Give every parameter a coordinate name: the last two parts of its path, if that is free.

    Variants are named by their points alone.
    """
    taken = set(RESERVED) | {located.axis.name for located in axes}
    labelled = []
    for located in axes:
        if located.axis.sampled:  # by the names under vary
            taken |= {*located.axis.labels}
    for located in axes:
        if located.axis.sampled:
            labelled.append(located)
            continue
        labels = []
        for path in () if located.axis.names else located.axis.parameters:
            parts = path.replace("-", "_").split(".")
            label = "_".join(parts[-2:])
            if label in taken:
                label = "_".join(parts)
            while label in taken:
                label += "_"
            taken.add(label)
            labels.append(label)
        axis = with_changes(located.axis, labels=tuple(labels))
        labelled.append(Located(axis, located.places))
    return labelled
