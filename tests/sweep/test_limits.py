"""What a case may take by default, and when one that failed for it is tried again."""

from __future__ import annotations

import psutil
import pytest

from demflow.model.outcome import Status
from demflow.sweep import prepared
from demflow.sweep.execution import limits, memory
from demflow.sweep.execution.limits import in_force
from demflow.sweep.prepared import may_pass
from demflow.sweep.study.load import Limits


def test_workers_share_the_machine_unless_the_study_says_otherwise(monkeypatch):
    monkeypatch.setattr(limits, "machine_memory", lambda: 20e9)
    shares = [in_force(Limits(), workers).memory for workers in (1, 2, 4)]
    assert shares == [share * limits.SHARED for share in (20e9, 10e9, 5e9)]
    assert in_force(Limits(), 1000).memory == limits.LEAST
    assert in_force(Limits(memory=3e9), 2) == Limits(memory=3e9)
    assert in_force(Limits(), None) == Limits()


def test_a_control_group_bounds_what_the_machine_has(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "CGROUP", tmp_path)
    whole = psutil.virtual_memory().total
    assert memory.machine_memory() == whole
    for told, bound in (("1000000\n", 1e6), ("max\n", whole)):
        (tmp_path / "memory.max").write_text(told)
        assert memory.machine_memory() == bound


@pytest.mark.parametrize(
    ("record", "now", "tried"),
    [
        ({"status": Status.FAILED}, Limits(memory=1e12), False),
        ({"status": Status.WORKER_DIED}, Limits(memory=1e12), False),
        ({"status": Status.OUT_OF_MEMORY, "limits": {"memory": 1e9}}, Limits(memory=1e9), False),
        ({"status": Status.OUT_OF_MEMORY, "limits": {"memory": 1e9}}, Limits(memory=2e9), True),
        ({"status": Status.OUT_OF_MEMORY}, Limits(memory=2e9), True),  # of an earlier version
        ({"status": Status.TIMED_OUT, "limits": {"time": 5.0}}, Limits(time=5.0), False),
        ({"status": Status.TIMED_OUT, "limits": {"time": 5.0}}, Limits(time=None), True),
    ],
)
def test_what_a_raised_limit_may_change_is_tried_again(record, now, tried):
    assert may_pass(record, now) is tried


def test_what_the_machine_was_short_of_is_tried_when_it_has_more(monkeypatch):
    record = {"status": Status.OUT_OF_MEMORY, "limits": {"memory": 8e9}, "room": 2e9}
    for there, tried in ((2.1e9, False), (4e9, True)):
        monkeypatch.setattr(prepared, "available", lambda there=there: there)
        assert may_pass(record, Limits(memory=8e9)) is tried
