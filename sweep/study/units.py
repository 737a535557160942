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
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

from demflow.sweep.printable import shortened

LONGEST_TEXT = 200  # characters of a quantity; what is longer is a mistake
LIKE = 0.6  # likeness of two names (difflib) from which on one may stand for the other

Dimension = tuple[int, int, int, int, int]  # powers of kg, m, s, rad, byte


class UnitError(ValueError):
    """A text that is no quantity, or a quantity of the wrong dimension."""


class UnknownUnit(UnitError):
    """A unit with a name that is not in the table."""

    def __init__(self, name: str):
        self.name = name
        super().__init__(f"unknown unit '{name}'")


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
_RATE: Dimension = (0, 3, -1, 0, 0)

_INCH = Fraction("0.0254")
_POUND = Fraction("0.45359237")
_ATMOSPHERE = Fraction(101325)
_PSI = _POUND * Fraction("9.80665") / _INCH**2
# 1 darcy passes 1 cm³/s of 1 cP through 1 cm² under 1 atm/cm
_DARCY = Fraction("1e-3") * Fraction("1e-6") / Fraction("1e-4") * Fraction("1e-2") / _ATMOSPHERE

_BARREL = 42 * 231 * _INCH**3
_STANDARD_GRAVITY = Fraction("9.80665")

# names, factor to SI, dimension, prefixes that are in use with the first name; words may begin
# with a capital
_DEFINITIONS: tuple[tuple[str, Fraction, Dimension, str], ...] = (
    ("%", Fraction(1, 100), _NUMBER, ""),
    ("g gram grams", Fraction(1, 1000), _MASS, "kmu"),
    ("t tonne tonnes", Fraction(1000), _MASS, ""),
    ("lb", _POUND, _MASS, ""),
    ("m metre metres meter meters", Fraction(1), _LENGTH, "kcmun"),
    ("micron microns", Fraction(1, 10**6), _LENGTH, ""),
    ("ft foot feet", 12 * _INCH, _LENGTH, ""),
    ("in inch inches", _INCH, _LENGTH, ""),
    ("s sec second seconds", Fraction(1), _TIME, "mun"),
    ("min minute minutes", Fraction(60), _TIME, ""),
    ("h hr hour hours", Fraction(3600), _TIME, ""),
    ("d day days", Fraction(86400), _TIME, ""),
    ("wk week weeks", Fraction(7 * 86400), _TIME, ""),
    ("yr year years", Fraction(86400) * Fraction("365.25"), _TIME, ""),
    ("rad radian radians", Fraction(1), _ANGLE, "m"),
    ("deg degree degrees °", Fraction(math.pi) / 180, _ANGLE, ""),
    ("N", Fraction(1), _FORCE, "kMG"),
    ("lbf", _POUND * _STANDARD_GRAVITY, _FORCE, ""),
    ("kgf", _STANDARD_GRAVITY, _FORCE, ""),
    ("dyn dyne dynes", Fraction(1, 10**5), _FORCE, ""),
    ("Pa pascal pascals", Fraction(1), _PRESSURE, "umhkMG"),
    ("bar", Fraction(10**5), _PRESSURE, "mk"),
    ("atm", _ATMOSPHERE, _PRESSURE, ""),
    ("psi PSI psia PSIA", _PSI, _PRESSURE, "kM"),
    ("ksi", 1000 * _PSI, _PRESSURE, ""),
    ("P poise", Fraction(1, 10), _VISCOSITY, "mc"),
    ("cp", Fraction(1, 1000), _VISCOSITY, ""),
    ("Pas", Fraction(1), _VISCOSITY, "m"),
    ("D darcy darcies", _DARCY, _AREA, "mun"),
    ("md millidarcy millidarcies", _DARCY / 1000, _AREA, ""),
    ("L l litre litres liter liters", Fraction(1, 1000), _VOLUME, "m"),
    ("ml cc", Fraction(1, 10**6), _VOLUME, ""),
    ("gal gallon gallons", 231 * _INCH**3, _VOLUME, ""),
    ("bbl BBL barrel barrels", _BARREL, _VOLUME, ""),
    ("bpd BPD", _BARREL / 86400, _RATE, ""),
    ("bpm BPM", _BARREL / 60, _RATE, ""),
    ("gpm GPM", 231 * _INCH**3 / 60, _RATE, ""),
    ("B byte bytes", Fraction(1), _MEMORY, "kMGT"),
    ("KiB", Fraction(2**10), _MEMORY, ""),
    ("MiB", Fraction(2**20), _MEMORY, ""),
    ("GiB", Fraction(2**30), _MEMORY, ""),
)


