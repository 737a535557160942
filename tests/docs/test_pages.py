"""The pages say what the program does: blocks run, references are those of the tables."""

from __future__ import annotations

import copy
import inspect
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

import demflow
from demflow.model import quantities
from demflow.sweep.command import cli
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import KEYS, load_study
from demflow.sweep.study.scene import SCENE
from demflow.sweep.study.schema import study_schema
from demflow.sweep.study.units import parse_quantity
from tests.benchmarks import page

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = (ROOT / "README.md", *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("reference/*.md")))

# what a part of a study is tried in
AROUND = """
study: around
scene:
  region: {shape: circle, radius: 12 m}
  grains: {count: 300, porosity: 0.17, seed: 1}
  matrix: {permeability: 5 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 2.2 GPa}
  wells: {producer: {at: [0 m, 0 m], radius: 0.5 m, rate: 1e-6 m3/s}}
  boundaries: {outer: 20 MPa}
  initial_pressure: 20 MPa
  times: {first: 10 s, last: 1e5 s, per_decade: 5}
observe: [well_pressure]
"""

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def _blocks(path: Path, language: str) -> list[str]:
    return [text for word, text in BLOCK.findall(path.read_text()) if word == language]


def _named(pages: tuple[Path, ...], language: str) -> list[object]:
    return [
        pytest.param(text, id=f"{path.name}-{number}")
        for path in pages
        for number, text in enumerate(_blocks(path, language))
    ]


def _study(text: str) -> dict[str, object]:
    """A block as a whole study: as it is, or put into one where it is a part."""
    part = yaml.safe_load(text)
    if "study" in part:
        return part
    study = yaml.safe_load(AROUND)
    for key, value in copy.deepcopy(part).items():
        if key in KEYS:
            study[key] = value
        else:
            assert key in SCENE.members, f"{key} is no key of a study, nor of a scene"
            study["scene"][key] = value
    return study


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder in which pages are followed, with the maps and records that they name."""
    shutil.copytree(ROOT / "studies" / "maps", tmp_path / "maps")
    shutil.copy(ROOT / "studies" / "build_up.yaml", tmp_path)
    gauge = np.loadtxt(ROOT / "studies/gauges/made_build_up.csv", delimiter=",", skiprows=1)
    gauge /= [parse_quantity("1 h", "s"), parse_quantity("1 psi", "Pa") / 1e3]
    np.savetxt(tmp_path / "gauge.csv", gauge, delimiter=",", header="t [h],p [psi]", comments="")
    rate = 1e-5 * 10.0 / 1.1 / parse_quantity("1 bbl/d", "m3/s")  # of 10 m, at the surface
    hours = 4000.0 / 3600.0
    (tmp_path / "rates.csv").write_text(f"t [h],q [bbl/d]\n0,{rate}\n{hours},0\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.usefixtures("packed_once")
@pytest.mark.parametrize("text", _named(PAGES, "yaml"))
def test_blocks_of_studies_are_valid_and_run(text, folder, capsys):
    """Each is checked, and its first case run; what has no scene is fitted."""
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(_study(text), sort_keys=False))
    alone = text.startswith("study") and "\nscene:" not in text
    status = cli.main(["fit" if alone else "check", str(path)])
    assert status == 0, capsys.readouterr()
    if not alone:
        study = load_study(path, smoke="\nsmoke:" in text)
        found = demflow.simulate(case_at(study, (0,) * len(study.axes)).scene)
        fields = {"grain_map", "pressure_map", "fracture_network"}  # words for more than one
        assert set(study.values["observe"]) - found.keys() <= fields


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_the_tutorial_can_be_followed(folder):
    """Each block in turn, as a reader would: studies saved, commands given, Python typed."""
    tutorial = DOCS / "tutorial.md"
    names: dict[str, object] = {}
    for language, text in BLOCK.findall(tutorial.read_text()):
        if language == "yaml":
            name = re.search(r"^study: (\S+)", text, re.MULTILINE)
            (folder / f"{name[1]}.yaml").write_text(text)
        elif language == "sh":
            for line in text.strip().splitlines():
                command = shlex.split(line)
                assert command[0] == "demflow"
                assert cli.main(command[1:]) == 0
        elif language == "python":
            exec(compile(text, str(tutorial), "exec"), names)
    assert (folder / "results" / "tutorial" / "report.html").is_file()
    assert (folder / "drawdown.png").stat().st_size > 10_000
    along, across = names["along"], names["across"]
    ratio = (along / across).sel(angle=[0, 90]).values
    assert ratio[0] > 1.0 > ratio[1]
    # others go on with what this one left
    notebook = json.loads((DOCS / "analysis.ipynb").read_text())
    cells: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), "analysis.ipynb", "exec"), cells)
    assert cells["values"].shape == (4, 2)
    assert len(cells["table"]) == 8
    demflow.run(folder / "build_up.yaml", workers=1, smoke=True)
    for text in _blocks(DOCS / "how-to.md", "python"):
        exec(compile(text, "how-to.md", "exec"), {})


@pytest.mark.slow
@pytest.mark.usefixtures("one_worker")
def test_the_first_page_can_be_followed(folder):
    """What README does with the quickstart's results, here of fewer grains."""
    study = (ROOT / "studies" / "quickstart.yaml").read_text().replace("count: 2500", "count: 250")
    (folder / "quickstart.yaml").write_text(study)
    demflow.run(folder / "quickstart.yaml", workers=1)
    names: dict[str, Any] = {}
    for text in _blocks(ROOT / "README.md", "python"):
        exec(compile(text, "README.md", "exec"), names)
    assert names["maps"].axis_aperture == 1.5e-4


