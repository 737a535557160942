"""A study → its cases, and the coordinates that its axes give to the dataset."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from demflow.model.scene import Scene
from demflow.sweep.study.axes import Axis
from demflow.sweep.study.load import Study
from demflow.sweep.study.scenes import SceneBuilder
from demflow.sweep.study.units import describe, to_degrees


@dataclass(frozen=True)
class Case:
    """One point of a study."""

    index: tuple[int, ...]  # position along each axis
    scene: Scene


class Coordinate(NamedTuple):
    """Numbers or words along an axis, as the dataset holds them."""

    name: str
    values: np.ndarray  # (points,) float, int or str; SI, angles in degrees
    unit: str  # "degree" for angles, "" for words
    long_name: str
    attributes: tuple[tuple[str, Any], ...] = ()  # further ones


def case_at(study: Study, index: Sequence[int]) -> Case:
    """The case at a position along each axis.

    Raises IndexError where the index does not fit the axes, SceneError at a case that cannot be
    (only in studies with too many combinations to check them all beforehand).
    """
    at = tuple(index)
    if len(at) != len(study.axes) or not all(
        0 <= k < n for k, n in zip(at, study.shape, strict=True)
    ):
        raise IndexError(f"index {at} does not fit a study of shape {study.shape}")
    return Case(at, SceneBuilder(study.values, study.axes).scene(at))


def coordinates(axis: Axis) -> tuple[Coordinate, ...]:
    """The coordinate of an axis, then those that lie along it beside.

    An axis over one number or word is its own coordinate, under the axis's name. Any other (over
    several parameters, or over points) has its values in words, `20 MPa, 10 MPa`, and its
    parameters follow as numbers under `axis.labels`, points as `…_x` and `…_y`. A sample has its
    numbers, from 0, and its parameters follow likewise.
    """
    if axis.names:
        return (Coordinate(axis.name, np.array(axis.names), "", "variant of the scene"),)
    columns = [
        _columns([point[k] for point in axis.values], label, axis.units[k], axis.long_names[k])
        for k, label in enumerate(axis.labels)
    ]
    beside = tuple(itertools.chain.from_iterable(columns))
    if axis.sampled:
        numbers = np.arange(len(axis.values), dtype=np.int32)
        return (Coordinate(axis.name, numbers, "", "number of the sample", axis.sampled), *beside)
    simple = not any(isinstance(point[0], tuple) for point in axis.values)
    if len(axis.parameters) == 1 and simple:
        return (beside[0]._replace(name=axis.name),)
    words = [", ".join(map(describe, point, axis.units)) for point in axis.values]
    if len(set(words)) < len(words):  # apart in digits that words leave out
        words = [f"{word} ({k})" for k, word in enumerate(words)]
    return (Coordinate(axis.name, np.array(words), "", f"point of {axis.name}"), *beside)


def _columns(values: list[Any], label: str, unit: str, long_name: str) -> list[Coordinate]:
    """One column of numbers or words; two for points; None is not a number or an empty word."""
    shown = _cf_unit(unit)
    if all(value is None or isinstance(value, int | float) for value in values):
        numbers = [math.nan if v is None else to_degrees(v) if unit == "rad" else v for v in values]
        return [Coordinate(label, np.array(numbers), shown, long_name)]
    if all(_is_point(value) for value in values):
        return [
            Coordinate(
                f"{label}_{name}", np.array([v[k] for v in values]), shown, f"{long_name}, {name}"
            )
            for k, name in enumerate("xy")
        ]
    words = ["" if value is None else describe(value, unit) for value in values]
    return [Coordinate(label, np.array(words), "", long_name)]


def _cf_unit(unit: str) -> str:
    """A unit as CF writes it: `m3/s` is `m3 s-1`, an angle is in `degree`."""
    if unit == "rad":
        return "degree"
    above, *below = unit.split("/")
    inverse = [re.sub(r"^([A-Za-z]+)(\d*)$", r"\1-\2", one) for one in below]
    inverse = [f"{one}1" if one.endswith("-") else one for one in inverse]
    return " ".join([above] * (above != "1" or not below) + inverse)


def _is_point(value: Any) -> bool:
    return (
        isinstance(value, tuple)
        and len(value) == 2
        and all(isinstance(part, int | float) for part in value)
    )
