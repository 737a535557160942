"""400 cases of two axes of apertures, as one family and case by case: processor time.

Through YAML on two workers, without figures; both studies pack the same rock, and what a process
takes to start counts too, so that a run of a single case, told beside, is a limit to what any
emulator can save. `DEMFLOW_BASE` may name the folder of another build: its run of the same study
stands in place of ours case by case then. `GRAINS`, 5,000 where it is not set, may be another
number.
"""

from __future__ import annotations

import os
from pathlib import Path

import xarray as xr

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import timed_run

GRAINS = int(os.environ.get("GRAINS", "5000"))
BOUND = 10.0
AXIS = "from: 50 um, to: 500 um, count: 20, spacing: log"

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
  one: {parameter: fractures.one.aperture, AXIS}
  two: {parameter: fractures.two.aperture, AXIS}
observe: [well_pressure]
solver: {method: METHOD, tolerance: 1e-4}
"""


def study(name: str, method: str, axis: str = AXIS) -> str:
    """The study by a method, over what both axes are given."""
    given = {"NAME": name, "COUNT": str(GRAINS), "METHOD": method, "AXIS": axis}
    text = STUDY
    for word, told in given.items():
        text = text.replace(word, told)
    return text


def run() -> Result:
    """Run all, and compare what they took and what they gave."""
    folder = results_folder() / "emulated"
    folder.mkdir()
    took, found = {}, {}
    for name, *how in (
        ("krylov", "krylov"),
        ("auto", "auto"),
        ("single", "auto", "values: [100 um]"),
    ):
        path = folder / f"{name}.yaml"
        path.write_text(study(name, *how))
        took[name] = timed_run(path, folder / name, workers=2)
        with xr.open_dataset(folder / name / name / "dataset.nc") as dataset:
            found[name] = dataset.load()
    off = abs(found["auto"].pressure_change / found["krylov"].pressure_change - 1.0)
    emulated = float((found["auto"].solver_used == "emulated").mean())
    before, lines = took["krylov"].cpu, []
    if base := os.environ.get("DEMFLOW_BASE"):
        other = timed_run(folder / "auto.yaml", folder / "base", root=Path(base), workers=2)
        before = other.cpu
        lines.append(f"{base}: {other.cpu:.1f} s of processor, {other.computed} stage runs")
    ratio, alone = before / took["auto"].cpu, took["single"].cpu
    lines += [
        f"case by case: {took['krylov'].cpu:.1f} s of processor, {took['krylov'].computed} stage "
        f"runs; as a family: {took['auto'].cpu:.1f} s, {took['auto'].computed} stage runs",
        f"a single case: {alone:.1f} s, {before / alone:.1f} times less; beyond it the family "
        f"takes {(before - alone) / (took['auto'].cpu - alone):.1f} times less",
        f"emulated: {100 * emulated:.0f} % of the cases from "
        f"{float(found['auto'].emulator_snapshots.max()):.0f} snapshots, bounds up to "
        f"{float(found['auto'].estimated_error.max()):.2g}; both differ by {float(off.max()):.2g}",
    ]
    holds = ratio >= BOUND and float(off.max()) <= 2e-4
    return Result(f"{ratio:.1f} times less", f"≥ {BOUND:g} times less", holds, "\n".join(lines))
