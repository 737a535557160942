"""Quantities with units: the field's units by their definitions, read into SI.

General unit libraries read several of the field's symbols wrongly (`mD` as millidebye,
`md` as milliday, `bbl` as 31.5 gallons), so this module holds one small table of its own.
Factors are exact rationals and a value is rounded once: `20 um` and `2e-5` are the
same number.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

LONGEST_TEXT = 200  # characters of a quantity; what is longer is a mistake

Dimension = tuple[int, int, int, int, int]  # powers of kg, m, s, rad, byte


class UnitError(ValueError):
    """A text that is no quantity, or a quantity of the wrong dimension."""


class Unit(NamedTuple):
    """A factor to SI and the dimension that it carries."""

    factor: Fraction
    dimension: Dimension


_PREFIX = {
    "n": Fraction(1, 10**9),
    "u": Fraction(1, 10**6),
    "m": Fraction(1, 1000),
    "c": Fraction(1, 100),
    "h": Fraction(100),
    "k": Fraction(10**3),
    "M": Fraction(10**6),
    "G": Fraction(10**9),
    "T": Fraction(10**12),
}

_NUMBER: Dimension = (0, 0, 0, 0, 0)
_MASS: Dimension = (1, 0, 0, 0, 0)
_LENGTH: Dimension = (0, 1, 0, 0, 0)
_AREA: Dimension = (0, 2, 0, 0, 0)
_VOLUME: Dimension = (0, 3, 0, 0, 0)
_TIME: Dimension = (0, 0, 1, 0, 0)
_ANGLE: Dimension = (0, 0, 0, 1, 0)
_MEMORY: Dimension = (0, 0, 0, 0, 1)
_FORCE: Dimension = (1, 1, -2, 0, 0)
_PRESSURE: Dimension = (1, -1, -2, 0, 0)
_VISCOSITY: Dimension = (1, -1, -1, 0, 0)

_INCH = Fraction("0.0254")
_POUND = Fraction("0.45359237")
_ATMOSPHERE = Fraction(101325)
_PSI = _POUND * Fraction("9.80665") / _INCH**2
# 1 darcy passes 1 cm³/s of 1 cP through 1 cm² under 1 atm/cm
_DARCY = Fraction("1e-3") * Fraction("1e-6") / Fraction("1e-4") * Fraction("1e-2") / _ATMOSPHERE

# names, factor to SI, dimension, prefixes that are in use with the first name
_DEFINITIONS: tuple[tuple[str, Fraction, Dimension, str], ...] = (
    ("%", Fraction(1, 100), _NUMBER, ""),
    ("g gram grams", Fraction(1, 1000), _MASS, "kmu"),
    ("t tonne tonnes", Fraction(1000), _MASS, ""),
    ("lb", _POUND, _MASS, ""),
    ("m metre metres meter meters", Fraction(1), _LENGTH, "kcmun"),
    ("ft foot feet", 12 * _INCH, _LENGTH, ""),
    ("in inch inches", _INCH, _LENGTH, ""),
    ("s sec second seconds", Fraction(1), _TIME, "mun"),
    ("min minute minutes", Fraction(60), _TIME, ""),
    ("h hr hour hours", Fraction(3600), _TIME, ""),
    ("d day days", Fraction(86400), _TIME, ""),
    ("yr year years", Fraction(86400) * Fraction("365.25"), _TIME, ""),
    ("rad radian radians", Fraction(1), _ANGLE, "m"),
    ("deg degree degrees °", Fraction(math.pi) / 180, _ANGLE, ""),
    ("N", Fraction(1), _FORCE, "kMG"),
    ("lbf", _POUND * Fraction("9.80665"), _FORCE, ""),
    ("Pa", Fraction(1), _PRESSURE, "uhkMG"),
    ("bar", Fraction(10**5), _PRESSURE, "mk"),
    ("atm", _ATMOSPHERE, _PRESSURE, ""),
    ("psi", _PSI, _PRESSURE, "kM"),
    ("ksi", 1000 * _PSI, _PRESSURE, ""),
    ("P poise", Fraction(1, 10), _VISCOSITY, "mc"),
    ("cp", Fraction(1, 1000), _VISCOSITY, ""),
    ("D darcy darcies", _DARCY, _AREA, "mun"),
    ("md millidarcy millidarcies", _DARCY / 1000, _AREA, ""),
    ("L l litre litres liter liters", Fraction(1, 1000), _VOLUME, "m"),
    ("gal", 231 * _INCH**3, _VOLUME, ""),
    ("bbl barrel barrels", 42 * 231 * _INCH**3, _VOLUME, ""),
    ("B byte bytes", Fraction(1), _MEMORY, "kMGT"),
    ("KiB", Fraction(2**10), _MEMORY, ""),
    ("MiB", Fraction(2**20), _MEMORY, ""),
    ("GiB", Fraction(2**30), _MEMORY, ""),
)


def _table() -> dict[str, Unit]:
    units: dict[str, Unit] = {}
    for names, factor, dimension, prefixes in _DEFINITIONS:
        first, *others = names.split()
        symbols = {name: factor for name in (first, *others)}
        symbols |= {prefix + first: _PREFIX[prefix] * factor for prefix in prefixes}
        for symbol, value in symbols.items():
            assert symbol not in units, symbol
            units[symbol] = Unit(value, dimension)
    return units


UNITS = _table()

# unit as the scene declares it -> what it measures, an example for messages
_MEANING: dict[str, tuple[str, str]] = {
    "1": ("a plain number", "0.5"),
    "kg": ("a mass", "5 kg"),
    "m": ("a length", "5 m"),
    "s": ("a time", "1 h"),
    "rad": ("an angle", "20 deg"),
    "B": ("a size of memory", "4 GB"),
    "m2": ("a permeability", "5 mD"),
    "m3": ("a volume", "1 bbl"),
    "m/s": ("a velocity", "1 mm/s"),
    "m2/s": ("a diffusivity", "1 m2/s"),
    "m3/s": ("a volume rate", "2e-5 m3/s"),
    "1/s": ("a frequency", "5 1/s"),
    "Pa": ("a pressure", "10 MPa"),
    "1/Pa": ("a compressibility", "1e-9 1/Pa"),
    "m3/Pa": ("a volume per pressure", "1e-9 m3/Pa"),
    "Pa/m": ("a pressure gradient", "10 kPa/m"),
    "Pa s": ("a viscosity", "1 cP"),
    "N": ("a force", "5 kN"),
    "N/m": ("a force per length", "5 MN/m"),
    "kg/m3": ("a density", "2650 kg/m3"),
}

# SI unit -> units for people, largest first
_DISPLAY: dict[str, tuple[str, ...]] = {
    "rad": ("deg",),
    "m": ("m", "mm", "um"),
    "s": ("s",),
    "B": ("GB", "MB", "B"),
    "m2": ("mD",),
    "Pa": ("GPa", "MPa", "kPa", "Pa"),
    "N/m": ("GN/m", "MN/m", "kN/m", "N/m"),
}

_NUMBER_PATTERN = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3}(?![\d.]))?"
_QUANTITY = re.compile(rf"(?P<number>{_NUMBER_PATTERN})(?P<unit>.*)", re.DOTALL)
QUANTITY_PATTERN = rf"^\s*{_NUMBER_PATTERN}\s*([A-Za-z°µμ%/(1].*)?$"  # for editors
_TOKEN = re.compile(
    r"(?P<name>[A-Za-z°%]+)(?:(?:\^|\*\*)?(?P<power>[-+]?\d))?(?!\d)|[*/()]|1(?!\d)"
)
_SUPERSCRIPT = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻µμ·⋅×", "0123456789-uu***")


def parse_quantity(value: str | float, unit: str, name: str = "") -> float:
    """A quantity in SI.

    Parameters
    ----------
    value : a number, which is SI already, or a text such as `5 mD`, `1 bbl/day`, `2e-5 m3/s`.
    unit : the SI unit of what is wanted ("1" for a plain number, "rad" for an angle).
    name : what the quantity is for; it stands in the message.

    Raises
    ------
    UnitError : no number, unknown unit (with the nearest valid one), wrong dimension
        (with what is expected and an example), or a number that is not finite.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise UnitError(f"{value!r} is not a quantity; {_expectation(unit, name)}")
    text = str(value).strip()
    match = _QUANTITY.fullmatch(text) if len(text) <= LONGEST_TEXT else None
    if match is None:
        shown = text if len(text) <= 40 else text[:37] + "..."
        if text.lstrip("+-.").lower() in ("inf", "infinity", "nan"):
            raise UnitError(f"{text} is not a finite number")
        raise UnitError(f"'{shown}' is not a number; {_expectation(unit, name)}")
    suffix = match["unit"].strip()
    factor = Fraction(1)
    if suffix:
        try:
            given = parse_unit(suffix)
        except UnitError as error:
            raise UnitError(f"{error} in '{text}'; {_expectation(unit, name)}") from None
        if given.dimension != parse_unit(unit).dimension:
            meaning = _meaning(given.dimension)
            raise UnitError(f"{text} is {meaning}; {_expectation(unit, name)}")
        factor = given.factor
    exact = Fraction(match["number"]) * factor
    try:
        result = float(exact)
    except OverflowError:
        raise UnitError(f"{text} is too large for a number") from None
    if exact != 0 and result == 0.0:
        raise UnitError(f"{text} is too small for a number; write 0 if you mean none")
    return result


