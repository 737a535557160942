"""Whom to blame for a dead worker: a stage run, or something outside. No Dask, no files.

A worker may be ended from outside, by an administrator or by a machine whose memory is full,
and nobody says so. Runs under which a worker died are tried again, each alone on a worker. A
run is blamed once the deaths of the workers that it was alone on are beyond chance: workers
that are ended from outside at a rate λ die k times or more in a time T with the probability

    P(N ≥ k) = 1 - Σ_{j<k} e^{-μ} μ^j / j! = γ(k, μ) / Γ(k),   μ = λ T

(Poisson). λ is the rate at which workers died without this run. Where none did in the rest T of
the time, λ is known to be small only, with a density T e^{-λT}; then

    P(N ≥ k) = (t / (t + T))^k

for a run that was alone for a time t. A run that takes long is not tried as often as that.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection

ATTEMPTS_ALONE = 2  # deaths of a worker, with nothing else on it, that convict a run at least
ATTEMPTS_QUICK = 3  # the same of one that took less than `PATIENCE` away: coincidence is too easy
ATTEMPTS_AT_MOST = 50  # that convict it though workers die everywhere: it would never end
CHANCE = 1e-6  # of being blamed for what came from outside
PATIENCE = 5.0  # s that a run may take away with it where no other worker dies


class Blame:
    """The deaths of one execution."""

    def __init__(self) -> None:
        self.deaths: Counter[int] = Counter()  # of workers that had nothing else on them, by run
        self._seconds: defaultdict[int, float] = defaultdict(float)  # until these, added up
        self._unexplained: list[frozenset[int]] = []  # runs under which a worker died

    def died(
        self, runs: Collection[int], *, seconds: float = 0.0, watched: float = 0.0
    ) -> int | None:
        """A worker died. Return the run to blame, None while it is unknown.

        Parameters
        ----------
        runs : what was left of its lot.
        seconds : since it began with that, s.
        watched : for which all workers together have stood so far, s.
        """
        if len(runs) == 1:
            (run,) = runs
            self.deaths[run] += 1
            self._seconds[run] += seconds
            if self._convicts(run, watched):
                self._unexplained = [aboard for aboard in self._unexplained if run not in aboard]
                return run
        self._unexplained.append(frozenset(runs))
        return None

    def _convicts(self, run: int, watched: float) -> bool:
        count, seconds = self.deaths[run], self._seconds[run]
        elsewhere = sum(run not in aboard for aboard in self._unexplained)
        if count < (ATTEMPTS_ALONE if seconds >= PATIENCE else ATTEMPTS_QUICK):
            return False
        if count >= ATTEMPTS_AT_MOST:
            return True
        if elsewhere:
            mean = elsewhere * seconds / watched if watched else math.inf
            return by_chance(count, mean) < CHANCE
        return seconds >= PATIENCE or (seconds / watched if watched else 0.0) ** count < CHANCE


def by_chance(count: int, mean: float) -> float:
    """P(N ≥ count) of a Poisson law of the given mean."""
    from scipy.special import gammainc  # 10 MB, for runs whose workers die

    return float(gammainc(count, mean))
