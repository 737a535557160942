"""Two workers do an ensemble of packings in little more than half the time of one.

Side by side, from the call to the dataset; the run of one worker between two of two, since a
shared host is now fast and now slow. Beside it stands what the machine itself gives: two such
runs of one worker each at the same time, against one alone. Two cores of a shared host, or of
one that lowers its clock when both are busy, are less than twice one.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import FOUR_AXES, timed_run

SEEDS, GRAINS, BOUND = 128, 1500, 1.8  # about a minute: starting the workers is a small part


def run() -> Result:
    """Run the same ensemble on two workers, on one, on two, and twice at once on one each."""
    folder = results_folder()
    timed_run(ensemble(folder, 2), folder / "warm", workers=1)  # compiles
    path = ensemble(folder, SEEDS)

    def timed(name: str, workers: int) -> float:
        return timed_run(path, folder / f"ensemble-{name}", workers=workers).seconds

    before, one, after = timed("before", 2), timed("one", 1), timed("after", 2)
    two = (before + after) / 2
    with ThreadPoolExecutor(2) as both:
        pair = max(both.map(timed, ("first", "second"), (1, 1)))
    lines = [
        f"{SEEDS} packings: 1 worker {one:.1f} s, 2 workers {before:.1f} and {after:.1f} s",
        f"two runs at once, of one worker each: {pair:.1f} s",
    ]
    return Result(
        f"{one / two:.2f} times faster (the machine gives {2 * one / pair:.2f})",
        f"≥ {BOUND}",
        one / two >= BOUND,
        "\n".join(lines),
    )


def ensemble(folder: Path, count: int) -> Path:
    """Write a study of packings that share nothing."""
    text = FOUR_AXES.format(
        name="ensemble", grains=GRAINS, angles=1, apertures=1, stresses=1, rates=[1e-5]
    )
    seeds = list(range(1, count + 1))
    vary = f"vary:\n  seed: {{parameter: grains.seed, values: {seeds}}}\n"
    path = folder / "ensemble.yaml"
    path.write_text(f"{text.partition('vary:')[0]}{vary}observe: [well_pressure]\n")
    return path
