"""What a parameter of a scene is: its unit, its bounds and the words that explain it.

The dataclasses of `model.scene` declare their fields with `parameter`. The same
declaration checks the value, gives the study file its units and its error
messages, and gives editors their schema, so that a bound is written once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, Field, field, fields
from functools import cache
from numbers import Real
from typing import Any

Problem = tuple[str, str]  # path of a parameter inside the scene, what is wrong with it
Problems = Iterator[Problem]


class SceneError(ValueError):
    """A scene that cannot be. `problems` lists (path of the parameter, what is wrong)."""

    def __init__(self, problems: list[Problem]):
        self.problems = problems
        super().__init__("; ".join(f"{path}: {what}" if path else what for path, what in problems))


def parameter(
    unit: str = "1",
    *,
    default: Any = MISSING,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    choices: tuple[str, ...] | None = None,
    reason: str = "",
    key: str | None = None,
    example: str | None = None,
    bare_at_most: float | None = None,
    help: str,
) -> Any:
    """A dataclass field that knows its unit, its bounds and what it means.

    Parameters
    ----------
    unit : SI unit of the value ("1" where it has none); angles are in rad.
    default : value if none is given; without it the parameter is required.
    above, at_least, below, at_most : bounds, exclusive and inclusive.
    choices : the words that are allowed, for a parameter that is a word.
    reason : why the bounds are what they are, where that is no matter of course.
    key : the name in a study file where it differs from the field's (a Python keyword).
    example : a value as a study file has it, where that of its unit would mislead.
    bare_at_most : the largest number that a study file may give without a unit: beyond it the
        unit was forgotten.
    help : one line for a user.
    """
    metadata = {
        "unit": unit,
        "above": above,
        "at_least": at_least,
        "below": below,
        "at_most": at_most,
        "choices": choices,
        "reason": reason,
        "key": key,
        "example": example,
        "bare_at_most": bare_at_most,
        "help": help,
    }
    if default is MISSING:
        return field(metadata=metadata)
    return field(default=default, metadata=metadata)


# What is computed with, by unit: products and powers of such numbers stay far from the largest
# and the smallest there are.
_SIZES = {"m": (1e-12, 1e9), "rad": (0.0, 1e4)}
_ANY_SIZE = (1e-60, 1e60)


def bound_problem(
    declared: Field[Any], value: Any, show: Callable[[float], str] | None = None
) -> str | None:
    """What is wrong with a value against the declaration of its field, or None.

    The bounds of a tuple are those of each of its numbers. `show` writes a number of the
    field's unit for whoever gave the value; by default in SI.

    Parameters
    ----------
    declared : the field
    value : what was given
    show : writes a number for whoever gave it; by default in SI
    """
    meta = declared.metadata
    if not meta or value is None:
        return None
    if meta["choices"] is not None:
        if value not in meta["choices"]:
            return f"{value!r} is none of {', '.join(meta['choices'])}"
        return None
    if isinstance(value, tuple):
        problems = (bound_problem(declared, part, show) for part in value)
        return next((what for what in problems if what is not None), None)
    if not isinstance(value, float | int) and not isinstance(value, Real):
        return None  # the first of the two is quick
    if isinstance(value, bool):
        return None
    if not math.isfinite(value):
        return f"{value} is not a finite number"
    unit = "" if meta["unit"] == "1" else f" {meta['unit']}"
    show = show or (lambda number: f"{number:g}{unit}")
    what = _beyond(meta, value, show)
    if what is None:
        return _size_problem(meta, value, show)
    return f"{what}; {meta['reason']}" if meta["reason"] else what


def _beyond(meta: Mapping[str, Any], value: Any, show: Callable[[float], str]) -> str | None:
    """The bound that a number breaks, or None."""
    if meta["above"] is not None and not value > meta["above"]:
        return f"{show(value)} is not above {show(meta['above'])}"
    if meta["at_least"] is not None and not value >= meta["at_least"]:
        return f"{show(value)} is below {show(meta['at_least'])}"
    if meta["below"] is not None and not value < meta["below"]:
        return f"{show(value)} is not below {show(meta['below'])}"
    if meta["at_most"] is not None and not value <= meta["at_most"]:
        return f"{show(value)} is above {show(meta['at_most'])}"
    return None


def _size_problem(meta: Mapping[str, Any], value: Any, show: Callable[[float], str]) -> str | None:
    """Why nothing is computed with a number of that size, or None."""
    least, most = _SIZES.get(meta["unit"], _ANY_SIZE)
    if meta["above"] is None and meta["at_least"] is None:
        least = 0.0  # a position or a rate may come near to zero, by round-off too
    size = abs(float(value))
    if size > most:
        return f"{show(value)} is beyond {show(most)}, up to which numbers are computed with"
    if 0.0 < size < least:
        return f"{show(value)} is below {show(least)}, from which on numbers are computed with"
    return None


@cache
def _declared(kind: type) -> tuple[Field[Any], ...]:
    """The fields of a dataclass that declare anything."""
    return tuple(declared for declared in fields(kind) if declared.metadata)


def check_fields(instance: Any) -> None:
    """Raise SceneError with every field of a dataclass that breaks its declaration."""
    problems = []
    for declared in _declared(instance.__class__):
        what = bound_problem(declared, getattr(instance, declared.name))
        if what is not None:
            problems.append((declared.metadata["key"] or declared.name, what))
    if problems:
        raise SceneError(problems)
