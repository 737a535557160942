"""Sweeps that several checks run, and what a run of one takes."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from tests.benchmarks.ran import results_folder

ROOT = Path(__file__).parents[2]
TOYS = "tests.sweep.toy_stages:STAGES"  # stages of a few lines: what they take is overhead
ANGLES, APERTURES, STRESSES, RATES = 5, 4, 4, 5

FOUR_AXES = """
study: {name}
title: Four axes
scene:
  region: {{shape: circle, radius: 14 m}}
  grains: {{count: {grains}, porosity: 0.16, seed: 1, modulus: 20 GPa, stiffness_ratio: 2.5}}
  bonds: {{kind: parallel, tensile_strength: 10 MPa, shear_strength: 20 MPa}}
  stress: {{xx: 20 MPa, yy: 10 MPa}}
  matrix: {{permeability: 1 mD, half_force: 5 MN/m, gap_factor: 0.5}}
  fluid: {{viscosity: 1 Pa s, bulk_modulus: 1 GPa}}
  fractures:
    natural: {{kind: set, angle: 0 deg, length: 5 m, spacing: 4 m, aperture: 100 um}}
  wells: {{producer: {{at: [0 m, 0 m], radius: 1 m, rate: 1e-5 m3/s}}}}
  boundaries: {{outer: 7 MPa}}
  initial_pressure: 7 MPa
  times: {{first: 1 s, last: 24000 s, per_decade: 10}}
vary:
  angle: {{parameter: fractures.natural.angle, from: 0 deg, to: 80 deg, count: {angles}}}
  aperture: {{parameter: fractures.natural.aperture, from: 50 um, to: 200 um, count: {apertures}}}
  stress_yy: {{parameter: stress.yy, from: 5 MPa, to: 20 MPa, count: {stresses}}}
  rate: {{parameter: wells.producer.rate, values: {rates}}}
observe: [well_pressure]
"""


class Took(NamedTuple):
    """What a run of a study took, all processes together."""

    seconds: float  # by the clock, from the call to the dataset
    cpu: float  # s, of all its processes
    computed: int  # stage runs
    failed: int  # cases


_CHILD = """
import json, sys, time
from PACKAGE.engine import run_study
options = json.loads(sys.argv[1])
begin = time.perf_counter()
done = run_study(figures=False, **options)
seconds = time.perf_counter() - begin
computed = done.executed.computed if done.executed else 0
print(json.dumps([seconds, computed, done.failed]))
"""


def timed_run(path: Path, results: Path, *, root: Path = ROOT, **options: Any) -> Took:
    """Run a study without figures, in processes of its own, by the build that lies at `root`."""
    given = json.dumps({"path": str(path), "results": str(results), **options})
    package = "demflow.sweep" if (root / "demflow").exists() else "sweep"
    before = cpu_of_children()
    done = subprocess.run(
        [sys.executable, "-c", _CHILD.replace("PACKAGE", package), given],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        check=True,
        capture_output=True,
        text=True,
    )
    seconds, computed, failed = json.loads(done.stdout)
    return Took(seconds, cpu_of_children() - before, computed, failed)


def timed_command(*arguments: str, root: Path = ROOT) -> tuple[float, str]:
    """Seconds that `demflow …` takes, from the shell's view, and what it prints to stdout.

    It is the command of the build that lies at `root`.
    """
    own = ("-m", "demflow")
    if not (root / "demflow").exists():
        own = ("-c", "from sweep.cli import main; raise SystemExit(main())")
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, *own, *arguments],
        cwd=root,
        check=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(root)},
    )
    return time.perf_counter() - begin, done.stdout


def four_axes(name: str, *, grains: int, angles: int = ANGLES, rates: int = RATES) -> Path:
    """Write the study of angles × apertures × stresses × rates."""
    folder = results_folder() / "studies"
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.yaml"
    path.write_text(
        FOUR_AXES.format(
            name=name,
            grains=grains,
            angles=angles,
            apertures=APERTURES,
            stresses=STRESSES,
            rates=[1e-5 * (k + 1) for k in range(rates)],
        )
    )
    return path


@cache
def four_hundred_cases(grains: int) -> tuple[Path, Path, Took]:
    """The 400 cases on two workers, run once: the study, its results and what that took."""
    path, results = four_axes("four_axes", grains=grains), results_folder() / "four_axes"
    return path, results, timed_run(path, results, workers=2)


def cpu_of_children() -> float:
    """Seconds of processor time of all processes that were started and have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
