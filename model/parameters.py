"""What a parameter of a scene is: its unit, its bounds and the words that explain it.

The dataclasses of `model.scene` declare their fields with `parameter`. The same
declaration checks the value, gives the study file its units and its error
messages, and gives editors their schema, so that a bound is written once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, field, fields
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
        "help": help,
    }
    if default is MISSING:
        return field(metadata=metadata)
    return field(default=default, metadata=metadata)


def bound_problem(declared: Field, value: Any) -> str | None:
    """What is wrong with a value against the declaration of its field, or None.

    The bounds of a tuple are those of each of its numbers.
    """
    meta = declared.metadata
    if not meta or value is None:
        return None
    if meta["choices"] is not None:
        if value not in meta["choices"]:
            return f"{value!r} is none of {', '.join(meta['choices'])}"
        return None
    if isinstance(value, tuple):
        problems = (bound_problem(declared, part) for part in value)
        return next((what for what in problems if what is not None), None)
    if isinstance(value, bool | str) or not isinstance(value, Real):
        return None
    if not math.isfinite(value):
        return f"{value} is not a finite number"
    what = _beyond(meta, value)
    return f"{what}; {meta['reason']}" if what and meta["reason"] else what


def _beyond(meta: Mapping[str, Any], value: Any) -> str | None:
    """The bound that a number breaks, or None."""
    unit = "" if meta["unit"] == "1" else f" {meta['unit']}"
    if meta["above"] is not None and not value > meta["above"]:
        return f"{value:g}{unit} is not above {meta['above']:g}{unit}"
    if meta["at_least"] is not None and not value >= meta["at_least"]:
        return f"{value:g}{unit} is below {meta['at_least']:g}{unit}"
    if meta["below"] is not None and not value < meta["below"]:
        return f"{value:g}{unit} is not below {meta['below']:g}{unit}"
    if meta["at_most"] is not None and not value <= meta["at_most"]:
        return f"{value:g}{unit} is above {meta['at_most']:g}{unit}"
    return None


def check_fields(instance: Any) -> None:
    """Raise SceneError with every field of a dataclass that breaks its declaration."""
    problems = []
    for declared in fields(instance):
        what = bound_problem(declared, getattr(instance, declared.name))
        if what is not None:
            problems.append((declared.metadata["key"] or declared.name, what))
    if problems:
        raise SceneError(problems)
