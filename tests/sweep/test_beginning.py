"""`demflow new` and `demflow completion`."""

import shutil
import subprocess

import pytest

from demflow.sweep.command.beginning import examples, script, title_of
from demflow.sweep.command.cli import main
from demflow.sweep.study.load import load_study


def test_new_lists_the_studies_with_their_titles(capsys):
    assert main(["new"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("quickstart")
    assert len(lines) == len(examples())
    assert title_of(examples()["quickstart"]) in lines[0]


@pytest.mark.parametrize("name", ["quickstart", "outcrop"])
def test_new_copies_a_study_that_is_valid_where_it_lies(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", name, "mine/own.yaml"]) == 0
    written = capsys.readouterr().out.split()
    assert written[0] == "mine/own.yaml"
    study = load_study(tmp_path / "mine" / "own.yaml")
    assert study.text == examples()[name].read_text(encoding="utf-8")
    assert len(written) == 1 + len(study.files)
    for file in study.files.values():
        assert (tmp_path / "mine") in file.path.resolve().parents


def test_new_writes_over_nothing_and_hints_at_names(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rev.yaml").write_text("mine")
    assert main(["new", "rev"]) == 2
    assert (tmp_path / "rev.yaml").read_text() == "mine"
    assert "there already" in capsys.readouterr().err
    assert main(["new", "quickstrat"]) == 2
    assert "did you mean 'quickstart'?" in capsys.readouterr().err


def completed(capsys, *words):
    """What bash offers for the last of some words."""
    assert main(["completion", "bash"]) == 0
    text = capsys.readouterr().out
    ask = f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; _demflow"
    command = f'{text}\n{ask}; echo "${{COMPREPLY[@]}}"'
    bash = shutil.which("bash")
    assert bash is not None
    return subprocess.run([bash, "-c", command], capture_output=True, text=True).stdout.split()


def test_bash_completes_commands_options_and_studies(capsys):
    assert completed(capsys, "demflow", "ru") == ["run"]
    assert completed(capsys, "demflow", "run", "--wor") == ["--workers"]
    assert completed(capsys, "demflow", "new", "quick") == ["quickstart"]


def test_other_shells_know_every_command(capsys):
    described = {"run": ("Run what's missing", ["-h", "--help", "--workers"]), "new": ("", [])}
    fish = script("fish", described)
    assert "-a run -d 'Run what\\'s missing'" in fish
    assert "'__fish_seen_subcommand_from run' -l workers" in fish
    assert script("zsh", described).startswith("autoload -U +X bashcompinit")
    assert main(["completion", "zsh"]) == 0
    told = capsys.readouterr().out
    for name in ("run", "check", "plan", "status", "report", "verify", "fit", "export"):
        assert f"        {name}) " in told
