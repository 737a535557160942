"""Re-hashing a results folder, and freeing what no study in it refers to."""

from __future__ import annotations

import io
import json
import shutil
import sys

import pytest

from demflow.sweep.command import cli
from demflow.sweep.command.upkeep import unwanted, verify
from demflow.sweep.dataset.folder import UNFINISHED_FILE
from demflow.sweep.dataset.open import open_results
from demflow.sweep.store.lock import FolderLock
from demflow.sweep.store.products import Store, StoreError
from demflow.sweep.study.load import StudyError
from tests.sweep import toy_stages, toys

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_worker")]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two studies in one folder: they share a packing and the case of rate 1."""
    folder = tmp_path_factory.mktemp("made")
    first = toys.write_study(folder, name="first", seeds=(1,), stresses=(), rates=(1.0, 2.0))
    second = toys.write_study(folder, name="second", seeds=(1,), stresses=(), rates=(1.0, 3.0))
    for path in (first, second):
        toys.run(path, folder / "results", workers=1)
    return folder


@pytest.fixture
def results(made, tmp_path):
    """A copy of them, for one test."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path / "results"


def flip(path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


def test_a_flipped_bit_of_a_dataset_is_found_and_the_next_run_collects_it_anew(results):
    assert verify(results).damaged == []
    dataset = results / "first" / "dataset.nc"
    good = open_results(dataset)
    flip(dataset, dataset.stat().st_size // 2)
    assert [path for path, _ in verify(results).damaged] == [dataset]
    assert not dataset.exists()
    finished = toys.run(results.parent / "first.yaml", results)
    assert finished.executed is None
    assert finished.collected
    assert open_results(dataset).well_pressure.equals(good.well_pressure)
    assert verify(results).damaged == []


def test_the_folder_of_a_study_stands_for_that_of_all(results):
    assert verify(results / "first").checked == verify(results).checked
    with pytest.raises(StoreError, match="no results folder"):
        verify(results.parent)


def test_clean_takes_the_folder_of_a_study_too_and_files_that_vanish(results, monkeypatch):
    (results / "second" / "study.yaml").unlink()
    assert unwanted(results / "first", table=toys.TABLE) == unwanted(results, table=toys.TABLE)
    gone = results / "store" / "ab" / "written.1.partial"
    monkeypatch.setattr(Store, "unwanted", lambda *_: iter([gone]))
    assert unwanted(results, table=toys.TABLE).files == []


@pytest.mark.parametrize("flipped", ["dataset.nc", "dataset.nc.sha256"])
def test_a_run_does_not_trust_a_dataset_without_its_hash(results, flipped):
    flip(results / "first" / flipped, 20)
    assert toys.run(results.parent / "first.yaml", results).collected
    assert verify(results).damaged == []


def stored(results) -> set[str]:
    return {path.name for path in results.glob("store/*/*") if path.is_file()}


def test_only_what_no_study_refers_to_is_freed(results, capsys):
    assert toys.demflow("clean", str(results), "--yes") == 0
    assert "refers to 0 files" in capsys.readouterr().err
    before = stored(results)
    for path in (results / "second").iterdir():
        path.unlink()
    path = results.parent / "first.yaml"
    kept = {run.id + ".product" for run in toys.prepared(path, results).plan.runs}
    size = sum(p.stat().st_size for p in results.glob("store/*/*.product") if p.name not in kept)

    assert toys.demflow("clean", str(results), "--json") == 0  # nobody at a terminal
    told = json.loads(capsys.readouterr().out)
    assert told == {"files": 2, "bytes": size, "freed": False}
    assert stored(results) == before

    assert toys.demflow("clean", str(results), "--yes", "--json") == 0
    assert json.loads(capsys.readouterr().out)["freed"]
    assert stored(results) == kept
    assert toys.run(path, results).executed is None


class Terminal(io.StringIO):
    """A stream at which somebody sits."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("answer", "files"), [("y\n", 6), ("\n", 8), ("", 8)])
def test_somebody_at_a_terminal_is_asked(results, monkeypatch, answer, files):
    (results / "second" / "study.yaml").unlink()
    monkeypatch.setattr(sys, "stdin", Terminal(answer))
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert toys.demflow("clean", str(results)) == 0
    assert "refers to 2 files" in " ".join(sys.stderr.getvalue().split())  # it may be wrapped
    assert len(stored(results)) == files


def test_what_an_interrupted_study_has_stored_is_not_freed(results):
    (results / "second" / "study.yaml").rename(results / "second" / UNFINISHED_FILE)
    assert unwanted(results, table=toys.TABLE).files == []


def test_a_run_says_what_it_is_at_until_it_has_collected(tmp_path):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0, toy_stages.RAISES))
    seen = []
    note = tmp_path / "results" / "toy" / UNFINISHED_FILE
    toys.run(path, tmp_path / "results", progress=lambda _: seen.append(note.read_text()))
    assert set(seen) == {path.read_text()}
    assert not note.exists()


def test_a_study_that_cannot_be_read_keeps_everything(results):
    before = stored(results)
    (results / "second" / "study.yaml").write_text("study: [")
    with pytest.raises(StudyError):
        unwanted(results, table=toys.TABLE)
    assert toys.demflow("clean", str(results), "--yes") == 2
    assert stored(results) == before


def test_nothing_is_freed_under_a_run_nor_in_another_folder(results, tmp_path, capsys):
    before = stored(results)
    (results / "second" / "study.yaml").unlink()
    with FolderLock(results, "demflow run first"):
        assert toys.demflow("clean", str(results), "--yes") == 2
    assert "demflow run first" in capsys.readouterr().err
    assert stored(results) == before
    with pytest.raises(StoreError, match="no results folder"):
        unwanted(tmp_path)
    assert cli.main(["clean", str(tmp_path)]) == 2
