"""What came of runs is entered without any worker: losses, late words of the dead, limits."""

from __future__ import annotations

import numpy as np
import pytest

from demflow.model.outcome import Status
from demflow.sweep.errors import RunError
from demflow.sweep.execution.ledger import LOST_PRODUCTS, Ledger
from demflow.sweep.execution.limits import Judge, Verdict
from demflow.sweep.execution.schedule import Schedule
from demflow.sweep.execution.worker import Outcome
from demflow.sweep.study.load import Limits
from tests.sweep import toys
from tests.sweep.stored import put


@pytest.fixture
def made(tmp_path):
    """One case of four stages, one after the other, nothing of it stored."""
    path = toys.write_study(tmp_path, seeds=(1,), stresses=(), rates=(1.0,))
    made = toys.prepared(path, tmp_path / "results")
    assert [made.plan.stage_of(run).name for run in range(4)] == [
        "pack",
        "stress",
        "flow",
        "observe",
    ]
    return made


UNLIMITED = Limits(time=None)


def ledger_of(made, limits=UNLIMITED, anew=False) -> Ledger:
    nothing = np.zeros(len(made.plan.runs), dtype=bool)
    return Ledger(Schedule(made.plan, nothing, nothing), made.store, limits, anew=anew)


def store(made, run: int, seconds: float = 0.0) -> None:
    put(made.store, made.plan.runs[run].id, {"x": np.zeros(3)}, {"seconds": seconds})


def test_a_product_that_is_lost_again_and_again_ends_the_run(made):
    ledger = ledger_of(made)
    missed = Outcome(1, Status.NOT_RUN, "it is damaged", lost=made.plan.runs[0].id)
    for _ in range(LOST_PRODUCTS):
        ledger.enter(Outcome(0, Status.DONE))
        ledger.enter(missed)
        assert not ledger.schedule.is_done(0)
    ledger.enter(Outcome(0, Status.DONE))
    with pytest.raises(RunError, match="it is damaged: again and again"):
        ledger.enter(missed)
    assert ledger.report.damaged == ["it is damaged"] * LOST_PRODUCTS


def test_a_product_that_is_whole_where_it_lies_is_only_sent_again(made):
    store(made, 0)
    ledger = ledger_of(made)
    ledger.enter(Outcome(0, Status.DONE))
    ledger.enter(Outcome(1, Status.NOT_RUN, "it came damaged", lost=made.plan.runs[0].id))
    assert ledger.schedule.is_done(0)
    assert ledger.report.damaged == ["it came damaged"]


def test_what_a_dead_worker_stored_counts_unless_it_may_have_lain_there_before(made):
    ledger, forced = ledger_of(made), ledger_of(made, anew=True)
    store(made, 1, seconds=3.0)
    for run in (0, 1, 2):
        ledger.find_stored(run)
        forced.find_stored(run)
    assert [ledger.schedule.is_done(run) for run in range(3)] == [False, True, False]
    assert forced.report.computed == 0
    assert ledger.report.computed == 1
    assert ledger.schedule.costs.seconds(made.plan.runs[1].kind) == 3.0


def test_a_conviction_is_recorded_with_its_limits_and_blocks_what_follows(made):
    ledger = ledger_of(made, Limits(time=2.0))
    ledger.convict(1, Verdict(Status.TIMED_OUT, "not done after 2 s"))
    record = made.store.failure(made.plan.runs[1].id)
    assert (record["status"], record["limits"]) == (2, {"time": 2.0, "memory": None})
    ledger.enter(Outcome(0, Status.DONE))
    assert (ledger.schedule.pending, ledger.schedule.tally().failed, ledger.report.failed) == (
        0,
        1,
        1,
    )


def test_what_a_worker_elsewhere_took_is_not_booked_here(made):
    ledger = ledger_of(made)
    ledger.enter(Outcome(0, Status.DONE, seconds=5.0, stored=10, machine="abacus"))
    ledger.find_stored(0)
    assert ledger.schedule.costs.known == {}
    ledger.enter(Outcome(1, Status.DONE, seconds=5.0, stored=10))
    assert [key.split("/")[0] for key in ledger.schedule.costs.known] == ["stress"]


def test_a_run_takes_the_time_of_all_that_it_builds_on(made):
    store(made, 0, seconds=3.0)
    store(made, 1, seconds=4.0)
    judge = Judge(made.plan, made.store, Limits(time=10.0))
    assert judge.before([2]) == 7.0
    assert judge.before([1, 2]) == 3.0  # run 1 takes its time together with run 2
    assert judge.of_time(7.0, 2.9) is None
    status, why, _ = judge.of_time(7.0, 3.1)
    assert (status, "7 s of them in earlier stages" in why) == (Status.TIMED_OUT, True)
    assert Judge(made.plan, made.store, UNLIMITED).of_time(7.0, 1e9) is None


def test_of_a_run_of_many_members_a_case_takes_the_part_of_one(made):
    made.plan.runs[1] = made.plan.runs[1]._replace(members=tuple(range(50)))
    store(made, 0, seconds=3.0)
    store(made, 1, seconds=100.0)
    judge = Judge(made.plan, made.store, Limits(time=10.0))
    assert judge.before([2]) == 5.0
    assert [judge.served(runs) for runs in ([1], [2], [1, 2])] == [50, 1, 1]


def test_what_a_worker_may_hold_is_its_own_limit_or_the_study_s(made):
    judge = Judge(made.plan, made.store, Limits(memory=3e9))
    assert judge.memory({}) == 3e9
    assert judge.memory({"memory_limit": 0}) == 3e9  # Dask's word for none
    assert judge.memory({"memory_limit": 1e9}) == 1e9
    assert Judge(made.plan, made.store, Limits()).memory({}) is None
    small, large = {"memory_limit": 1e9}, {"metrics": {"memory": 3.1e9}}
    assert judge.of_memory(small | {"metrics": {"memory": 2e9}}) is None  # its nanny's business
    assert "limits.memory" in judge.of_memory(large).message
    verdict = judge.outgrown(small)
    assert (verdict.status, verdict.memory) == (Status.OUT_OF_MEMORY, 1e9)
    assert verdict.message.startswith("more than 1 GB, all that a worker of this cluster may hold")
