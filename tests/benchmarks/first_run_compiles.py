"""What the first run of the quickstart on a fresh machine costs beside another build.

The quickstart is run twice with figures as a user would, on two workers, each time from nothing
but the kernels: the first time there are none. Processor time of all processes, the least of some
rounds in which both builds take turns. `DEMFLOW_BASE` names the folder of the other build; without
it the first run is held against the later one.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import NamedTuple
from unittest import mock

from tests import cache
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result, at_most
from tests.benchmarks.sweeps import ROOT, cpu_of_children, timed_command

ROUNDS = 3
BOUND = 0.5  # of the other build's first run
WITHIN = 4.0  # later runs, where there is no other build


class Took(NamedTuple):
    """Processor time of two runs, s."""

    first: float
    later: float

    def __str__(self) -> str:
        return f"{self.first:.1f} s of processor time first, {self.later:.1f} s later"


def run() -> Result:
    """Run the quickstart without kernels, and again with them."""
    base = os.environ.get("DEMFLOW_BASE")
    if not base:
        ours = measured(ROOT)
        return at_most(ours.first / ours.later, WITHIN, "later runs", str(ours))
    rounds = [(measured(Path(base).resolve()), measured(ROOT)) for _ in range(ROUNDS)]
    lines = [f"{theirs}; here {ours}" for theirs, ours in rounds]
    least_theirs, least = (min(took.first for took in side) for side in zip(*rounds, strict=True))
    return at_most(least / least_theirs, BOUND, "part of the other build's time", "\n".join(lines))


def measured(root: Path) -> Took:
    """What both runs take with the build that lies at `root`."""
    folder, took = results_folder() / f"cold_{root.name}", []
    shutil.rmtree(folder, ignore_errors=True)  # of the round before
    own = cache.variables(folder)
    own["NUMBA_CACHE_DIR"] = str(folder / "kernels")
    study = str(root / "studies" / "quickstart.yaml")
    with mock.patch.dict(os.environ, own):
        for name in ("first", "second"):
            before, results = cpu_of_children(), str(folder / name)
            timed_command("run", study, "--workers", "2", "--results", results, root=root)
            took.append(cpu_of_children() - before)
    return Took(*took)