def test_a_cluster_is_made_and_handed_to_the_run(monkeypatch):
    """With a queue that gives an address at once."""
    asked: dict[str, Any] = {}
    cluster = SimpleNamespace(
        scheduler_address="tcp://node:8786",
        scale=lambda jobs: asked.update(jobs=jobs),
        wait_for_workers=lambda number: asked.update(workers=number),
    )
    queue: Any = ModuleType("dask_jobqueue")
    queue.SLURMCluster = lambda **options: asked.update(options) or cluster
    monkeypatch.setitem(sys.modules, "dask_jobqueue", queue)
    run = inspect.signature(demflow.run)
    monkeypatch.setattr(demflow, "run", lambda *a, **k: asked.update(run.bind(*a, **k).arguments))
    (text,) = _blocks(DOCS / "clusters.md", "python")
    exec(compile(text, "clusters.md", "exec"), {"__name__": "__main__"})
    assert asked["scheduler"] == "tcp://node:8786"
    assert asked["processes"] == asked["cores"]


def test_no_block_is_left_out():
    """Languages that the tests above execute; commands.md is what the program itself prints."""
    for path in PAGES:
        languages = {word for word, _ in BLOCK.findall(path.read_text())}
        followed = path.name in ("README.md", "tutorial.md", "how-to.md", "clusters.md")
        assert languages <= {"yaml", "text"} | ({"python", "sh"} if followed else set()), path


def _keys(schema: object) -> set[str]:
    """Every key that a study may have, by what the schema for editors holds."""
    if isinstance(schema, list):
        return set().union(*map(_keys, schema)) if schema else set()
    if not isinstance(schema, dict):
        return set()
    found = set(schema.get("properties", {}))
    return found.union(*(_keys(one) for key, one in schema.items() if key not in ("if", "then")))


def test_every_key_of_a_study_is_documented():
    text = (DOCS / "reference" / "study.md").read_text()
    said = {path.rpartition(".")[2] for path in re.findall(r"`([\w.-]+)`", text)}
    missing = _keys(study_schema()) - said
    assert not missing - {"shape", "kind"}  # they stand in the headings of what they choose


def test_every_variable_is_documented():
    text = (DOCS / "reference" / "dataset.md").read_text()
    for table in (
        *(quantities.CASE, quantities.PRINCIPAL, quantities.ENSEMBLE),
        *(quantities.SWEEP, quantities.RAGGED, quantities.MAPS),
    ):
        assert not [name for name in table if f"| `{name}` |" not in text]


def test_every_figure_of_a_run_is_named():
    """By the start of its file's name, as the sheet adds it; `_0` and names of wells follow."""
    text = (DOCS / "gallery.md").read_text()
    names = re.findall(r'sheet\.add\(f?"(\w+)', (ROOT / "sweep/figures/__init__.py").read_text())
    assert len(names) > 15
    assert not [name for name in names if f"`{name}" not in text]


def test_every_check_has_its_row():
    """`python -m tests.benchmarks --page` writes them anew."""
    assert page.PAGE.read_text() == page.drawn(page.kept(), page.titles())


@pytest.mark.slow
def test_reference_pages_are_those_of_the_tables():
    """`make docs` writes them anew."""
    done = subprocess.run(
        [sys.executable, str(DOCS / "reference.py"), "--check"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_key_that_a_stage_reads_says_so():
    """A key without a reader changes nothing, or no study shows it."""
    text = (DOCS / "reference" / "study.md").read_text()
    scene = text[text.index("## scene\n") : text.index("## limits")]
    silent = [line.split("|")[1] for line in scene.splitlines() if line.endswith("|  |")]
    assert not silent


@pytest.mark.slow
def test_pages_build_without_a_warning(tmp_path):
    """All links inside the pages lead somewhere, and no page is left out."""
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E", "-d", tmp_path / "trees",
         DOCS, tmp_path / "html"],
        capture_output=True,
        text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    html = (tmp_path / "html" / "index.html").read_text()
    loaded = re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="(https?:[^"]+)"', html)
    assert not loaded
