"""Samples of parameters by laws of chance, axes from files, and combinations left out."""

import json

import numpy as np
import pytest
from scipy import stats
from study_text import SMALL, broken, load, place_of, problems

from demflow import sweep
from demflow.model.outcome import Status
from demflow.sweep.command.cli import main
from demflow.sweep.prepared import planned
from demflow.sweep.study.cases import case_at, coordinates
from demflow.sweep.study.designs import METHODS, STEP, block, design
from demflow.sweep.study.laws import Law

STUDY = """\
study: sampled
scene:
  region: {shape: rectangle, width: 2 m, height: 1.4 m}
  grains: {count: 60, packing: square}
  matrix: {aperture: 10 um}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  boundaries: {left: 2 MPa, right: 1 MPa}
  initial_pressure: 1 MPa
  times: [1 s, 10 s]
vary:
  opening: {parameter: matrix.aperture, distribution: {log_normal: 0.5, median: 10 um}}
  left: {parameter: boundaries.left, values: [2 MPa, 3 MPa]}
  mu: {parameter: fluid.viscosity, distribution: {uniform: [0.5 cP, 2 cP]}}
sample: {method: sobol, count: 8, seed: 3}
observe: [boundary_flow]
"""
LAW = "{log_normal: 0.5, median: 10 um}"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [1, 6, 16])
def test_a_longer_design_begins_with_the_shorter(method, count):
    short, long = (design(method, 3, n, seed=5) for n in (count, 2 * count))
    assert short.shape == (count * block(method, 3), 3)
    np.testing.assert_array_equal(long[: len(short)], short)
    assert np.all((long > 0.0) & (long < 1.0))
    assert not np.array_equal(short, design(method, 3, count, seed=6))


@pytest.mark.parametrize("count", [5, 12, 64])
def test_a_latin_hypercube_has_one_point_in_each_stratum(count):
    strata = np.floor(design("latin_hypercube", 4, count, seed=2) * count).astype(int)
    np.testing.assert_array_equal(np.sort(strata, axis=0), np.tile(np.arange(count), (4, 1)).T)


def test_a_sobol_sample_is_balanced():
    strata = np.floor(design("sobol", 5, 64, seed=2) * 64).astype(int)
    np.testing.assert_array_equal(np.sort(strata, axis=0), np.tile(np.arange(64), (5, 1)).T)


def test_rows_of_saltelli_differ_from_a_in_one_number_of_b():
    rows = design("saltelli", 3, 4, seed=1).reshape(4, 5, 3)
    a, b = rows[:, 0], rows[:, 1]
    for k in range(3):
        mixed = rows[:, 2 + k]
        np.testing.assert_array_equal(mixed[:, k], b[:, k])
        np.testing.assert_array_equal(np.delete(mixed, k, 1), np.delete(a, k, 1))


def test_a_trajectory_moves_each_number_once():
    paths = design("morris", 4, 20, seed=1).reshape(20, 5, 4)
    moves = np.diff(paths, axis=1)
    np.testing.assert_allclose(np.abs(moves).sum(axis=1), STEP)
    assert np.all(np.count_nonzero(moves, axis=2) == 1)
    assert set(np.unique(paths)) == {0.125, 0.375, 0.625, 0.875}
    assert len({tuple(np.argmax(np.abs(m), axis=1)) for m in moves}) > 5


U = (np.arange(200) + 0.5) / 200


@pytest.mark.parametrize(
    ("law", "known"),
    [
        (Law("uniform", (2.0, 5.0)), stats.uniform(2.0, 3.0)),
        (Law("log_uniform", (1e-5, 1e-3)), stats.loguniform(1e-5, 1e-3)),
        (Law("normal", (2.0, 10.0)), stats.norm(10.0, 2.0)),
        (Law("normal", (2.0, 10.0), (9.0, 15.0)), stats.truncnorm(-0.5, 2.5, 10.0, 2.0)),
        (Law("normal", (1.0, 0.0), (8.0, 9.0)), stats.truncnorm(8.0, 9.0)),
        (Law("normal", (1.0, 0.0), (-12.0, -11.0)), stats.truncnorm(-12.0, -11.0)),
        (Law("log_normal", (0.5, 8e-5)), stats.lognorm(0.5, scale=8e-5)),
        (Law("triangular", (1.0, 2.0, 5.0)), stats.triang(0.25, 1.0, 4.0)),
        (Law("triangular", (1.0, 1.0, 5.0)), stats.triang(0.0, 1.0, 4.0)),
    ],
    ids=lambda x: x.kind if isinstance(x, Law) else "",
)
def test_laws_are_those_of_their_names(law, known):
    np.testing.assert_allclose(law.quantile(U), known.ppf(U), rtol=1e-9)


