"""Quantities: by the definitions of the units, and wrong ones by a clear refusal."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demflow.sweep.study.units import (
    UNITS,
    UnitError,
    describe,
    format_quantity,
    nearest,
    parse_quantity,
    parse_unit,
    to_degrees,
)

DEFINITIONS = [
    ("1 D", "m2", 1e-7 / 101325),  # 1 cP cm²/s/atm
    ("1 darcy", "m2", 9.869233e-13),
    ("1 mD", "m2", 9.869233e-16),
    ("1 md", "m2", 9.869233e-16),
    ("1 bbl", "m3", 0.158987294928),
    ("1 bbl/day", "m3/s", 0.158987294928 / 86400),
    ("7.42 bbl/d", "m3/s", 7.42 * 0.158987294928 / 86400),
    ("1 gal", "m3", 3.785411784e-3),
    ("1 psi", "Pa", 6894.757293168),
    ("1 kpsi", "Pa", 6894757.293168),
    ("1 atm", "Pa", 101325.0),
    ("1 bar", "Pa", 1e5),
    ("1 cP", "Pa s", 1e-3),
    ("1 cp", "Pa s", 1e-3),
    ("1 ft", "m", 0.3048),
    ("1 in", "m", 0.0254),
    ("1 yr", "s", 365.25 * 86400),
    ("1 d", "s", 86400.0),
    ("1 min", "s", 60.0),
    ("1 hr", "s", 3600.0),
    ("1 lb/ft3", "kg/m3", 16.018463373960142),
    ("6.89e-6 1/psi", "1/Pa", 6.89e-6 / 6894.757293168),
    ("180 deg", "rad", math.pi),
    ("90°", "rad", math.pi / 2),
    ("4 GB", "B", 4e9),
    ("4 GiB", "B", 4 * 2**30),
    ("16 %", "1", 0.16),
]


@pytest.mark.parametrize(("text", "unit", "value"), DEFINITIONS)
def test_field_units_follow_their_definitions(text, unit, value):
    assert parse_quantity(text, unit) == pytest.approx(value, rel=3e-7, abs=0)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        (7, "m", 7.0),
        (2.5, "Pa", 2.5),
        ("1e-3", "1", 1e-3),
        ("20 um", "m", 2e-5),
        ("100 µm", "m", 1e-4),
        ("100 μm", "m", 1e-4),
        ("100um", "m", 1e-4),
        ("1e3m", "m", 1e3),
        ("+.5 m", "m", 0.5),
        ("2e-5 m3/s", "m3/s", 2e-5),
        ("2e-5 m^3/s", "m3/s", 2e-5),
        ("2e-5 m**3 s-1", "m3/s", 2e-5),
        ("2e-5 m³·s⁻¹", "m3/s", 2e-5),
        ("1 kg m⁻¹s⁻¹", "Pa s", 1.0),
        ("1 Pa·s", "Pa s", 1.0),
        ("1 Pa*s", "Pa s", 1.0),
        ("1e-9 1/Pa", "1/Pa", 1e-9),
        ("1e-9/Pa", "1/Pa", 1e-9),
        ("1e-9 m3/(s Pa)", "m3/(s Pa)", 1e-9),
        ("5 MN/m", "N/m", 5e6),
        ("2.65 g/cm3", "kg/m3", 2650.0),
    ],
)
def test_notations_give_the_number_that_is_meant_to_the_last_bit(text, unit, value):
    assert parse_quantity(text, unit) == value


@pytest.mark.parametrize(
    ("text", "unit", "words"),
    [
        ("5 kg", "Pa", ["5 kg is a mass", "stress.xx is a pressure", "10 MPa"]),
        ("5 mD", "m", ["a permeability", "stress.xx is a length"]),
        ("5 md", "s", ["a permeability", "stress.xx is a time"]),
        ("5 m", "rad", ["a length", "an angle", "20 deg"]),
        ("5 deg", "1", ["an angle", "a plain number"]),
        ("5 mpa", "Pa", ["unknown unit 'mpa'", "did you mean 'mPa' or 'MPa'"]),
        ("5 darcys", "m2", ["unknown unit 'darcys'", "did you mean 'darcy'"]),
        ("5 qqq", "m", ["unknown unit 'qqq'", "a length"]),
        ("mD", "m2", ["'mD' is not a number", "5 mD"]),
        ("", "m", ["'' is not a number"]),
        ("5,3 m", "m", ["decimals take a point", "5.3 m;"]),
        ("12:30", "s", ["cannot read"]),
        ("0x10", "1", ["cannot read"]),
        ("1 m3/s m", "m2/s", ["two ways"]),
        ("5 (m", "m", ["bracket"]),
        ("5 m)", "m", ["cannot read"]),
        ("5 m/", "m", ["cannot read"]),
        ("5 m//s", "m/s", ["cannot read"]),
        ("5 m^23", "m", ["cannot read"]),
        ("1e999 m", "m", ["too large"]),
        ("1e-999 m", "m", ["too small"]),
        ("1e99999999999 m", "m", ["cannot read"]),
        ("9" * 5000, "m", ["is not a number"]),
        ("inf", "m", ["not a finite number"]),
        (".nan", "m", ["not a finite number"]),
        (math.nan, "m", ["not a finite number"]),
        (True, "1", ["True is not a quantity"]),
    ],
)
def test_a_wrong_quantity_is_refused_in_words(text, unit, words):
    with pytest.raises(UnitError) as caught:
        parse_quantity(text, unit, "stress.xx")
    for word in words:
        assert word in str(caught.value)


def test_the_traps_of_general_libraries():
    assert parse_unit("mD") == parse_unit("md")  # not millidebye, not milliday
    assert parse_unit("mD").dimension == parse_unit("m2").dimension
    assert parse_unit("min").dimension == parse_unit("s").dimension  # not milli-inch
    assert parse_unit("bbl").factor == 42 * parse_unit("gal").factor  # not 31.5
    assert parse_unit("d").factor == 24 * parse_unit("h").factor


finite = st.floats(allow_nan=False, allow_infinity=False)


@settings(deadline=None)
@given(finite)
def test_a_bare_number_is_si_and_keeps_its_bits(value):
    assert parse_quantity(value, "m") == value
    assert parse_quantity(repr(value), "m") == value


@settings(deadline=None)
@given(
    st.floats(min_value=1e-6, max_value=1e6),
    st.sampled_from([name for name in UNITS if name != "%"]),
)
def test_every_unit_scales_by_its_factor(value, name):
    dimension = UNITS[name].dimension
    si = " ".join(
        f"{base}{power}"
        for base, power in zip(("kg", "m", "s", "rad", "B"), dimension, strict=True)
        if power
    )
    expected = value * float(UNITS[name].factor)
    assert parse_quantity(f"{value!r} {name}", si) == pytest.approx(expected, rel=4e-16, abs=0)


@settings(deadline=None)
@given(
    st.floats(min_value=1e-12, max_value=1e12),
    st.sampled_from(["Pa", "m", "s", "m2", "rad", "m3/s", "Pa s", "N/m", "kg/m3", "B", "1"]),
)
def test_what_is_formatted_can_be_read_again(value, unit):
    assert parse_quantity(format_quantity(value, unit), unit) == pytest.approx(value, rel=1e-5)


@settings(deadline=None)
@given(st.integers(-360, 360))
def test_whole_degrees_come_back_whole(degrees):
    assert to_degrees(parse_quantity(f"{degrees} deg", "rad")) == degrees


@settings(deadline=None)
@given(st.text(max_size=60))
def test_any_text_is_a_number_or_a_unit_error(text):
    try:
        value = parse_quantity(text, "Pa")
    except UnitError:
        return
    assert math.isfinite(value)


def test_format_and_describe():
    assert format_quantity(parse_quantity("65 deg", "rad"), "rad") == "65 deg"
    assert format_quantity(5e6, "Pa") == "5 MPa"
    assert format_quantity(2e-5, "m") == "20 um"
    assert format_quantity(0.0, "m") == "0 m"
    assert describe((1.0, 0.0), "m") == "[1 m, 0 m]"
    assert describe(((0.0, 2e-5), (3600.0, 0.0)), "s, m3/s") == (
        "[[0 s, 2e-05 m3/s], [3600 s, 0 m3/s]]"
    )


def test_nearest_prefers_the_same_letters():
    assert nearest("mpa", ["Pa", "MPa", "GPa"]) == "MPa"
    assert nearest("viscocity", ["viscosity", "bulk_modulus"]) == "viscosity"
    assert nearest("zzz", ["viscosity"]) is None
