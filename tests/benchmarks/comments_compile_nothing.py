"""A comment in each of ten modules without kernels compiles nothing in the next quickstart."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.benchmarks.result import Result

ROOT = Path(__file__).parents[2]
MODULES = 10
COMPILED = "from demflow.model.compile import"  # in whatever has kernels

# All cases in one process, whose seconds of compiling are then known.
CASES = """
import itertools, math
from demflow.model import simulate
from demflow.model.compilation import compilation
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import load_study
study = load_study("studies/quickstart.yaml", smoke=True)
for index in itertools.product(*(range(len(axis.values)) for axis in study.axes)):
    simulate(case_at(study, index).scene)
print(compilation.seconds)
"""


def without_kernels(model: Path) -> list[Path]:
    """Ten modules from all rooms of the model that a quickstart imports and that have no kernel."""
    plain = [p for p in sorted(model.rglob("*.py")) if COMPILED not in p.read_text()]
    plain = [p for p in plain if "analytic" not in p.parts and p.stat().st_size > 1000]
    return plain[:: max(1, len(plain) // MODULES)][:MODULES]


def ran(checkout: Path, cache: Path, results: str) -> tuple[float, set[str]]:
    """Seconds of compiling of a quickstart of 16 cases, and the kernels kept after it."""
    environment = {**os.environ, "PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": str(cache)}
    options = {"cwd": checkout, "env": environment, "capture_output": True, "text": True}
    in_process = subprocess.run([sys.executable, "-c", CASES], check=True, **options)
    study = ("run", "studies/quickstart.yaml", "--smoke", "--workers", "2", "--results", results)
    subprocess.run([sys.executable, "-m", "demflow", *study], check=True, **options)
    return float(in_process.stdout), {p.name for p in cache.rglob("*.nbc")}


def run() -> Result:
    """Compile, comment, run again; then change a law, to show that this would be seen."""
    with tempfile.TemporaryDirectory(prefix="demflow-bench-") as folder:
        checkout, cache = Path(folder) / "checkout", Path(folder) / "cache"
        for part in ("demflow", "model", "sweep", "studies"):
            shutil.copytree(ROOT / part, checkout / part, symlinks=True)
        cold, kernels = ran(checkout, cache, "first")
        chosen = without_kernels(checkout / "model")
        for module in chosen:
            text = module.read_text()
            module.write_text(f"# a comment\n{text}\n# and another\n")
        after, kept = ran(checkout, cache, "second")
        law = checkout / "model" / "mechanics" / "contact" / "law" / "linear.py"
        law.write_text(law.read_text().replace("law.kn * un", "law.kn * un * 1.0"))
        changed, _ = ran(checkout, cache, "third")
    new = kept - kernels
    details = "\n".join(
        [
            f"compiling at first: {cold:.1f} s, {len(kernels)} kernels",
            f"commented: {', '.join(str(m.relative_to(checkout)) for m in chosen)}",
            f"compiling then: {after:.3f} s, {len(new)} kernels written",
            f"compiling after a change of the contact law: {changed:.1f} s",
        ]
    )
    holds = len(chosen) == MODULES and cold > 1.0 and after == 0.0 and not new and changed > 0.0
    return Result(f"{after:.3f} s, {len(new)} kernels", "0 s, 0 kernels", holds, details)
