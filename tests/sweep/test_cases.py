"""Cases: their order, what they share, and the coordinates that axes give to the dataset."""

import itertools
import math

import numpy as np
import pytest
from study_text import EXAMPLE, SMALL, load

from demflow.model.parameters import SceneError
from demflow.sweep.analysis.cases import axis_title
from demflow.sweep.study.axes import Axis
from demflow.sweep.study.cases import Case, case_at, coordinates
from demflow.sweep.study.scenes import SceneBuilder


def varied(folder, axes, text=SMALL):
    return load(folder, text[: text.index("vary:")] + axes + text[text.index("observe:") :])


def cases(study):
    """Every case in the order of a plan, from one builder as there."""
    builder = SceneBuilder(study.values, study.axes)
    return [Case(index, builder.scene(index)) for index in np.ndindex(study.shape)]


def test_every_case_once_the_last_axis_fastest(tmp_path):
    study = load(tmp_path, EXAMPLE)
    made = cases(study)
    assert study.shape == (3, 5, 3, 2)
    assert [case.index for case in made] == list(np.ndindex(3, 5, 3, 2))
    assert len({case.scene for case in made}) == len(made)
    for case in made:
        angle, aperture, stress, rate = (
            axis.values[k][0] for axis, k in zip(study.axes, case.index, strict=True)
        )
        natural = case.scene.fractures[1]
        assert (natural.angle, natural.aperture) == (angle, aperture)
        assert (case.scene.stress.yy, case.scene.wells[0].rate) == (stress, rate)


def test_a_case_alone_is_the_case_of_the_sweep(tmp_path):
    study = load(tmp_path, EXAMPLE)
    for case in itertools.islice(cases(study), 0, None, 7):
        assert case_at(study, case.index) == case
        assert hash(case_at(study, case.index).scene) == hash(case.scene)


def test_blocks_of_equal_content_are_one_object(tmp_path):
    made = cases(load(tmp_path, EXAMPLE))
    assert len({id(case.scene.grains) for case in made}) == 1
    assert len({id(case.scene.wells) for case in made}) == 2
    assert len({id(case.scene.stress) for case in made}) == 3
    assert len({id(case.scene.fractures) for case in made}) == 15


@pytest.mark.slow
def test_more_variants_of_a_block_than_are_kept(tmp_path):
    axes = "vary:\n  q: {parameter: wells.producer.rate, from: 1, to: 90, count: 90}\n"
    axes += "  r: {parameter: wells.producer.radius, from: 1 mm, to: 90 mm, count: 90}\n"
    study = varied(tmp_path, axes)
    for case in cases(study):
        well = case.scene.wells[0]
        assert (well.rate, well.radius) == tuple(
            axis.values[k][0] for axis, k in zip(study.axes, case.index, strict=True)
        )


@pytest.mark.parametrize("index", [(0,), (0, 0, 0, 2), (0, 0, 0, -1), (0, 0, 0, 0, 0), ()])
def test_an_index_that_does_not_fit(tmp_path, index):
    with pytest.raises(IndexError, match="does not fit a study of shape"):
        case_at(load(tmp_path, EXAMPLE), index)


def test_a_case_that_could_not_be_foreseen_raises_at_that_case_alone(tmp_path):
    """Three parameters that clash only together, among more combinations than are tried."""
    axes = """vary:
  w: {parameter: region.width, values: [24 m, 12 m]}
  h: {parameter: boundaries.left, from: 1 MPa, to: 70 MPa, count: 70}
  q: {parameter: wells.producer.rate, from: 1, to: 70, count: 70}
  x: {parameter: wells.producer.at, values: [[0, 0], [7 m, 0]]}
"""
    text = SMALL.replace("{p: {at: [3, 0]}}", "{p: {at: [0, 3]}}")
    study = varied(tmp_path, axes, text)
    assert case_at(study, (0, 5, 5, 1)).scene.wells[0].at == (7.0, 0.0)
    with pytest.raises(SceneError, match=r"wells\.producer\.at: the well lies outside"):
        case_at(study, (1, 5, 5, 1))


