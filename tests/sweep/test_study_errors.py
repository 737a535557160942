# ruff: noqa: E501 (a mistake and what is said about it stand in one line)
"""Studies that do not load: each mistake at its place, in words that help, all at once."""

import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from study_text import EXAMPLE, SMALL, broken, load, place_of, problems

from demflow.sweep.study.axes import MAX_CASES
from demflow.sweep.study.load import StudyError, load_study
from demflow.sweep.study.yaml_source import LARGEST_FILE

# what is replaced, by what, where the problem is reported, what is said
MISTAKES = [
    # keys
    ("viscosity:", "viscocity:", "viscocity", "unknown key 'viscocity' in scene.fluid; did you mean 'viscosity'?"),
    ("scene:", "scena:", "scena", "unknown key 'scena' in the study; did you mean 'scene'?"),
    ("viscosity: 1 cP, ", "", "fluid", "scene.fluid lacks 'viscosity' (dynamic viscosity), for instance 1 cP"),
    ("  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}\n", "", "scene:", "what is observed needs a fluid"),
    ("observe:", "observes:", "observes", "unknown key 'observes' in the study; did you mean 'observe'?"),
    ("study:", "studi:", "studi", "unknown key 'studi' in the study; did you mean 'study'?"),
    ("study: small\n", "", None, "the study lacks 'study'"),
    ("observe: [well_pressure, pressure_map]\n", "", None, "the study lacks 'observe'"),
    ("count: 500,", "count: 500, count: 600,", "count: 600", "duplicate key 'count'"),
    ("shape: rectangle", "shape: rectangel", "rectangel", "'rectangel' is none of rectangle, circle, polygon; did you mean 'rectangle'?"),
    ("shape: rectangle, ", "", "region", "scene.region lacks 'shape', one of rectangle, circle, polygon"),
    ("kind: set", "kind: sets", "sets", "fractures.natural.kind: 'sets' is none of bi-wing, set, trace"),
    ("  joint: {", "  a.b: {", "a.b", "'a.b' is no name"),
    ("{p: {at: [3, 0]}}", "[1, 2]", "[1, 2]", "scene.probes is a mapping of names"),
    ("producer: {at: [0, 0], radius: 1 ft, rate: 1 bbl/day}", "producer: 5", "5\n  boundaries", "scene.wells.producer is a mapping with the keys at, radius"),
    # values
    ("xx: 20 MPa", "xx: 5 kg", "5 kg", "5 kg is a mass; stress.xx is a pressure, for instance 10 MPa"),
    ("xx: 20 MPa", "xx: 5 mpa", "5 mpa", "unknown unit 'mpa' (did you mean 'mPa' or 'MPa'?) in '5 mpa'; stress.xx is a pressure"),
    ("viscosity: 1 cP", "viscosity: -1 cP", "-1 cP", "fluid.viscosity: -1 cP is not above 0 cP"),
    ("porosity: 0.17", "porosity: 0.5", "0.5", "grains.porosity: 0.5 is above 0.22; discs at rest that touch reach no other"),
    ("porosity: 0.17", "porosity: .inf", ".inf", "not a finite number"),
    ("count: 500", "count: 1.5", "1.5", "1.5 is not a whole number"),
    ("count: 500", "count: 1e30", "1e30", "1e30 is too large for grains.count"),
    ("count: 500", "count: [500]", "[500]", "grains.count is a single value"),
    ("count: 500", "count: 500, packing: hexagnal", "hexagnal", "did you mean 'hexagonal'?"),
    ("at: [3, 0]", "at: [3]", "[3]", "probes.p.at is a list of 2 values, for instance [5 m, 5 m]"),
    ("at: [3, 0]", "at: [3, 0 s]", "0 s", "0 s is a time; probes.p.at is a length"),
    ("rate: 1 bbl/day", "schedule: [[0 s, 1 s]]", "1 s]]", "1 s is a time; wells.producer.schedule is a volume rate"),
    ("rate: 1 bbl/day", "schedule: 5", "5}", "wells.producer.schedule is a list, for instance [[1 h, 2e-5 m3/s], …]"),
    ("{left: 7 MPa", "{left: 7 m", "7 m,", "7 m is a length; boundaries.left is a pressure"),
    ("[1 s, 1 min, 1 h]", "[1 s, 1 m, 1 h]", "1 m,", "1 m is a length; times is a time"),
    ("[1 s, 1 min, 1 h]", "{first: 1 s, last: 0.5 s, per_decade: 3}", "0.5 s", "the last time must come after the first"),
    ("[1 s, 1 min, 1 h]", "{first: 1 s, last: 9 s, per_decade: 3, restart: [5 s, 4 s]}", "[5 s", "times increase, each by more than `first`"),
    ("[1 s, 1 min, 1 h]", "{first: 1 s, last: 9 s, per_decade: 3, restart: [8.5 s]}", "[8.5 s", "and `last` is later still"),
    ("[1 s, 1 min, 1 h]", "{first: 1e-20 s, last: 1e20 s, per_decade: 1000}", "1000}", "more than 10000 output times"),
    ("{p: {at: [3, 0]}}", "{p: {from: [0, 0], to: [1, 1], count: 1e9}}", "1e9", "1e+09 is above 10000"),
    ("[well_pressure, pressure_map]", "[wel_pressure, pressure_map]", "wel_pressure", "unknown word 'wel_pressure'; did you mean 'well_pressure'?"),
    ("[well_pressure, pressure_map]", "[well_pressure, well_rate]", "well_rate", "unknown word 'well_rate'; it comes with well_pressure"),
    ("{left: 7 MPa", "{left: closed", "closed", "boundaries.left: a side is closed where boundaries has nothing on it: leave left out"),
    ("rate: 1 bbl/day", "rate: 1 bbl/day, min_bhp: 1 MPa", "min_bhp", "did you mean 'least_pressure'?"),
    ("[well_pressure, pressure_map]", "[pressure_map, pressure_map]", "pressure_map]", "'pressure_map' is named twice"),
    ("[well_pressure, pressure_map]", "well_pressure", "well_pressure", "observe is a list of"),
    ("solver: {tolerance: 1e-3}", "solver: {method: kryloff}", "kryloff", "did you mean 'krylov'?"),
    ("study: small", "study: ../x", "../x", "study '../x' names a folder under results/"),
    ("study: small", "study: .hidden", ".hidden", "names a folder"),
    ("study: small", "study: a/b", "a/b", "names a folder"),
    ("study: small", "study: store", "store", "results/store is used"),
    ("study: small", "study: [a]", "[a]", "names a folder"),
    # between blocks
    ("at: [0, 0], radius", "at: [20, 0], radius", "[20, 0]", "wells.producer.at: the well lies outside the region"),
    ("radius: 1 ft", "radius: 90 m", "90 m", "wells.producer.radius: the well reaches beyond the rim, which is"),
    ("at: [3, 0]", "at: [30, 0]", "[30, 0]", "probes.p.at: the probe lies outside the region"),
    ("to: [4, 2]", "to: [-3, 1]", "[-3, 1], aperture", "fractures.joint.to: the fracture has zero length"),
    ("rate: 1 bbl/day", "rate: 1, pressure: 5 MPa", "1, pressure", "give exactly one of rate, pressure, schedule"),
    ("{left: 7 MPa", "{inner: 7 MPa", "7 MPa, right", "the region has no such side"),
    ("matrix: {permeability: 1 mD}", "matrix: {permeability: 1 mD, aperture: 1 um}", "1 mD", "give one of permeability, hydraulic_conductivity or aperture"),
    ("  initial_pressure: 7 MPa\n", "", "scene:", "a transient starts from a pressure"),
]  # fmt: skip


