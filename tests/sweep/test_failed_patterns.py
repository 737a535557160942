"""Whichever cases of a study fail, what is left is drawn and put on a page."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
import pytest
import xarray as xr
from PIL import Image

import demflow.sweep.figures as figures
from demflow.model.outcome import Status
from demflow.model.quantities import CASE
from demflow.sweep.figures import maps, style, write_figures
from demflow.sweep.report import write_report
from demflow.sweep.report.html import escape
from demflow.sweep.store import written
from demflow.sweep.store.products import StoreError
from demflow.sweep.study.cases import case_at
from tests.sweep.invented import LINEAR, RADIAL, SWEEP, invented_dataset, invented_maps, study_of

pytestmark = pytest.mark.slow

COUNT = 2  # random patterns, beside those of one good case
FEW = SWEEP.replace("per_decade: 12", "per_decade: 1").replace("count: 3", "count: 2")
FEW = FEW.replace("[0 deg, 30 deg, 65 deg]", "[0 deg, 65 deg]")
PACKINGS = ("[1, 2, 3, 4, 5]", "[1, 2]")
SPECIMEN = """
study: specimens
scene:
  region: {shape: rectangle, width: 3 cm, height: 6 cm}
  grains: {count: 100, modulus: 20 GPa, porosity: 0.17}
  bonds: {kind: parallel, tensile_strength: 10 MPa, shear_strength: 20 MPa}
  test: {confining_stress: 1 MPa}
vary:
  confining: {parameter: test.confining_stress, values: [0 MPa, 5 MPa, 10 MPa]}
  packing: {parameter: grains.seed, values: [1, 2]}
observe: [peak_strength, crack_count]
"""
SPEED = """
vary:
  packing: {parameter: grains.seed, values: [1, 2]}
  solver: {parameters: [solver.method, solver.tolerance], values: [[krylov, 1e-3], [krylov, 1e-4],
    [implicit, 1e-3]]}