def test_a_cut_logarithmic_law_keeps_its_shape_within():
    law = Law("log_normal", (0.7, 2.0), (1.0, 4.0))
    known = stats.lognorm(0.7, scale=2.0)
    low, high = known.cdf(1.0), known.cdf(4.0)
    np.testing.assert_allclose(law.quantile(U), known.ppf(low + (high - low) * U), rtol=1e-9)


def test_discrete_values_come_as_often_as_they_weigh():
    values = Law("discrete", ("a", "b", "c"), weights=(1.0, 0.0, 3.0)).quantile(U)
    assert [values.count(v) for v in "abc"] == [50, 0, 150]
    whole = Law("uniform", (3, 6), whole=True).quantile(U)
    assert [whole.count(v) for v in range(2, 8)] == [0, 50, 50, 50, 50, 0]


def test_a_sample_is_one_dimension_with_its_parameters_along_it(tmp_path):
    study = load(tmp_path, STUDY)
    assert [axis.name for axis in study.axes] == ["sample", "left"]
    assert study.shape == (8, 2)
    number, opening, mu = coordinates(study.axes[0])
    np.testing.assert_array_equal(number.values, np.arange(8))
    points = design("sobol", 2, 8, seed=3)
    expected = stats.lognorm(0.5, scale=1e-5).ppf(points[:, 0])
    np.testing.assert_allclose(opening.values, expected, rtol=1e-9)
    np.testing.assert_allclose(mu.values, 5e-4 + 1.5e-3 * points[:, 1], rtol=1e-12)
    assert (opening.name, opening.unit, mu.unit) == ("opening", "m", "Pa s")
    assert "log_normal: 0.5, median: 10 um" in opening.long_name
    scene = case_at(study, (5, 1)).scene
    assert scene.matrix.aperture == opening.values[5]
    assert scene.fluid.viscosity == mu.values[5]
    assert dict(scene.boundaries)["left"] == 3e6


@pytest.mark.parametrize("method", METHODS)
def test_a_longer_sample_runs_only_what_is_new(tmp_path, method):
    text = STUDY.replace("sobol, count: 8", f"{method}, count: 8")
    short = planned(load(tmp_path, text))
    long = planned(load(tmp_path, text.replace("count: 8", "count: 16")))
    assert len(long.cases) == 2 * len(short.cases)
    first = {run.id for run in short.runs}
    assert first < {run.id for run in long.runs}
    again = {long.runs[run].id for case in range(len(short.cases)) for run in long.case_runs(case)}
    assert again == first


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_an_extended_study_computes_the_new_cases_alone(tmp_path, capsys):
    path, folder = tmp_path / "study.yaml", ["--results", str(tmp_path)]
    text = STUDY + "where: left < 3 MPa or opening > 10 um\n"
    path.write_text(text)
    assert main(["run", str(path), "--json", *folder]) == 0
    first = sweep.open_results(tmp_path / "sampled")
    path.write_text(text.replace("count: 8", "count: 16"))
    capsys.readouterr()
    assert main(["plan", str(path), "--json", *folder]) == 0
    to_run = json.loads(capsys.readouterr().out)["to_run"]
    assert main(["run", str(path), "--json", *folder]) == 0
    assert json.loads(capsys.readouterr().out)["computed"] == to_run
    second = sweep.open_results(tmp_path / "sampled")
    same = second.isel(sample=slice(8))
    for name in ("boundary_flow", "opening", "mu", "porosity", "status"):
        np.testing.assert_array_equal(same[name], first[name])
    assert second["sample"].attrs["sampling_method"] == "sobol"
    kept = (second["left"] < 3e6) | (second["opening"] > 1e-5)
    ended = second["status"].transpose(*kept.dims)
    np.testing.assert_array_equal(ended == Status.DONE, kept)
    np.testing.assert_array_equal(ended == Status.LEFT_OUT, ~kept)
    assert main(["status", str(path), "--json", *folder]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["cases"], told["done"], told["failed"]) == (int(kept.sum()),) * 2 + (0,)
    assert told["failures"] == []
    case = sweep.open_case(tmp_path / "sampled", sample=3, left=2e6)
    assert case["sample"] == 3


