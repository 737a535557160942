"""`gravity` and `excavate` in a study: forms, names, axes, and what is wrong with them."""

import numpy as np
import pytest
import xarray as xr
from PIL import Image
from study_text import SMALL, load

from demflow.model.scene import CircularHole, PolygonalHole, RectangularHole
from demflow.sweep.figures.holes import draw_inflow
from demflow.sweep.figures.style import house_style
from demflow.sweep.plan.graph import make_plan
from demflow.sweep.plan.table import stage_table
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


@pytest.mark.slow
def test_inflow_is_drawn_against_the_axis_that_changes_it_most(tmp_path):
    half, far, seed = np.array([5e6, 20e6, 80e6]), np.array([10e6, 40e6]), np.array([1, 2, 3])
    flow = np.einsum("h,f,s->hfs", half, 1.0 / (far + 50e6), 1.0 + 0.01 * seed)
    whole = xr.Dataset(
        {
            "status": (("half", "far", "seed"), np.zeros(flow.shape, np.int8)),
            "boundary_flow": (("half", "far", "seed", "boundary"), np.stack([-flow, flow], -1)),
        },
        {"half": half, "far": far, "seed": seed, "boundary": ["drift", "top"]},
    )
    with house_style():
        path = draw_inflow(whole, {"drift"}, tmp_path / "inflow.png", {"seed"})
        assert path is not None
        with Image.open(path) as image:
            told = image.info["Description"]
        assert told == "Steady inflow into drift against half; bars: standard deviation over seed."
        assert draw_inflow(whole, {"shaft"}, tmp_path / "none.png", {"seed"}) is None
        alone = whole.isel(half=[0], far=[0])
        assert draw_inflow(alone, {"drift"}, tmp_path / "none.png", {"seed"}) is None


@pytest.mark.slow
def test_inflow_is_drawn_in_time_where_there_is_time(tmp_path):
    half, seed, time = np.geomspace(1e6, 1e8, 12), np.array([1, 2]), np.array([0.0, 1e3, 1e4, 1e5])
    flow = np.einsum("h,s,t->hst", half, 1.0 + 0.01 * seed, 1e-14 / (1.0 + time))
    whole = xr.Dataset(
        {
            "status": (("half", "seed"), np.zeros((12, 2), np.int8)),
            "boundary_flow": (
                ("half", "seed", "boundary", "elapsed_time"), np.stack([-flow, flow], 2)
            ),
        },
        {"half": half, "seed": seed, "boundary": ["drift", "top"], "elapsed_time": time},
    )  # fmt: skip
    with house_style():
        path = draw_inflow(whole, {"drift"}, tmp_path / "inflow.png", {"seed"})
        assert path is not None
        with Image.open(path) as image:
            told = image.info["Description"]
        words = "8 of 12 values of half; bands: standard deviation over seed"
        assert told == f"Inflow of drift in time; {words}."
        alone = whole.isel(half=[3], seed=[0])
        assert draw_inflow(alone, {"drift"}, tmp_path / "alone.png", {"seed"}) is not None
        assert draw_inflow(whole, {"shaft"}, tmp_path / "none.png", {"seed"}) is None
