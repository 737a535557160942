"""What a folder of another version still holds is told, and is what the plan finds there."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sweep.heritage import inherited, note
from sweep.stages import stage_table
from sweep.store import Store
from tests.sweep import toy_stages, toys

STAGES = stage_table(toys.TABLE)


@pytest.fixture
def store(tmp_path):
    return Store.open(tmp_path / "store")


def raised(name: str):
    return tuple(replace(s, version=2) if s.name == name else s for s in STAGES)


def test_nothing_is_said_where_nothing_changed(store):
    assert inherited(store, STAGES) is None
    note(store, STAGES)
    assert inherited(store, STAGES) is None
    for text in ("{", "[]", "{}"):
        (store.root / "stages.json").write_text(text)
        assert inherited(store, STAGES) is None


def test_a_raised_version_costs_the_stage_and_what_follows(store):
    note(store, STAGES)
    told = inherited(store, raised("stress"))
    assert "kept are its results of pack;" in told
    assert "stress (version 1, now 2)" in told
    assert "flow (follows stress)" in told
    assert "no stage" in inherited(store, raised("pack"))
    note(store, STAGES[:2])
    assert "flow (new)" in inherited(store, STAGES)


def test_what_is_kept_is_what_is_stored(tmp_path, monkeypatch):
    path, results, told = toys.write_study(tmp_path), tmp_path / "results", []
    toys.run(path, results, tell=told.append)
    assert told == []
    monkeypatch.setattr(toy_stages, "STAGES", raised("observe"))
    prepared = toys.prepared(path, results)
    there = {
        prepared.plan.stage_of(run).name
        for run in range(len(prepared.plan.runs))
        if prepared.stored()[run]
    }
    message = inherited(prepared.store, prepared.plan.stages)
    assert f"kept are its results of {', '.join(s.name for s in STAGES if s.name in there)};" in (
        message
    )
    assert there == {"pack", "stress", "flow"}