JOINTED = broken(
    "to: [4, 2], aperture: 100 um}",
    "to: [4, 2], joint: {normal_stiffness: 10 GPa/m, shear_stiffness: 4 GPa/m, friction: 0.6, dilation_angle: 7 deg}}",
)
MISTAKES_OF_JOINTS = [
    ("friction: 0.6", "fricton: 0.6", "fricton", "unknown key 'fricton' in scene.fractures.joint.joint; did you mean 'friction'?"),
    ("normal_stiffness: 10 GPa/m, ", "", "joint: {shear", "scene.fractures.joint.joint lacks 'normal_stiffness'"),
    ("10 GPa/m", "10 GPa", "10 GPa", "10 GPa is a pressure; fractures.joint.joint.normal_stiffness is a"),
    ("7 deg", "5 m", "5 m}", "5 m is a length; fractures.joint.joint.dilation_angle is an angle"),
    ("7 deg", "90 deg", "90 deg", "fractures.joint.joint.dilation_angle: 90 deg is not below 90 deg"),
    ("7 deg", "-1 deg", "-1 deg", "fractures.joint.joint.dilation_angle: -1 deg is below 0 deg"),
    ("friction: 0.6", "friction: -1", "-1,", "fractures.joint.joint.friction: -1 is below 0"),
    ("{normal_stiffness: 10 GPa/m, shear_stiffness: 4 GPa/m, friction: 0.6, dilation_angle: 7 deg}", "5", "5}\n", "joint.joint is a mapping with the keys normal_stiffness"),
    ("from: [-3, 1], to: [4, 2]", "from: [-30, 90], to: [4, 92]", "[-30, 90]", "the fracture lies outside the region"),
    ("  stress: {xx: 20 MPa, yy: 10 MPa}\n", "", "joint: {normal", "a joint acts only where the scene names a stress or a test"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "at", "said"), MISTAKES_OF_JOINTS)
