"""Every study of the repository runs small, through the same door as a user's."""

from __future__ import annotations

import html
import re
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from demflow import sweep
from demflow.model.outcome import Status
from demflow.sweep.command.cli import main
from demflow.sweep.dataset.folder import FIGURES, REPORT_FILE

STUDIES = sorted((Path(__file__).parents[2] / "studies").glob("*.yaml"))


# a few hundred grains yield less than the whole study's, and the run says so
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:in .* cases a pressure falls below zero"),
]


@pytest.fixture(scope="module", params=STUDIES, ids=lambda path: path.stem)
def ran(request, one_worker, tmp_path_factory):
    """A study, its dataset and the folder of its results, from one small run."""
    results = tmp_path_factory.mktemp(request.param.stem)
    study = sweep.load_study(request.param, smoke=True)
    with (
        mock.patch("demflow.sweep.figures.style.DPI", 60),  # as coarse as can be told from none
        mock.patch("demflow.sweep.figures.maps.pixels", return_value=320),
    ):
        dataset = sweep.run(request.param, workers=1, results=results, smoke=True)
    return study, dataset, results / study.name


def test_there_are_studies():
    paper = {"paper_linear", "paper_radial", "paper_fractured"}
    assert {"quickstart", "speed_vs_error", "hard_cases", *paper} <= {path.stem for path in STUDIES}


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_study_passes_its_check_and_has_a_smoke_block(path, capsys):
    assert main(["check", str(path)]) == 0
    assert sweep.load_study(path, smoke=True).text == sweep.load_study(path).text
    assert "\nsmoke:" in path.read_text(encoding="utf-8")


def test_every_case_is_as_expected_and_balances(ran):
    study, dataset, folder = ran
    assert dict(zip((axis.name for axis in study.axes), study.shape, strict=True)) == {
        axis.name: dataset.sizes[axis.name] for axis in study.axes
    }
    assert main(["status", str(study.path), "--smoke", "--results", str(folder.parent)]) == 0
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert ("Expected and found" in text) == bool(study.promised)
    assert "<td>NO</td>" not in text
    if study.promised:  # its bounds, which the report holds every case against, are its own
        return
    assert np.all(dataset["status"].values == Status.DONE)
    if "mass_balance_error" in dataset:  # only where something flowed
        assert np.all(dataset["mass_balance_error"].values <= 1e-10)
    for name in ("porosity", "well_pressure", "boundary_flow", "permeability"):
        if name in dataset:
            assert np.all(np.isfinite(dataset[name].values))


def test_a_second_run_computes_nothing(ran, monkeypatch):
    study, dataset, folder = ran

    def refuse(*_args, **_kwargs):
        raise AssertionError("a finished study starts no workers")

    monkeypatch.setattr("demflow.sweep.execution.loop.execute", refuse)
    again = sweep.run(study.path, workers=1, results=folder.parent, smoke=True)
    assert again.identical(dataset)


def test_figures_and_report_are_drawn(ran):
    study, _, folder = ran
    figures = list((folder / FIGURES).glob("*.png"))
    assert figures
    assert all(path.stat().st_size > 5_000 for path in figures)
    text = (folder / REPORT_FILE).read_text(encoding="utf-8")
    assert html.escape(study.title) in text
    own = re.sub(r"/\*!.*?\*/", "", text)  # but for whom the script is by
    assert not re.search("https?:", own.replace("http://www.w3.org", ""))
