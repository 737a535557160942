"""What the first run of the quickstart on a fresh machine costs beside a later one.

The quickstart is run twice with figures as a user would, on two workers, each time from nothing
but the kernels: the first time there are none. Processor time of all processes.
"""

from __future__ import annotations

import os
from unittest import mock

from tests import cache
from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import cpu_of_children, timed_command

BOUND = 1.9  # half of what it was: 3.8


def run() -> Result:
    """Run the quickstart without kernels, and again with them."""
    took = []
    own = cache.variables(results_folder() / "cold")
    own["NUMBA_CACHE_DIR"] = str(results_folder() / "cold" / "kernels")
    with mock.patch.dict(os.environ, own):
        for name in ("first", "second"):
            before, results = cpu_of_children(), results_folder() / "cold" / name
            study = str(STUDIES / "quickstart.yaml")
            timed_command("run", study, "--workers", "2", "--results", str(results))
            took.append(cpu_of_children() - before)
    ratio = took[0] / took[1]
    return Result(
        f"{ratio:.2f} times a later run",
        f"≤ {BOUND:g} times",
        ratio <= BOUND,
        f"{took[0]:.1f} s of processor time first, {took[1]:.1f} s later",
    )
