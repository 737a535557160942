"""Laws of chance that a parameter of a study can have: `distribution:` of an axis.

A law maps a probability to the value that it falls short of, in the unit of the parameter whose
law it is. Its first key says which law it is, as in `{log_normal: 0.5, median: 80 um}`.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from demflow.model.parameters import parameter
from demflow.sweep.study.sections import Parameter, Reading, hinted
from demflow.sweep.study.units import example, format_quantity
from demflow.sweep.study.yaml_source import Mapping, Node, Sequence


class Form(NamedTuple):
    """What a law is written with: its own key holds one number or a list of so many."""

    numbers: int  # under its own key; 0: any number of values
    beside: str = ""  # the key of its middle
    within: bool = False  # whether it may be cut


FORMS = {
    "uniform": Form(2),
    "log_uniform": Form(2),
    "normal": Form(1, "mean", within=True),
    "log_normal": Form(1, "median", within=True),
    "triangular": Form(3),
    "discrete": Form(0),
}


def keys_of(name: str) -> tuple[str, ...]:
    """The keys that a law takes."""
    form = FORMS[name]
    more = ("within",) if form.within else ("weights",) if name == "discrete" else ()
    return (name, *((form.beside,) if form.beside else ()), *more)


@dataclass(frozen=True)
class Law:
    """A law of chance, in SI."""

    kind: str  # one of FORMS
    numbers: tuple[Any, ...]  # ends; deviation and middle; ends about the mode; or values
    within: tuple[float, float] = (-math.inf, math.inf)
    weights: tuple[float, ...] = ()  # of discrete values; none: all alike
    whole: bool = False  # whether values are whole numbers

    def quantile(self, u: np.ndarray) -> list[Any]:
        """Values whose probability not to be exceeded is u, each above 0 and below 1."""
        if self.kind == "discrete":
            weights = np.array(self.weights or (1.0,) * len(self.numbers))
            steps = np.cumsum(weights) / weights.sum()
            found = np.searchsorted(steps[:-1], u, side="right")
            return [self.numbers[k] for k in found]
        values = self._numbers(np.asarray(u, dtype=float))
        if self.whole:
            return [int(v) for v in np.floor(values)]
        return [float(f"{v:.15g}") for v in values]

    def _numbers(self, u: np.ndarray) -> np.ndarray:
        if self.kind == "uniform":
            low, high = self.numbers
            return np.asarray(low + (high + (1 if self.whole else 0) - low) * u)
        if self.kind == "log_uniform":
            low, high = np.log(self.numbers)
            found: np.ndarray = np.exp(low + (high - low) * u)
            return found
        if self.kind == "triangular":
            low, mode, high = self.numbers
            turn = (mode - low) / (high - low)
            rising = low + np.sqrt(u * (high - low) * (mode - low))
            falling = high - np.sqrt((1.0 - u) * (high - low) * (high - mode))
            found = np.where(u < turn, rising, falling)
            return found
        return self._normal(u)

    def _normal(self, u: np.ndarray) -> np.ndarray:
        """Normal, of the value or of its logarithm, cut to what lies within."""
        from scipy.special import log_ndtr, ndtr, ndtri, ndtri_exp

        deviation, middle = self.numbers
        log = self.kind == "log_normal"
        centre = math.log(middle) if log else middle
        with np.errstate(divide="ignore"):
            ends = np.log(np.maximum(self.within, 0.0)) if log else np.array(self.within)
        low, high = (ends - centre) / deviation
        if low > 0.0:  # far in the upper tail probabilities are counted from above
            above = np.logaddexp(log_ndtr(-low) + np.log1p(-u), log_ndtr(-high) + np.log(u))
            z = -ndtri_exp(above)
        elif high < 0.0:
            z = ndtri_exp(np.logaddexp(log_ndtr(low) + np.log1p(-u), log_ndtr(high) + np.log(u)))
        else:
            z = ndtri(ndtr(low) + (ndtr(high) - ndtr(low)) * u)
        values = np.clip(centre + deviation * z, *ends)
        return np.exp(values) if log else np.asarray(values)

    def in_words(self, unit: str) -> str:
        """The law as a study has it, in one line."""

        def show(value: Any, unit: str = unit) -> str:
            return value if isinstance(value, str) else format_quantity(value, unit)

        form = FORMS[self.kind]
        if form.beside:
            first = show(self.numbers[0], "1" if self.kind == "log_normal" else unit)
            text = f"{self.kind}: {first}, {form.beside}: {show(self.numbers[1])}"
        else:
            text = f"{self.kind}: [{', '.join(map(show, self.numbers))}]"
        if math.isfinite(self.within[0]):
            text += f", within: [{', '.join(map(show, self.within))}]"
        if self.weights:
            text += f", weights: [{', '.join(f'{w:g}' for w in self.weights)}]"
        return text


def read_law(node: Node, target: Parameter, path: str, reading: Reading) -> Law | None:
    """The law of a parameter, None after reporting what is wrong with it.

    Parameters
    ----------
    node : what stands there in the file
    target : the parameter that is drawn
    path : of it
    reading : takes the problems that are met
    """
    before = len(reading.problems)
    law = _read(node, target, path, reading)
    return law if len(reading.problems) == before else None


def _read(node: Node, target: Parameter, path: str, reading: Reading) -> Law | None:
    names = list(node.entries) if isinstance(node, Mapping) else []
    kind = next((name for name in names if name in FORMS), None)
    if not isinstance(node, Mapping) or kind is None:
        hint = hinted(names[0], FORMS, reading) if names else ""
        message = (
            f"a distribution is one of {', '.join(FORMS)}, as in {{uniform: [low, high]}}, "
            "{log_normal: 0.5, median: …}"
        )
        reading.report(node.place, f"{message}{hint}")
        return None
    valid = keys_of(kind)
    for key in names:
        if key not in valid:
            hint = hinted(key, valid, reading)
            message = f"{kind} takes {', '.join(valid)}, and no '{key}'{hint}"
            reading.report(node.keys[key], message)
    if kind != "discrete" and target.type not in (float, int):
        reading.report(node.keys[kind], f"{path} is no quantity; give it discrete values")
        return None
    if kind == "discrete":
        return _discrete(node, target, path, reading)
    if target.type is int and kind != "uniform":
        message = f"{path} is a whole number; its law is uniform or discrete"
        reading.report(node.keys[kind], message)
        return None
    return _continuous(kind, node, target, path, reading)


def _continuous(
    kind: str, node: Mapping, target: Parameter, path: str, reading: Reading
) -> Law | None:
    before = len(reading.problems)
    form = FORMS[kind]
    value = dataclasses.replace(target, optional=False)

    def several(key: str, count: int) -> tuple[Any, ...]:
        given = node.entries[key]
        if not isinstance(given, Sequence) or len(given.items) != count:
            ends = ("least", "likeliest", "largest") if count == 3 else ("least", "largest")
            message = f"{key} is a list of {count} values, the {', '.join(ends)}"
            reading.report(given.place, message)
            return ()
        found = tuple(value.read(item, path, reading) for item in given.items)
        if len(reading.problems) > before:
            return found
        if not (found[0] < found[-1] and list(found) == sorted(found)):
            reading.report(given.place, f"the values of {key} rise from the least to the largest")
        return found

    if form.beside:
        if form.beside not in node.entries:
            one = target.declared.metadata.get("example") or example(target.unit)
            message = f"{kind} lacks '{form.beside}', for instance {form.beside}: {one}"
            reading.report(node.place, message)
            return None
        spread = parameter(
            "1" if kind == "log_normal" else target.unit, above=0, help="standard deviation"
        )
        deviation = Parameter(spread, float, optional=False)
        numbers: tuple[Any, ...] = (
            deviation.read(node.entries[kind], f"{kind}, the deviation,", reading),
            value.read(node.entries[form.beside], path, reading),
        )
    else:
        numbers = several(kind, form.numbers)
    within = several("within", 2) if "within" in node.entries else (-math.inf, math.inf)
    if len(reading.problems) > before:
        return None
    if kind in ("log_uniform", "log_normal") and not numbers[-1 if form.beside else 0] > 0.0:
        reading.report(node.entries[kind].place, f"{kind} is a law of positive values")
    if kind == "log_normal" and "within" in node.entries and not within[1] > 0.0:
        reading.report(node.entries["within"].place, f"{kind} has positive values alone")
    return Law(kind, numbers, (within[0], within[1]), whole=target.type is int)


def _discrete(node: Mapping, target: Parameter, path: str, reading: Reading) -> Law | None:
    listed = node.entries["discrete"]
    if not isinstance(listed, Sequence) or not listed.items:
        reading.report(listed.place, "discrete is a list of values")
        return None
    values = tuple(target.read(item, path, reading) for item in listed.items)
    weights: tuple[float, ...] = ()
    given = node.entries.get("weights")
    if given is not None:
        declared = parameter(at_least=0, help="weight of a value")
        items = given.items if isinstance(given, Sequence) else ()
        number = Parameter(declared, float, optional=False)
        weights = tuple(number.read(item, "weights", reading) for item in items)
        if len(weights) != len(values) or not sum(weights) > 0.0:
            message = f"weights is a list of {len(values)} numbers, one for each value, not all 0"
            reading.report(given.place, message)
    return Law("discrete", values, weights=weights)
