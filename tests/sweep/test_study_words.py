"""What is said of a mistake helps: the right unit, the nearest name, one problem for one slip."""

from __future__ import annotations

import functools
import random
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from study_text import SMALL, broken, load, problems

from demflow.model.region import Polygon
from demflow.sweep.study.load import StudyError, load_study
from demflow.sweep.study.units import UNITS, UnitError, nearest, parse_quantity, parse_unit
from tests.sweep.damaged_studies import damaged, studies


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("1 mPa s", "Pa s", 1e-3),
        ("1 mPa.s", "Pa s", 1e-3),
        ("1 Pa.s", "Pa s", 1.0),
        ("2 kg.m-3", "kg/m3", 2.0),
        ("5 mPa", "Pa", 5e-3),
        ("5 micron", "m", 5e-6),
        ("1 kgf", "N", 9.80665),
        ("1 kgf/cm2", "Pa", 98066.5),
        ("1 psia", "Pa", 6894.757293168),
        ("1 bpd", "m3/s", 0.158987294928 / 86400),
        ("1 bbl/D", "m3/s", 0.158987294928 / 86400),
        ("1 D", "m2", 9.869232667e-13),
        ("1 Darcy", "m2", 9.869232667e-13),
        ("1 ml/min", "m3/s", 1e-6 / 60),
        ("2 weeks", "s", 14 * 86400.0),
    ],
)
def test_units_of_the_field_with_one_meaning_are_read(text, unit, value):
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize(
    ("text", "unit", "said"),
    [
        ("5 STB", "m3", "formation volume factor"),
        ("5 STB/D", "m3/s", "formation volume factor"),
        ("5 Mscf/d", "m3/s", "formation volume factor"),
        ("5 psig", "Pa", "counts from the pressure of the air"),
        ("2 months", "s", "a month has 28 to 31 days"),
        ("5 mpa", "Pa", "did you mean 'mPa' or 'MPa'?"),
        ("0,1 m", "m", "decimals take a point, and thousands nothing: 0.1 m;"),
        ("1,200 m", "m", "decimals take a point, and thousands nothing: 1.200 m or 1200 m;"),
        ("1,200,300.5 m", "m", "thousands nothing: 1200300.5 m;"),
    ],
)
def test_units_with_several_meanings_are_refused_in_words(text, unit, said):
    with pytest.raises(UnitError) as caught:
        parse_quantity(text, unit)
    assert said in str(caught.value)


@settings(deadline=None)
@given(
    st.sampled_from(sorted(UNITS)),
    st.sampled_from(["m", "Pa", "Pa s", "s", "m2", "m3/s", "rad", "N/m", "1"]),
    st.integers(0, 8),
    st.sampled_from("aKmMxsd"),
)
def test_a_hint_is_of_the_dimension_that_is_wanted_and_of_no_other_size(name, unit, at, letter):
    """A known unit with a letter more, another letter, or a letter less."""
    at %= len(name)
    for misspelt in (name[:at] + letter + name[at:], name[:at] + name[at + 1 :]):
        try:
            parse_quantity(f"5 {misspelt}", unit)
        except UnitError as error:
            hints = re.findall(r"'([^']+)'(?= or|\?)", str(error).partition("did you mean")[2])
            for hint in hints:
                assert parse_unit(hint).dimension == parse_unit(unit).dimension
                # M and m are two sizes: both are told; else a prefix more or less is no hint
                assert hint.lower() == misspelt.lower() or hint not in (
                    misspelt[1:],
                    *(prefix + misspelt for prefix in "numchkMGT"),
                )
            sizes = {parse_unit(hint).factor for hint in hints}
            assert len(sizes) < 2 or len({hint.lower() for hint in hints}) == 1


def test_the_words_of_a_name_are_found_before_its_letters():
    keys = ("at", "radius", "rate", "skin_factor", "wellbore_storage", "pressure")
    assert nearest("skin", keys) == "skin_factor"
    assert nearest("storage", keys) == "wellbore_storage"
    assert nearest("Rate", keys) == "rate"
    assert nearest("radus", keys) == "radius"
    assert nearest("colour", keys) is None


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("angle: 65 deg", "angle: 65", "an angle of 65 lacks its unit; give 65 deg or 65 rad"),
        ("angle: 65 deg", "angle: 0.5", "give 0.5 deg or 0.5 rad"),
        ("2 m, aperture: 100 um", "2 m, aperture: 100", "100 lacks its unit: a number without"),
        ("porosity: 0.17", "porosity: 17", "17 is above 0.22"),
        ("porosity: 0.17", "porosity: 17", "did you mean 17 %?"),
        ("radius: 1 ft", "radius: -1 ft", "-1 ft is not above 0 ft"),
        ("permeability: 1 mD", "permeability: -5 mD", "-5 mD is not above 0 mD"),
        ("rate: 1 bbl/day", "rate: 1 bbl/day, skin: 3", "did you mean 'skin_factor'?"),
        ("rate: 1 bbl/day", "rate: 1 bbl/day, skin_factor: -1000", "-1000 is below -20"),
        (", bulk_modulus: 1 GPa", "", "for instance 2.2 GPa"),
        ("radius: 1 ft", "radius: 0,3 m", "a comma parts keys, decimals take a point"),
        ("at: [3, 0]", "at: [3,5, 0]", "a comma parts values, decimals take a point"),
        ("width: 14 m", "width: 1e160 m", "1e+160 m is beyond 1e+09 m"),
        ("spacing: 2 m", "spacing: 1e-300 m", "1e-300 m is below 1e-12 m"),
        ("count: 500", "mean_radius: 1e8 m", "a grain of 1e+08 m is larger than the region"),
        ("count: 500", "mean_radius: 1 um", "grains in the region, more than 2,000,000"),
        ("  yy: {parameter", "  method: {parameter", "an argument of xarray's sel"),
    ],
)
def test_one_slip_is_one_problem_that_says_what_to_write(tmp_path, old, new, said):
    found = problems(tmp_path, broken(old, new))
    assert any(said in line for line in found), found
    if "0,3" not in new:  # which is two entries, of which neither can be what was meant
        assert len(found) == 1, found


