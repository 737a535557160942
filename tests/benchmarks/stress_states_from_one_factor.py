"""A further stress state of a bonded rock costs little beside its explicit run, and is the same."""

from __future__ import annotations

import statistics

from model.scene import Stress
from tests.benchmarks.result import Result
from tests.benchmarks.specimens import difference, loaded, packed, responses

STATES = ((26e6, 24e6, 1e-3), (25e6, 27e6, 1e-3), (28e6, 25e6, 1e-4), (22e6, 24e6, 1e-4))
TIMES, FORCES = 100.0, 1e-3


def run() -> Result:
    """Ratio of times and difference of forces at 5,000 and 20,000 grains."""
    ratios, differences, lines = [], [], []
    for count in (5000, 20_000):
        rock, units = packed(count), responses(count)
        loaded(rock, Stress(xx=25e6, yy=25e6), units)  # compiles
        for xx, yy, tolerance in STATES:
            found, seconds = loaded(
                rock, Stress(xx=xx, yy=yy, method="static", tolerance=tolerance), units
            )
            reference, explicit = loaded(
                rock, Stress(xx=xx, yy=yy, method="explicit", tolerance=1e-4)
            )
            apart = difference(found, reference)
            ratios.append(explicit / seconds)
            differences.append(apart)
            lines.append(
                f"{count:6} grains {xx / 1e6:.0f}:{yy / 1e6:.0f} MPa: explicit {explicit:.3f} s, "
                f"static {1e3 * seconds:.1f} ms ({int(found.steps)} corrections, unbalance "
                f"{float(found.unbalanced_ratio):.1e}), {explicit / seconds:.0f} times faster, "
                f"forces {apart:.2%} apart"
            )
    ratio, worst = statistics.median(ratios), max(differences)
    return Result(
        f"{ratio:.0f} times faster in the median, forces {worst:.2%} apart at most",
        f"≥ {TIMES:.0f} times, ≤ {FORCES:.1%}",
        ratio >= TIMES and worst <= FORCES,
        "\n".join(lines),
    )