GRID = broken(
    "  yy: {parameter: stress.yy, values: [5 MPa, 10 MPa]}\n",
    """\
  xx: {parameter: stress.xx, values: [5 MPa, 10 MPa, 20 MPa]}
  yy: {parameter: stress.yy, values: [5 MPa, 10 MPa, 20 MPa]}
  angle: {parameter: fractures.natural.angle, values: [0 deg, 30 deg, 90 deg]}
  way: {parameter: solver.method, values: [krylov, implicit]}
""",
    SMALL,
)


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("xx >= yy", lambda x, y, a, m: x >= y),
        ("5 MPa < yy <= 2 * xx", lambda x, y, a, m: 5 < y <= 2 * x),
        ("xx == yy or angle > 30 deg", lambda x, y, a, m: x == y or a > 30),
        ("not (xx == yy or angle > 30 deg)", lambda x, y, a, m: not (x == y or a > 30)),
        ("way == krylov and yy != 10 MPa", lambda x, y, a, m: m == "krylov" and y != 10),
        ("0.4*yy < xx and xx < yy or way != krylov", lambda x, y, a, m: 2 * y < 5 * x < 5 * y or m[0] == "i"),  # noqa: E501
        ("[xx > 5 MPa, yy < 2e7]", lambda x, y, a, m: x > 5 and y < 20),
    ],
)  # fmt: skip
def test_where_keeps_the_combinations_that_it_says(tmp_path, condition, holds):
    study = load(tmp_path, GRID + f"where: {condition}\n")
    expected = [
        holds(x, y, a, m)
        for x in (5, 10, 20)
        for y in (5, 10, 20)
        for a in (0, 30, 90)
        for m in ("krylov", "implicit")
    ]
    assert not all(expected)
    np.testing.assert_array_equal(study.kept.ravel(), expected)
    plan = planned(study)
    assert plan.count == sum(expected)
    assert plan.left_out == frozenset(np.flatnonzero(~np.array(expected)).tolist())


def test_what_is_left_out_need_not_be_possible(tmp_path):
    text = broken(
        "    joint: {kind: trace, from: [-3, 1], to: [4, 2], aperture: 100 um}\n", "", SMALL
    )
    text = broken("parameter: stress.yy, values: [5 MPa, 10 MPa]",
                  "parameter: wells.producer.radius, values: [1 m, 9 m]}\n"
                  "  x: {parameter: region.width, values: [14 m, 40 m]", text)  # fmt: skip
    text = broken("height: 14 m", "height: 40 m", text)
    assert any("where yy = 9 m" in one for one in problems(tmp_path, text))
    assert problems(tmp_path, text + "where: yy < 2 m or x > 20 m\n") == []


@pytest.mark.parametrize(
    ("condition", "words"),
    [
        ("xx", "compared with nothing"),
        ("xx > ", "something is missing"),
        ("(xx > yy", "a bracket is open"),
        ("xx > yy)", "is too much"),
        ("xx = yy", "equality is written =="),
        ("xx > angle", "not of one kind"),
        ("xx > 5 mD", "5 mD is a permeability"),
        ("angle > 30", "lacks its unit"),
        ("angl > 5 deg", "did you mean 'angle'?"),
        ("way > krylov", "words are compared by =="),
        ("xx > 1 GPa", "leaves no case"),
        ("'xx > yyy'", "did you mean 'yy'?"),
        ("{a: b}", "a condition is a text"),
        ("'" + 60 * "(" + "xx > yy'", "brackets in brackets"),
    ],
)
def test_a_condition_that_cannot_be_read_is_told_with_its_place(tmp_path, condition, words):
    text = GRID + f"where: {condition}\n"
    (found,) = problems(tmp_path, text)
    assert found.startswith(place_of(text, "where: ", 7))
    assert words in found


