"""`demflow new` and `demflow completion`."""

import json
import shutil
import subprocess
from pathlib import Path

import jsonschema
import pytest
import yaml

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
    first, _, rest = study.text.partition("\n")
    assert rest == examples()[name].read_text(encoding="utf-8")
    schema = tmp_path / "mine" / first.partition("$schema=")[2]
    jsonschema.Draft202012Validator(json.loads(schema.read_text())).validate(yaml.safe_load(rest))
    assert written[-1] == "mine/demflow.schema.json"
    assert len(written) == 2 + len(study.files)
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


def test_the_schema_is_written_where_it_harms_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["schema", "--write", "schemas/own.json"]) == 0
    assert capsys.readouterr().out == "# yaml-language-server: $schema=own.json\n"
    written = (tmp_path / "schemas" / "own.json").read_text()
    assert main(["schema"]) == 0
    assert capsys.readouterr().out == written
    assert main(["schema", "--write", "schemas/own.json"]) == 0  # an older one gives way
    for mine in ("study: mine", "[1]", '{"title": "mine"}'):
        (tmp_path / "demflow.schema.json").write_text(mine)
        assert main(["schema", "--write", "demflow.schema.json"]) == 2
        assert main(["new", "quickstart"]) == 2
        assert (tmp_path / "demflow.schema.json").read_text() == mine
        assert not (tmp_path / "quickstart.yaml").exists()
    assert main(["schema", "--write", "my schema.json"]) == 2
    assert "blanks" in capsys.readouterr().err


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


@pytest.mark.parametrize(
    ("word", "study"),
    [("radial", "paper_radial"), ("fractured", "paper_fractured"), ("consolidation", "terzaghi")],
)
def test_a_word_of_its_name_or_title_is_enough(word, study, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", word]) == 0
    assert Path(f"{study}.yaml").exists()
    assert main(["new", "Pressure"]) == 2
    assert "several studies are about 'Pressure'" in capsys.readouterr().err
