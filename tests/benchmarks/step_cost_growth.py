"""How the cost of a step per disc grows from 1,000 to 200,000 discs, in real runs."""

from __future__ import annotations

from tests.benchmarks.result import Result, at_most
from tests.benchmarks.steps import our_steps, rock

SIZES = (1_000, 5_000, 50_000, 200_000)
BOUND = 1.7


def run() -> Result:
    """Best of several runs at each size."""
    found = {}
    for size in SIZES:
        packing = rock(size)
        found[len(packing.x)] = min(our_steps(packing, None)[0])
    lines = "\n".join(f"{n} discs: {t:.1f} ns per disc and step" for n, t in found.items())
    times = list(found.values())
    return at_most(times[-1] / times[0], BOUND, "growth", lines)
