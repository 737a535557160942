"""Axes of variants and the outcomes that a study states."""

import json

import numpy as np
import pytest
import xarray as xr
from study_text import broken, load, place_of, problems

from demflow import sweep
from demflow.model.outcome import Status
from demflow.model.quantities import CASE
from demflow.model.scene import Circle, Rectangle, Solver
from demflow.sweep.command.cli import main
from demflow.sweep.study.cases import case_at, coordinates
from demflow.sweep.study.expect import DEFAULTS, Expectation, beyond_bounds, ends_as_expected

STUDY = """\
study: varied
scene:
  region: {shape: rectangle, width: 2 m, height: 1.4 m}
  grains: {count: 150, packing: square}
  matrix: {aperture: 10 um}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  boundaries: {left: 2 MPa, right: 1 MPa}
  initial_pressure: 1 MPa
  times: [1 s, 10 s]
vary:
  rate: {parameter: wells.w.rate, values: [1e-7 m3/s, 2e-7 m3/s]}
  case:
    variants:
      boxed: {wells: {w: {at: [0, 0], radius: 0.2 m, rate: 1e-9}}}
      round:
        region: {shape: circle, radius: 1 m}
        wells: {w: {at: [0.1, 0], radius: 0.1 m, rate: 1e-9}}
        boundaries: {outer: 1 MPa}
        grains.count: 200
      wild:
        wells: {w: {at: [0, 0], radius: 0.2 m, rate: 1e-9}}
        solver: {method: explicit, safety_factor: 2.1}
        expect: {status: failed, message: blows up}
observe: [well_pressure, time_error]
solver: {method: krylov}
expect: {mass_balance_error: 1e-10}
smoke: {vary.case: [round]}
"""


def test_a_variant_replaces_blocks_and_single_values(tmp_path):
    study = load(tmp_path, STUDY)
    boxed, varied, wild = (case_at(study, (0, k)).scene for k in range(3))
    assert isinstance(boxed.region, Rectangle)
    assert varied.region == Circle(1.0)
    assert dict(varied.boundaries) == {"outer": 1e6}
    assert (boxed.grains.count, varied.grains.count) == (150, 200)
    assert varied.grains.packing == "square"
    assert (boxed.solver.method, wild.solver.method) == ("krylov", "explicit")
    assert wild.solver.safety_factor == 2.1


def test_a_variant_sets_what_the_study_leaves_to_its_defaults(tmp_path):
    text = STUDY.replace("solver: {method: krylov}\n", "")
    text = text.replace("        grains.count: 200\n", "        solver.tolerance: 1e-7\n")
    study = load(tmp_path, text)
    tolerances = [case_at(study, (0, k)).scene.solver.tolerance for k in range(3)]
    assert tolerances == [Solver().tolerance, 1e-7, Solver().tolerance]


def test_an_axis_moves_what_the_study_leaves_to_its_defaults(tmp_path):
    text = STUDY.replace("solver: {method: krylov}\n", "")
    text = text.replace(
        "parameter: wells.w.rate, values: [1e-7 m3/s, 2e-7 m3/s]",
        "parameter: solver.tolerance, values: [1e-3, 1e-5]",
    )
    study = load(tmp_path, text)
    assert [case_at(study, (k, 0)).scene.solver.tolerance for k in range(2)] == [1e-3, 1e-5]


def test_other_axes_move_numbers_in_every_variant_wherever_they_stand(tmp_path):
    study = load(tmp_path, STUDY)
    assert [axis.name for axis in study.axes] == ["rate", "case"]
    for k in range(3):
        rates = [case_at(study, (i, k)).scene.wells[0].rate for i in range(2)]
        assert rates == [1e-7, 2e-7]


def test_the_coordinate_of_variants_is_their_names(tmp_path):
    (only,) = coordinates(load(tmp_path, STUDY).axes[1])
    assert only.values.tolist() == ["boxed", "round", "wild"]
    assert load(tmp_path, STUDY, smoke=True).axes[1].names == ("round",)


def test_a_block_may_be_taken_out(tmp_path):
    text = broken("      wild:\n", "      still: {boundaries: null, wells: {w: {at: [0, 0], "
                  "radius: 0.2 m, rate: 1e-9}}}\n      wild:\n", STUDY)  # fmt: skip
    assert case_at(load(tmp_path, text), (0, 2)).scene.boundaries == ()


