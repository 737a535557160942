"""Two workers do an ensemble of packings in little more than half the time of one.

Side by side in turn, from the first job to the last answer; a machine with less than two
free cores falls short here by its load.
"""

from __future__ import annotations

import numpy as np

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import FOUR_AXES, timed_run

SEEDS, GRAINS, BOUND, REPEATS = 24, 600, 1.8, 2


def run() -> Result:
    """Run the same ensemble on one and on two workers, and compare medians."""
    folder = results_folder()
    text = FOUR_AXES.format(
        name="ensemble", grains=GRAINS, angles=1, apertures=1, stresses=1, rates=[1e-5]
    )
    head, _, _ = text.partition("vary:")
    seeds = list(range(1, SEEDS + 1))
    vary = f"vary:\n  seed: {{parameter: grains.seed, values: {seeds}}}\n"
    path = folder / "ensemble.yaml"
    path.write_text(f"{head}{vary}observe: [well_pressure]\n")
    seconds: dict[int, list[float]] = {1: [], 2: []}
    for repeat in range(REPEATS):
        for workers, taken in seconds.items():
            taken.append(
                timed_run(path, folder / f"ensemble-{workers}-{repeat}", workers=workers).seconds
            )
    one, two = (float(np.median(seconds[workers])) for workers in (1, 2))
    lines = [
        f"{workers} worker(s): {', '.join(f'{s:.1f}' for s in taken)} s"
        for workers, taken in seconds.items()
    ]
    return Result(
        f"{one / two:.2f} times faster", f"≥ {BOUND}", one / two >= BOUND, "\n".join(lines)
    )
