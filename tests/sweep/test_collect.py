"""The dataset: every case in its place, described as CF asks."""

from __future__ import annotations

import itertools
import math
import os
import platform
import subprocess
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demflow.model.outcome import Status
from demflow.model.quantities import CASE, SWEEP
from demflow.sweep.dataset import collect as collect_module
from demflow.sweep.dataset.file import collected_digest
from demflow.sweep.dataset.open import open_results
from demflow.sweep.dataset.tiles import tiles
from demflow.sweep.prepared import prepare
from tests.sweep import toy_stages, toys
from tests.sweep.conventions import complaints

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_worker")]


@given(st.lists(st.integers(1, 6), max_size=4).map(tuple), st.integers(1, 50))
def test_tiles_cut_the_cases_into_blocks_that_fit(shape, most):
    seen = np.zeros(shape, dtype=int)
    order = np.arange(math.prod(shape)).reshape(shape)
    for tile in tiles(shape, most):
        assert len(tile.cases) == math.prod(tile.shape) <= most or not shape
        assert list(order[tile.at].ravel()) == list(tile.cases)
        seen[tile.at] += 1
    assert (seen == 1).all()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("collected")
    path = toys.write_study(folder, rates=(1.0, toy_stages.RAISES, 3.0))
    return path, toys.run(path, folder / "results")


def test_every_case_lies_where_its_coordinates_say(finished):
    _path, ran = finished
    dataset = open_results(ran.folder)
    assert dict(dataset.sizes) == {
        "seed": 2,
        "stress_yy": 2,
        "rate": 3,
        "well": 1,
        "elapsed_time": 3,
        "component": 3,
        "stage": 4,
    }
    packed = {seed: toy_stages.pack(count=50, seed=seed) for seed in (1, 2)}
    for seed in (1, 2):
        for stress in (5e6, 10e6):
            for rate in (1.0, 3.0):
                case = dataset.sel(seed=seed, stress_yy=stress, rate=rate)
                load = packed[seed].x * 20e6 + stress
                pressure = packed[seed].x.mean() + load.mean() + rate * np.log1p([1.0, 10.0, 100.0])
                np.testing.assert_allclose(case.well_pressure.sel(well="producer"), pressure)
                np.testing.assert_allclose(case.stress_achieved, load[:3])
                assert case.grain_count == 50
                assert case.status == Status.DONE
    failed = dataset.sel(rate=toy_stages.RAISES)
    assert (failed.status == Status.FAILED).all()
    assert (failed.message == "flow: the well is dry; try a smaller rate").all()
    for name in ("well_pressure", "porosity", "stress_achieved"):
        assert np.isnan(failed[name]).all()
    # asked for, but never found by these stages
    assert np.isnan(dataset.pressure_derivative).all()


def test_the_time_spent_adds_up(finished):
    path, ran = finished
    made = prepare(path, ran.folder.parent, table=toys.TABLE)
    spent = 0.0
    for run in made.plan.runs:
        record = made.store.meta(run.id) if made.store.has(run.id) else made.store.failure(run.id)
        spent += (record or {"seconds": 0.0})["seconds"]
    total = float(open_results(ran.folder).compute_time.sum())
    assert total == pytest.approx(spent, rel=1e-12)
    assert total > 0


def test_each_case_tells_the_time_of_its_stages(finished):
    """Shared runs count in full in every case, and once in what the cases caused."""
    path, ran = finished
    made = prepare(path, ran.folder.parent, table=toys.TABLE)
    dataset = open_results(ran.folder)
    told = dataset.stage_time.values.reshape(len(made.plan.cases), -1)
    assert list(dataset.stage.values) == ["pack", "stress", "flow", "observe"]
    for case, runs in enumerate(made.plan.cases):
        for run, seconds in zip(runs, told[case], strict=True):
            identity = made.plan.runs[run].id
            record = (
                made.store.meta(identity)
                if made.store.has(identity)
                else made.store.failure(identity) or {}
            )
            np.testing.assert_equal(seconds, record.get("seconds", np.nan))
    # what follows a failed stage was not run
    failed = dataset.sel(rate=toy_stages.RAISES).stage_time
    assert np.isnan(failed.sel(stage="observe")).all()
    assert not np.isnan(failed.sel(stage="pack")).any()


