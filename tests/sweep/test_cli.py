"""The command line: exit status, what goes where, and that it answers at once."""

from __future__ import annotations

import functools
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from demflow.sweep import prepared
from demflow.sweep.command import cli, forecast
from demflow.sweep.command.progress_line import ProgressLine, duration, line, size
from demflow.sweep.dataset.open import open_results
from demflow.sweep.execution.progress import Progress, StageProgress
from demflow.sweep.store.lock import FolderLock
from tests.sweep import toy_stages, toys

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("one_worker")]


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    return toys.write_study(folder, name="good", seeds=(1,), stresses=()), str(folder / "results")


@pytest.fixture(scope="module")
def bad(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    rates = (1.0, toy_stages.RAISES)
    path = toys.write_study(folder, name="bad", seeds=(1,), stresses=(), rates=rates)
    return path, str(folder / "results")


def test_a_good_study_from_plan_to_verify(good, capsys):
    path, results = good
    place = ["--results", results]
    assert toys.demflow("plan", str(path), *place, "--json") == 0
    planned = json.loads(capsys.readouterr().out)
    assert [(s["name"], s["runs"], s["shared"], s["to_run"]) for s in planned["stages"]] == [
        ("pack", 1, 2, 1),
        ("stress", 1, 2, 1),
        ("flow", 3, 0, 3),
        ("observe", 3, 0, 3),
    ]
    assert planned["seconds"] is None
    assert not Path(results).exists()  # a plan writes nothing

    assert toys.demflow("status", str(path), *place) == 0
    assert capsys.readouterr().out == "3 cases: 0 done, 0 failed, 3 missing\n"

    assert toys.demflow("run", str(path), *place) == 0
    told = capsys.readouterr()
    assert told.out.splitlines() == [
        f"dataset  {results}/good/dataset.nc",
        f"figures  {results}/good/figures",
    ]
    assert "3 of 3 cases done, 0 failed, 0 left" in told.err
    assert "3 of 3 cases good; 8 stage runs in" in told.err

    assert toys.demflow("run", str(path), *place, "--json") == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["computed"] == 0
    assert "nothing was computed" in told.err

    assert toys.demflow("plan", str(path), *place) == 0
    assert "expected time: 0.0 s" in capsys.readouterr().out
    assert toys.demflow("status", str(path), *place, "--json") == 0
    assert json.loads(capsys.readouterr().out)["done"] == 3
    assert cli.main(["verify", results]) == 0
    assert capsys.readouterr().out == "9 files checked, 0 damaged\n"


def test_a_plan_of_what_was_measured(good, capsys):
    path, results = good
    more = path.read_text().replace("[1.0, 2.0, 3.0]", "[1.0, 2.0, 3.0, 4.0]")
    grown = path.parent / "grown.yaml"
    grown.write_text(more)
    toys.demflow("run", str(path), "--results", results)
    capsys.readouterr()
    assert toys.demflow("plan", str(grown), "--results", results, "--json", "--workers", "1") == 0
    planned = json.loads(capsys.readouterr().out)
    assert planned["to_run"] == 2
    assert 0 < sum(stage["seconds"] for stage in planned["stages"]) < planned["seconds"]
    assert planned["bytes"] > 0
    assert planned["memory"] > 1e6
    assert toys.demflow("plan", str(grown), "--results", results) == 0
    assert "?" not in capsys.readouterr().out


def test_some_case_failed(bad, capsys):
    path, results = bad
    assert toys.demflow("run", str(path), "--results", results) == 1
    assert "1 of 2 cases good, 1 failed" in capsys.readouterr().err
    assert toys.demflow("status", str(path), "--results", results) == 1
    assert capsys.readouterr().out.splitlines() == [
        "2 cases: 1 done, 1 failed, 0 missing",
        "seed = 1, rate = -1 m3/s: failed: flow: the well is dry; try a smaller rate",
    ]
    assert toys.demflow("status", str(path), "--results", results, "--json") == 1
    failure = {"seed": 1, "rate": -1.0, "status": "failed", "tried_again": False}
    found = json.loads(capsys.readouterr().out)["failures"]
    assert found == [failure | {"message": "flow: the well is dry; try a smaller rate"}]


def test_damage_is_found_and_healed(bad, capsys):
    path, results = bad
    toys.demflow("run", str(path), "--results", results)
    capsys.readouterr()
    victim = next(Path(results, "store").rglob("*.product"))
    os.truncate(victim, victim.stat().st_size - 1)
    assert cli.main(["verify", results]) == 1
    told = capsys.readouterr()
    assert told.out.splitlines()[0] == f"{victim}: the data differ from what was written"
    assert "set aside" in told.err
    toys.demflow("run", str(path), "--results", results, "--json")
    assert json.loads(capsys.readouterr().out)["computed"] == 1
    assert cli.main(["verify", results, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["damaged"] == []


def test_an_invalid_study_runs_nothing(good, tmp_path, capsys):
    path, _ = good
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(path.read_text().replace("viscosity", "viscoity"))
    for command in ("run", "plan", "status", "report"):
        assert cli.main([command, str(wrong), "--results", str(tmp_path / "results")]) == 2
        told = capsys.readouterr()
        assert f"{wrong}:" in told.err
        assert "viscosity" in told.err
        assert told.out == ""
    assert cli.main(["check", str(wrong)]) == 2
    assert f"{wrong}:" in capsys.readouterr().out
    assert cli.main(["check", str(wrong), "--json"]) == 2
    told = json.loads(capsys.readouterr().out)
    assert not told["valid"]
    assert all(p["line"] > 0 and p["column"] > 0 for p in told["problems"])
    assert cli.main(["check", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: valid, 3 cases\n"
    assert not (tmp_path / "results").exists()


def test_a_folder_in_use_is_refused(good, capsys):
    path, results = good
    toys.demflow("run", str(path), "--results", results)
    with FolderLock(toys.Path(results), "demflow run other"):
        assert toys.demflow("run", str(path), "--results", results) == 2
        assert f"process {os.getpid()}" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["walk", "study.yaml"],
        ["run"],
        ["run", "study.yaml", "--workers", "0"],
        ["run", "study.yaml", "--workers", "two"],
    ],
)
def test_wrong_usage(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main(arguments)
    assert stopped.value.code == 2
    assert "usage: demflow" in capsys.readouterr().err


def test_wrong_places(good, tmp_path, capsys):
    path, _ = good
    assert cli.main(["verify", str(tmp_path)]) == 2
    assert "is no results folder" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    assert toys.demflow("run", str(path), "--results", str(tmp_path / "file")) == 2
    assert "cannot be used" in capsys.readouterr().err
    assert toys.demflow("run", str(tmp_path / "absent.yaml")) == 2
    assert "absent.yaml" in capsys.readouterr().err


def test_a_folder_of_something_else_is_left_alone(good, tmp_path, capsys):
    path, _ = good
    diary = tmp_path / "results" / "good" / "study.yaml"
    diary.parent.mkdir(parents=True)
    diary.write_text("dear diary")
    assert toys.demflow("run", str(path), "--results", str(tmp_path / "results")) == 2
    assert f"{diary.parent} holds files that are no results" in capsys.readouterr().err
    assert diary.read_text() == "dear diary"


@pytest.mark.parametrize("command", ["run", "plan", "status", "verify"])
def test_a_store_of_a_newer_version_is_refused(good, tmp_path, capsys, command):
    mark = tmp_path / "store" / "FORMAT"
    mark.parent.mkdir()
    mark.write_bytes(b"demflow9\n")
    place = [str(good[0]), "--results", str(tmp_path)] if command != "verify" else [str(tmp_path)]
    assert toys.demflow(command, *place) == 2
    assert "made by another version of demflow (demflow9)" in capsys.readouterr().err
    assert list(tmp_path.rglob("*")) == [mark.parent, mark]


@pytest.mark.parametrize("place", ["mkdir", "open"])
def test_a_folder_that_cannot_be_written_is_wrong_usage(good, tmp_path, monkeypatch, capsys, place):
    def refuse(path, *_: object) -> None:
        raise OSError(30, "Read-only file system", str(path))

    (tmp_path / "results").mkdir()
    monkeypatch.setattr(os, place, refuse)
    status = toys.demflow("run", str(good[0]), "--results", str(tmp_path / "results"))
    monkeypatch.undo()
    (told,) = capsys.readouterr().err.splitlines()
    assert status == 2
    assert str(tmp_path / "results") in told
    assert "Read-only file system" in told


def test_a_study_that_changes_while_it_runs_is_told(tmp_path, capsys):
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    text = path.read_text()
    changed = functools.partial(path.write_text, text.replace("[1.0]", "[2.0]"))
    finished = toys.run(path, tmp_path / "results", progress=lambda _: changed())
    assert finished.changed
    assert (finished.folder / "study.yaml").read_text() == text
    assert open_results(finished.folder).rate.values == [1.0]
    assert toys.demflow("status", str(path), "--results", str(tmp_path / "results")) == 0
    assert "1 missing" in capsys.readouterr().out


def test_schema_is_json(capsys):
    assert cli.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["type"] == "object"


@pytest.mark.parametrize("command", [["--help"], ["check", "STUDY"], ["schema"]])
def test_what_must_answer_at_once_imports_nothing_heavy(good, command):
    code = (
        "import sys\n"
        "from demflow.sweep.command.cli import main\n"
        "try:\n"
        "    main(sys.argv[1:])\n"
        "except SystemExit:\n"
        "    pass\n"
        "heavy = {'xarray', 'numba', 'dask', 'scipy', 'matplotlib', 'netCDF4', 'distributed'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)\n"
    )
    arguments = [str(good[0]) if word == "STUDY" else word for word in command]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == "[]\n"
    assert done.stdout


def test_a_reader_that_stops_reading_is_no_error(good):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        f"'{sys.executable}' -m demflow schema | head -c 1",
        shell=True,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "{"
    assert "Traceback" not in done.stderr


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_in_place_and_in_a_log(monkeypatch):
    states = [Progress(8, 0, 0, None), Progress(8, 3, 1, 61.0), Progress(8, 7, 1, 0.0)]
    assert line(states[1]) == "3 of 8 cases done, 1 failed, 4 left, 61 s to go"
    assert line(Progress(8, 7, 0, 0.01)).endswith("1 left, less than a second to go")
    waiting = Progress(8, 0, 0, None, waiting=300.0)
    assert line(waiting).endswith("8 left, no worker for 5 min: waiting")
    quiet = Progress(8, 3, 0, 60.0, still=40.0, workers=2, deaths=1)
    assert line(quiet).endswith("60 s to go (last progress 40 s ago; workers: 2, 1 have died)")
    assert line(quiet._replace(ending=True, still=0.0)).endswith("Ctrl-C again stops at once")
    assert "progress" not in line(quiet._replace(still=20.0))
    assert line(Progress(8, 0, 0, None, True)).endswith("8 left, compiling: once on this machine")
    log = io.StringIO()
    written = ProgressLine(log)
    for state in [*states, states[-1]]:
        written(state)
    written.close()
    # the one in between came too soon after the first
    assert log.getvalue().splitlines() == [line(states[0]), line(states[2])]
    monkeypatch.setenv("TERM", "dumb")
    assert not ProgressLine(Terminal()).in_place


def shown(screen):
    """What stands on a terminal at last: lines are left, cleared and written anew."""
    lines, at = [""], 0
    for text, code, newline in re.findall(r"([^\x1b\r\n]+)|\x1b\[\??([\d;]*[A-Za-z])|(\n)", screen):
        if newline:
            at += 1
            lines += [""] * (at == len(lines))
        elif code == "2K":
            lines[at] = ""
        elif code.endswith("A"):
            at -= int(code[:-1])
        else:
            lines[at] += text
    return [line.rstrip() for line in lines]


@pytest.mark.parametrize("no_colour", ["", "1"])
def test_progress_on_a_terminal(no_colour, monkeypatch):
    monkeypatch.setenv("NO_COLOR", no_colour)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "80")
    stages = [StageProgress("pack", 2, 2), StageProgress("stress", 1, 4)]  # packed before
    begun = Progress(8, 0, 0, None, stages=tuple(stages))
    going = Progress(8, 3, 1, 61.0, stages=(stages[0], StageProgress("stress", 3, 4)))
    ended = Progress(8, 7, 1, 0.0, stages=(stages[0], StageProgress("stress", 4, 4)))
    screen = Terminal()
    in_place = ProgressLine(screen)
    in_place.every = 0.0
    for state, stressed in ((begun, 1), (going, 3), (ended, None)):
        in_place(state)
        first, *others = filter(None, shown(screen.getvalue()))
        assert first.endswith(line(state))
        assert [one.lstrip("━╸╺ ") for one in others] == [f"stress: {stressed} of 4"] * bool(
            stressed
        )
    in_place.close()
    assert screen.getvalue().endswith(("\n", "\n\x1b[?25h"))  # and the cursor is there again
    assert "\x1b[?25h" in screen.getvalue()
    assert ("\x1b[31m1 failed" in screen.getvalue()) is not bool(no_colour)


@pytest.mark.parametrize("columns", [30, 59, 60, 100])
def test_lines_in_place_never_wrap(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    screen = Terminal()
    in_place = ProgressLine(screen)
    in_place.every = 0.0
    for done in (0, 3, 900):
        stage = StageProgress("observe", done, 1000)
        in_place(Progress(1000, done, 1, 61.0, still=40.0, workers=12, deaths=3, stages=(stage,)))
        lines = shown(screen.getvalue())
        assert max(map(len, lines)) <= columns
        assert sum(map(bool, lines)) == 2
    assert any(one.startswith("━" * 17) for one in lines) is (columns >= 60)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0.0 s"),
        (0.031, "31 ms"),
        (8, "8.0 s"),
        (90, "90 s"),
        (180, "3 min"),
        (7500, "2 h 05 min"),
    ],
)
def test_durations(seconds, text):
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 B"), (999, "999 B"), (3_100_000, "3.1 MB"), (5e12, "5000 GB")]
)
def test_sizes(count, text):
    assert size(count) == text


ROOT = Path(__file__).parents[2]


def command(*arguments, **options):
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "demflow", *arguments],
        cwd=ROOT,
        capture_output=True,
        check=False,
        **options,
    )


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_any_terminal_can_show_what_a_study_says(tmp_path, encoding):
    path = tmp_path / "é.yaml"
    path.write_text('"\u4e2d\u202e": 1\nscene: 5\n', encoding="utf-8")
    done = command("check", str(path), env={**os.environ, "PYTHONIOENCODING": encoding})
    assert done.returncode == 2
    assert b"Traceback" not in done.stderr
    assert "U+202E" in done.stdout.decode(encoding)