def _table() -> dict[str, Unit]:
    units: dict[str, Unit] = {}
    for names, factor, dimension, prefixes in _DEFINITIONS:
        first, *others = names.split()
        words = [name.capitalize() for name in others if name.islower() and len(name) > 3]
        symbols = {name: factor for name in (first, *others, *words)}
        symbols |= {prefix + first: _PREFIX[prefix] * factor for prefix in prefixes}
        for symbol, value in symbols.items():
            assert symbol not in units, symbol
            units[symbol] = Unit(value, dimension)
    return units


UNITS = _table()

_SURFACE = "{} is measured at the surface; multiply by the formation volume factor and give {}"
# names that the field knows and that have no one meaning here, and what to write
_REFUSED: dict[str, str] = {
    "stb": _SURFACE.format("a stock-tank barrel", "bbl"),
    **dict.fromkeys(
        ("scf", "mscf", "mmscf", "scm"), _SURFACE.format("a standard volume of gas", "m3 or ft3")
    ),
    "psig": "psig counts from the pressure of the air; add 14.7 and give psi, or give all "
    "pressures from there, in psi",
    "barg": "barg counts from the pressure of the air; add 1 and give bar, or give all pressures "
    "from there, in bar",
    **dict.fromkeys(("month", "months"), "a month has 28 to 31 days; give d"),
}

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
_COMMA = re.compile(r"([-+]?\d+),(\d+(?:[.,]\d+)*)\s*(.*)", re.DOTALL)
_TOKEN = re.compile(
    r"(?P<name>[A-Za-z°%]+)(?:(?:\^|\*\*)?(?P<power>[-+]?\d))?(?!\d)|[*/()]|1(?!\d)"
)
_SUPERSCRIPT = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻µμ·⋅×", "0123456789-uu***")


def parse_quantity(
    value: str | float, unit: str, name: str = "", example: str | None = None
) -> float:
    """A quantity in SI.

    Parameters
    ----------
    value : a number, which is SI already, or a text such as `5 mD`, `1 bbl/day`, `2e-5 m3/s`.
    unit : the SI unit of what is wanted ("1" for a plain number, "rad" for an angle).
    name : what the quantity is for; it stands in the message.
    example : a quantity that would do, for the message; by default one of that unit.

    Raises
    ------
    UnitError : no number, unknown unit (with the nearest valid one), wrong dimension
        (with what is expected and an example), or a number that is not finite.
    """
    known = _number_in_si(value, unit) if isinstance(value, str) else None
    if known is not None:
        return known
    expected = _expectation(unit, name, example)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise UnitError(f"{value!r} is not a quantity; {expected}")
    return _read(str(value).strip(), unit, expected)


@lru_cache(maxsize=1 << 14)
def _number_in_si(text: str, unit: str) -> float | None:
    """A quantity in SI, None where it is none: studies repeat theirs in many variants."""
    try:
        return _read(text.strip(), unit, "")
    except UnitError:
        return None


def _read(text: str, unit: str, expected: str) -> float:
    """A quantity in SI; `expected` says in messages what is wanted."""
    match = _QUANTITY.fullmatch(text) if len(text) <= LONGEST_TEXT else None
    if match is None:
        if text.lstrip("+-.").lower() in ("inf", "infinity", "nan"):
            raise UnitError(f"{text} is not a finite number")
        raise UnitError(f"'{shortened(text, 40)}' is not a number; {expected}")
    factor = _factor_to_si(match["unit"].strip(), text, unit, expected)
    exact = Fraction(match["number"]) * factor
    try:
        result = float(exact)
    except OverflowError:
        raise UnitError(f"{text} is too large for a number") from None
    if exact != 0 and result == 0.0:
        raise UnitError(f"{text} is too small for a number; write 0 if you mean none")
    return result