def test_what_is_superposed_says_so(finished):
    comment = open_results(finished[1].folder).well_pressure.attrs["comment"]
    assert "unit step" in comment
    assert "share" in comment


def test_units_and_names_are_those_of_the_table(finished):
    dataset = open_results(finished[1].folder)
    for name, quantity in {**CASE, **SWEEP}.items():
        if name in dataset:
            assert dataset[name].attrs["units"] == quantity.unit
            assert dataset[name].dims == ("seed", "stress_yy", "rate", *quantity.dimensions)
    assert dataset.stress_yy.attrs["units"] == "Pa"
    assert dataset.elapsed_time.attrs["units"] == "s"
    status = dataset.status.attrs
    assert list(status["flag_values"]) == [int(s) for s in Status]
    assert status["flag_meanings"].split()[:2] == ["done", "failed"]
    assert list(dataset.component.values) == ["xx", "yy", "xy"]


def test_the_dataset_says_where_it_comes_from(finished):
    path, ran = finished
    attributes = open_results(ran.folder).attrs
    assert attributes["Conventions"] == "CF-1.11"
    assert attributes["study_text"] == path.read_text()
    assert attributes["seed"] == "1, 2"
    assert attributes["stage_versions"] == "pack 1, stress 1, flow 1, observe 1"
    assert attributes["stage_runs"] == "pack 2, stress 4, flow 12, observe 12 behind 12 cases"
    assert attributes["machine"].startswith(platform.machine())
    for name in ("numpy", "scipy", "numba", "qdldl", "xarray", "netCDF4", "python"):
        assert attributes[f"{name}_version"][0].isdigit()
    assert (ran.folder / "study.yaml").read_text() == path.read_text()


def test_coordinates_have_no_fill_value(finished):
    with netCDF4.Dataset(finished[1].dataset) as file:
        for name in file.dimensions:
            assert "_FillValue" not in file[name].ncattrs()


def test_cf_checker_finds_no_error(finished, tmp_path):
    # the checker takes every coordinate in Pa for a height, an axis of the study too
    found = complaints(finished[1].dataset, tmp_path / "report.json")
    assert [said for said in found if "not in the recommended order T, Z, Y, X" not in said] == []


def test_small_tiles_give_the_same_file(finished, tmp_path, monkeypatch):
    path, ran = finished
    made = prepare(path, ran.folder.parent, table=toys.TABLE)
    monkeypatch.setattr(collect_module, "TILE_CASES", 2)
    other = tmp_path / "dataset.nc"
    verdicts = made.verdicts()
    arguments = (made.study, made.plan, made.store, made.scene_of, verdicts, other)
    assert collect_module.collect(*arguments, "digest") == (verdicts, [])
    with netCDF4.Dataset(ran.dataset) as a, netCDF4.Dataset(other) as b:
        assert a.variables.keys() == b.variables.keys()
        for name in a.variables:
            np.testing.assert_array_equal(a[name][...], b[name][...])
    assert collected_digest(other) == "digest"
    assert collected_digest(tmp_path / "absent.nc") is None
    other.write_bytes(other.read_bytes()[:1000])
    assert collected_digest(other) is None


