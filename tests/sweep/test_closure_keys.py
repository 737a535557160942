"""`closure` in a study, and what `check` tells where stress closes nothing."""

import pytest
import yaml
from study_text import SMALL, load

from demflow.model.scene import Closure
from demflow.sweep.command.traces import told_closures, told_multipliers, told_partings
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import StudyError

JOINT = "joint: {kind: trace, from: [-3, 1], to: [4, 2], aperture: 100 um}"


def closing(words: str) -> str:
    assert JOINT in SMALL
    return SMALL.replace(JOINT, JOINT.replace("um}", f"um, closure: {words}}}"))


@pytest.mark.parametrize(
    ("words", "law"),
    [
        ("none", Closure(law="none")),
        ("{half_stress: 5 MPa}", Closure(half_stress=5e6)),
        (
            "{table: [[0 MPa, 100 um], [10 MPa, 40 um]]}",
            Closure(table=((0.0, 1e-4), (1e7, 4e-5))),
        ),
    ],
)
def test_laws_are_read(tmp_path, words, law):
    fractures = case_at(load(tmp_path, closing(words)), (0,)).scene.fractures
    (found,) = [one.closure for one in fractures if one.name == "joint"]
    assert found is not None
    assert found == law or found.table == pytest.approx(law.table)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("nonne", "is none of none"),
        ("{table: [[0, 100 um], [10 MPa, 200 um]]}", "must not grow with stress"),
        ("{table: [[0, 100 um], [10 um, 2 um]]}", "table"),
        ("{half_stress: 1 MPa, table: [[0, 1], [1, 1]]}", "exactly one of half_stress"),
    ],
)
def test_what_is_no_law_is_refused(tmp_path, words, told):
    with pytest.raises(StudyError) as error:
        load(tmp_path, closing(words))
    assert told in str(error.value)


def test_check_tells_what_a_varied_stress_leaves_as_it_is(tmp_path):
    natural, _, matrix = told_closures(load(tmp_path, SMALL))
    assert natural.startswith("fractures.natural: apertures are the same at every stress")
    assert natural.endswith("for it has no closure")
    assert matrix.endswith("for it has neither half_stress nor half_force")
    assert told_closures(load(tmp_path, closing("none")))[1].endswith("as closure: none says")
    closed = closing("{half_stress: 5 MPa}").replace("mD}", "mD, half_stress: 1 MPa}")
    assert told_closures(load(tmp_path, closed)) == [natural]
    rates = SMALL.replace("stress.yy, values: [5 MPa, 10 MPa]", "grains.seed, values: [1, 2]")
    assert told_closures(load(tmp_path, rates)) == []


@pytest.mark.parametrize(
    ("matrix", "bonded", "warned"),
    [
        ("half_stress: 1 MPa", False, True),
        ("half_force: 1 MN/m", False, True),
        ("half_stress: 1 MPa, gap_factor: 0", False, False),
        ("half_stress: 1 MPa", True, False),
        ("", False, False),
    ],
)
def test_check_warns_of_grains_that_may_part(tmp_path, matrix, bonded, warned):
    study = yaml.safe_load(SMALL)
    scene = study["scene"]
    scene["matrix"] |= yaml.safe_load(f"{{{matrix}}}")
    scene.pop("bonds", None)
    if bonded:
        scene["bonds"] = {
            "kind": "parallel",
            "tensile_strength": "1 GPa",
            "shear_strength": "1 GPa",
        }
    found = told_partings(load(tmp_path, yaml.safe_dump(study)))
    assert bool(found) == warned


@pytest.mark.parametrize(
    ("barrier", "warned"),
    [
        ("transmissibility_multiplier: 0.01", True),
        ("transmissibility_multiplier: 0", False),  # sealed, whatever the grains
        ("thickness: 5 cm, permeability: 1 uD", False),
        ("resistance: 1e12 Pa s/m", False),
    ],
)
def test_check_warns_of_barriers_whose_worth_depends_on_the_grains(tmp_path, barrier, warned):
    text = SMALL.replace(JOINT, JOINT.replace("aperture: 100 um", barrier))
    found = told_multipliers(load(tmp_path, text))
    assert [line.startswith("fractures.joint: ") for line in found] == [True] * warned