@pytest.mark.parametrize(
    ("old", "new", "at", "words"),
    [
        ("grains.count: 200", "grain.count: 200", "grain.count", "variant 'round'"),
        ("grains.count: 200", "figures.maps: [1 s]", "figures.maps", "the same for all cases"),
        ("grains.count: 200", "grains.count: -3", "-3", "grains.count"),
        ("parameter: wells.w.rate", "parameter: wells.v.rate", "wells.v.rate", "wells.v.rate"),
        ("[1e-7 m3/s", "[1e-7 Pa", "1e-7 Pa", "wells.w.rate"),
        ("status: failed", "status: fallen", "fallen", "did you mean 'failed'"),
        ("smoke: {vary.case: [round]}", "smoke: {vary.case: [square]}", "[square]", "square"),
        ("round:\n", "round:\n        at: [1, 2]\n", "at: [1, 2]", "'at'"),
    ],
)
def test_what_is_wrong_is_told_at_its_place(tmp_path, old, new, at, words):
    text = broken(old, new, STUDY)
    found = problems(tmp_path, text)
    assert found
    line = place_of(text, at).split(":")[0]
    assert any(one.startswith(f"{line}:") and words in one for one in found), found


def test_a_variant_that_contradicts_itself_is_told_at_the_variant(tmp_path):
    text = broken("radius: 0.1 m", "radius: 3 m", STUDY)
    found = problems(tmp_path, text)[0]
    assert found.startswith(place_of(text, "round:\n").split(":")[0])
    assert "beyond the rim" in found
    assert "case = round" in found


def test_an_axis_must_find_its_parameter_in_every_variant(tmp_path):
    text = broken("wells: {w: {at: [0.1, 0]", "wells: {v: {at: [0.1, 0]", STUDY)
    assert any(
        "'wells.w.rate' names no parameter of 'round'" in p for p in problems(tmp_path, text)
    )


def test_expectations_are_the_studys_and_each_variants_own(tmp_path):
    study = load(tmp_path, STUDY)
    assert study.expectation((1, 0)) == Expectation(mass_balance_error=1e-10)
    wild = Expectation(status="failed", message="blows up", mass_balance_error=1e-10)
    assert study.expectation((0, 2)) == wild


def test_an_outcome_is_met_or_not():
    failed = Expectation(status="failed", message="too many")
    assert ends_as_expected(failed, Status.FAILED, "flow: too many steps")
    assert not ends_as_expected(failed, Status.FAILED, "flow: something else")
    assert not ends_as_expected(failed, Status.DONE, "")
    either = Expectation(may_fail="too many")
    assert ends_as_expected(either, Status.DONE, "")
    assert ends_as_expected(either, Status.FAILED, "too many steps")
    assert not ends_as_expected(either, Status.FAILED, "no")
    bound = Expectation(time_error=1e-3)
    assert not beyond_bounds(bound, {"time_error": 1e-3})
    assert beyond_bounds(bound, {"time_error": 2e-3})
    assert beyond_bounds(bound, {"time_error": np.nan})


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_a_study_whose_cases_fail_as_stated_is_good(tmp_path, capsys):
    """Exit status, dataset and report; and the same study without its words is not."""
    path = tmp_path / "study.yaml"
    path.write_text(STUDY, encoding="utf-8")
    place = ["--results", str(tmp_path / "results")]
    assert main(["run", str(path), "--workers", "1", "--json", *place]) == 0
    assert json.loads(capsys.readouterr().out)["failed"] == 0
    assert main(["status", str(path), *place]) == 0
    dataset = sweep.open_results(tmp_path / "results" / "varied")
    assert isinstance(dataset, xr.Dataset)
    assert dataset["status"].sel(case="wild").values.tolist() == [Status.FAILED, Status.FAILED]
    done = dataset.sel(case=["boxed", "round"])
    assert np.all(done["time_error"] <= 1e-4)
    assert np.all(done["estimated_error"] <= 1e-4)
    assert np.all(done["solver_time"] > 0)
    page = (tmp_path / "results" / "varied" / "report.html").read_text(encoding="utf-8")
    assert "6 of 6 cases came out as the study says" in page
    path.write_text(broken("blows up", "sinks", STUDY), encoding="utf-8")
    assert main(["run", str(path), "--workers", "1", *place]) == 1


@pytest.mark.parametrize("name", DEFAULTS)
def test_what_no_sound_result_exceeds_is_judged_unasked(name):
    assert name in CASE
    plain = Expectation()
    assert not beyond_bounds(plain, {name: 0.5 * DEFAULTS[name]})
    for value in (2.0 * DEFAULTS[name], np.nan, np.inf):
        (told,) = beyond_bounds(plain, {name: value})
        assert name in told
    own = Expectation(**{name: 4.0 * DEFAULTS[name]})  # a study may ask for less
    assert not beyond_bounds(own, {name: 2.0 * DEFAULTS[name]})