def test_one_mistake_of_a_joint_is_one_problem_at_its_place(tmp_path, old, new, at, said):
    text = broken(old, new, JOINTED)
    found = problems(tmp_path, text)
    assert any(said in line for line in found), found
    assert any(line.startswith(place_of(text, at) + ":") for line in found), found


def test_a_jointed_study_loads(tmp_path):
    assert not problems(tmp_path, JOINTED)


@pytest.mark.parametrize(("old", "new", "at", "said"), MISTAKES)
def test_one_mistake_is_one_problem_at_its_place(tmp_path, old, new, at, said):
    text = broken(old, new)
    found = problems(tmp_path, text)
    assert found, "nothing was found"
    lines = [line for line in found if said in line]
    assert lines, found
    if at is not None:
        place = re.match(r"\d+:\d+", lines[0])[0]
        start = text.index(new) if new else 0
        index = text.index(at, start if at in text[start:] else 0)
        assert place == place_of(text[:index] + "\0", "\0")
    assert len(found) == 1, found


AXES = [
    ("{parameter: stress.zz, values: [1]}", "stress.zz", "'stress.zz' names no parameter of this scene; did you mean 'stress."),
    ("{parameter: scene.stress.xx, values: [1]}", "scene.stress", "did you mean 'stress.xx'?"),
    ("{parameter: fractures.natral.angle, values: [1]}", "fractures.natral", "did you mean 'fractures.natural.angle'?"),
    ("{parameter: wells, values: [1]}", "wells,", "'wells' names no parameter"),
    ("{parameter: stress.xx.y, values: [1]}", "stress.xx.y", "names no parameter"),
    ("{parameter: title, values: [1]}", "title", "names no parameter"),
    ("{parameter: bonds.kind, values: [parallel]}", "bonds.kind", "the scene has no bonds"),
    ("{parameter: times, values: [1]}", "times,", "share their output times"),
    ("{parameter: observe, values: [1]}", "observe,", "observe the same"),
    ("{parameter: region.shape, values: [circle]}", "region.shape", "decides which other keys there are"),
    ("{parameter: stress.yy, values: [1 MPa]}", "stress.yy, values: [5", "axis 'yy' varies 'stress.yy', as axis 'b' does"),
    ("{parameters: [stress.xx, stress.xx], values: [[1, 2]]}", "stress.xx], v", "as itself does"),
    ("{parameter: stress.xx, values: []}", "[]", "values is empty"),
    ("{parameter: stress.xx, values: 5}", "5}", "values is a list"),
    ("{parameter: stress.xx}", "b: ", "lacks 'values'"),
    ("{values: [1]}", "b: ", "needs either 'parameter' or 'parameters'"),
    ("{parameter: stress.xx, vlues: [1]}", "vlues", "unknown key 'vlues' in vary.b; did you mean 'values'?"),
    ("{parameter: stress.xx, values: [1 MPa, 2 MPa, 1e6]}", "1e6", "the value stands twice"),
    ("{parameter: stress.xx, values: [1 MPa, 2 kg]}", "2 kg", "2 kg is a mass; stress.xx is a pressure"),
    ("{parameter: stress.xx, values: [1 MPa, -1 MPa]}", "-1 MPa", "stress.xx: -1 MPa is not above 0 MPa"),
    ("{parameter: stress.xx, values: [null]}", "null", "'null' is not a number; stress.xx is a pressure"),
    ("{parameter: grains.packing, values: [squar]}", "squar", "did you mean 'square'?"),
    ("{parameter: stress.xx, from: 1, to: 2}", "b: ", "lacks 'count'"),
    ("{parameter: stress.xx, from: 1, to: 2, count: 0}", "0}", "0 is not between 1 and 100000"),
    ("{parameter: stress.xx, from: 1, to: 2, count: 1e12}", "1e12", "is not between 1 and 100000"),
    ("{parameter: stress.xx, from: 1, to: 1, count: 2}", "1, count", "the value stands twice"),
    ("{parameter: stress.xx, from: 1, to: 2, count: 2, spacing: lg}", "lg", "neither linear nor log; did you mean 'log'?"),
    ("{parameter: grains.friction, from: 0, to: 1, count: 2, spacing: log}", "0, to", "log spacing needs positive ends"),
    ("{parameter: grains.seed, from: 1, to: 2, count: 3}", "3}", "gives no whole numbers"),
    ("{parameter: grains.packing, from: a, to: b, count: 3}", "from", "is no quantity"),
    ("{parameter: stress.xx, values: [1], count: 3}", "count: 3", "has values already; remove count"),
    ("{parameters: [stress.xx, grains.seed], values: [[1 MPa]]}", "[1 MPa]]", "each point is a list of 2 values"),
    ("{parameters: stress.xx, values: [1]}", "stress.xx,", "parameters is a list of paths"),
    ("5", "5\n  yy", "vary.b is a mapping"),
    # the scene that a value makes
    ("{parameter: region.width, values: [14 m, 5 m]}", "5 m]}", "the probe lies outside the region (where b = 5 m)"),
    ("{parameter: wells.producer.at, values: [[0, 0], [9, 0]]}", "[9, 0]", "the well lies outside the region (where b = [9 m, 0 m])"),
    ("{parameter: fractures.natural.permeability, values: [1 mD]}", "1 mD]", "give exactly one of permeability, aperture"),
    ("{parameter: boundaries.outer, values: [1 MPa]}", "1 MPa]", "name no other beside it"),
    ("{parameter: boundaries.botom, values: [1 MPa]}", "1 MPa]", "the region has no such side"),
]  # fmt: skip


