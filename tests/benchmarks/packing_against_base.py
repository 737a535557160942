"""What it takes to pack 5,000 and 20,000 grains to equilibrium, beside another build.

Stage *pack* alone, with floaters fitted, kernels compiled; least processor time of several runs,
the processes of both builds taking turns. `DEMFLOW_BASE` names the folder of the other one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.benchmarks.result import Result, at_most
from tests.benchmarks.sweeps import ROOT

SIZES, POROSITIES, ROUNDS, BOUND = (5000, 20_000), (0.165, 0.18), 3, 0.6

_CHILD = """
import json, sys, time
from PACKAGEmodel.region import Rectangle
from PACKAGEmodel.stages import pack

def took(count, porosity):
    begin = time.process_time()
    made = pack(
        region=Rectangle(10.0, 10.0), count=count, mean_radius=None, packing="random",
        radius_ratio=1.66, porosity=porosity, seed=1, floaters="fit",
    )
    return time.process_time() - begin, int(made.steps)

took(300, 0.165)
print(json.dumps(took(int(sys.argv[1]), float(sys.argv[2]))))
"""


def run() -> Result:
    """Worst ratio over sizes and porosities."""
    base = os.environ.get("DEMFLOW_BASE")
    if not base:
        return Result("not measured", f"≤ {BOUND}", False, "set DEMFLOW_BASE")
    worst, lines = 0.0, []
    for count in SIZES:
        ours = theirs = 0.0
        for porosity in POROSITIES:
            found = [
                [_packed(root, count, porosity) for root in (Path(base).resolve(), ROOT)]
                for _ in range(ROUNDS)
            ]
            (before, steps), (now, own) = (min(runs) for runs in zip(*found, strict=True))
            ours, theirs = ours + now, theirs + before
            lines.append(
                f"{count} grains at {porosity}: {now:.2f} s of processor in {own} steps against "
                f"{before:.2f} s in {steps}"
            )
        worst = max(worst, ours / theirs)
    return at_most(worst, BOUND, "of the other build's time", "\n".join(lines))


def _packed(root: Path, count: int, porosity: float) -> tuple[float, int]:
    """Processor time and steps of one packing by the build that lies at `root`."""
    package = "demflow." if (root / "demflow").exists() else ""
    done = subprocess.run(
        [sys.executable, "-c", _CHILD.replace("PACKAGE", package), str(count), str(porosity)],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        check=True,
        capture_output=True,
        text=True,
    )
    seconds, steps = json.loads(done.stdout)
    return seconds, steps
