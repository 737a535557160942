"""400 cases of two axes of apertures, as one family and case by case: processor time, 5,000 grains.

Through YAML on two workers, without figures; both studies pack the same rock, and what a process
takes to start counts too. `DEMFLOW_BASE` may name the folder of another build, whose run of the
same study is told beside.
"""

from __future__ import annotations

import os
from pathlib import Path

import xarray as xr

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import timed_run

GRAINS, BOUND = 5000, 10.0

STUDY = """
study: NAME
title: Two axes of apertures
scene:
  region: {shape: circle, radius: 14 m}
  grains: {count: COUNT, radius_ratio: 1.66, porosity: 0.16, seed: 1}
  matrix: {permeability: 0.458 mD}
  fluid: {viscosity: 1 Pa s, bulk_modulus: 1 GPa}
  fractures:
    one: {kind: set, angle: 65 deg, length: 5 m, spacing: 2.5 m, aperture: 100 um}
    two: {kind: set, angle: -10 deg, length: 4 m, spacing: 3 m, aperture: 100 um}
  wells: {producer: {at: [0 m, 0 m], radius: 0.964 m, rate: 2e-5 m3/s}}
  boundaries: {outer: 7 MPa}
  initial_pressure: 7 MPa
  times: {first: 1 s, last: 24000 s, per_decade: 20}
vary:
  one: {parameter: fractures.one.aperture, from: 50 um, to: 500 um, count: 20, spacing: log}
  two: {parameter: fractures.two.aperture, from: 50 um, to: 500 um, count: 20, spacing: log}
observe: [well_pressure]
solver: {method: METHOD, tolerance: 1e-4}
"""


def run() -> Result:
    """Run both, and compare what they took and what they gave."""
    folder = results_folder() / "emulated"
    folder.mkdir()
    took, found = {}, {}
    for method in ("krylov", "auto"):
        path = folder / f"{method}.yaml"
        text = STUDY.replace("METHOD", method).replace("NAME", method)
        path.write_text(text.replace("COUNT", str(GRAINS)))
        took[method] = timed_run(path, folder / method, workers=2)
        with xr.open_dataset(folder / method / method / "dataset.nc") as dataset:
            found[method] = dataset.load()
    off = abs(found["auto"].pressure_change / found["krylov"].pressure_change - 1.0)
    ratio = took["krylov"].cpu / took["auto"].cpu
    emulated = float((found["auto"].solver_used == "emulated").mean())
    lines = [
        f"case by case: {took['krylov'].cpu:.1f} s of processor, {took['krylov'].computed} stage "
        f"runs; as a family: {took['auto'].cpu:.1f} s, {took['auto'].computed} stage runs",
        f"emulated: {100 * emulated:.0f} % of the cases from "
        f"{float(found['auto'].emulator_snapshots.max()):.0f} snapshots, bounds up to "
        f"{float(found['auto'].estimated_error.max()):.2g}; both differ by {float(off.max()):.2g}",
        *_of_another_build(folder / "auto.yaml", folder),
    ]
    holds = ratio >= BOUND and float(off.max()) <= 2e-4
    return Result(f"{ratio:.1f} times less", f"≥ {BOUND:g} times less", holds, "\n".join(lines))


def _of_another_build(path: Path, folder: Path) -> list[str]:
    """What the study takes with the build that `DEMFLOW_BASE` names, if any."""
    base = os.environ.get("DEMFLOW_BASE")
    if not base:
        return []
    took = timed_run(path, folder / "base", root=Path(base), workers=2)
    return [f"{base}: {took.cpu:.1f} s of processor, {took.computed} stage runs"]
