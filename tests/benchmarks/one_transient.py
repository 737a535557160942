"""What one case takes once its rock is packed: its pipes opened, its transient found.

Two sets of fractures in 5,000 and 17,000 pores at 1e-4, stages *open* and *flow* together, least
processor time of several runs in one process each. `DEMFLOW_BASE` names the folder of another
build, whose processes take turns with ours: there traces cut the pipes in *open*, here they have
nodes of their own in *flow*. What joins the wells to the rock, which cases share that differ in
traces alone, is found anew each time. What rock without fractures takes is told beside; there the
place of a well between pores is solved for, which the base took for the middle of one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.benchmarks.emulated_apertures import STUDY
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result, at_most
from tests.benchmarks.sweeps import ROOT

GRAINS, ROUNDS, BOUND = (2500, 8500), 3, 0.65

_CHILD = """
import json, sys, time
if sys.argv[2] == "demflow":
    from demflow.sweep.prepared import prepare
    from demflow.sweep.plan.table import stage_table
else:
    from sweep.prepared import prepare
    from sweep.stages import stage_table
prepared = prepare(sys.argv[1], sys.argv[1] + ".results")
plan, scene, made, took = prepared.plan, prepared.scene_of(0), {}, 0.0
for number, run in enumerate(plan.runs):
    stage = plan.stage_of(number)
    if stage.name == "observe":
        continue
    if hasattr(stage, "given"):
        reads = stage.given(scene, run.leg)
    else:
        reads = {name: read(scene) for name, read in stage.reads.items()}
    parents = [made[plan.runs[k].id] if k >= 0 else None for k in run.parents]
    spent = []
    for _ in range(8 if stage.name in ("open", "flow") else 1):
        system = sys.modules.get("demflow.model.flow.equation.system")
        if hasattr(system, "_kept_wells"):
            system._kept_wells.clear()
        begin = time.process_time()
        made[run.id] = stage.run(*parents, **reads)
        spent.append(time.process_time() - begin)
    took += min(spent) if len(spent) > 1 else 0.0
print(json.dumps(took))
"""


def run() -> Result:
    """Worst ratio over sizes."""
    base = os.environ.get("DEMFLOW_BASE")
    if not base:
        return Result("not measured", f"≤ {BOUND}", False, "set DEMFLOW_BASE")
    worst, lines = 0.0, []
    for grains in GRAINS:
        for fractured in (True, False):
            study = _study(grains, fractured)
            took: dict[Path, list[float]] = {Path(base).resolve(): [], ROOT: []}
            for _ in range(ROUNDS):
                for root, seconds in took.items():
                    seconds.append(_seconds(study, root))
            theirs, ours = (1e3 * min(seconds) for seconds in took.values())
            rock = "two sets" if fractured else "no fracture"
            lines.append(f"{grains} grains, {rock}: {ours:.1f} ms against {theirs:.1f} ms")
            worst = max(worst, ours / theirs) if fractured else worst
    return at_most(worst, BOUND, "of the other build's time", "\n".join(lines))


def _study(grains: int, fractured: bool) -> Path:
    """One case of the family of two apertures, or its rock alone."""
    head, rest = STUDY.split("vary:")
    if not fractured:
        head = "\n".join(line for line in head.splitlines() if "kind: set" not in line)
        head = head.replace("  fractures:\n", "") + "\n"
    text = head + "observe" + rest.split("observe")[1]
    name = f"transient_{grains}_{'sets' if fractured else 'rock'}"
    path = results_folder() / f"{name}.yaml"
    text = text.replace("METHOD", "krylov").replace("NAME", name).replace("COUNT", str(grains))
    path.write_text(text)
    return path


def _seconds(study: Path, root: Path) -> float:
    """Processor time of *open* and *flow* by the build that lies at `root`."""
    package = "demflow" if (root / "demflow").exists() else "other"
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, str(study), package],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"},
        check=True,
        capture_output=True,
        text=True,
    )
    return float(json.loads(done.stdout))
