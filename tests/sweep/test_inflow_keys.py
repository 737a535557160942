"""`boundaries` with an inflow in a study: forms, axes, results, and what is wrong with them."""

import numpy as np
import pytest
from study_text import broken, load, problems

from demflow.model.scene import Inflow
from demflow.model.stages import simulate
from demflow.sweep.plan.graph import make_plan
from demflow.sweep.plan.table import stage_table
from demflow.sweep.study.cases import case_at

SIDES = "{left: 7 MPa, right: 5 MPa}"
FORMS = "{left: {flux: 365.25 mm/year}, right: 5 MPa, top: {inflow: 1 L/h}}"
WITH = broken(SIDES, FORMS)
YEAR, HOUR = 365.25 * 86400.0, 3600.0


def test_a_flux_counts_over_the_length_of_the_side(tmp_path):
    scene = case_at(load(tmp_path, WITH), (0,)).scene
    assert scene.side_names == ("right", "left", "top")
    assert scene.held_sides == (("right", 5e6),)
    (left, top) = scene.inflow_sides
    assert left.rate_changes == ((0.0, pytest.approx(-0.36525 / YEAR * 14.0)),)
    assert top.rate_changes == ((0.0, pytest.approx(-1e-3 / HOUR)),)
    assert dict(scene.boundaries)["left"] == Inflow(flux=pytest.approx(0.36525 / YEAR))


def test_inflows_are_varied_and_share_all_but_what_is_made_of_them(tmp_path):
    axis = "vary:\n  q: {parameter: boundaries.top.inflow, values: [1 L/h, 3 L/h]}\n"
    study = load(tmp_path, WITH.replace("vary:\n", axis))
    scenes = [case_at(study, (k, 0)).scene for k in (0, 1)]
    assert [s.inflow_sides[1].rate_changes[0][1] for s in scenes] == pytest.approx(
        [-1e-3 / HOUR, -3e-3 / HOUR]
    )
    plan = make_plan(scenes, stage_table())
    ran = [plan.stages[run.stage].name for run in plan.runs]
    assert ran.count("flow") == 1
    assert ran.count("observe") == 2


def test_a_case_tells_pressure_and_flow_of_its_sides(tmp_path):
    text = WITH.replace("[well_pressure, pressure_map]", "[boundary_pressure, boundary_flow]")
    text = text.replace("  stress: {xx: 20 MPa, yy: 10 MPa}\n", "")
    text = text.replace("yy: {parameter: stress.yy, values: [5 MPa, 10 MPa]}", "")
    text = text.replace("vary:\n", "").replace("count: 500", "count: 300")
    scene = case_at(load(tmp_path, text), ()).scene
    seen = simulate(scene)
    assert seen["boundary_flow"].shape == seen["boundary_pressure"].shape == (3, 3)
    np.testing.assert_allclose(seen["boundary_flow"][2], 1e-3 / HOUR)
    assert np.all(seen["boundary_pressure"][0] == 5e6)
    assert np.all(np.diff(seen["boundary_pressure"][2]) != 0.0)
    assert seen["mass_balance_error"] < 1e-10


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("{inflow: 1 L/h}", "{inflw: 1 L/h}", "a block with the keys {inflow, flux, schedule}"),
        ("{inflow: 1 L/h}", "{inflow: 1 MPa}", "boundaries.top.inflow"),
        ("{inflow: 1 L/h}", "{inflow: 1 L/h, flux: 0 m/s}", "give exactly one of"),
        ("top: {inflow", "tp: {inflow", "the region has no such side"),
        ("{inflow: 1 L/h}", "{schedule: [[2 h, 1 L/h], [1 h, 0 L/h]]}", "times must increase"),
        ("{inflow: 1 L/h}", "{}", "boundaries.top"),
        ("{inflow: 1 L/h}", "{schedule: null}", "give exactly one of"),
    ],
)
def test_faults_are_told_where_they_stand(tmp_path, old, new, told):
    found = problems(tmp_path, broken(old, new, WITH))
    assert len(found) == 1
    assert told in found[0]
    line = WITH[: WITH.index(old)].count("\n") + 1
    assert found[0].startswith(f"{line}:")


def test_no_steady_state_has_a_schedule_or_inflows_alone(tmp_path):
    steady = WITH.replace("  times: [1 s, 1 min, 1 h]\n", "").replace(
        "  initial_pressure: 7 MPa\n", ""
    )
    assert problems(tmp_path, steady) == []
    twice = steady.replace("{inflow: 1 L/h}", "{schedule: [[0 s, 1 L/h], [1 h, 0 L/h]]}")
    (told,) = problems(tmp_path, twice)
    assert "a schedule has no steady state" in told
    (told,) = problems(tmp_path, steady.replace("right: 5 MPa, ", ""))
    assert "without a fixed pressure" in told


def test_a_coupled_rock_takes_no_inflow(tmp_path):
    text = WITH.replace("  stress:", "  coupling: linear\n  stress:")
    text = text.replace(
        "    natural: {kind: set, angle: 65 deg, length: 5 m, spacing: 2 m, aperture: 100 um}\n", ""
    )
    text = text.replace(
        "    joint: {kind: trace, from: [-3, 1], to: [4, 2], aperture: 100 um}\n", ""
    ).replace("  fractures:\n", "")
    found = problems(tmp_path, text)
    assert any("boundaries.left" in one and "without coupling" in one for one in found)
