"""The block `fit:`: what is fitted to which measured test, between which bounds."""

from __future__ import annotations

import re
from collections.abc import Mapping as Values
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from demflow.model.parameters import bound_problem, parameter
from demflow.sweep.study.blocks import Block, block_of
from demflow.sweep.study.measured import MeasuredTest
from demflow.sweep.study.reservoir import (
    MODEL_PARAMETERS,
    PARAMETERS,
    Rock,
    parameters_of,
)
from demflow.sweep.study.scene import SCENE
from demflow.sweep.study.sections import (
    NoParameter,
    Parameter,
    Reading,
    hinted,
    report_unknown,
)
from demflow.sweep.study.units import UnitError, parse_quantity
from demflow.sweep.study.yaml_source import Mapping, Node, Scalar, Sequence

PREFIX = "data."


class Bounds(NamedTuple):
    """A parameter that is fitted: a path of the scene, or a name of a reservoir model."""

    name: str
    low: float  # SI
    high: float
    unit: str  # SI
    shown: tuple[str, float]  # unit that the study writes, and its factor to SI


@dataclass(frozen=True)
class FitBlock:
    """The keys of `fit:` that are read like any other."""

    to: str = parameter(help="measured test, as in data.test")
    profile: bool | None = parameter(
        default=None, help="intervals by profile likelihood; by default where they must be"
    )
    reservoir: Rock = field(default_factory=Rock)


FIT: Block = block_of(FitBlock)
OWN = ("parameters", "model", "models")


class FitRequest(NamedTuple):
    """A fit that can be made."""

    to: str  # name of the test
    models: tuple[str, ...]  # none: the network of the scene
    free: tuple[Bounds, ...]
    known: Values[str, float]  # SI
    rock: Rock
    profile: bool | None


def asks_for_models(node: Node | None) -> bool:
    """Whether a block `fit:` names reservoir models, so that it needs no scene."""
    return isinstance(node, Mapping) and bool({"model", "models"} & set(node.entries))


def read_fit(
    node: Node | None, tests: Values[str, MeasuredTest], scene: Any, reading: Reading
) -> FitRequest | None:
    """The block `fit:`, or None; `scene` holds the values of the scene, None without one.

    Parameters
    ----------
    node : what stands there in the file
    tests : measured tests by name
    scene : values of the scene, None without one
    reading : takes the problems that are met
    """
    if node is None or (isinstance(node, Scalar) and node.empty):
        return None
    before = len(reading.problems)
    values = FIT.read(node, "fit", reading, also=OWN)
    if not isinstance(node, Mapping):
        return None
    to = str(values.get("to", "")).removeprefix(PREFIX)
    if to and to not in tests and f"{PREFIX}{to}" not in reading.unreadable:
        hint = hinted(to, tests, reading) or ("" if tests else "; the study has no data")
        reading.report(reading.place("fit.to"), f"fit.to: there is no data.{to}{hint}")
    models = _models(node, reading)
    asked = node.entries.get("parameters")
    if not isinstance(asked, Mapping) or not asked.entries:
        what = "fit.parameters is a mapping: name: [low, high], or name: value"
        reading.report(asked.place if asked else node.place, what)
        return None
    free, known = _parameters(asked, models, scene, reading)
    problems: list[tuple[str, str]] = []
    given = FIT.build(values, "fit", problems)
    for path, what in problems:
        reading.report(reading.place(path), f"{path}: {what}")
    if models:
        _check_known(models, free, known, given.reservoir, node, reading)
    if len(reading.problems) > before:
        return None
    if not free:
        reading.report(asked.place, "fit.parameters: nothing is left to fit; give [low, high]")
        return None
    return FitRequest(to, models, tuple(free), known, given.reservoir, given.profile)


def _parameters(
    asked: Mapping, models: tuple[str, ...], scene: Any, reading: Reading
) -> tuple[list[Bounds], dict[str, float]]:
    """What is fitted between bounds, and what is known."""
    free: list[Bounds] = []
    known: dict[str, float] = {}
    before = len(reading.problems)
    for name, value in asked.entries.items():
        place = asked.keys[name]
        section = _section(name, models, scene, place, reading)
        if section is None:
            continue
        read = [_value(one, name, section, reading) for one in _items(value)]
        if len(reading.problems) > before or None in read:
            continue
        if len(read) == 1 and isinstance(value, Scalar):
            known[name] = read[0]
        elif len(read) == 2 and read[0] < read[1]:
            unit = section.unit if isinstance(section, Parameter) else section
            written = _items(value)[1]
            shown = _shown(written.text if isinstance(written, Scalar) else "", unit)
            free.append(Bounds(name, read[0], read[1], unit, shown))
        else:
            what = f"fit.parameters.{name} is [low, high], the bounds between which it is sought"
            reading.report(value.place, what)
    return free, known


