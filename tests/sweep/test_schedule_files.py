"""Schedules of wells, sides and walls may stand in files."""

import numpy as np
import pytest

from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import load_study
from demflow.sweep.study.yaml_source import StudyError

STUDY = """study: scheduled
scene:
  region: {shape: rectangle, width: 4 m, height: 4 m}
  grains: {count: 100, packing: square}
  matrix: {aperture: 10 um}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  wells: {p: {at: [0 m, 0 m], radius: 0.1 m, WELL}}
  boundaries: {left: 2 MPa, right: SIDE}
  initial_pressure: 2 MPa
  times: {first: 1 s, last: 4 d, per_decade: 4}
observe: [well_pressure]
"""


def scene_of(folder, files, well="rate: 1e-6 m3/s", side="2 MPa"):
    for name, text in files.items():
        (folder / name).write_text(text)
    path = folder / "study.yaml"
    path.write_text(STUDY.replace("WELL", well).replace("SIDE", side))
    return case_at(load_study(path), ()).scene


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("q.csv", "time [h],rate [L/h]\n0,36\n24,0\n"),
        ("q.csv", "t,q\nh,m3/h\n0,0.036\n24,0\n"),
        ("q.txt", "# a logger\nmade by hand\nt [d]\tq [m3/h]\tremark\n0\t0.036\ton\n1\t0\toff\n"),
        ("q.csv", "date,rate [L/h]\n2024-05-17 08:30,36\n2024-05-18 08:30,0\n"),
        ("q.csv", "Date;Time;rate [L/h]\n2024-05-17;08:30;36,0\n2024-05-18;08:30;0\n"),
    ],
)
def test_a_file_is_the_list_that_it_holds(tmp_path, name, text):
    listed = scene_of(tmp_path, {}, "schedule: [[0 s, 36 L/h], [1 d, 0 L/h]]")
    filed = scene_of(tmp_path, {name: text}, f"schedule: {name}")
    for ours, theirs in zip(filed.wells[0].schedule, listed.wells[0].schedule, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-12)


def test_pressures_and_inflows_have_files_too(tmp_path):
    files = {
        "p.csv": "time [d],pressure [bar]\n0,15\n2,10\n",
        "in.csv": "time [d],inflow [L/h]\n0,36\n2,0\n",
    }
    scene = scene_of(tmp_path, files, "pressure_schedule: p.csv", "{schedule: in.csv}")
    held = scene.wells[0].pressure_schedule
    flows_in = dict(scene.boundaries)["right"].schedule
    np.testing.assert_allclose(held, [(0.0, 15e5), (172800.0, 10e5)], rtol=1e-12)
    np.testing.assert_allclose(flows_in, [(0.0, 1e-5), (172800.0, 0.0)], rtol=1e-12)


def test_an_axis_takes_files_and_lists(tmp_path):
    (tmp_path / "q.csv").write_text("time [s],rate [m3/s]\n0,2e-6\n")
    path = tmp_path / "study.yaml"
    text = STUDY.replace("WELL", "schedule: q.csv").replace("SIDE", "2 MPa")
    values = "{parameter: wells.p.schedule, values: [q.csv, [[0 s, 1e-6 m3/s]]]}"
    path.write_text(f"{text}vary: {{q: {values}}}\n")
    study = load_study(path)
    found = [case_at(study, (k,)).scene.wells[0].schedule for k in range(2)]
    assert found == [((0.0, 2e-6),), ((0.0, 1e-6),)]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t [h],x [L/h]\n0,1\n1,2\n", "no column is the rate; name it so"),
        ("t [h],q [psi]\n0,1\n1,2\n", "1 psi is a pressure"),
        ("t [h],q [L/h]\n0,1\n1,\n", "line 3 without time or value"),
        ("t [h],q [L/h]\n1,1\n0,2\n", "times must increase"),
        ("date,q [L/h]\n17/05/2024,1\n18/05/2024,2\n", "nor a date as in 2024-05-17T08:30:00"),
        ("t [h],q\n0,1\n1,2\n", "column 'q' has no unit"),
        ("t [s],q [L/h]\n" + "".join(f"{k},1\n" for k in range(10_001)), "10001 changes"),
        (None, "there is no such file"),
    ],
)
def test_a_file_that_holds_no_schedule_is_refused_at_its_place(tmp_path, text, said):
    files = {} if text is None else {"q.csv": text}
    with pytest.raises(StudyError) as raised:
        scene_of(tmp_path, files, "schedule: q.csv")
    (problem,) = raised.value.problems
    assert said in problem.message
    assert "date_format" not in problem.message
    assert problem.line == 7
