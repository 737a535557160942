"""A step with friction and history against Yade's CundallStrack, 5,000 discs, one thread each."""

from __future__ import annotations

from tests.benchmarks.result import Result
from tests.benchmarks.steps import against_yade


def run() -> Result:
    """Ours is a real run towards 2:1, Yade's a periodic packing at rest."""
    return against_yade(5_000, None, 0.1)
