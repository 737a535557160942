"""`gravity` and `excavate` in a study: forms, names, axes, and what is wrong with them."""

import pytest
from study_text import SMALL, load

from demflow.model.scene import CircularHole, PolygonalHole, RectangularHole
from demflow.sweep.plan.graph import make_plan, stage_table
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import StudyError

HOLES = """\
  gravity: 9.81 m/s2
  excavate:
    - {shape: circle, at: [-3 m, -4 m], radius: 150 cm, name: drift, pressure: 1 MPa}
    - {shape: rectangle, at: [0 m, 4 m], width: 3 m, height: 2 m}
    - {shape: polygon, vertices: [[4, -6], [6, -6], [5, -4]]}
  boundaries: {left: 7 MPa, right: 5 MPa, drift: 0 Pa, "hole[1]": 1 bar}
"""
SIDES = "  boundaries: {left: 7 MPa, right: 5 MPa}\n"
WITH = SMALL.replace(SIDES, HOLES)


def test_holes_are_read_with_names_units_and_shapes(tmp_path):
    scene = case_at(load(tmp_path, WITH), (0,)).scene
    assert scene.gravity == 9.81
    round_, drift, wedge = scene.excavate
    assert round_ == CircularHole(at=(-3.0, -4.0), radius=1.5, side="drift", pressure=1e6)
    assert drift == RectangularHole(at=(0.0, 4.0), width=3.0, height=2.0)
    assert wedge == PolygonalHole(vertices=((4.0, -6.0), (6.0, -6.0), (5.0, -4.0)))
    assert scene.rock.sides[-3:] == ("drift", "hole[1]", "hole[2]")
    assert dict(scene.boundaries)["hole[1]"] == 1e5


def test_a_hole_can_be_varied_and_shares_the_packing_with_none(tmp_path):
    text = WITH.replace(
        "vary:\n", "vary:\n  size: {parameter: excavate.0.radius, values: [1, 2]}\n"
    )
    study = load(tmp_path, text)
    plain = load(tmp_path, SMALL)
    scenes = [case_at(study, (k, 0)).scene for k in (0, 1)]
    assert [scene.excavate[0].radius for scene in scenes] == [1.0, 2.0]
    plan = make_plan([*scenes, case_at(plain, (0,)).scene], stage_table())
    runs = [plan.runs[k].stage for k in range(len(plan.runs))]
    names = [plan.stages[k].name for k in runs]
    assert names.count("pack") == 1
    assert names.count("stress") == names.count("network") == 3


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("shape: circle", "shape: circel", "excavate.0.shape: 'circel' is none of circle"),
        ("radius: 150 cm", "radius: 150 cP", "excavate.0.radius"),
        ("radius: 150 cm, ", "", "excavate.0 lacks 'radius'"),
        ("name: drift", "nme: drift", "did you mean 'name'"),
        ("drift: 0 Pa", "drfit: 0 Pa", "no such side"),
        ("9.81 m/s2", "9.81 m/s", "gravity"),
        ("[-3 m, -4 m]", "[-6 m, -4 m]", "excavate.0: it reaches beyond the region"),
        ("    - {shape: circle", "    - 3\n    - {shape: circle", "excavate.0 lacks 'shape'"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path, old, new, told):
    with pytest.raises(StudyError) as error:
        load(tmp_path, WITH.replace(old, new))
    assert told in str(error.value)
