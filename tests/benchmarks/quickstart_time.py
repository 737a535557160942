"""The quickstart runs in under a minute on two cores, and a second run computes nothing."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time

from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result


def timed(folder: str) -> tuple[float, str]:
    """Seconds and messages of one run as a whole process."""
    start = time.perf_counter()
    command = [
        sys.executable,
        "-m",
        "demflow",
        "run",
        str(STUDIES / "quickstart.yaml"),
    ]
    done = subprocess.run(
        [*command, "--workers", "2", "--results", folder],
        capture_output=True,
        text=True,
        check=True,
    )
    return time.perf_counter() - start, done.stdout + done.stderr


def run() -> Result:
    """Seconds of the first and the second run; kernels are compiled by a run before."""
    folder = results_folder() / "timed"
    timed(str(folder))
    shutil.rmtree(folder)
    first, _ = timed(str(folder))
    second, said = timed(str(folder))
    return Result(
        f"{first:.1f} s, second run {second:.1f} s",
        "≤ 60 s, ≤ 5 s and nothing computed",
        first <= 60 and second <= 5 and "nothing was computed" in said,
        said,
    )
