"""What scenes whose grains and fluid are not coupled pay for coupling: no bit, and no time.

Every shipped study at the size of its smoke block, all its cases that are not coupled, stage by
stage in one process. This build: none of the modules of `model/coupling` is imported, but for what
the table of stages names of it (`told`). Beside the build that lies at `DEMFLOW_BASE`, one from
before coupling was there: studies that both ship with the same text are run by both in turns. A
stage that has the same version in both, as have all before it, gives the same bits, or numbers that
are round-off apart, which are counted: sums in another order, kernels compiled in other parts. The
processor time of all stages together is at most 1.02 times as long, the least of some turns
counting for each stage run. Stages whose version was raised since, or that of one before them, and
those that are told otherwise what to do, are counted apart: the changelog says what moved.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT

MOST, TURNS = 1.02, int(os.environ.get("TURNS", "7"))
ROUND_OFF = 1e-14  # of the largest number of a field
NEEDED = ("demflow.model.coupling", "demflow.model.coupling.told")

# One build, which knows only what both have: each line in names a study and a file, into which go
# its stage runs (of which case first, versions with those of what went before, what it was told,
# product, processor time); each line out tells which modules of coupling are loaded by then.
PROGRAM = """
import itertools, pickle, sys, time
import numpy as np
from demflow.model.outcome import ModelError
from demflow.model.stages import STAGES
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import load_study

def plain(value):
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, (tuple, list)):
        return {k: plain(one) for k, one in enumerate(value)}
    if hasattr(value, "tocsr"):
        value = value.tocsr()
        return plain([value.data, value.indices, value.indptr])
    return np.asarray(value) if np.asarray(value).dtype != object else repr(value)

def runs(study):
    made = {}
    for case, index in enumerate(itertools.product(*map(range, study.shape))):
        scene, keys, versions = case_at(study, index).scene, {}, {}
        if getattr(scene, "coupled", False):
            continue
        for stage in STAGES:
            if not stage.wanted(scene):
                continue
            given = stage.given(scene)
            key = (stage.name, *(keys.get(p) for p in stage.parents), pickle.dumps(given))
            keys[stage.name] = key
            before = {v for p in stage.parents if p in versions for v in versions[p]}
            versions[stage.name] = before | {(stage.name, stage.version)}
            if key in made:
                continue
            began = time.process_time()
            try:
                product = stage.run(*(made.get(keys.get(p)) for p in stage.parents), **given)
            except ModelError:
                break
            took = time.process_time() - began
            made[key] = product
            yield (case, stage.name), (versions[stage.name], repr(given), plain(product), took)

for line in sys.stdin:
    path, file = line.split()
    with open(file, "wb") as into:
        pickle.dump(dict(runs(load_study(path, smoke=True))), into)
    print(*(m for m in sorted(sys.modules) if m.startswith("demflow.model.coupling")), flush=True)
"""


class Run(NamedTuple):
    """One run of a stage."""

    versions: set[tuple[str, int]]  # of the stage and of all before it
    told: str  # what it was told of the scene
    product: Any  # arrays and words in dictionaries
    seconds: float  # of processor time


class Build:
    """A process of one build, which runs studies."""

    def __init__(self, root: Path) -> None:
        one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(root)}
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM],
            cwd=root,
            env={**os.environ, **one},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.loaded: list[str] = []  # modules of coupling

    def ran(self, study: Path) -> dict[tuple[int, str], Run]:
        """Its stage runs, by the case that asked first and the stage."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        file = results_folder() / "runs.pickle"
        self._process.stdin.write(f"{study} {file}\n")
        self._process.stdin.flush()
        self.loaded = self._process.stdout.readline().split()
        return {key: Run(*one) for key, one in pickle.loads(file.read_bytes()).items()}

    def end(self) -> None:
        """Let the process go."""
        self._process.communicate()


