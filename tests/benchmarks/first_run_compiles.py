"""What the first run of the quickstart on a fresh machine costs beside a later one.

The quickstart is run twice with figures as a user would, on two workers, each time from nothing
but the kernels: the first time there are none. Processor time of all processes. `DEMFLOW_BASE` may
name the folder of another build, whose quickstart is run likewise just before: half of its ratio
is then the bound.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple
from unittest import mock

from tests import cache
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT, cpu_of_children, timed_command

BOUND = 1.9  # half of what it was: 3.8
PART = 0.5  # of the ratio of another build


class Took(NamedTuple):
    """Processor time of two runs, s."""

    first: float
    later: float

    @property
    def ratio(self) -> float:
        """How many times a later run the first one takes."""
        return self.first / self.later

    def __str__(self) -> str:
        return f"{self.first:.1f} s of processor time first, {self.later:.1f} s later"


def run() -> Result:
    """Run the quickstart without kernels, and again with them."""
    base = os.environ.get("DEMFLOW_BASE")
    other = measured(Path(base).resolve()) if base else None
    took = measured(ROOT)
    bound = PART * other.ratio if other else BOUND
    lines = [f"{base}: {other}, {other.ratio:.2f} times", str(took)] if other else [str(took)]
    return Result(
        f"{took.ratio:.2f} times a later run",
        f"≤ {bound:.3g} times",
        took.ratio <= bound,
        "\n".join(lines),
    )


def measured(root: Path) -> Took:
    """What both runs take with the build that lies at `root`."""
    folder, took = results_folder() / f"cold_{root.name}", []
    own = cache.variables(folder)
    own["NUMBA_CACHE_DIR"] = str(folder / "kernels")
    study = str(root / "studies" / "quickstart.yaml")
    with mock.patch.dict(os.environ, own):
        for name in ("first", "second"):
            before, results = cpu_of_children(), str(folder / name)
            timed_command("run", study, "--workers", "2", "--results", results, root=root)
            took.append(cpu_of_children() - before)
    return Took(*took)
