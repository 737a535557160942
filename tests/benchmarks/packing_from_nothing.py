"""Packings of 5,000 and 20,000 grains: wanted porosity, few floaters, few steps."""

from __future__ import annotations

import time

from tests.benchmarks.result import Result
from tests.benchmarks.specimens import packed

POROSITY, FLOATERS, STEPS = 0.003, 0.01, 8000


def run() -> Result:
    """Worst over sizes and porosities."""
    packed(300)  # compiles
    miss = floating = steps = 0.0
    lines = []
    for count in (5000, 20_000):
        for wanted in (0.165, 0.18):
            start = time.process_time()
            rock = packed(count, porosity=wanted)
            seconds = time.process_time() - start
            part = float(rock.floaters) / len(rock.x)
            miss = max(miss, abs(float(rock.porosity) - wanted))
            floating, steps = max(floating, part), max(steps, float(rock.steps))
            lines.append(
                f"{len(rock.x):6} grains: porosity {float(rock.porosity):.4f} for {wanted}, "
                f"floaters {part:.2%}, z {float(rock.coordination):.2f}, {int(rock.steps)} steps, "
                f"{seconds:.1f} s"
            )
    return Result(
        f"porosity within {miss:.4f}, floaters {floating:.2%}, {steps:.0f} steps",
        f"≤ {POROSITY}, ≤ {FLOATERS:.0%}, ≤ {STEPS}",
        miss <= POROSITY and floating <= FLOATERS and steps <= STEPS,
        "\n".join(lines),
    )
