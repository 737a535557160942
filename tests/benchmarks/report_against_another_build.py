"""Figures and report of 100, 378 and 1,000 cases in a part of the time of another build.

`DEMFLOW_BASE` names the folder of that build. Each build runs the studies itself, then both draw
in turns, each time in a process of its own. Processor time, the least of the turns: of the whole
command `demflow report` at 100 and 1,000 cases, and of drawing the figures of 378 cases of 10,000
grains, from the dataset to the last file, with what is imported for it. TURNS (of the environment)
makes more or fewer.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from tests.benchmarks.ran import results_folder
from tests.benchmarks.report_in_a_browser import STUDIES, study_text
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT, cpu_of_children, timed_command, timed_run

TURNS = int(os.environ.get("TURNS", "5"))
REPORT, DRAWING = 0.5, 0.3  # at most these parts

TEXTS = {
    "cases-100": STUDIES["cases-100"],
    "cases-1000": STUDIES["cases-1000"],
    "cases-378": study_text("cases-378", 10_000, (7, 9, 6)),
}

_DRAW = """
import sys, time
from pathlib import Path
from PACKAGE import load_study, open_results

study, folder = load_study(Path(sys.argv[1])), Path(sys.argv[2])
dataset = open_results(folder)
begin = time.process_time()
from PACKAGE.figures import write_figures

write_figures(dataset, folder, study)
print(time.process_time() - begin)
"""


class _Build(NamedTuple):
    """One of the two that are compared."""

    root: Path
    folder: Path  # of its studies and results

    def study(self, name: str) -> Path:
        return self.folder / f"{name}.yaml"

    @property
    def results(self) -> Path:
        return self.folder / "results"

    def report(self, name: str) -> float:
        """Seconds of processor of `demflow report`."""
        before = cpu_of_children()
        arguments = ("report", str(self.study(name)), "--results", str(self.results))
        timed_command(*arguments, root=self.root)
        return cpu_of_children() - before

    def draw(self, name: str) -> float:
        """Seconds of processor of drawing its figures."""
        package = "demflow.sweep" if (self.root / "demflow").exists() else "sweep"
        code = _DRAW.replace("PACKAGE", package)
        done = subprocess.run(
            [sys.executable, "-c", code, str(self.study(name)), str(self.results / name)],
            cwd=self.root,
            env={**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(self.root)},
            check=True,
            capture_output=True,
            text=True,
        )
        return float(done.stdout.split()[-1])


def run() -> Result:
    """Run the studies with both builds, and draw in turns."""
    base = os.environ.get("DEMFLOW_BASE")
    if not base:
        return Result("nothing to compare with", "DEMFLOW_BASE to name a build", False)
    builds = [
        _Build(root, results_folder() / name)
        for root, name in ((Path(base).resolve(), "base"), (ROOT, "own"))
    ]
    for build in builds:
        build.folder.mkdir()
        for name, text in TEXTS.items():
            build.study(name).write_text(text)
            timed_run(build.study(name), build.results, root=build.root, workers=2)
    lines, parts, holds = [], [], True
    for name, what, bound in (
        ("cases-100", _Build.report, REPORT),
        ("cases-1000", _Build.report, REPORT),
        ("cases-378", _Build.draw, DRAWING),
    ):
        took: list[list[float]] = [[], []]
        for _ in range(TURNS):
            for build, own in zip(builds, took, strict=True):
                own.append(what(build, name))
        part = min(took[1]) / min(took[0])
        parts.append(f"{part:.2f}")
        holds &= part <= bound
        told = [", ".join(f"{one:.2f}" for one in own) for own in took]
        lines.append(
            f"{name}, {what.__name__}: {told[1]} s of processor; {base}: {told[0]} s; "
            f"{part:.2f} of it, bound {bound}"
        )
    return Result(
        f"{', '.join(parts)} of {base}", f"≤ {REPORT}, {REPORT}, {DRAWING}", holds, "\n".join(lines)
    )