def apart(a: Any, b: Any) -> float:
    """How far two products differ: 0 for the same bits, else relative to a field's largest number.

    Fields that one of them has not are not compared; infinite where words or shapes differ.
    """
    if isinstance(a, dict) and isinstance(b, dict):
        return max((apart(a[name], b[name]) for name in a.keys() & b.keys()), default=0.0)
    if isinstance(a, str) or isinstance(b, str):
        return 0.0 if a == b else np.inf
    if a.dtype != b.dtype or a.shape != b.shape:
        return np.inf
    if a.tobytes() == b.tobytes():
        return 0.0
    if a.dtype.kind not in "fc" or not np.array_equal(np.isfinite(a), np.isfinite(b)):
        return np.inf
    known = np.isfinite(a)
    off = np.abs(a[known] - b[known]).max(initial=0.0)
    return float(off / max(np.abs(a[known]).max(initial=0.0), 1e-300))


def alone() -> tuple[int, list[str]]:
    """Stage runs of all shipped studies, and modules of coupling that they imported."""
    build = Build(ROOT)
    count = sum(len(build.ran(path)) for path in sorted(STUDIES.glob("*.yaml")))
    build.end()
    return count, [name for name in build.loaded if name not in NEEDED]


def beside(base: Path) -> tuple[Counter[str], float, list[str]]:
    """How stage runs compare with those of another build, and the processor time over its."""
    builds = Build(base), Build(ROOT)
    seen, lines, spent = Counter[str](), [], np.zeros(2)
    for path in sorted(STUDIES.glob("*.yaml")):
        other = base / "studies" / path.name
        if not other.exists() or other.read_text() != path.read_text():
            continue
        turns = [tuple(build.ran(path) for build in builds) for _ in range(TURNS + 1)]
        before, now = turns[0]
        both = sorted(before.keys() & now.keys())
        for key in both:
            off = apart(before[key].product, now[key].product)
            kind = "same bits" if off == 0.0 else "round-off" if off <= ROUND_OFF else "other"
            if kind != "same bits" and before[key].versions != now[key].versions:
                moved = sorted(stage for stage, _ in before[key].versions ^ now[key].versions)
                kind = f"version of {', '.join(sorted(set(moved)))} raised"
            if kind == "other":
                lines.append(f"{path.name}, case {key[0]}, {key[1]}: {off:.1e} apart")
                if before[key].told != now[key].told:
                    kind = "told otherwise"
                    lines += [f"  told {one[key].told}" for one in (before, now)]
            seen[kind] += 1
        least = [[min(t[k][key].seconds for t in turns[1:]) for key in both] for k in range(2)]
        took = np.array(least).sum(axis=1)
        spent += took
        lines.append(f"{path.name}: {len(both)} stage runs, {took[0]:.3f} and {took[1]:.3f} s")
    for build in builds:
        build.end()
    lines += [f"{kind}: {count}" for kind, count in seen.most_common()]
    return seen, float(spent[1] / spent[0]), lines


def run() -> Result:
    """Run the studies by this build, then by turns beside another one."""
    count, beyond = alone()
    figure, bound = f"{count} stage runs, {len(beyond)} modules of coupling imported", "0 modules"
    base = os.environ.get("DEMFLOW_BASE")
    if base is None:
        told = f"{figure}; no build to compare with (DEMFLOW_BASE)"
        return Result(told, bound, False, "\n".join(beyond))
    seen, ratio, lines = beside(Path(base))
    raised = seen.total() - seen["same bits"] - seen["round-off"] - seen["other"]
    return Result(
        f"{figure}; of {seen.total()} beside another build {seen['same bits']} the same bits, "
        f"{seen['round-off']} round-off apart, {raised} of a raised version or told otherwise, "
        f"{seen['other']} other; {ratio:.2f} of its processor time",
        f"{bound}; none other; ≤ {MOST:g}",
        not beyond and not seen["other"] and seen["same bits"] > 0 and ratio <= MOST,
        "\n".join([*beyond, *lines]),
    )