@pytest.mark.parametrize(("axis", "at", "said"), AXES)
def test_one_wrong_axis_is_reported_at_its_place(tmp_path, axis, at, said):
    text = SMALL.replace("vary:\n", f"vary:\n  b: {axis}\n")
    found = problems(tmp_path, text)
    assert len(found) == 1, found
    assert said in found[0]
    index = text.index(at, text.index("  b: "))
    assert found[0].startswith(place_of(text[:index] + "\0", "\0") + ":")


@pytest.mark.parametrize("name", ["well", "permeability", "elapsed_time", "row", "probe", "status"])
def test_names_of_the_dataset_are_taken(tmp_path, name):
    text = SMALL.replace("  yy: {", f"  {name}: {{")
    (found,) = problems(tmp_path, text)
    assert f"axis '{name}': the dataset uses this name itself" in found


@pytest.mark.parametrize("name", ["method", "tolerance", "drop"])
def test_an_axis_that_could_not_be_selected_by_its_name(tmp_path, name):
    (found,) = problems(tmp_path, SMALL.replace("  yy: {", f"  {name}: {{"))
    assert f"'{name}' cannot be told from an argument of xarray's sel" in found


@pytest.mark.parametrize("name", ["a-b", "1a", "a b", "é", "_x"])
def test_names_of_axes_are_identifiers(tmp_path, name):
    (found,) = problems(tmp_path, SMALL.replace("  yy: {", f"  {name}: {{"))
    assert "letters, digits and '_'" in found


