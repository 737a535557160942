"""The ready queue, without a worker: order, bundles, blame, and the count of cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from demflow.sweep.execution.blame import ATTEMPTS_QUICK
from demflow.sweep.execution.schedule import (
    BUNDLE_SECONDS,
    LONGEST_SECONDS,
    SHARES,
    Schedule,
    State,
    Tally,
)
from demflow.sweep.plan.graph import CostClass, Plan, StageRun, stage_table
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
    """Run everything on one worker; the bundles in order."""
    bundles = []
    while bundle := schedule.next_bundle():
        for run in bundle.runs:
            parents = schedule.plan.runs[run].parents
            assert all(p < 0 or schedule.is_done(p) for p in parents)
            schedule.done(run, seconds)
        bundles.append(bundle.runs)
    return bundles


def test_long_runs_go_one_by_one_and_cases_finish_in_order():
    schedule = fresh(tree(2, 2, 2))
    bundles = drain(schedule, seconds=10.0)
    assert all(len(bundle) == 1 for bundle in bundles)
    assert [run for (run,) in bundles] == list(range(14))  # depth first
    assert schedule.pending == 0


def test_short_runs_go_in_bundles_of_bounded_length():
    schedule = fresh(tree(4, 10, 10))
    bundles = drain(schedule, seconds=BUNDLE_SECONDS / 8)
    assert sorted(run for bundle in bundles for run in bundle) == list(range(444))
    assert max(map(len, bundles)) == 8
    assert len(bundles) < 444 / 6


def test_bundles_are_long_at_first_and_short_at_the_end():
    schedule = fresh(tree(100, 1, 1))
    schedule.share_out(2)
    assert schedule.bundle_seconds == BUNDLE_SECONDS  # nothing is known yet
    each, lengths = LONGEST_SECONDS / 10, []
    while bundle := schedule.next_bundle():
        left = each * (300 - sum(lengths)) / 2  # for each of two workers
        assert len(bundle.runs) * each <= max(BUNDLE_SECONDS, left / SHARES) + each
        lengths.append(len(bundle.runs))
        for run in bundle.runs:
            schedule.done(run, each)
        schedule.share_out(2)
    assert sum(lengths) == 300
    assert (lengths[0], max(lengths), lengths[-1]) == (1, 10, 1)


def test_bundles_are_no_longer_than_a_part_of_a_case_s_time_limit():
    schedule = fresh(tree(100, 1, 1))
    while (bundle := schedule.next_bundle()) and bundle.seconds is None:
        for run in bundle.runs:
            schedule.done(run, 0.1)
    schedule.share_out(2)
    free = schedule.bundle_seconds
    schedule.share_out(2, limit=4.0)
    assert schedule.bundle_seconds == 4.0 / SHARES < free


@given(st.integers(1, 3), st.integers(1, 3), st.integers(1, 3), st.data())
def test_whatever_happens_every_run_ends_once(packs, flows, observers, data):
    plan = tree(packs, flows, observers)
    count = len(plan.runs)
    stored = data.draw(st.sets(st.integers(0, count - 1)))
    schedule = fresh(plan, stored)
    tally = Tally(plan, schedule.state)
    poison = data.draw(st.sets(st.integers(0, count - 1), max_size=2)) - stored
    killer = data.draw(st.sets(st.integers(0, count - 1), max_size=2)) - stored - poison
    ended: list[int] = []

    def end(runs: list[int], good: bool) -> None:
        ended.extend(runs)
        for run in runs:
            tally.finish(run, good)

    for _ in range(100 * count):
        if not schedule.pending:
            break
        bundle = schedule.next_bundle()
        assert bundle is not None
        for run in bundle.runs:
            if schedule.state[run] != State.RUNNING:
                continue  # a run before it has failed
            if run in killer:
                if (guilty := schedule.died(bundle)) is not None:
                    end(schedule.failed(guilty), good=False)
                break
            if run in poison:
                end(schedule.failed(run), good=False)
            else:
                schedule.done(run, data.draw(st.sampled_from([1e-3, 1.0])))
                end([run], good=True)
        schedule.again(bundle.runs)
    assert schedule.pending == 0
    assert sorted(ended) == sorted(set(range(count)) - stored)
    state = schedule.state
    assert {r for r in range(count) if state[r] == State.FAILED} <= poison | killer
    for run, entry in enumerate(plan.runs):
        bad = any(p >= 0 and state[p] in (State.FAILED, State.BLOCKED) for p in entry.parents)
        assert (state[run] == State.BLOCKED) == (bad and run not in stored)
    good = np.count_nonzero((state[plan.cases] == State.DONE).all(axis=1))
    assert (tally.done, tally.failed, tally.left) == (good, len(plan.cases) - good, 0)


def test_a_death_is_blamed_on_a_run_only_when_it_was_alone():
    schedule = fresh(tree(1, 1, 3), stored=(0, 1))
    schedule.done(1, 1e-6)
    first = schedule.next_bundle()
    assert first.runs == (2,)
    schedule.done(2, 1e-6)
    company = schedule.next_bundle()
    assert company.runs == (3, 4)
    assert schedule.died(company) is None
    assert schedule.next_bundle(alone_possible=False) is None
    for _ in range(ATTEMPTS_QUICK):
        alone = schedule.next_bundle()
        assert alone.alone
        assert alone.runs == (3,)
        verdict = schedule.died(alone)
    assert verdict == 3
    schedule.failed(3)
    assert schedule.next_bundle().runs == (4,)


def test_a_lost_product_is_computed_again_before_its_children():
    schedule = fresh(tree(1, 2, 1), stored=(0,))
    tally = Tally(schedule.plan, schedule.state)
    child = schedule.next_bundle().runs
    schedule.lost(0)
    tally.reopen(0)
    schedule.again(child)
    assert schedule.next_bundle().runs == (0,)
    assert schedule.next_bundle() is None
    schedule.done(0, 1.0)
    drain(schedule, 1.0)
    assert schedule.pending == 0
    assert tally.left == 2


def test_known_failures_block_their_descendants_at_once():
    schedule = fresh(tree(2, 1, 2), failed=(1,))
    assert [State(s).name for s in schedule.state[1:4]] == ["FAILED", "BLOCKED", "BLOCKED"]
    assert Tally(schedule.plan, schedule.state).failed == 2
    assert 1 not in {run for bundle in drain(schedule, 1.0) for run in bundle}


def test_time_left_follows_what_was_measured():
    schedule = fresh(tree(1, 2, 2))
    assert schedule.seconds_left(2) is None
    for kind, seconds in zip(KINDS, (8.0, 4.0, 1.0), strict=True):
        schedule.costs.add(kind, seconds, 100)
    assert schedule.seconds_left(2) == pytest.approx((8 + 2 * 4 + 4 * 1) / 2)