@lru_cache(maxsize=1024)
def parse_unit(text: str) -> Unit:
    """Factor to SI and dimension of a unit such as `kg/m3`, `Pa s`, `1/Pa`, `m^2`, `m3/(s Pa)`.

    Raises UnitError where a name is unknown or the expression cannot be read.
    """
    plain = re.sub(r"(?<=[⁰¹²³⁴-⁹])(?=[A-Za-z])", " ", text).translate(_SUPERSCRIPT)
    tokens: list[re.Match[str]] = []
    position = 0
    while position < len(plain):
        if plain[position].isspace():
            position += 1
            continue
        token = _TOKEN.match(plain, position)
        if token is None:
            raise UnitError(f"cannot read the unit '{text}'")
        tokens.append(token)
        position = token.end()
    unit, end = _product(tokens, 0, text)
    if end != len(tokens):
        raise UnitError(f"cannot read the unit '{text}'")
    return unit


def nearest(name: str, valid: Iterable[str]) -> str | None:
    """The valid name that is most like a given one, or None if none is like it."""
    names = list(valid)
    same = [known for known in names if known.lower() == name.lower()]
    if same:
        return same[0]
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    return close[0] if close else None


def to_degrees(angle: float) -> float:
    """An angle in degrees, rounded to 12 digits, so that `65 deg` comes back as 65."""
    return float(f"{math.degrees(angle):.12g}")