def test_a_combination_that_cannot_be_is_found(tmp_path):
    axes = """vary:
  w: {parameter: region.width, values: [14 m, 10 m]}
  x: {parameter: wells.producer.at, values: [[0, 0], [6 m, 0]]}
"""
    text = SMALL[: SMALL.index("vary:")] + axes + SMALL[SMALL.index("observe:") :]
    (found,) = problems(tmp_path, text)
    assert "the well lies outside the region (where w = 10 m and x = [6 m, 0 m])" in found


def test_a_pair_is_found_among_more_combinations_than_are_tried(tmp_path):
    axes = "vary:\n  w: {parameter: region.width, values: [14 m, 10 m]}\n"
    axes += "  x: {parameter: wells.producer.at, values: [[0, 0], [6 m, 0]]}\n"
    axes += "  q: {parameter: wells.producer.rate, from: 1, to: 25, count: 25}\n"
    axes += "  f: {parameter: grains.friction, from: 1, to: 25, count: 25}\n"
    text = SMALL[: SMALL.index("vary:")] + axes + SMALL[SMALL.index("observe:") :]
    (found,) = problems(tmp_path, text)
    assert "(where w = 10 m and x = [6 m, 0 m])" in found


def test_too_many_cases(tmp_path):
    axes = "vary:\n  q: {parameter: wells.producer.rate, from: 1, to: 400, count: 400}\n"
    axes += "  f: {parameter: grains.friction, from: 1, to: 251, count: 251}\n"
    text = SMALL[: SMALL.index("vary:")] + axes + SMALL[SMALL.index("observe:") :]
    (found,) = problems(tmp_path, text)
    assert found.startswith(place_of(text, "vary:"))
    assert "vary makes 100,400 cases; a study may have 100,000 at most" in found
    assert len(load(tmp_path, text.replace("251", "250")).axes) == 2
    assert MAX_CASES == 100_000


def test_all_mistakes_at_once_in_the_order_of_the_file(tmp_path):
    text = SMALL
    used = []
    for old, new, _, said in MISTAKES:
        independent = said.startswith(
            ("5 kg", "fluid.vis", "grains.por", "wells.producer.at", "probes.p.at: the")
        )
        if independent and old in text:
            text = broken(old, new, text)
            used.append(said)
    text = text.replace("vary:\n", "vary:\n  b: {parameter: grains.sed, values: [1]}\n")
    text = text.replace("tolerance: 1e-3", "tolerance: 3")
    used += ["did you mean 'grains.seed'?", "solver.tolerance: 3 is not below 1"]
    found = problems(tmp_path, text)
    assert len(found) == len(used) == 7
    for said in used:
        assert any(said in line for line in found)
    places = [tuple(map(int, line.split(":")[:2])) for line in found]
    assert places == sorted(places)


@pytest.mark.parametrize(
    ("smoke", "said"),
    [
        ("{grain.count: 3}", "the study has no 'grain'; did you mean 'grains'?"),
        ("{grains.coun: 3}", "unknown key 'coun' in scene.grains; did you mean 'count'?"),
        ("{grains.count: -3}", "grains.count: -3 is below 1"),
        ("{vary.yz: [1 MPa]}", "the study has no 'yz'; valid are yy"),
        ("{vary.yy: [1 kg]}", "1 kg is a mass"),
        ("{vary: {}}", "cannot override 'vary' as a whole"),
        ("{smoke.x: 1}", "cannot override 'smoke.x'"),
        ("[1]", "smoke is a mapping of paths"),
        ("{region.width: 4 m}", "with the smoke block: probes.p.at: the probe lies outside"),
    ],
)
def test_smoke_is_checked_also_where_it_is_not_used(tmp_path, smoke, said):
    (found,) = problems(tmp_path, SMALL + f"smoke: {smoke}\n")
    assert said in found


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("limits: {time: 10 MPa}", "10 MPa is a pressure; limits.time is a time"),
        ("limits: {memory: 0 GB}", "limits.memory: 0 GB is not above 0 GB"),
        ("limits: {tim: 5}", "unknown key 'tim' in limits; did you mean 'time'?"),
        ("figures: {maps: [1 kg]}", "1 kg is a mass; figures.maps is a time"),
        ("figures: {maps: [2 h]}", "7200 s is not in times, 1 s to 3600 s"),
        ("figures: {compare: radial}", "radial is the flow in a circle, not in a rectangle"),
        ("figures: {compare: liner}", "did you mean 'linear'?"),
    ],
)
def test_limits_and_figures(tmp_path, block, said):
    (found,) = problems(tmp_path, SMALL + block)
    assert said in found


