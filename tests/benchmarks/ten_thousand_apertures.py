"""10,240 samples of `uncertain_apertures` on two workers: time, and memory of all processes."""

from __future__ import annotations

import resource

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT, timed_run

SECONDS, GIGABYTES = 120.0, 2.0


def run() -> Result:
    """Run the study as it is shipped."""
    took = timed_run(
        ROOT / "studies" / "uncertain_apertures.yaml", results_folder() / "samples", workers=2
    )
    largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
    memory = 3 * largest  # of each of three processes at most
    return Result(
        f"{took.seconds:.0f} s, at most {memory:.2f} GB",
        f"< {SECONDS:g} s, < {GIGABYTES:g} GB",
        took.seconds < SECONDS and memory < GIGABYTES and took.failed == 0,
        f"{took.computed} stage runs, {took.cpu:.0f} s of processor, {took.failed} cases failed",
    )