observe: [time_error, pressure_map, boundary_flow]
solver: {tolerance: 1e-3}
"""
TEXTS = {
    "wells": FEW,
    "linear": LINEAR.replace(*PACKINGS),
    "radial": RADIAL.replace(*PACKINGS),
    "build_up": RADIAL.replace("compare: radial", "").replace(*PACKINGS),
    "specimens": SPECIMEN,
    "speed": LINEAR.partition("vary:")[0] + SPEED,
}


def specimens(study) -> xr.Dataset:
    """Strengths and crack counts of a study of tests."""
    names, rng = [axis.name for axis in study.axes], np.random.default_rng(1)
    data = {
        name: (names, rng.uniform(1.0, 2.0, study.shape))
        for name in ("peak_strength", "crack_count")
    }
    data["message"] = (names, np.full(study.shape, "", dtype=object))
    data["status"] = (names, np.zeros(study.shape, dtype=np.int8))
    axes = {axis.name: np.array([p[0] for p in axis.values]) for axis in study.axes}
    return xr.Dataset(data, axes, {"title": "specimens"})


def record_of_a_test() -> xr.Dataset:
    """The record of one test to failure."""
    strain = np.linspace(0.0, 0.01, 5)
    curves = {name: ("record", strain) for name in ("axial_strain", "lateral_strain")}
    cracks = {name: ("crack", [0.01, 0.02]) for name in ("crack_x", "crack_y")}
    return xr.Dataset(
        curves
        | cracks
        | {
            "axial_stress": ("record", 1e9 * strain),
            "cracks": ("record", np.arange(5)),
            "crack_mode": ("crack", [1, 2]),
            "box": ("wall", [-0.015, 0.015, -0.03, 0.03]),
        }
    )


def shut_in(study, index):
    """A case whose well is shut in before the end."""
    case = case_at(study, index)
    changes = ((0.0, 2e-5), (420.0, 0.0))
    well = dataclasses.replace(case.scene.wells[0], rate=None, schedule=changes)
    return dataclasses.replace(case, scene=dataclasses.replace(case.scene, wells=(well,)))


def with_failures(dataset: xr.Dataset, good: np.ndarray, rng: np.random.Generator) -> xr.Dataset:
    """The dataset with all but the good cases failed, in any of the ways."""
    dataset = dataset.copy(deep=True)
    ways = [s for s in Status if s is not Status.DONE]
    dataset["status"].values[~good] = rng.choice(ways, np.count_nonzero(~good))
    dataset["message"].values[~good] = "flow: it came to $nothing"
    axes = dataset["status"].dims
    for name, variable in dataset.data_vars.items():
        if name in CASE and variable.dtype.kind == "f" and variable.dims[: len(axes)] == axes:
            variable.values[~good] = np.nan
    return dataset


@pytest.mark.parametrize("name", TEXTS)
def test_every_pattern_of_failures_is_drawn(name, tmp_path, monkeypatch):
    study = study_of(TEXTS[name], tmp_path)
    whole = specimens(study) if name == "specimens" else invented_dataset(study)
    if name == "speed":
        whole["solver_time"] = whole["time_error"] * 1e5
    kept: dict[tuple[int, ...], xr.Dataset] = {}

    def case_of(folder, at, **_):
        index = tuple(
            int(np.flatnonzero(whole[axis.name].values == at[axis.name])[0]) for axis in study.axes
        )
        if index not in kept:
            kept[index] = (
                record_of_a_test() if name == "specimens" else invented_maps(study, index, 6.0)
            )
        return kept[index]

    monkeypatch.setattr(figures, "case_of", case_of)
    if name == "build_up":
        monkeypatch.setattr(figures, "case_at", shut_in)
    monkeypatch.setattr(style, "DPI", 20)
    monkeypatch.setattr(maps, "pixels", lambda: 100)
    rng = np.random.default_rng(3)
    number = int(np.prod(study.shape))
    drawn = 0
    patterns = [np.arange(number) == k for k in (0, number - 1)]
    patterns += [rng.random(number) < share for share in np.linspace(0.4, 0.8, COUNT)]
    for good in patterns:
        dataset = with_failures(whole, good.reshape(study.shape), rng)
        found = write_figures(dataset, tmp_path, study)
        write_report(dataset, tmp_path, study, found.paths)
        assert found.messages == []
        assert bool(found.paths) == bool(good.any())
        drawn += len(found.paths)
    assert drawn


def test_only_what_was_drawn_is_ever_replaced_or_removed(tmp_path, monkeypatch):
    study = study_of(FEW, tmp_path)
    dataset = invented_dataset(study)
    monkeypatch.setattr(style, "DPI", 20)
    monkeypatch.setattr(maps, "pixels", lambda: 100)
    monkeypatch.setattr(figures, "case_of", lambda *_, **__: invented_maps(study, (0,) * 4, 6.0))
    folder, elsewhere = tmp_path / "figures", tmp_path / "elsewhere.png"
    folder.mkdir()
    for name in ("mine.png", "mine.csv", "permeability.png"):
        (folder / name).write_text("the user's")
    elsewhere.write_text("the user's too")
    (folder / "pressure_map_0.png").symlink_to(elsewhere)
    (folder / "mine_too.png").symlink_to(elsewhere)
    drawn = write_figures(dataset, tmp_path, study)
    assert len(drawn.messages) == 2
    assert all("kept as" in message for message in drawn.messages)
    for name in ("mine.png", "mine.csv", "permeability.png.kept"):
        assert (folder / name).read_text() == "the user's"
    for name in ("mine_too.png", "pressure_map_0.png.kept"):
        assert (folder / name).is_symlink()
    assert elsewhere.read_text() == "the user's too"
    assert not (folder / "pressure_map_0.png").is_symlink()
    assert written.is_whole(folder)
    # of what was drawn before, only what is as it was drawn goes
    fewer = with_failures(dataset, single(dataset), np.random.default_rng(1))
    second = folder / "pressure_map_1.png"
    for retouched in (False, True):
        write_figures(dataset, tmp_path, study)
        if retouched:
            second.write_text("retouched")
        again = write_figures(fewer, tmp_path, study)
        assert again.messages == []
        assert {p.name for p in drawn.paths} - {p.name for p in again.paths} == {second.name}
        assert second.exists() == retouched


def single(dataset) -> np.ndarray:
    """One good case."""
    good = np.zeros(dataset["status"].shape, dtype=bool)
    good.flat[0] = True
    return good


def test_nothing_is_drawn_into_a_folder_that_is_a_link(tmp_path):
    study = study_of(FEW, tmp_path)
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (theirs / "SHA256SUMS").write_text("")
    (tmp_path / "figures").symlink_to(theirs)
    with pytest.raises(StoreError, match="is a link"):
        write_figures(invented_dataset(study), tmp_path, study)
    assert [p.name for p in theirs.iterdir()] == ["SHA256SUMS"]


def test_a_list_cannot_name_what_lies_elsewhere(tmp_path):
    other = tmp_path / "precious.png"
    other.write_text("precious")
    folder = tmp_path / "figures"
    folder.mkdir()
    sha256 = hashlib.sha256(b"precious").hexdigest()
    (folder / "precious.png").symlink_to(other)
    lines = [f"{sha256}  {name}" for name in ("../precious.png", "precious.png", "..", str(other))]
    (folder / "SHA256SUMS").write_text("\n".join(lines))
    assert written.ours(folder) == []
    written.replace_files(folder, {})
    assert other.read_text() == "precious"


@pytest.mark.parametrize("text", ["costs $5 and $6", "$\\frac{1}{$", "_under $x_1$", r"a\$b"])
def test_texts_are_drawn_as_they_are(text, tmp_path, monkeypatch):
    """No dollar begins a formula: the picture is that of the same signs, one by one."""
    with style.house_style():
        figure = style.new_figure(4.0, 2.0)
        panel = figure.subplots()
        panel.plot([1.0, 1e4], [1e-3, 1e3], label=style.legend_text(text))
        panel.set(xscale="log", yscale="log", title=text, xlabel=text)
        legend = panel.legend()
        style.save(figure, tmp_path / "f.png", text)
        renderer = figure.canvas.get_renderer()
        for shown in (panel.title, panel.xaxis.label, *legend.get_texts()):
            assert not shown.get_parse_math()
            assert shown.get_text().strip() == text
        labels = [one.get_text() for one in panel.get_yticklabels()]
        assert renderer is not None
    assert "10³" in labels
    assert not any("$" in one for one in labels)


def test_what_cannot_be_seen_is_shown_as_what_it_is(tmp_path):
    text = "a\x1b[31mb\u202ec\x00d"
    with style.house_style():
        figure = style.new_figure(4.0, 2.0)
        panel = figure.subplots()
        panel.set(title=f"{text}\nsecond")
        path = style.save(figure, tmp_path / "f.png", text)
    assert panel.get_title() == "a\\x1b[31mb\\u202ec\\x00d\nsecond"
    with Image.open(path) as image:
        assert image.info["Description"] == "a\\x1b[31mb\\u202ec\\x00d"
    assert escape(f"<{text}>") == "&lt;a\\x1b[31mb\\u202ec\\x00d&gt;"
