"""Four times the grains need hardly more steps to equilibrium at 2:1."""

from __future__ import annotations

from demflow.model.scene import Bonds, Stress
from tests.benchmarks.result import Result, at_most
from tests.benchmarks.specimens import CEMENTS, loaded, packed

LOADS: tuple[tuple[str, Bonds | None, Stress], ...] = (
    ("bonded 2:1", CEMENTS["parallel bonds"], Stress(xx=16e6, yy=8e6, method="explicit")),
    ("unbonded 2:1", None, Stress(xx=16e6, yy=8e6)),
)


def run() -> Result:
    """Worst ratio of steps, 20,000 grains over 5,000."""
    worst, lines = 0.0, []
    for name, bonds, target in LOADS:
        few, many = (
            int(loaded(packed(count, floaters="leave"), target, bonds)[0].steps)
            for count in (5000, 20_000)
        )
        worst = max(worst, many / few)
        lines.append(f"{name}: {few} steps at 5,000 grains, {many} at 20,000")
    return at_most(worst, 1.3, "ratio of steps", "\n".join(lines))
