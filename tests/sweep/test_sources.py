"""Results stay with the sources that made them, and only what these are behind is made anew."""

from __future__ import annotations

import os
import sys

import pytest

from demflow.sweep.command.upkeep import unwanted
from demflow.sweep.plan.sources import closures
from demflow.sweep.prepared import prepare
from demflow.sweep.store.inherited import inherited, note
from demflow.sweep.store.origins import note_origins, sources_told
from tests.sweep import toys
from tests.sweep.stored import put

FILES = {
    "__init__": "",
    "shared": "STRENGTH = 1.0\n",
    "law": '"""Poiseuille."""\n\nfrom working.shared import STRENGTH\n\nFACTOR = 12.0 * STRENGTH\n',
    "packing": "from working import shared\n\n\ndef pack(*, seed):\n    return shared.STRENGTH\n",
    "flowing": "def flow(packed):\n    from working.law import FACTOR\n\n    return FACTOR\n",
    "looking": (
        "from typing import TYPE_CHECKING\n\n"
        "if TYPE_CHECKING:\n    from working.law import FACTOR\n"
        "\n\ndef observe(packed, flowed):\n    return {}\n"
    ),
    "table": (
        "from demflow.model.stages import Stage\n\nalways = lambda s: True\nSTAGES = (\n"
        "    Stage('pack', 'working.packing:pack', 1, (), {'seed': lambda s: s.grains.seed},"
        " always, dict),\n"
        "    Stage('flow', 'working.flowing:flow', 1, ('pack',), {}, always, dict),\n"
        "    Stage('observe', 'working.looking:observe', 1, ('pack', 'flow'), {}, always, dict,"
        " observed=True),\n)\n"
    ),
}
TABLE = "working.table:STAGES"


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A package under work with a table of stages; returns what writes one of its modules."""
    folder = tmp_path / "working"
    folder.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    times = iter(range(1, 100))

    def write(name, text):
        (folder / f"{name}.py").write_text(text)
        os.utime(folder / f"{name}.py", ns=(0, next(times) * 10**9))

    for name, text in FILES.items():
        write(name, text)
    yield write
    for name in [n for n in sys.modules if n.partition(".")[0] == "working"]:
        del sys.modules[name]


@pytest.fixture
def made(tmp_path):
    """Plans the study; `run` stores all products that are missing, and tells of which stages."""
    path = toys.write_study(tmp_path, seeds=(1, 2), stresses=(), rates=())

    def plan():
        return prepare(path, tmp_path / "results", table=TABLE, create=True)

    def run():
        project = plan()
        told = inherited(project.store, project.plan)
        note(project.store, project.study, project.plan)
        note_origins(project.store, project.plan.stages)
        missing = [r for r in project.plan.runs if not project.store.has(r.id)]
        for one in missing:
            put(project.store, one.id, {}, {})
        project.folder.mkdir(exist_ok=True)
        (project.folder / "study.yaml").write_text(project.study.text)
        return {project.plan.stages[one.stage].name for one in missing}, told

    run.plan = plan
    return run


def test_only_stages_behind_which_the_sources_changed_are_made_anew(work, made):
    assert made()[0] == {"pack", "flow", "observe"}
    assert made() == (set(), None)
    work("law", FILES["law"].replace("12.0", "6.0"))
    again, told = made()
    assert again == {"flow", "observe"}
    assert "kept are its results of pack; computed anew: flow (its sources have changed)" in told
    assert sources_told(made.plan().plan.stages).startswith("flow ")
    work("packing", FILES["packing"] + "\n\nUNUSED = 1\n")
    assert made()[0] == {"pack", "flow", "observe"}  # what takes a product goes with it
    work("looking", FILES["looking"].replace("return {}", "return {1: 2}"))
    assert made()[0] == {"observe"}
    work("shared", "STRENGTH = 2.0\n")
    assert made()[0] == {"pack", "flow", "observe"}


def test_who_goes_back_finds_the_first_results_again(work, made):
    made()
    first = [run.id for run in made.plan().plan.runs]
    work("law", FILES["law"].replace("12.0", "6.0"))
    other = [run.id for run in made.plan().plan.runs]
    assert len(set(first) & set(other)) == 2  # the packings
    made()
    work("law", FILES["law"])
    assert [run.id for run in made.plan().plan.runs] == first
    assert made() == (set(), None)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("law", "Poiseuille.", "The cubic law,\nof Poiseuille."),
        ("law", "FACTOR = 12.0", "# of parallel plates\nFACTOR = (\n    12.0\n)"),
        ("table", "STAGES = (", "STAGES = (  # in order"),
    ],
)
def test_words_and_layout_change_nothing(work, made, name, old, new):
    made()
    text = FILES[name].replace(old, new)
    assert text != FILES[name]
    work(name, text)
    assert made() == (set(), None)


def test_a_version_that_was_raised_begins_anew(work, made):
    made()
    work("law", FILES["law"].replace("12.0", "6.0"))
    work("table", FILES["table"].replace("'working.flowing:flow', 1", "'working.flowing:flow', 2"))
    sys.modules.pop("working.table")
    assert made()[0] == {"flow", "observe"}
    assert sources_told(made.plan().plan.stages) == ""


def test_what_the_sources_at_hand_cannot_reach_is_unwanted(work, made, tmp_path):
    made()
    work("law", FILES["law"].replace("12.0", "6.0"))
    made()
    # no dataset tells of them: those of the first sources and those of the present ones stay
    assert unwanted(tmp_path / "results", table=TABLE).files == []
    work("law", FILES["law"])
    assert len(unwanted(tmp_path / "results", table=TABLE).files) == 4


@pytest.mark.slow
def test_a_function_without_sources_is_known_by_its_version():
    functions = ["demflow.model.mechanics.packing.packing:pack", "no.such.module:function"]
    packing, none, flow = closures([*functions, "demflow.model.flow.solvers.registry:flow"])
    assert none == ""
    assert packing != flow