def test_coordinates_of_simple_axes(tmp_path):
    angle, aperture, stress, rate = (coordinates(axis) for axis in load(tmp_path, EXAMPLE).axes)
    assert [len(each) for each in (angle, aperture, stress, rate)] == [1, 1, 1, 1]
    assert (angle[0].name, angle[0].unit) == ("fracture_angle", "degree")
    assert angle[0].values.tolist() == [0.0, 30.0, 65.0]  # to the last bit
    assert angle[0].long_name == "natural: angle from the x axis, counter-clockwise"
    assert (aperture[0].unit, aperture[0].values[0], aperture[0].values[-1]) == ("m", 2e-5, 5e-4)
    assert np.diff(np.log(aperture[0].values)) == pytest.approx([math.log(25) / 4] * 4)
    assert (rate[0].name, rate[0].unit, rate[0].values.tolist()) == ("rate", "m3 s-1", [1e-5, 2e-5])


def test_coordinates_of_other_axes(tmp_path):
    study = varied(
        tmp_path,
        """vary:
  place: {parameter: wells.producer.at, values: [[0, 0], [1 m, 2 m]]}
  state: {parameters: [stress.xx, stress.yy], values: [[1 MPa, 2 MPa], [3 MPa, 4 MPa]]}
  kind: {parameters: [fractures.joint.aperture, fractures.joint.permeability],
         values: [[1 um, null], [null, 5 m2]]}
  word: {parameter: solver.method, values: [auto, explicit]}
  pump: {parameters: [wells.producer.rate, wells.producer.schedule],
         values: [[1e-5, null], [null, [[0 s, 1e-5], [1 h, 0]]]]}
  seed: {parameter: grains.seed, values: [1, 2, 3]}
""",
    )
    place, state, kind, word, pump, seed = (coordinates(axis) for axis in study.axes)
    assert [c.name for c in place] == ["place", "producer_at_x", "producer_at_y"]
    assert place[0].values.tolist() == ["[0 m, 0 m]", "[1 m, 2 m]"]
    assert place[2].values.tolist() == [0.0, 2.0]
    assert [c.name for c in state] == ["state", "stress_xx", "stress_yy"]
    assert state[0].values.tolist() == ["1 MPa, 2 MPa", "3 MPa, 4 MPa"]
    assert state[2].values.tolist() == [2e6, 4e6]
    assert [c.name for c in kind] == ["kind", "joint_aperture", "joint_permeability"]
    assert kind[0].values[0] == "1 um, none"
    np.testing.assert_array_equal(kind[1].values, [1e-6, np.nan])
    assert (word[0].name, word[0].values.tolist(), word[0].unit) == (
        "word",
        ["auto", "explicit"],
        "",
    )
    assert pump[2].values.tolist() == ["", "[[0 s, 1e-05 m3/s], [3600 s, 0 m3/s]]"]
    assert seed[0].values.tolist() == [1, 2, 3]
    assert seed[0].values.dtype.kind == "i"


def test_names_of_coordinates_are_unique_and_free(tmp_path):
    study = varied(
        tmp_path,
        """vary:
  grains_seed: {parameter: grains.friction, values: [0, 1]}
  a: {parameters: [wells.producer.at, grains.seed], values: [[[0, 0], 1], [[1, 1], 2]]}
  b: {parameters: [probes.producer.at, stress.xx], values: [[[3, 0], 1], [[3, 1], 2]]}
""",
        SMALL.replace("{p: {at: [3, 0]}}", "{producer: {at: [3, 0]}}"),
    )
    names = [c.name for axis in study.axes for c in coordinates(axis)]
    assert len(names) == len(set(names)) == 9
    assert {"producer_at_x", "probes_producer_at_x", "grains_seed", "grains_seed_"} <= set(names)


@pytest.mark.parametrize(
    ("unit", "cf"),
    [
        ("m3/s", "m3 s-1"),
        ("1/Pa", "Pa-1"),
        ("kg/m3", "kg m-3"),
        ("Pa s", "Pa s"),
        ("N/m", "N m-1"),
        ("rad", "degree"),
        ("1", "1"),
    ],
)
def test_units_as_cf_writes_them(unit, cf):
    axis = Axis("a", ("x.y",), ((1.0,),), (unit,), ("x_y",), ("what",))
    assert coordinates(axis)[0].unit == cf


def test_a_coordinate_that_had_to_make_way_is_called_as_what_it_is():
    assert axis_title("matrix_aperture_") == "matrix aperture"
    assert axis_title("stress_yy") == "stress yy"