def _factor_to_si(suffix: str, text: str, unit: str, expected: str) -> Fraction:
    """Factor of what follows the number of a quantity; raises as `parse_quantity` does."""
    if not suffix:
        return Fraction(1)
    if comma := decimal_comma(text):
        raise UnitError(f"'{text}': {comma}; {expected}")
    wanted = parse_unit(unit).dimension
    try:
        given = parse_unit(suffix)
    except UnknownUnit as error:
        if refused := _REFUSED.get(error.name.lower()):
            raise UnitError(f"'{text}': {refused}") from None
        hint = _meant(error.name, suffix, wanted)
        raise UnitError(f"{error}{hint} in '{text}'; {expected}") from None
    except UnitError as error:
        raise UnitError(f"{error} in '{text}'; {expected}") from None
    if given.dimension != wanted:
        by_day = _with_name(suffix, "D", "day")  # a day in bbl/D, where no permeability fits
        if by_day is None or by_day.dimension != wanted:
            raise UnitError(f"{text} is {_meaning(given.dimension)}; {expected}")
        return by_day.factor
    return given.factor


def decimal_comma(text: str) -> str:
    """What to write instead of a number with a comma, "" for any other text."""
    match = _COMMA.fullmatch(text)
    if match is None:
        return ""
    whole, rest, unit = match.groups()
    unit = f" {unit}" if unit else ""
    readings = [] if re.search(r"[.,]", rest) else [f"{whole}.{rest}{unit}"]
    if re.fullmatch(r"\d{3}(,\d{3})*(\.\d+)?", rest) and whole.lstrip("+-0"):
        readings.append(f"{whole}{rest.replace(',', '')}{unit}")
    hint = f": {' or '.join(readings)}" if readings else ""
    return f"decimals take a point, and thousands nothing{hint}"


def _meant(name: str, text: str, wanted: Dimension) -> str:
    """A hint at the unit that an unknown name stands for: of the dimension that is wanted.

    Names that differ by their case alone are all told. Of others one is, if it is the nearest,
    and no other of the same likeness has another size; a prefix more or less is another size.
    """
    of_dimension = {dimension: symbol for symbol, (_, dimension) in UNITS.items()}
    replaced = {one: _with_name(text, name, symbol) for one, symbol in of_dimension.items()}
    fits = {one for one, unit in replaced.items() if unit is not None and unit[1] == wanted}
    valid = [symbol for symbol, (_, dimension) in UNITS.items() if dimension in fits]
    same = [symbol for symbol in valid if symbol.lower() == name.lower()]
    same = list({UNITS[symbol].factor: symbol for symbol in same}.values())
    if not same:
        prefixed = {name[1:]} | {prefix + name for prefix in _PREFIX}
        near = {one: _likeness(name, one) for one in valid if one not in prefixed}
        best = max(near.values(), default=0.0)
        same = [one for one, likeness in near.items() if likeness == best >= LIKE]
        if len({UNITS[one].factor for one in same}) > 1:
            return ""
        same = same[:1]
    return f" (did you mean {' or '.join(map(repr, same))}?)" if same else ""


def _with_name(text: str, name: str, symbol: str) -> Unit | None:
    """The unit that a text is with one of its names replaced, None where it is none."""
    try:
        return parse_unit(re.sub(rf"(?<![A-Za-z]){re.escape(name)}(?![A-Za-z])", symbol, text))
    except UnitError:
        return None


