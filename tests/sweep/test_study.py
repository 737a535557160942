"""Studies that load: what their text means."""

import hashlib
import itertools
import math
import pickle
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from study_text import EXAMPLE, SMALL, broken, load

from demflow.model.scene import BiWing, Circle, FractureSet, Grains, Trace
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import load_study
from demflow.sweep.study.scene import SCENE


@pytest.fixture
def example(tmp_path):
    return load(tmp_path, EXAMPLE)


def test_the_documented_example_loads(example):
    assert example.name == "fractured-reservoir"
    assert example.shape == (3, 5, 3, 2)
    assert example.text == EXAMPLE
    assert example.sha256 == hashlib.sha256(EXAMPLE.encode()).hexdigest()
    assert [axis.name for axis in example.axes] == [
        "fracture_angle",
        "aperture",
        "stress_yy",
        "rate",
    ]
    scene = case_at(example, (2, 4, 0, 1)).scene
    assert scene.region == Circle(radius=14.0)
    assert scene.grains == Grains(count=4000, porosity=0.16, modulus=20e9)
    assert [type(fracture) for fracture in scene.fractures] == [BiWing, FractureSet, Trace]
    assert [fracture.name for fracture in scene.fractures] == ["hydraulic", "natural", "other"]
    natural = scene.fractures[1]
    assert (natural.angle, natural.aperture) == (pytest.approx(math.radians(65)), 5e-4)
    assert scene.fractures[2].start == (-3.0, 1.0)
    assert (scene.stress.xx, scene.stress.yy) == (20e6, 5e6)
    assert scene.wells[0].rate == 2e-5
    assert scene.boundaries == (("outer", 7e6),)
    assert scene.matrix.half_force == 5e6
    assert scene.observe == ("well_pressure", "permeability", "pressure_map")


def test_a_line_of_probes_is_expanded(example):
    probes = case_at(example, (0, 0, 0, 0)).scene.probes
    assert [p.name for p in probes] == ["inner", *(f"line[{k}]" for k in range(50))]
    assert probes[1].at == (0.0, 0.0)
    assert probes[50].at == (13.8, 0.0)
    steps = [b.at[0] - a.at[0] for a, b in itertools.pairwise(probes[1:])]
    assert steps == pytest.approx([13.8 / 49] * 49)


def test_times_are_even_in_their_logarithm_and_include_both_ends(example):
    times = case_at(example, (0, 0, 0, 0)).scene.times
    assert (times[0], times[-1]) == (1.0, 24000.0)
    ratios = [b / a for a, b in itertools.pairwise(times)]
    assert ratios == pytest.approx([ratios[0]] * len(ratios))
    assert 20 <= 1 / math.log10(ratios[0]) < 20.5


def test_round_decades_are_met_exactly(tmp_path):
    text = broken("times: [1 s, 1 min, 1 h]", "times: {first: 1e-3, last: 100, per_decade: 1}")
    assert case_at(load(tmp_path, text), (0,)).scene.times == (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)


def test_times_begin_anew_where_a_rate_changes(tmp_path):
    text = broken(
        "times: [1 s, 1 min, 1 h]",
        "times: {first: 1 s, last: 250 s, per_decade: 2, restart: [100 s, 150 s]}",
    )
    times = case_at(load(tmp_path, text), (0,)).scene.times
    first = [10.0 ** (k / 2) for k in range(5)]
    second = [100.0 + 50.0 ** (k / 4) for k in range(5)]
    assert times == pytest.approx([*first, *second, *(150.0 + lag for lag in first)], rel=1e-11)
    assert times[4] == 100.0
    assert times[9] == 150.0
    assert times[-1] == 250.0


def test_an_axis_supplies_what_the_scene_leaves_out(tmp_path):
    text = broken("stress: {xx: 20 MPa, yy: 10 MPa}", "stress: {xx: 20 MPa}")
    study = load(
        tmp_path,
        broken(", rate: 1 bbl/day", "", text).replace(
            "vary:", "vary:\n  q: {parameter: wells.producer.pressure, values: [1 MPa, 2 MPa]}"
        ),
    )
    scene = case_at(study, (1, 0)).scene
    assert (scene.stress.yy, scene.wells[0].pressure) == (5e6, 2e6)


