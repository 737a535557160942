"""Whom to blame for a dead worker: a stage run, or something outside. No Dask, no files.

A worker may be ended from outside, by an administrator or by a machine whose memory is full,
and nobody says so. Runs under which a worker died are tried again, each alone on a worker. A
run is blamed once the deaths of the workers that it was alone on are beyond chance: workers
that are ended from outside at a rate λ die k times or more in a time T with the probability

    P(N ≥ k) = 1 - Σ_{j<k} e^{-μ} μ^j / j!,   μ = λ T

(Poisson). λ is the rate at which workers died without this run; where none did, the second
death alone convicts.
"""

from __future__ import annotations

import math
from collections.abc import Collection

ATTEMPTS_ALONE = 2  # deaths of a worker, with nothing else on it, that convict a run at least
ATTEMPTS_AT_MOST = 50  # that convict it though workers die everywhere: it would never end
CHANCE = 1e-6  # of being blamed for what came from outside


class Blame:
    """The deaths of one execution."""

    def __init__(self) -> None:
        self.deaths: dict[int, int] = {}  # of workers that had nothing else on them, by run
        self._seconds: dict[int, float] = {}  # until these deaths, added up, by run
        self._unexplained: list[frozenset[int]] = []  # runs under which a worker died

    def died(
        self, runs: Collection[int], *, alone: bool, seconds: float = 0.0, watched: float = 0.0
    ) -> int | None:
        """A worker died. Return the run to blame, None while it is unknown.

        Parameters
        ----------
        runs : what it was at, or was to do next.
        alone : whether nothing else waited there.
        seconds : since it began with them, s.
        watched : for which all workers together have stood so far, s.
        """
        if alone and len(runs) == 1:
            (run,) = runs
            self.deaths[run] = self.deaths.get(run, 0) + 1
            self._seconds[run] = self._seconds.get(run, 0.0) + seconds
            if self._convicts(run, watched):
                self._unexplained = [aboard for aboard in self._unexplained if run not in aboard]
                return run
        self._unexplained.append(frozenset(runs))
        return None

    def _convicts(self, run: int, watched: float) -> bool:
        count, elsewhere = self.deaths[run], sum(run not in a for a in self._unexplained)
        if count < ATTEMPTS_ALONE or not elsewhere:
            return count >= ATTEMPTS_ALONE
        if count >= ATTEMPTS_AT_MOST:
            return True
        mean = elsewhere * self._seconds[run] / watched if watched else math.inf
        return by_chance(count, mean) < CHANCE


def by_chance(count: int, mean: float) -> float:
    """P(N ≥ count) of a Poisson law of the given mean."""
    if math.isinf(mean):
        return 1.0
    term, below = math.exp(-mean), 0.0
    for j in range(count):
        below += term
        term *= mean / (j + 1)
    return max(0.0, 1.0 - below)