def test_points_of_an_axis_stand_in_a_file(tmp_path):
    (tmp_path / "points.csv").write_text(
        "# measured\nname;yy [psi];stress.xx\na;1000;2 MPa\n\nb;2000 kPa;3e6\n",
        encoding="utf-8-sig",
    )
    text = broken("parameter: stress.yy, values: [5 MPa, 10 MPa]",
                  "parameters: [stress.xx, stress.yy], file: points.csv")  # fmt: skip
    study = load(tmp_path, text)
    (axis,) = study.axes
    np.testing.assert_allclose(axis.values, [(2e6, 6894757.293), (3e6, 2e6)], rtol=1e-9)
    (kept,) = study.files.values()
    assert kept.path == tmp_path / "points.csv"


@pytest.mark.parametrize(
    ("content", "columns", "words"),
    [
        ("a,yy\n1,5\n2,mD\n", "", "line 3: 'mD' is not a number"),
        ("a,yy\n1,5\n2,\n", "", "line 3: stress.yy is empty"),
        ("a,yy\n1,5\n2\n", "", "line 3: stress.yy is empty"),
        ("a,yy [mD]\n1,5\n", "", "line 2: 5 mD is a permeability"),
        ("a,b\n1,5\n", "", "no column is named 'stress.yy' (there are a, b); name it so"),
        ("a,b\n1,5\n", ", columns: [c]", "no column is named 'c'"),
        ("a,b\n1,5\n", ", columns: [a, b]", "columns names 1 columns"),
        ("yy\n", "", "it holds no points"),
        ("yy\n5e6\n5e6\n", "", "the value stands twice"),
        (None, "", "there is no such file"),
    ],
)
def test_a_file_without_the_points_is_told(tmp_path, content, columns, words):
    if content is not None:
        (tmp_path / "p.csv").write_text(content)
    text = broken("values: [5 MPa, 10 MPa]", f"file: p.csv{columns}")
    (found,) = problems(tmp_path, text)
    assert words in found


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (LAW, "{gaussian: 1}", "a distribution is one of uniform"),
        (LAW, "{log_normal: 0.5}", "log_normal lacks 'median'"),
        (LAW, "{log_normal: 5 MPa, median: 10 um}", "5 MPa is a pressure"),
        (LAW, "{log_normal: 0.5, median: 10 mD}", "10 mD is a permeability"),
        (LAW, "{normal: 0.5, mean: 10 um, mode: 3}", "and no 'mode'"),
        (LAW, "{normal: 50 um, mean: 10 um}", "cut the law, as in within"),
        (LAW, "{uniform: [20 um, 10 um]}", "rise from the least to the largest"),
        (LAW, "{uniform: 20 um}", "uniform is a list of 2 values"),
        (LAW, "{log_uniform: [0 um, 10 um]}", "positive values"),
        (LAW, "{triangular: [1 um, 5 um]}", "triangular is a list of 3 values"),
        (LAW, "{discrete: [1 um, 5 um], weights: [1]}", "weights is a list of 2 numbers"),
        (LAW, "{normal: -1 um, mean: 10 um}", "is not above 0"),
        ("fluid.viscosity, distribution: {uniform: [0.5 cP, 2 cP]}",
         "grains.packing, distribution: {uniform: [1, 2]}", "is no quantity"),
        ("sample: {method: sobol, count: 8, seed: 3}\n", "", "say how it is sampled"),
        ("method: sobol,", "method: sobl,", "did you mean 'sobol'?"),
        ("count: 8", "count: 100000", "at most"),
        (", count: 8", "", "sample lacks 'count'"),
        ("  left: {", "  sample: {", "the sample has this name"),
        ("parameter: matrix.aperture, dist", "parameters: [matrix.aperture], dist", "that of one"),
        (f"distribution: {LAW}", f"distribution: {LAW}, from: 1 um", "remove from"),
    ],
)  # fmt: skip
def test_a_sample_that_cannot_be_drawn_is_told(tmp_path, old, new, words):
    found = problems(tmp_path, broken(old, new, STUDY))
    assert any(words in one for one in found), found
    assert len(found) == 1


def test_a_sample_without_a_law_is_told(tmp_path):
    (found,) = problems(tmp_path, SMALL + "sample: {count: 4}\n")
    assert "no axis under vary has a distribution" in found