def test_axes_over_words_points_schedules_several_and_nothing(tmp_path):
    axes = """vary:
  place: {parameter: wells.producer.at, values: [[0, 0], [1 m, 2 ft]]}
  kind: {parameters: [grains.packing, grains.porosity, stress.xx, stress.yy],
         values: [[random, 0.16, 1 MPa, 1 MPa], [random, 0.18, 2 MPa, 3 MPa]]}
  what: {parameters: [fractures.joint.aperture, fractures.joint.permeability],
         values: [[1 um, null], [null, 5 D]]}
  top: {parameter: boundaries.top, values: [1 MPa, 2 MPa]}
  seed: {parameter: grains.seed, from: 1, to: 5, count: 3}
  pumps: {parameters: [wells.producer.rate, wells.producer.schedule],
          values: [[1e-5, null], [null, [[0 s, 1e-5], [1 h, 0]]]]}
"""
    study = load(tmp_path, SMALL[: SMALL.index("vary:")] + axes + SMALL[SMALL.index("observe:") :])
    assert study.shape == (2, 2, 2, 2, 3, 2)
    scene = case_at(study, (1, 1, 1, 1, 2, 1)).scene
    assert scene.wells[0].at == (1.0, pytest.approx(0.6096))
    assert scene.wells[0].schedule == ((0.0, 1e-5), (3600.0, 0.0))
    assert scene.wells[0].rate is None
    assert (scene.grains.porosity, scene.stress.xx, scene.stress.yy) == (0.18, 2e6, 3e6)
    assert (scene.fractures[1].aperture, scene.grains.seed) == (None, 5)
    assert scene.fractures[1].permeability == pytest.approx(4.9346163e-12)
    assert dict(scene.boundaries)["top"] == 2e6


def test_spaced_values(tmp_path):
    def values(axis: str) -> list:
        text = SMALL.replace("yy: {parameter: stress.yy, values: [5 MPa, 10 MPa]}", axis)
        return [point[0] for point in load(tmp_path, text).axes[0].values]

    spaced = "a: {{parameter: {}, from: {}, to: {}, count: {}, spacing: {}}}"
    listed = "a: {{parameter: {}, values: {}}}"
    assert values(spaced.format("stress.yy", "1 kPa", "10 MPa", 5, "log")) == [
        1e3,
        1e4,
        1e5,
        1e6,
        1e7,
    ]
    assert values(spaced.format("stress.yy", "1 MPa", "2 MPa", 3, "linear")) == [1e6, 1.5e6, 2e6]
    assert values(spaced.format("stress.yy", "1 MPa", "2 MPa", 1, "linear")) == [1e6]
    angle = "fractures.natural.angle"
    assert values(spaced.format(angle, "0 deg", "90 deg", 4, "linear")) == values(
        listed.format(angle, "[0 deg, 30 deg, 60 deg, 90 deg]")
    )


def test_smoke_overrides(tmp_path):
    smoke = """smoke: {grains.count: 50, vary.yy: [7 MPa], times: [1 s], solver.method: krylov,
        figures.maps: [1 s], matrix.gap_factor: 0.1, observe: [pressure_map], title: short}
figures: {maps: [1 min], compare: linear}
limits: {time: 10 min, memory: 4 GB}
"""
    full = load(tmp_path, SMALL + smoke)
    small = load(tmp_path, SMALL + smoke, smoke=True)
    assert (full.shape, small.shape) == ((2,), (1,))
    assert (full.smoke, small.smoke) == (False, True)
    assert full.sha256 == small.sha256
    assert full.axes[0].values[0] == (5e6,)
    a, b = case_at(full, (0,)).scene, case_at(small, (0,)).scene
    assert (a.grains.count, b.grains.count) == (500, 50)
    assert (a.matrix.gap_factor, b.matrix.gap_factor) == (0.5, 0.1)
    assert (b.stress.yy, b.times, b.solver.method, b.solver.tolerance) == (
        7e6,
        (1.0,),
        "krylov",
        1e-3,
    )
    assert (full.figures.maps, small.figures.maps, full.figures.compare) == (
        (60.0,),
        (1.0,),
        "linear",
    )
    assert (full.limits.time, full.limits.memory) == (600.0, 4e9)
    assert (small.title, full.title) == ("short", "small")