def format_quantity(value: float, unit: str, digits: int = 6) -> str:
    """A value in SI as people write it: `1.1345` rad is `65 deg`, `5e6` Pa is `5 MPa`."""
    if unit == "1":
        return f"{value:.{digits}g}"
    if not math.isfinite(value):
        return f"{value} {unit}"
    choices = _DISPLAY.get(unit, (unit,))
    for choice in choices:
        scaled = float(Fraction(value) / parse_unit(choice).factor)
        if abs(scaled) >= 1 or choice == choices[-1]:
            break
    if scaled == 0.0:
        choice = choices[0]
    return f"{scaled:.{digits}g} {choice}"


def describe(value: Any, unit: str) -> str:
    """A value for people: a word as it is, a list (a point, a schedule) in its units."""
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        units = unit.split(", ")  # one for each value of an innermost list
        if len(units) != len(value) or any(isinstance(part, tuple) for part in value):
            units = [unit] * len(value)
        return "[" + ", ".join(map(describe, value, units)) + "]"
    return str(value) if value is None else format_quantity(value, unit, digits=12)


def example(unit: str) -> str:
    """A quantity of that unit, as an example for messages and help."""
    return _MEANING[unit][1] if unit in _MEANING else f"1 {unit}"


def _meaning(dimension: Dimension) -> str:
    """What a dimension measures, in words where the field has a word."""
    for unit, (words, _) in _MEANING.items():
        if parse_unit(unit).dimension == dimension:
            return words
    powers = zip(("kg", "m", "s", "rad", "B"), dimension, strict=True)
    return "in " + " ".join(
        f"{base}^{power}" if power != 1 else base for base, power in powers if power
    )


def _expectation(unit: str, name: str) -> str:
    words = _MEANING[unit][0] if unit in _MEANING else f"in {unit}"
    subject = f"{name} is {words}" if name else f"{words} is wanted"
    return f"{subject}, for instance {example(unit)}"


def _product(tokens: list[re.Match[str]], at: int, text: str) -> tuple[Unit, int]:
    """Read factors joined by `*`, `/` or a space, up to the end or a closing bracket."""
    unit = Unit(Fraction(1), _NUMBER)
    divided = False
    first = True
    while at < len(tokens) and tokens[at][0] != ")":
        sign = 1
        if tokens[at][0] in ("*", "/"):
            if tokens[at][0] == "*" and first:
                raise UnitError(f"cannot read the unit '{text}'")
            sign = -1 if tokens[at][0] == "/" else 1
            divided = divided or sign == -1
            at += 1
        elif divided:
            raise UnitError(f"the unit '{text}' can be read in two ways (bracket the divisor)")
        factor, at = _factor(tokens, at, text)
        unit = Unit(
            unit.factor * factor.factor**sign,
            _combine(unit.dimension, factor.dimension, sign),
        )
        first = False
    if first:
        raise UnitError(f"cannot read the unit '{text}'")
    return unit, at


def _factor(tokens: list[re.Match[str]], at: int, text: str) -> tuple[Unit, int]:
    """Read one factor: a name with its power, 1, or a bracket."""
    token = tokens[at] if at < len(tokens) else None
    if token is not None and token[0] == "(":
        unit, end = _product(tokens, at + 1, text)
        if end == len(tokens):
            raise UnitError(f"a bracket stays open in the unit '{text}'")
        return unit, end + 1
    if token is not None and token[0] == "1":
        return Unit(Fraction(1), _NUMBER), at + 1
    if token is None or token["name"] is None:
        raise UnitError(f"cannot read the unit '{text}'")
    name = token["name"]
    if name not in UNITS:
        like = nearest(name, UNITS)
        hint = f" (did you mean '{like}'?)" if like else ""
        raise UnitError(f"unknown unit '{name}'{hint}")
    power = int(token["power"] or 1)
    base = UNITS[name]
    return Unit(base.factor**power, _combine(_NUMBER, base.dimension, power)), at + 1


def _combine(a: Dimension, b: Dimension, power: int) -> Dimension:
    """The dimension of a b^power."""
    return (
        a[0] + power * b[0],
        a[1] + power * b[1],
        a[2] + power * b[2],
        a[3] + power * b[3],
        a[4] + power * b[4],
    )