@lru_cache(maxsize=1024)
def parse_unit(text: str) -> Unit:
    """Factor to SI and dimension of a unit such as `kg/m3`, `Pa s`, `1/Pa`, `m^2`, `m3/(s Pa)`.

    Raises UnitError where a name is unknown or the expression cannot be read.
    """
    plain = re.sub(r"(?<=[⁰¹²³⁴-⁹])(?=[A-Za-z])", " ", text).translate(_SUPERSCRIPT)
    plain = re.sub(r"(?<=[A-Za-z0-9)])\.(?=[A-Za-z(])", "*", plain)  # Pa.s
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


FIELD_WORDS = {  # as others call what has a name here
    **dict.fromkeys(("bhp", "flowing_pressure", "pwf"), "pressure"),
    **dict.fromkeys(("min_bhp", "bhp_min", "minimum_bhp", "min_pressure"), "least_pressure"),
    **dict.fromkeys(("max_bhp", "bhp_max", "maximum_bhp", "max_pressure"), "largest_pressure"),
    **dict.fromkeys(("lhs", "latin_hypercube", "sobol"), "distribution"),
    **dict.fromkeys(("perm", "k"), "permeability"),
    **dict.fromkeys(("poro", "phi"), "porosity"),
    "compliance": "compressibility",
    "position": "at",
}


def nearest(name: str, valid: Iterable[str]) -> str | None:
    """The valid name that a given one most likely stands for, or None if none is like it.

    One that differs by its case, or is called so by others; the only one of which it is the first
    or the last words (`skin` of `skin_factor`); else the one that is spelt most like it.
    """
    names = list(valid)
    folded = FIELD_WORDS.get(name.lower(), name.lower())
    same = [known for known in names if known.lower() == folded]
    if same:
        return same[0]
    part = [known for known in names if f"_{known}_".find(f"_{folded}_") >= 0]
    if len(part) == 1:
        return part[0]
    close = difflib.get_close_matches(name, names, n=1, cutoff=LIKE)
    return close[0] if close else None


def _likeness(a: str, b: str) -> float:
    return difflib.SequenceMatcher(None, a, b).ratio()


def to_degrees(angle: float) -> float:
    """An angle in degrees, rounded to 12 digits, so that `65 deg` comes back as 65."""
    return float(f"{math.degrees(angle):.12g}")


def format_quantity(value: float, unit: str, digits: int = 6) -> str:
    """A value in SI as people write it: `1.1345` rad is `65 deg`, `5e6` Pa is `5 MPa`.

    Parameters
    ----------
    value : in SI
    unit : SI unit
    digits : significant digits
    """
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


def bare(text: str) -> bool:
    """Whether a quantity is written without a unit."""
    match = _QUANTITY.fullmatch(text.strip())
    return match is not None and not match["unit"].strip()


def in_unit_of(text: str, unit: str) -> Callable[[float], str]:
    """How a value in SI is shown to whoever wrote that quantity: in the unit that was used."""
    match = _QUANTITY.fullmatch(text.strip())
    own = match["unit"].strip() if match else ""
    factor = _factor_to_si(own, text, unit, "")
    shown = own or ("" if unit == "1" else unit)

    def show(value: float) -> str:
        scaled = float(Fraction(value) / factor) if math.isfinite(value) else value
        return f"{scaled:.6g}{shown}" if shown == "%" else f"{scaled:.6g} {shown}".strip()

    return show


def describe(value: Any, unit: str) -> str:
    """A value for people: a word as it is, a list (a point, a schedule) in its units."""
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        units = unit.split(", ")  # one for each value of an innermost list
        if len(units) != len(value) or any(isinstance(part, tuple) for part in value):
            units = [unit] * len(value)
        return "[" + ", ".join(map(describe, value, units)) + "]"
    return "none" if value is None else format_quantity(value, unit, digits=12)


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


def _expectation(unit: str, name: str, one: str | None) -> str:
    words = _MEANING[unit][0] if unit in _MEANING else f"in {unit}"
    subject = f"{name} is {words}" if name else f"{words} is wanted"
    return f"{subject}, for instance {one or example(unit)}"


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
        raise UnknownUnit(name)
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