def test_problems_name_file_line_and_column(tmp_path):
    with pytest.raises(StudyError) as caught:
        load(tmp_path, broken("viscosity:", "viscocity:"))
    expected = (
        f"{tmp_path / 'study.yaml'}:7:11: unknown key 'viscocity' in scene.fluid; "
        "did you mean 'viscosity'?"
    )
    assert str(caught.value) == expected
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, str(problem)) == (7, 11, expected)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "1:1: the study is empty"),
        (b"# nothing\n", "1:1: the study is empty"),
        (b"- 1\n", "1:1: a study is a mapping of keys to values, not a list"),
        (b"hello", "1:1: a study is a mapping of keys to values, not a single word"),
        (b"a: [1, 2\nb: 3", "2:2: bad YAML"),
        (b"a: b: c", "1:5: bad YAML: mapping values are not allowed in this context; check the indentation"),
        (
            b"a:\n  b: 1\n c: 2",
            "3:2: bad YAML: did not find expected key, while parsing a block mapping; check the "
            "indentation",
        ),
        (b"a: 1\n\tb: 2", "2:1: bad YAML"),
        (b"a: 1\nb: \x00", "2:4: bad YAML"),
        (b"a: 1\nbc: \xff", "2:5: the file is not UTF-8 text"),
        (b"---\na: 1\n---\nb: 1\n", "3:1: a study is one document"),
        (b"a: " + b"[" * 30, "nested deeper than 20 levels"),
        (b"a: 1\n#" + b"x" * LARGEST_FILE, "1:1: the file is larger than 1 MB"),
        (b"a: &x 5\nb: *x", "anchors are not allowed; remove '&x'"),
        (b"a: &x 5\nb: *x", "2:4: aliases are not allowed"),
        (b"a: !!python/name:os.system 5", "1:4: tags are not allowed"),
        (b"? [1]\n: 2", "1:3: a key must be a word"),
        (b"<<: {study: x}", "unknown key '<<'"),
    ],
)  # fmt: skip
def test_what_is_no_study(tmp_path, content, said):
    path = tmp_path / "study.yaml"
    path.write_bytes(content)
    with pytest.raises(StudyError) as caught:
        load_study(path)
    assert said in str(caught.value)


def test_what_is_no_file(tmp_path):
    for path, said in (
        (tmp_path, "this is a folder, not a study file"),
        (tmp_path / "none.yaml", "there is no such file"),
        ("/dev/zero", "this is a device"),
        ("a\0b", "there is no such file"),
    ):
        with pytest.raises(StudyError, match=said):
            load_study(path)


@pytest.mark.slow
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_any_damage_is_a_study_error_or_a_study(tmp_path, data):
    """Words of the example cut out, doubled or exchanged: never another exception."""
    words = re.findall(
        r"\s+|[\w.%-]+|.", EXAMPLE.split("vary:")[0] if data.draw(st.booleans()) else EXAMPLE
    )
    for _ in range(data.draw(st.integers(1, 3))):
        k = data.draw(st.integers(0, len(words) - 1))
        junk = [
            "",
            "null",
            "[]",
            "{}",
            "-1",
            "0",
            "1e400",
            "x",
            ".nan",
            "[1, 2]",
            "{a: 1}",
            words[k] * 2,
        ]
        words[k] = data.draw(st.sampled_from([*junk, data.draw(st.sampled_from(words))]))
    found = problems(tmp_path, "".join(words))
    assert all(re.fullmatch(r"[1-9]\d*:[1-9]\d*: .+", line, re.DOTALL) for line in found)
