"""The ready queue, without a worker: order, lots, suspects, and the count of cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demflow.sweep.execution.schedule import (
    BLOCKED,
    DONE,
    FAILED,
    LONGEST_SECONDS,
    LOT_SECONDS,
    RUNNING,
    SHARES,
    WORTH_SECONDS,
    Schedule,
)
from demflow.sweep.plan.graph import Plan
from demflow.sweep.plan.runs import CostClass, StageRun
from demflow.sweep.plan.table import stage_table
from tests.sweep.toys import TABLE

STAGES = stage_table(TABLE)[:3]
KINDS = [CostClass(stage.name, stage.version, "", 0) for stage in STAGES]


def tree(packs: int, flows: int, observers: int) -> Plan:
    """Each pack has flows, each flow has observers; every observer is a case."""
    runs: list[StageRun] = []
    cases = []
    for _ in range(packs):
        pack = len(runs)
        runs.append(StageRun(f"p{pack}", 0, (), len(cases), KINDS[0]))
        for _ in range(flows):
            flow = len(runs)
            runs.append(StageRun(f"f{flow}", 1, (pack,), len(cases), KINDS[1]))
            for _ in range(observers):
                cases.append((pack, flow, len(runs)))
                observer = StageRun(f"o{len(runs)}", 2, (flow, pack, -1), len(cases) - 1, KINDS[2])
                runs.append(observer)
    return Plan(STAGES, runs, np.array(cases, dtype=np.int32))


def fresh(plan: Plan, stored=(), failed=()) -> Schedule:
    masks = [np.isin(np.arange(len(plan.runs)), list(which)) for which in (stored, failed)]
    return Schedule(plan, *masks)


def drain(schedule: Schedule, seconds: float) -> list[tuple[int, ...]]:
    """Run everything on one worker; the lots in order."""
    lots = []
    while lot := schedule.next_lot():
        for run in lot:
            parents = schedule.plan.runs[run].parents
            assert all(p < 0 or schedule.is_done(p) for p in parents)
            schedule.done(run, seconds)
        lots.append(lot)
    return lots


def test_long_runs_go_one_by_one_and_cases_finish_in_order():
    schedule = fresh(tree(2, 2, 2))
    lots = drain(schedule, seconds=10.0)
    assert all(len(lot) == 1 for lot in lots)
    assert [run for (run,) in lots] == list(range(14))  # depth first
    assert schedule.pending == 0


def test_short_runs_go_in_lots_of_bounded_length():
    schedule = fresh(tree(4, 10, 10))
    lots = drain(schedule, seconds=LOT_SECONDS / 8)
    assert sorted(run for lot in lots for run in lot) == list(range(444))
    assert max(map(len, lots)) == 8
    assert len(lots) < 444 / 6


def test_lots_are_long_at_first_and_short_at_the_end():
    schedule = fresh(tree(100, 1, 1))
    schedule.share_out(2)
    assert schedule.lot_seconds == LOT_SECONDS  # nothing is known yet
    each, lengths = LONGEST_SECONDS / 10, []
    while lot := schedule.next_lot():
        left = each * (300 - sum(lengths)) / 2  # for each of two workers
        assert len(lot) * each <= max(LOT_SECONDS, left / SHARES) + each
        lengths.append(len(lot))
        for run in lot:
            schedule.done(run, each)
        schedule.share_out(2)
    assert sum(lengths) == 300
    assert (lengths[0], max(lengths), lengths[-1]) == (1, 10, 1)


def test_lots_are_no_longer_than_a_part_of_a_case_s_time_limit():
    schedule = fresh(tree(100, 1, 1))
    for _ in STAGES:  # each is measured once
        for run in schedule.next_lot():
            schedule.done(run, 0.1)
    schedule.share_out(2)
    free = schedule.lot_seconds
    schedule.share_out(2, limit=4.0)
    assert schedule.lot_seconds == 4.0 / SHARES < free


@pytest.mark.slow
@given(st.integers(1, 3), st.integers(1, 3), st.integers(1, 3), st.data())
def test_whatever_happens_every_run_ends_once(packs, flows, observers, data):
    plan = tree(packs, flows, observers)
    count = len(plan.runs)
    stored = data.draw(st.sets(st.integers(0, count - 1)))
    schedule = fresh(plan, stored)
    poison = data.draw(st.sets(st.integers(0, count - 1), max_size=2)) - stored
    killer = data.draw(st.sets(st.integers(0, count - 1), max_size=2)) - stored - poison
    ended: list[int] = []
    for _ in range(100 * count):
        if not schedule.pending:
            break
        lot = schedule.next_lot()
        assert lot
        if schedule.suspects.intersection(lot):
            assert len(lot) == 1
        for run in lot:
            if schedule.state[run] != RUNNING:
                continue  # a run before it has failed
            if run in killer:
                if len(lot) == 1:
                    schedule.failed(run)
                    ended.append(run)
                else:
                    schedule.suspect(lot)
                break
            if run in poison:
                schedule.failed(run)
            else:
                schedule.done(run, data.draw(st.sampled_from([1e-3, 1.0])))
            ended.append(run)
        schedule.again(lot)
    assert schedule.pending == 0
    state = schedule.state
    blocked = {run for run in range(count) if state[run] == BLOCKED}
    assert sorted([*ended, *blocked]) == sorted(set(range(count)) - stored)
    assert {r for r in range(count) if state[r] == FAILED} <= poison | killer
    for run, entry in enumerate(plan.runs):
        bad = any(p >= 0 and state[p] in (FAILED, BLOCKED) for p in entry.parents)
        assert (state[run] == BLOCKED) == (bad and run not in stored)
    good = np.count_nonzero((state[plan.cases] == DONE).all(axis=1))
    assert schedule.tally() == (good, len(plan.cases) - good, 0)
    of_stages = schedule.stages()
    assert sum(runs for _, _, runs in of_stages) == count
    for name, done, runs in of_stages:
        own = [k for k, run in enumerate(plan.runs) if plan.stages[run.stage].name == name]
        assert (done, runs) == (np.count_nonzero(state[own] == DONE), len(own))


def test_suspects_go_by_themselves_and_before_all_others():
    schedule = fresh(tree(1, 1, 4), stored=(0, 1))
    schedule.done(schedule.next_lot()[0], 1e-6)
    company = schedule.next_lot()
    assert company == (3, 4, 5)
    schedule.done(3, 1e-6)
    schedule.suspect(company)
    assert [schedule.next_lot() for _ in range(3)] == [(4,), (5,), ()]
    schedule.failed(4)
    schedule.again((4, 5))
    assert [schedule.next_lot() for _ in range(2)] == [(5,), ()]


def test_as_many_workers_are_wanted_as_have_something_to_do():
    schedule = fresh(tree(2, 3, 1))
    assert schedule.wanted() == 2  # nothing is known but that two packings are ready
    for kind in KINDS:
        schedule.costs.add(kind, WORTH_SECONDS, 100)
    assert schedule.wanted() == 2
    for _ in range(2):  # a packing and one of its flows
        schedule.done(*schedule.next_lot(), WORTH_SECONDS)
    assert schedule.wanted() == 4  # the other packing, two flows and an observer
    while lot := schedule.next_lot():
        for run in lot:
            schedule.done(run, 1e-3)
    assert schedule.wanted() == 0


def test_a_lost_product_is_computed_again_before_its_children():
    schedule = fresh(tree(1, 2, 1), stored=(0,))
    child = schedule.next_lot()
    schedule.lost(0)
    schedule.again(child)
    assert schedule.next_lot() == (0,)
    assert schedule.next_lot() == ()
    schedule.done(0, 1.0)
    drain(schedule, 1.0)
    assert schedule.pending == 0
    assert schedule.tally() == (2, 0, 0)


def test_known_failures_block_their_descendants_at_once():
    schedule = fresh(tree(2, 1, 2), failed=(1,))
    assert schedule.state[1:4].tolist() == [FAILED, BLOCKED, BLOCKED]
    assert schedule.tally().failed == 2
    assert 1 not in {run for lot in drain(schedule, 1.0) for run in lot}


def test_time_left_follows_what_was_measured():
    schedule = fresh(tree(1, 2, 2))
    assert schedule.seconds_left(2) is None
    for kind, seconds in zip(KINDS, (8.0, 4.0, 1.0), strict=True):
        schedule.costs.add(kind, seconds, 100)
    assert schedule.seconds_left(2) == pytest.approx((8 + 2 * 4 + 4 * 1) / 2)
