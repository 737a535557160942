"""A step of parallel-bonded discs against Yade's CohFrict with moments, 5,000 discs."""

from __future__ import annotations

from demflow.model.scene import Bonds
from tests.benchmarks.result import Result
from tests.benchmarks.steps import against_yade


def run() -> Result:
    """Ours is a real run towards 2:1, Yade's a periodic packing at rest; one thread each."""
    strong = Bonds(kind="parallel", tensile_strength=1e12, shear_strength=1e12)
    return against_yade(5_000, strong, 0.125)
