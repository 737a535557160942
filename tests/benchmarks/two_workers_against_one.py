"""Two workers do an ensemble of packings in little more than half the time of one.

Side by side in turn, from the call to the dataset. Beside it stands what the machine itself
gives: two such runs of one worker each at the same time, against one alone. Two cores of a
shared host, or of one that lowers its clock when both are busy, are less than twice one.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import FOUR_AXES, timed_run

SEEDS, GRAINS, BOUND, REPEATS = 24, 600, 1.8, 2


def run() -> Result:
    """Run the same ensemble on one and on two workers, and compare medians."""
    folder = results_folder()
    path = ensemble(folder)
    seconds: dict[str, list[float]] = {}

    def timed(name: str, workers: int) -> float:
        return timed_run(path, folder / f"ensemble-{name}", workers=workers).seconds

    with ThreadPoolExecutor(2) as both:
        for repeat in range(REPEATS):
            one = timed(f"one-{repeat}", 1)
            two = timed(f"two-{repeat}", 2)
            pair = max(both.map(timed, [f"a-{repeat}", f"b-{repeat}"], [1, 1]))
            for name, taken in (("1 worker", one), ("2 workers", two), ("2 runs at once", pair)):
                seconds.setdefault(name, []).append(taken)
    one, two, pair = (float(np.median(taken)) for taken in seconds.values())
    lines = [f"{name}: {', '.join(f'{s:.1f}' for s in taken)} s" for name, taken in seconds.items()]
    lines.append(f"two runs at once do {2 * one / pair:.2f} times what one does in the same time")
    return Result(
        f"{one / two:.2f} times faster (the machine gives {2 * one / pair:.2f})",
        f"≥ {BOUND}",
        one / two >= BOUND,
        "\n".join(lines),
    )


def ensemble(folder: Path) -> Path:
    """Write a study of packings that share nothing."""
    text = FOUR_AXES.format(
        name="ensemble", grains=GRAINS, angles=1, apertures=1, stresses=1, rates=[1e-5]
    )
    seeds = list(range(1, SEEDS + 1))
    vary = f"vary:\n  seed: {{parameter: grains.seed, values: {seeds}}}\n"
    path = folder / "ensemble.yaml"
    path.write_text(f"{text.partition('vary:')[0]}{vary}observe: [well_pressure]\n")
    return path
