"""`where:` of a study: which combinations of the axes are cases; the others are left out.

A condition compares axes (or what lies along them) with each other and with values, as
`stress_xx >= stress_yy` or `5 MPa <= stress_yy < 2 * stress_xx and kind != sealed`. Of several
conditions all must hold.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from demflow.sweep.printable import shortened
from demflow.sweep.study.axes import Axis
from demflow.sweep.study.sections import Reading
from demflow.sweep.study.units import UnitError, bare, nearest, parse_quantity
from demflow.sweep.study.yaml_source import Node, Scalar, Sequence

LONGEST = 1000  # characters of a condition
DEEPEST = 50  # brackets in brackets
_SPLIT = re.compile(r"(<=|>=|==|!=|<|>|=|\(|\)|\band\b|\bor\b|\bnot\b)")
_FACTOR = re.compile(r"(?:(?P<factor>[-+.\deE]+)\s*\*\s*)?(?P<name>[A-Za-z_]\w*)")
_TRUTHS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


class _Wrong(Exception):
    pass


class _Column(NamedTuple):
    """What lies along an axis."""

    axis: int
    values: np.ndarray  # (points,) SI, or words
    unit: str  # "" of words


def kept_cases(node: Node | None, axes: list[Axis], reading: Reading) -> np.ndarray | None:
    """Which cases there are, bool of the shape of the axes; None where all are.

    Reports conditions that cannot be read, and those that leave nothing.

    Parameters
    ----------
    node : what stands there in the file
    axes : of the study
    reading : takes the problems that are met
    """
    if node is None or (isinstance(node, Scalar) and node.empty):
        return None
    items = node.items if isinstance(node, Sequence) else (node,)
    shape = tuple(len(axis.values) for axis in axes)
    kept = np.ones(shape, dtype=bool)
    before = len(reading.problems)
    columns = _columns(axes)
    for item in items:
        try:
            if not isinstance(item, Scalar):
                raise _Wrong("a condition is a text such as stress_xx >= stress_yy")
            kept &= _Reader(item.text, columns, len(axes)).condition()
        except _Wrong as error:
            reading.report(item.place, f"where: {error}")
    if len(reading.problems) > before:
        return None
    if not kept.any():
        reading.report(node.place, "where leaves no case: no combination of the axes meets it")
        return None
    return kept


def _columns(axes: list[Axis]) -> dict[str, _Column]:
    columns = {}
    for number, axis in enumerate(axes):
        if axis.names:
            columns[axis.name] = _Column(number, np.array(axis.names), "")
            continue
        names = list(axis.labels)
        if len(axis.parameters) == 1 and not axis.sampled:
            names = [axis.name]
        if axis.sampled:
            columns[axis.name] = _Column(number, np.arange(float(len(axis.values))), "1")
        for k, name in enumerate(names):
            column = [point[k] for point in axis.values]
            if all(value is None or isinstance(value, int | float) for value in column):
                numbers = np.array([np.nan if value is None else float(value) for value in column])
                columns[name] = _Column(number, numbers, axis.units[k])
            elif all(value is None or isinstance(value, str) for value in column):
                columns[name] = _Column(number, np.array([v or "" for v in column]), "")
    return columns


class _Reader:
    """Reads one condition from left to right."""

    def __init__(self, text: str, columns: dict[str, _Column], dimensions: int):
        if len(text) > LONGEST:
            raise _Wrong(f"a condition has at most {LONGEST} characters")
        self.words = [word.strip() for word in _SPLIT.split(text) if word.strip()]
        self.text, self.columns, self.dimensions = shortened(text, 60), columns, dimensions
        self.at = self.depth = 0

    def condition(self) -> np.ndarray:
        """Where the whole of it holds."""
        found = self._any()
        if self.at < len(self.words):
            raise _Wrong(f"'{shortened(self.words[self.at], 40)}' is too much in '{self.text}'")
        return found

    def _next(self, *wanted: str) -> bool:
        if self.at < len(self.words) and self.words[self.at] in wanted:
            self.at += 1
            return True
        return False

    def _any(self) -> np.ndarray:
        found = self._every()
        while self._next("or"):
            found = found | self._every()
        return found

    def _every(self) -> np.ndarray:
        found = self._one()
        while self._next("and"):
            found = found & self._one()
        return found

    def _one(self) -> np.ndarray:
        self.depth += 1
        if self.depth > DEEPEST:
            raise _Wrong(f"more than {DEEPEST} brackets in brackets")
        try:
            if self._next("not"):
                return ~self._one()
            if self._next("("):
                found = self._any()
                if not self._next(")"):
                    raise _Wrong(f"a bracket is open in '{self.text}'")
                return found
            return self._comparison()
        finally:
            self.depth -= 1

    def _comparison(self) -> np.ndarray:
        """A chain such as `1 MPa <= a < b`."""
        sides, signs = [self._side()], []
        while self.at < len(self.words) and self.words[self.at] in (*_TRUTHS, "==", "!=", "="):
            signs.append(self.words[self.at])
            self.at += 1
            sides.append(self._side())
        if not signs:
            raise _Wrong(f"'{shortened(sides[0], 40)}' is compared with nothing in '{self.text}'")
        if "=" in signs:
            raise _Wrong(f"equality is written == in '{self.text}'")
        found = [_FACTOR.fullmatch(side) for side in sides]
        named = [m["name"] for m in found if m and m["name"] in self.columns]
        if not named:
            like = next(filter(None, (nearest(side, self.columns) for side in sides)), None)
            known = f"did you mean '{like}'?" if like else f"there are {', '.join(self.columns)}"
            raise _Wrong(f"no axis is named in '{self.text}'; {known}")
        units = {self.columns[name].unit for name in named}
        if len(units) > 1:
            raise _Wrong(f"{' and '.join(named)} are not of one kind in '{self.text}'")
        (unit,) = units
        arrays = [self._values(side, unit) for side in sides]
        every = np.ones((1,) * self.dimensions, dtype=bool)
        for sign, a, b in zip(signs, arrays, arrays[1:], strict=False):
            every = every & self._truth(sign, a, b, unit)
        return every

    def _side(self) -> str:
        if self.at == len(self.words) or self.words[self.at] in (*_TRUTHS, "and", "or", ")"):
            raise _Wrong(f"something is missing in '{self.text}'")
        self.at += 1
        return self.words[self.at - 1]

    def _values(self, side: str, unit: str) -> np.ndarray:
        match = _FACTOR.fullmatch(side)
        if match and match["name"] in self.columns:
            column = self.columns[match["name"]]
            values = column.values
            if match["factor"] and not unit:
                raise _Wrong(f"{match['name']} holds words, in '{self.text}'")
            if match["factor"]:
                try:
                    values = float(match["factor"]) * values
                except ValueError:
                    raise _Wrong(f"'{match['factor']}' is no number in '{self.text}'") from None
            shape = [1] * self.dimensions
            shape[column.axis] = -1
            return values.reshape(shape)
        if not unit:
            return np.array(side.strip("'\"")).reshape((1,) * self.dimensions)
        try:
            value = parse_quantity(side, unit)
            if unit == "rad" and value and bare(side):
                raise UnitError(f"an angle of {side} lacks its unit; give {side} deg or {side} rad")
        except UnitError as error:
            like = nearest(side, self.columns)
            hint = f"; did you mean '{like}'?" if like else ""
            raise _Wrong(f"{error}{hint}, in '{self.text}'") from None
        return np.array(value).reshape((1,) * self.dimensions)

    def _truth(self, sign: str, a: np.ndarray, b: np.ndarray, unit: str) -> np.ndarray:
        if not unit:
            if sign not in ("==", "!="):
                raise _Wrong(f"words are compared by == and != in '{self.text}'")
            return np.asarray(a == b) if sign == "==" else np.asarray(a != b)
        # numbers that differ by round-off are the same
        same = np.isclose(a, b, rtol=1e-9, atol=0.0)
        if sign in ("==", "!="):
            found: np.ndarray = same if sign == "==" else ~same & ~np.isnan(a - b)
            return found
        strict = np.asarray(_TRUTHS[sign](a, b))
        found = (strict | same) if sign.endswith("=") else (strict & ~same)
        return found