@pytest.mark.parametrize(
    ("name", "closed"),
    [("quickstart", ">&-"), ("none", "<&- >&- 2>&-"), ("quickstart", ">/dev/full")],
)
def test_streams_that_are_closed_or_full_are_no_fault(name, closed):
    line = f"{sys.executable} -m demflow check studies/{name}.yaml {closed}"
    done = subprocess.run(["sh", "-c", line], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == (1 if "full" in closed else 0 if name == "quickstart" else 2)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


@pytest.mark.parametrize("address", ["foo", "", "tcp://", "http://a:1", "tcp://a:b", "a b:1"])
def test_an_address_that_is_none_is_wrong_usage(capsys, address):
    with pytest.raises(SystemExit) as caught:
        cli.main(["run", "studies/quickstart.yaml", "--scheduler", address])
    assert caught.value.code == 2
    assert "such as tcp://10.0.0.5:8786" in capsys.readouterr().err


def test_of_many_problems_json_has_the_first_and_their_count(tmp_path, capsys):
    path = tmp_path / "many.yaml"
    path.write_text("".join(f"a{k}: 1\n" for k in range(300)))
    assert cli.main(["check", str(path), "--json"]) == 2
    told = json.loads(capsys.readouterr().out)
    assert len(told["problems"]) == 100
    assert told["count"] >= 300


def test_a_plan_is_held_against_the_machine(good, tmp_path, capsys, monkeypatch):
    path, results = good
    toys.demflow("run", str(path), "--results", results)
    grown = path.parent / "beyond.yaml"
    grown.write_text(path.read_text().replace("[1.0, 2.0, 3.0]", "[5.0, 6.0, 7.0]"))
    capsys.readouterr()
    assert toys.demflow("plan", str(grown), "--results", results, "--json") == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    monkeypatch.setattr(forecast, "machine_memory", lambda: 1e6)
    monkeypatch.setattr(forecast.shutil, "disk_usage", lambda _: SimpleNamespace(free=10))
    assert toys.demflow("plan", str(grown), "--results", results, "--json") == 0
    told = capsys.readouterr()
    disk, memory = json.loads(told.out)["warnings"]
    assert "of disk are needed and 10 B are free" in disk
    assert "of memory are needed and the machine has 1.0 MB" in memory
    assert told.err.count("warning: ") == 2


def test_a_plan_counts_what_is_compiled_first(good, tmp_path, capsys, monkeypatch):
    path, results = good
    toys.demflow("run", str(path), "--results", results)
    grown = path.parent / "compiled.yaml"
    grown.write_text(path.read_text().replace("[1.0, 2.0, 3.0]", "[8.0, 9.0]"))
    seconds = []
    for kernels in (1000, 0):
        monkeypatch.setattr(forecast, "kept_kernels", lambda found=kernels: found)
        capsys.readouterr()
        toys.demflow("plan", str(grown), "--results", results, "--json")
        told = json.loads(capsys.readouterr().out)
        seconds.append(told["seconds"])
    assert told["compiling"] == forecast.COMPILING / 2
    assert seconds[1] - seconds[0] == pytest.approx(told["compiling"])


def test_a_long_plan_says_how_far_it_is(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(prepared, "SILENCE", 0.0)
    rates = tuple(float(k) for k in range(1, 2002))
    path = toys.write_study(tmp_path, name="long", seeds=(1,), stresses=(), rates=rates)
    assert toys.demflow("plan", str(path), "--results", str(tmp_path / "none")) == 0
    assert "planning: 1,000 of 2,001 cases" in capsys.readouterr().err