@pytest.mark.parametrize("axis", ["values: [0, 45]", "from: 0, to: 90 deg, count: 3"])
def test_a_bare_angle_of_an_axis_is_read_where_it_is_none(tmp_path, axis):
    text = broken("vary:\n", f"vary:\n  a: {{parameter: fractures.natural.angle, {axis}}}\n")
    found = problems(tmp_path, text)
    assert found == ([] if "90 deg" in axis else found)
    assert ("45" in axis) == any("give 45 deg or 45 rad" in line for line in found)


@pytest.mark.parametrize("word", ["sets", "quite different"])
def test_a_kind_that_is_not_known_hides_no_other_mistake(tmp_path, word):
    text = broken("kind: set, angle: 65 deg", f"kind: {word}, angle: 65 kg, coulor: 3")
    found = problems(tmp_path, text)
    assert len(found) == 3, found
    for said in ("is none of", "65 kg is a mass", "unknown key 'coulor'"):
        assert any(said in line for line in found), found


def test_each_value_that_cannot_be_read_is_one_problem(tmp_path):
    """No second one follows from it, such as a well outside of a region that is not known."""
    values = re.compile(r"(?<=[:\[,] )-?\d[\w./]*(?: [A-Za-z]+\w*(?:/\w+)?)?(?=[,}\]\n])")
    places = list(values.finditer(SMALL))
    assert len(places) > 20
    for place in places:
        for wrong in ("5 xyz", "null", "[[7]]"):
            text = SMALL[: place.start()] + wrong + SMALL[place.end() :]
            found = problems(tmp_path, text)
            assert len(found) <= 1, (place[0], wrong, found)


@pytest.mark.parametrize(
    "vary",
    [
        "{parameter: stress.xx, values: [1 MPa, 2 kg]}",
        "{parameter: bonds.friction, values: [0.1]}",
        "{parameter: region.radius, values: [1 m]}",
        "{parameter: test.kind, values: [tension]}",
        "{parameter: fractures.x.angle, values: [1 deg]}",
        "{parameter: initial_pressure.gradient, values: [[0, 0]]}",
        "{variants: {a: {stress: null}, b: {stress: {xx: 1 MPa}}}}",
        "{variants: {a: {region: {shape: circle}}, b: {region: {}}}}",
        "{variants: {a: {fluid: {viscosity: 1 cP}}, b: {bonds: {friction: 1}}}}",
    ],
)
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("  stress: {xx: 20 MPa, yy: 10 MPa}\n", ""),
        ("{xx: 20 MPa, yy: 10 MPa}", "{yy: 10 MPa}"),
        ("{xx: 20 MPa, yy: 10 MPa}", "{xx: 20 MPa}"),
        ("shape: rectangle", "shape: rectangl"),
        ("shape: rectangle, width: 14 m, height: 14 m", "shape: circle"),
        ("{viscosity: 1 cP, bulk_modulus: 1 GPa}", "{viscosity: 1 cP}"),
        ("kind: set", "kind: sett"),
        (
            "solver: {tolerance: 1e-3}\n",
            "solver: {tolerance: 1e-3}\nsmoke: {stress.zz: 1, region: 5}\n",
        ),
    ],
)
def test_an_axis_into_a_block_that_is_not_there_is_told(tmp_path, vary, old, new):
    text = broken(old, new).replace("vary:\n", f"vary:\n  a: {vary}\n")
    with pytest.raises(StudyError):
        load(tmp_path, text)


@pytest.mark.slow
@settings(max_examples=120, deadline=None)
@given(st.integers(0, 2**32))
def test_a_damaged_study_ends_in_clean_words_or_success(tmp_path_factory, seed):
    path = tmp_path_factory.getbasetemp() / "damaged.yaml"
    path.write_bytes(damaged(studies_once(), random.Random(seed)))
    try:
        study = load_study(path)
    except StudyError as error:
        lines = str(error).split("\n")
        assert all(line.isprintable() for line in lines)
        assert all(re.match(r".*:\d+:\d+: .|.*: … and", line) for line in lines)
    else:
        assert study.shape is not None


@functools.cache
def studies_once():
    return studies()


def test_a_polygon_of_many_corners_is_checked_pair_by_pair_where_pairs_are_near():
    """A star of 20,000 corners, and one in which a far corner was moved across its rim."""
    import numpy as np

    angle = 2.0 * np.pi * np.arange(20_000) / 20_000
    radius = 40.0 + 5.0 * np.cos(9.0 * angle)
    star = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    assert len(Polygon(tuple(map(tuple, star.tolist()))).sides) == 20_000
    star[777] *= -2.0
    with pytest.raises(ValueError, match="cross"):
        Polygon(tuple(map(tuple, star.tolist())))
