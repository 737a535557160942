"""What a user reads of coupling before anything runs."""

import pytest

from demflow.model.scene import one_way_ratio
from demflow.sweep.command.cli import main
from demflow.sweep.command.coupling import told_coupling
from demflow.sweep.study.load import load_study

ROCK = """
study: told
scene:
  region: {shape: rectangle, width: 3 m, height: 3 m}
  grains: {count: 300, porosity: 0.17, seed: 1, modulus: 20 GPa}
  bonds: {kind: parallel, tensile_strength: 50 MPa, shear_strength: 50 MPa}
  stress: {xx: 10 MPa, yy: 10 MPa}
  matrix: {permeability: 5 mD, half_stress: 10 MPa}
  fluid: {viscosity: 1 cP, bulk_modulus: 2.2 GPa}
  boundaries: {left: 50 MPa, right: 45 MPa}
  initial_pressure: 50 MPa
  coupling: auto
  times: [1 s, 1 h]
vary:
  right: {parameter: boundaries.right, values: [49.99 MPa, 45 MPa]}
observe: [boundary_flow]
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "told.yaml"
    path.write_text(ROCK)
    return path


def test_check_tells_what_auto_takes_and_what_one_way_costs(study, capsys):
    assert main(["check", str(study)]) == 0
    first, last = [line for line in capsys.readouterr().out.splitlines() if "coupling" in line]
    assert first.startswith("coupling of the first case: linear; ")
    assert last.startswith("coupling of the last case: apertures; ")
    assert f"off by about {1.0 / one_way_ratio(0.5, 0.5) - 1.0:.1%}" in last
    assert "off by about 0.1%" in first


def test_a_method_that_is_chosen_is_told_with_the_same_cost(study):
    study.write_text(ROCK.replace("coupling: auto", "coupling: linear"))
    _, last = told_coupling(load_study(study))
    assert last.startswith("coupling of the last case: linear; ")
    assert "off by about" in last
    study.write_text(ROCK.replace("  coupling: auto\n", ""))
    assert told_coupling(load_study(study)) == []
