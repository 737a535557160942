"""Whose a dataset is, what of it is good, and what is told of it."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from demflow.model.outcome import Status
from demflow.sweep import engine, prepared
from demflow.sweep.dataset.open import open_results
from demflow.sweep.errors import ResultsError
from demflow.sweep.store.products import StoreError
from tests.sweep import toy_stages, toys

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_worker")]

POOR = "tests.sweep.toy_stages:POOR"
SMOKE = "smoke: {vary.rate: [1]}\n"


@pytest.fixture(autouse=True)
def no_drawing(monkeypatch):
    monkeypatch.setattr(engine, "draw", lambda prepared, finished, **_: finished)


def study(folder, name="toy", **changes):
    return toys.write_study(folder, name=name, seeds=(), stresses=(), **changes)


def report(path, results, **options):
    return engine.draw_study(path, results, table=toys.TABLE, **options)


def test_a_report_is_of_the_studys_own_dataset(tmp_path):
    path, results = study(tmp_path, rates=(1.0, 2.0)), tmp_path / "results"
    toys.run(path, results)
    assert report(path, results).cases == 2
    path.write_text(path.read_text().replace("title: Toy", "title: Another title"))
    assert report(path, results).cases == 2
    for rates, why in (((1.0, 2.0, 3.0), "values of rate"), ((1.0, 5.0), "values of rate")):
        study(tmp_path, rates=rates)
        with pytest.raises(ResultsError, match=why):
            report(path, results)
    text = study(tmp_path, rates=(1.0, 2.0)).read_text()
    path.write_text(text.replace("count: 50", "count: 51"))
    with pytest.raises(ResultsError, match="its scene is another"):
        report(path, results)
    path.write_text(text.replace("  rate:", "  speed:"))
    with pytest.raises(ResultsError, match="it varies rate"):
        report(path, results)
    # what is there can be drawn still
    assert report(results / "toy" / "study.yaml", results).cases == 2


def test_a_dataset_that_is_known_by_its_study_needs_no_plan(tmp_path, monkeypatch):
    path, results = study(tmp_path, rates=(1.0, 2.0)), tmp_path / "results"
    toys.run(path, results)
    planned, made = prepared.planned, []

    def counted(*arguments):
        made.append(arguments)
        return planned(*arguments)

    monkeypatch.setattr(prepared, "planned", counted)
    drawn = report(path, results)
    assert (drawn.cases, drawn.failed, drawn.missing, made) == (2, 0, 0, [])
    # the same cases in other words are told apart from other cases by the plan alone
    path.write_text(path.read_text().replace("title: Toy", "title: Another title"))
    assert (report(path, results).cases, len(made)) == (2, 1)
    path.write_text(path.read_text().replace("count: 50", "count: 51"))
    with pytest.raises(ResultsError, match="its scene is another"):
        report(path, results)
    assert len(made) == 2


def test_a_changed_file_behind_a_study_makes_another_dataset(tmp_path):
    path, results, rates = study(tmp_path), tmp_path / "results", tmp_path / "rates.csv"
    path.write_text(path.read_text().replace("values: [1.0, 2.0, 3.0]", "file: rates.csv"))
    rates.write_text("rate [m3/s]\n1\n2\n")
    toys.run(path, results)
    assert report(path, results).cases == 2
    rates.write_text("rate [m3/s]\n1.0\n2.0\n")  # the same in other words
    assert report(path, results).cases == 2
    rates.write_text("rate [m3/s]\n1\n3\n")
    with pytest.raises(ResultsError, match="values of rate"):
        report(path, results)
    assert report(results / "toy" / "study.yaml", results).cases == 2


def test_drawing_imports_only_what_it_draws_with():
    code = (
        "import sys\n"
        "import demflow.sweep.figures, demflow.sweep.report\n"
        "heavy = {'numba', 'scipy.stats', 'scipy.special', 'scipy.spatial', 'dask',\n"
        "         'distributed', 'matplotlib.backends.backend_pdf'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_smoke_run_leaves_the_whole_dataset_alone(tmp_path):
    path, results = study(tmp_path, rates=(1.0, 2.0)), tmp_path / "results"
    path.write_text(path.read_text() + SMOKE)
    assert toys.run(path, results, smoke=True).cases == 1
    with pytest.raises(ResultsError, match="with the smoke block"):
        report(path, results)
    assert toys.run(path, results).cases == 2
    before = (results / "toy" / "dataset.nc").read_bytes()
    with pytest.raises(StoreError, match=r"whole study.*--results"):
        toys.run(path, results, smoke=True)
    with pytest.raises(ResultsError, match="without the smoke block"):
        report(path, results, smoke=True)
    assert (results / "toy" / "dataset.nc").read_bytes() == before


def test_two_files_of_one_name_do_not_replace_each_other(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    results = tmp_path / "results"
    first, second = study(tmp_path / "a", rates=(1.0,)), study(tmp_path / "b", rates=(2.0,))
    toys.run(first, results)
    with pytest.raises(StoreError, match="another study of the name 'toy'"):
        toys.run(second, results)
    study(tmp_path / "a", rates=(1.0, 3.0))  # one's own may change
    assert toys.run(first, results).cases == 2
    first.unlink()  # it was moved, or is gone
    assert toys.run(second, results).cases == 1
    # its own copy in the folder stands for it, and a copy that says the same is the same study
    assert toys.run(results / "toy" / "study.yaml", results).cases == 1
    (tmp_path / "c").mkdir()
    assert toys.run(study(tmp_path / "c", rates=(2.0,)), results).cases == 1


def test_what_is_finished_can_be_collected(tmp_path, capsys):
    path, results = study(tmp_path, rates=(1.0, 2.0)), tmp_path / "results"
    toys.run(path, results)
    study(tmp_path, rates=(1.0, 3.0, 2.0, toy_stages.RAISES))
    finished = engine.collect_study(path, results, table=toys.TABLE)
    assert (finished.cases, finished.failed, finished.missing) == (4, 2, 2)
    dataset = open_results(results / "toy")
    assert list(dataset.status.values) == [Status.DONE, Status.NOT_RUN, Status.DONE, Status.NOT_RUN]
    assert list(np.isnan(dataset.porosity.values)) == [False, True, False, True]
    assert "demflow run" in str(dataset.message.values[1])
    assert toys.demflow("collect", str(path), "--results", str(results)) == 0
    assert "2 of 4 cases good, 2 missing; nothing was computed" in capsys.readouterr().err
    assert toys.run(path, results).failed == 1
    assert toys.demflow("collect", str(path), "--results", str(results)) == 1
    with pytest.raises(StoreError, match="demflow run"):
        engine.collect_study(path, tmp_path / "nothing", table=toys.TABLE)


def test_a_result_beyond_its_bounds_is_not_good(tmp_path, capsys):
    path, results = study(tmp_path, rates=(1e-9, 1.0)), tmp_path / "results"
    finished = engine.run_study(path, results=results, table=POOR)
    assert (finished.cases, finished.failed, finished.inaccurate) == (2, 1, 1)
    (told,) = finished.messages()
    assert "2 of 2 cases a pressure falls below zero" in told
    dataset = open_results(results / "toy")
    assert list(dataset.status.values) == [Status.DONE, Status.INACCURATE]
    assert str(dataset.message.values[1]) == "mass_balance_error is 1, not ≤ 1e-06"
    assert not np.isnan(dataset.well_pressure).any()  # what was found is kept
    assert "inaccurate" in dataset.status.attrs["flag_meanings"].split()
    again = engine.run_study(path, results=results, table=POOR)
    assert (again.failed, again.inaccurate, again.collected) == (1, 1, False)
    capsys.readouterr()
    arguments = str(path), "--results", str(results)
    assert toys.demflow("status", *arguments, "--json", table=POOR) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["done"], told["failed"], told["inaccurate"]) == (1, 0, 1)
    assert toys.demflow("run", *arguments, table=POOR) == 1
    assert "1 of 2 cases good, 1 inaccurate; all were stored" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("expect", "good"),
    [
        ("{mass_balance_error: 2}", 2),
        ("{mass_balance_error: 1e-10}", 0),
        ("{mass_balance_error: 2, lowest_pressure: 0 Pa}", 0),
        ("{mass_balance_error: 2, lowest_pressure: -1 kPa}", 2),
        ("{status: inaccurate, message: mass_balance_error}", 1),
        ("{mass_balance_error: 2, time_error: 1}", 0),  # which is not there
    ],
)
def test_the_bounds_are_the_users(tmp_path, expect, good):
    path = study(tmp_path, rates=(1e-9, 1.0))
    path.write_text(path.read_text() + f"expect: {expect}\n")
    finished = engine.run_study(path, results=tmp_path / "results", table=POOR)
    assert finished.cases - finished.failed == good