def _shown(text: str, unit: str) -> tuple[str, float]:
    """The unit of a quantity as it is written, and its factor; SI where it has none."""
    suffix = re.sub(r"^[-+]?[\d.]*(?:[eE][-+]?\d+)?\s*", "", text.strip())
    return (suffix, parse_quantity(f"1 {suffix}", unit)) if suffix else (unit, 1.0)


def _models(node: Mapping, reading: Reading) -> tuple[str, ...]:
    found = node.entries.get("models", node.entries.get("model"))
    if found is None:
        return ()
    names = []
    for one in _items(found):
        text = one.text if isinstance(one, Scalar) else "this"
        if text in MODEL_PARAMETERS:
            names.append(text)
            continue
        known = ", ".join(MODEL_PARAMETERS)
        hint = hinted(text, MODEL_PARAMETERS, reading) or f"; there are {known}"
        reading.report(one.place, f"fit.model: no model is called '{text}'{hint}")
    return tuple(dict.fromkeys(names))


def _items(node: Node) -> tuple[Node, ...]:
    return node.items if isinstance(node, Sequence) else (node,)


def _section(
    name: str, models: tuple[str, ...], scene: Any, place: Any, reading: Reading
) -> Parameter | str | None:
    """The parameter of the scene at a path, or the unit of one of the models; None: reported."""
    if models or scene is None:
        valid = tuple(dict.fromkeys(one for model in models for one in parameters_of(model)))
        if name in valid:
            return PARAMETERS[name].unit
        report_unknown(name, place, valid or tuple(PARAMETERS), "fit", reading, "fit.parameters")
        return None
    try:
        found = SCENE.find(scene, tuple(name.split(".")))
    except NoParameter as reason:
        hint = hinted(name, SCENE.paths(scene, ""), reading)
        what = str(reason) or f"the scene has no parameter '{name}'{hint}"
        reading.report(place, f"fit.parameters: {what}")
        return None
    if found.type is not float:
        reading.report(place, f"fit.parameters: '{name}' is no quantity that can be fitted")
        return None
    return found


def _value(node: Node, name: str, section: Parameter | str, reading: Reading) -> Any:
    path = f"fit.parameters.{name}"
    if isinstance(section, Parameter):
        value = section.read(node, path, reading)
        what = bound_problem(section.declared, value)
        return None if what else value
    if not isinstance(node, Scalar):
        reading.report(node.place, f"{path} is a quantity, or two of them: [low, high]")
        return None
    try:
        return parse_quantity(node.text, section, path)
    except UnitError as error:
        reading.report(node.place, str(error))
        return None


def _check_known(
    models: tuple[str, ...],
    free: list[Bounds],
    known: Values[str, float],
    rock: Rock,
    node: Mapping,
    reading: Reading,
) -> None:
    """Report what a reservoir model needs and neither is fitted nor given."""
    given = {one.name for one in free} | known.keys()
    for model in models:
        lacking = [
            name
            for name in parameters_of(model)
            if name not in given and PARAMETERS[name].default is None
        ]
        if lacking:
            what = f"{model} needs {', '.join(lacking)}: give a value or [low, high]"
            reading.report(node.place, f"fit.parameters: {what}")
    missing = [
        name
        for name in ("porosity", "viscosity", "compressibility", "well_radius")
        if getattr(rock, name) != getattr(rock, name)
    ]
    if missing:
        what = f"fit.reservoir lacks {', '.join(missing)}, which the models need"
        reading.report(reading.place("fit.reservoir"), what)
    below = [one.name for one in free if one.low <= 0.0 and one.name in _POSITIVE]
    below += [name for name, value in known.items() if value <= 0.0 and name in _POSITIVE]
    if below:
        reading.report(node.place, f"fit.parameters: {', '.join(below)} must be above zero")


_POSITIVE = {
    name
    for name, one in PARAMETERS.items()
    if name not in ("skin_factor", "drift", "initial_pressure", "wellbore_storage")
}