@pytest.mark.parametrize("place", range(8))
def test_a_dataset_that_cannot_take_its_place_leaves_the_earlier_one(
    finished, tmp_path, monkeypatch, place
):
    path, ran = finished
    made = prepare(path, ran.folder.parent, table=toys.TABLE)
    dataset = tmp_path / "dataset.nc"
    arguments = (made.study, made.plan, made.store, made.scene_of, made.verdicts(), dataset)
    collect_module.collect(*arguments, "earlier")
    calls = itertools.count()

    def failing(real):
        def call(*given: object) -> object:
            if next(calls) == place:
                raise OSError(28, "No space left on device")
            return real(*given)

        return call

    monkeypatch.setattr(os, "fsync", failing(os.fsync))
    monkeypatch.setattr(os, "replace", failing(os.replace))
    with pytest.raises(OSError, match="No space") as refused:
        collect_module.collect(*arguments, "later")
    monkeypatch.undo()
    assert str(tmp_path) in str(refused.value.filename)
    assert collected_digest(dataset) in ("earlier", "later")
    assert {p.name for p in tmp_path.iterdir()} == {"dataset.nc", "dataset.nc.sha256"}
    collect_module.collect(*arguments, "later")
    assert collected_digest(dataset) == "later"


_FULL = """
import resource, sys
from pathlib import Path
from demflow.sweep.dataset.collect import collect
from tests.sweep import toys
path, folder = Path(sys.argv[1]), Path(sys.argv[2])
made = toys.prepared(path, folder)
dataset = made.folder / "dataset.nc"
whole = dataset.stat().st_size
for bytes in (*(whole * part // 20 for part in range(20)), 10 * whole):
    # the system refuses all beyond, as a full disk does
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes, resource.RLIM_INFINITY))
    try:
        collect(made.study, made.plan, made.store, made.scene_of, made.verdicts(), dataset, "more")
        print("written")
    except OSError as error:
        print(error.filename)
    assert not list(made.folder.glob("*.partial"))
"""


def test_a_disk_that_fills_at_any_byte_is_an_error_and_the_earlier_dataset_stays(finished):
    """Also on its last byte, where the netCDF library itself would end the process."""
    path, ran = finished
    before = collected_digest(ran.dataset)
    command = [sys.executable, "-c", _FULL, str(path), str(ran.folder.parent)]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    *refused, last = done.stdout.splitlines()
    assert len(refused) == 20
    assert all(name.startswith(str(ran.folder / "dataset.nc")) for name in refused)
    assert last == "written"
    assert before != collected_digest(ran.dataset) == "more"


def test_a_study_without_axes_is_one_case(tmp_path):
    path = toys.write_study(tmp_path, seeds=(), stresses=(), rates=())
    dataset = open_results(toys.run(path, tmp_path / "results", workers=1).folder)
    assert dataset.status.dims == ()
    assert (dataset.status.item(), dataset.message.item()) == (Status.DONE, "")
    assert dataset.well_pressure.dims == ("well", "elapsed_time")
    assert np.isfinite(dataset.well_pressure).all()


MOVING = """
  probes: {still: {at: [1 m, 2 m]}, moved: {at: [0 m, 0 m]}}
"""


def test_a_probe_that_moves_along_an_axis_tells_where_it_is(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1, 2), stresses=(), rates=(1.0, 2.0))
    text = path.read_text().replace("  initial_pressure", f"{MOVING[1:]}  initial_pressure")
    axis = "  place: {parameter: probes.moved.at, values: [[0 m, 1 m], [3 m, 1 m]]}\nobserve"
    text = text.replace("observe", axis, 1).replace("[well_pressure]", "[probe_pressure]")
    path.write_text(text)
    dataset = open_results(toys.run(path, tmp_path / "results").folder)
    assert dataset.probe_x.dims == ("place", "probe")
    assert dataset.probe_y.dims == ("place", "probe")
    assert dataset.probe_x.sel(probe="moved").values.tolist() == [0.0, 3.0]
    assert dataset.probe_x.sel(probe="still").values.tolist() == [1.0, 1.0]
    assert dataset.probe_y.values.tolist() == [[2.0, 1.0], [2.0, 1.0]]
    assert {"probe_x", "probe_y"} <= set(dataset.probe_pressure.coords)
