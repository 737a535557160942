"""Whom the death of a worker is blamed on, played through without one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from demflow.sweep.execution.blame import ATTEMPTS_ALONE, ATTEMPTS_AT_MOST, CHANCE, Blame, by_chance


def test_the_chance_is_that_of_many_drawn_numbers():
    drawn = np.random.default_rng(1).poisson(2.5, 200_000)
    for count in range(8):
        assert by_chance(count, 2.5) == pytest.approx(np.mean(drawn >= count), abs=4e-3)
    assert by_chance(2, 1e-3) == pytest.approx(1e-6 / 2, rel=1e-3)
    assert (by_chance(3, math.inf), by_chance(3, 0.0)) == (1.0, 0.0)


def test_where_no_other_worker_dies_the_second_long_death_alone_convicts():
    blame = Blame()
    assert blame.died((3, 4, 5)) is None
    for _ in range(ATTEMPTS_ALONE - 1):
        assert blame.died((4,), seconds=100.0, watched=200.0) is None
    assert blame.died((4,), seconds=100.0, watched=400.0) == 4


def test_a_short_run_is_tried_more_often_before_it_is_blamed():
    """Two workers, each death 0.1 s after it began and 2 s after the last."""
    blame, verdicts = Blame(), []
    blame.died((4, 7))
    while not verdicts or verdicts[-1] is None:
        watched = 4.0 * (len(verdicts) + 1)
        verdicts.append(blame.died((7,), seconds=0.1, watched=watched))
    assert verdicts == [None] * 3 + [7]
    assert (0.1 / 4.0) ** 4 < CHANCE < (0.1 / 4.0) ** 3


def test_a_storm_at_the_very_start_convicts_nobody():
    """Two workers of which one is killed every 0.5 s, under runs of 0.2 s that wait to be tried."""
    chance = np.random.default_rng(5)
    for _ in range(100):
        blame, watched, suspects = Blame(), 2.0, list(range(10))
        blame.died(suspects)
        for _ in range(100):
            until = chance.exponential(1.0)  # of this worker's life
            watched += 2.0 * min(until, 0.2)
            if until > 0.2:
                suspects.pop(0)
                if not suspects:
                    break
            else:
                run = suspects[0]
                assert blame.died((run,), seconds=until, watched=watched) is None


def test_a_run_that_kills_at_once_is_blamed_though_workers_die_elsewhere_too():
    """Ten deaths in 100 worker-seconds: one in 10 s is chance, three in 0.06 s are not."""
    blame = Blame()
    for _ in range(10):
        assert blame.died(()) is None
    verdicts = []
    while not verdicts or verdicts[-1] is None:
        verdicts.append(blame.died((7,), seconds=0.02, watched=100.0))
    assert (verdicts[-1], len(verdicts)) == (7, 3)
    assert blame.died((8,), seconds=0.02, watched=100.0) is None


def test_what_a_convicted_run_did_speaks_for_nobody_else():
    blame = Blame()
    for _ in range(ATTEMPTS_ALONE):
        convicted = blame.died((1,), seconds=5.0, watched=50.0)
    assert convicted == 1
    for _ in range(ATTEMPTS_ALONE):
        convicted = blame.died((2,), seconds=5.0, watched=50.0)
    assert convicted == 2


def test_workers_ended_at_random_convict_no_run_however_long_it_takes():
    """Two workers are killed every 2 s each, as they were for 10 s before.

    Of the attempts of a run of 4 s one in seven ends well: twelve are not enough for all.
    """
    chance = np.random.default_rng(3)
    rate, needs, most = 0.5, 4.0, 0
    blame, watched = Blame(), 20.0
    for _ in range(10):
        blame.died(())
    for run in range(300):
        attempts = 0
        while (until := chance.exponential(1 / rate)) < needs:
            attempts += 1
            watched += until
            if attempts >= ATTEMPTS_AT_MOST - 1:
                break  # whoever needs that many is given up by rule, not by the law
            assert blame.died((run,), seconds=until, watched=watched) is None
        watched += needs
        # the other worker, which did other runs meanwhile
        for _ in range(chance.poisson(rate * needs)):
            blame.died((-1 - run, -1000 - run))
        watched += needs
        most = max(most, attempts)
    assert most > 12
    assert CHANCE < 1e-5


def test_a_run_under_which_workers_die_for_ever_is_given_up():
    blame = Blame()
    for _ in range(1000):
        blame.died(())
    verdicts = [blame.died((1,), seconds=60.0, watched=600.0) for _ in range(ATTEMPTS_AT_MOST)]
    assert verdicts == [None] * (ATTEMPTS_AT_MOST - 1) + [1]
