"""The forms of `initial_pressure`: a number, a field, the word steady."""

import json

import pytest

from demflow import sweep
from demflow.model.scene import InitialField
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.schema import study_schema
from demflow.sweep.study.yaml_source import StudyError

STUDY = """\
study: starts
scene:
  region: {{shape: circle, radius: 14 m}}
  grains: {{count: 200, packing: square}}
  matrix: {{aperture: 10 um}}
  fluid: {{viscosity: 1 cP, bulk_modulus: 2.2 GPa}}
  wells:
    w: {{at: [0, 0], radius: 1 m, rate: 1e-6 m3/s, skin_factor: 2, wellbore_storage: 1e-9 m3/Pa}}
  boundaries: {{outer: 5 MPa}}
  initial_pressure: {start}
  times: [1 s, 1 h]
{vary}observe: [well_pressure]
smoke: {{grains.count: 100}}
"""


def load(tmp_path, start, vary=""):
    path = tmp_path / "study.yaml"
    path.write_text(STUDY.format(start=start, vary=vary), encoding="utf-8")
    return sweep.load_study(path)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("7 MPa", 7e6),
        ("steady", "steady"),
        (
            "{pressure: 7 MPa, at: [1 m, 2 m], gradient: [0 Pa/m, -10 kPa/m]}",
            InitialField(pressure=7e6, at=(1.0, 2.0), gradient=(0.0, -1e4)),
        ),
        (
            "{pressure: 7 MPa, gradient: [0, 1]}",
            InitialField(pressure=7e6, gradient=(0.0, 1.0)),
        ),
    ],
)
def test_each_form_is_read(tmp_path, text, expected):
    scene = case_at(load(tmp_path, text), []).scene
    assert scene.initial_pressure == expected
    assert (scene.wells[0].skin_factor, scene.wells[0].wellbore_storage) == (2.0, 1e-9)


def test_a_number_and_the_parts_of_a_field_can_vary(tmp_path):
    for start, parameter in (
        ("7 MPa", "initial_pressure"),
        ("{pressure: 7 MPa, gradient: [0, 1]}", "initial_pressure.pressure"),
    ):
        vary = f"vary:\n  start: {{parameter: {parameter}, values: [1 MPa, 2 MPa]}}\n"
        study = load(tmp_path, start, vary)
        last = case_at(study, [1]).scene.initial_pressure
        assert (last if start == "7 MPa" else last.pressure) == 2e6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stedy", "not a number"),
        ("7 m", "7 m is a length"),
        ("{pressure: 7 MPa}", "lacks 'gradient'"),
        ("{pressure: 7 MPa, gradient: [0, 1], up: 1}", "unknown key 'up'"),
        ("{pressure: 7 MPa, gradient: 3}", "a list of 2 values"),
    ],
)
def test_slips_are_found_with_their_place(tmp_path, text, message):
    with pytest.raises(StudyError, match=message) as error:
        load(tmp_path, text)
    assert ":10:" in str(error.value)


def test_the_schema_knows_all_forms():
    forms = study_schema()["properties"]["scene"]["properties"]["initial_pressure"]
    text = json.dumps(forms)
    assert '"const": "steady"' in text
    assert "gradient" in text
