"""What a folder of another version still holds is told, and is what the plan finds there."""

from __future__ import annotations

from dataclasses import replace

import pytest

from demflow.sweep.plan.table import stage_table
from demflow.sweep.store.inherited import inherited, note
from demflow.sweep.store.products import Store
from tests.sweep import toy_stages, toys

STAGES = stage_table(toys.TABLE)


@pytest.fixture
def made(tmp_path, monkeypatch):
    """A study, as a table of stages plans it; its store was noted by the stages as they are."""
    path = toys.write_study(tmp_path)

    def planned(stages=STAGES, path=path):
        monkeypatch.setattr(toy_stages, "STAGES", stages)
        prepared = toys.prepared(path, tmp_path / "results")
        return prepared.store, prepared.study, prepared.plan

    Store.open(tmp_path / "results" / "store")
    note(*planned())
    return planned


def changed(name: str, **how):
    return tuple(replace(s, **how) if s.name == name else s for s in STAGES)


def told(made, stages) -> str | None:
    store, _, plan = made(stages)
    return inherited(store, plan)


def test_nothing_is_said_where_nothing_changed(made):
    assert told(made, STAGES) is None
    store, study, plan = made()
    for text in ("{", "[]", "{}"):
        (store.root / "stages.json").write_text(text)
        assert told(made, STAGES) is None
    (store.root / "stages.json").unlink()
    assert inherited(store, plan) is None
    note(store, study, plan)
    assert inherited(store, plan) is None


def test_a_raised_version_costs_the_stage_and_what_follows(made):
    message = told(made, changed("stress", version=2))
    assert "kept are its results of pack;" in message
    assert "stress (version 1, now 2)" in message
    assert "flow (follows stress)" in message
    assert "no stage" in told(made, changed("pack", version=2))


def test_a_new_stage_is_told(made):
    pack, stress = STAGES[:2]
    note(*made((pack, replace(stress, observed=True))))
    assert "flow (new)" in told(made, STAGES)


def test_a_stage_that_reads_something_else_under_the_same_version_is_told(made):
    more = STAGES[0].reads | {"porosity": lambda s: s.grains.porosity}
    message = told(made, changed("pack", reads=more))
    assert "kept are its results of no stage" in message
    assert "pack (it reads something else)" in message
    other = STAGES[1].reads | {"stress": lambda s: (s.stress, 1.0)}  # under the same name
    message = told(made, changed("stress", reads=other))
    assert "kept are its results of pack;" in message
    assert "stress (it reads something else)" in message


def test_what_is_kept_is_told_of_the_study_that_was_run(made, tmp_path):
    """Another study, whose products nobody has, does not make the stages look changed."""
    other = toys.write_study(tmp_path, name="other", seeds=(8, 9), rates=(7.0,))
    store, _, plan = made(STAGES, other)
    assert inherited(store, plan) is None


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
@pytest.mark.parametrize("how", [{"version": 2}, {"reads": {"rate": lambda s: s.wells[0].rate}}])
def test_what_is_kept_is_what_is_stored(tmp_path, monkeypatch, how):
    path, results, heard = toys.write_study(tmp_path), tmp_path / "results", []
    toys.run(path, results, tell=heard.append)
    assert heard == []
    monkeypatch.setattr(toy_stages, "STAGES", changed("observe", **how))
    prepared = toys.prepared(path, results)
    there = {
        prepared.plan.stage_of(run).name
        for run in range(len(prepared.plan.runs))
        if prepared.stored()[run]
    }
    message = inherited(prepared.store, prepared.plan)
    assert f"kept are its results of {', '.join(s.name for s in STAGES if s.name in there)};" in (
        message
    )
    assert there == {"pack", "stress", "flow"}