def test_smoke_takes_the_place_of_a_spacing(tmp_path):
    study = load(
        tmp_path, EXAMPLE.replace("smoke: {", "smoke: {vary.aperture: [20 um], "), smoke=True
    )
    assert study.axes[1].values == ((2e-5,),)
    study = load(
        tmp_path, EXAMPLE.replace("smoke: {", "smoke: {vary.aperture.count: 2, "), smoke=True
    )
    assert study.axes[1].values == ((2e-5,), (5e-4,))


def test_without_axes_there_is_one_case(tmp_path):
    text = SMALL.replace("vary:\n  yy: {parameter: stress.yy, values: [5 MPa, 10 MPa]}\n", "")
    study = load(tmp_path, text)
    assert study.shape == ()
    assert case_at(study, ()).scene.stress.yy == 10e6
    assert study.title == "small"
    assert (study.limits.time, study.limits.memory) == (24 * 3600.0, None)
    assert study.figures.maps == ()


def test_an_empty_optional_block_is_as_good_as_none(tmp_path):
    assert (
        case_at(
            load(tmp_path, broken("  probes: {p: {at: [3, 0]}}", "  probes:")), (0,)
        ).scene.probes
        == ()
    )


def test_a_polygon_and_its_sides(tmp_path):
    text = broken(
        "{shape: rectangle, width: 14 m, height: 14 m}",
        "{shape: polygon, vertices: [[-7, -7], [7 m, -7], [7, 7], [-7, 7]]}",
    )
    study = load(tmp_path, broken("{left: 7 MPa, right: 5 MPa}", "{'side[0]': 7 MPa}", text))
    assert case_at(study, (0,)).scene.boundaries == (("side[0]", 7e6),)


def test_every_declared_parameter_is_a_key():
    """What the dataclasses declare is what the grammar knows, key by key and unit by unit."""

    def compare(block):
        declared = {
            f.metadata.get("key") or f.name: f for f in fields(block.cls) if f.name != "name"
        }
        assert list(block.members) == list(declared)
        for key, member in block.members.items():
            if hasattr(member.section, "unit"):
                assert member.section.unit == declared[key].metadata["unit"]
            for inner in kinds(member.section):
                compare(inner)
            if hasattr(member.section, "members"):
                compare(member.section)

    def kinds(section):
        """The blocks of a section of several kinds, a word's forms one by one; laws likewise."""
        words = {**getattr(section, "blocks", {}), **getattr(section, "laws", {})}.values()
        return [block for word in words for block in getattr(word, "blocks", (word,))]

    compare(SCENE)
    for kind in kinds(SCENE.members["fractures"].section.inner):
        compare(kind)


def test_a_study_survives_pickling(example):
    assert pickle.loads(pickle.dumps(example)) == example


def test_checking_a_study_imports_nothing_heavy(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_text(EXAMPLE, encoding="utf-8")
    heavy = ("xarray", "numba", "dask", "distributed", "scipy", "matplotlib", "pandas", "netCDF4")
    code = (
        "import sys; from sweep.study.load import load_study;"
        "import sweep.study.cases, sweep.study.schema;"
        f"load_study({str(path)!r}); print([m for m in {heavy!r} if m in sys.modules])"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=root, check=True
    )
    assert done.stdout.strip() == "[]"


def test_a_byte_order_mark_is_no_error(tmp_path):
    path = tmp_path / "study.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + SMALL.encode())
    assert load_study(path).name == "small"
