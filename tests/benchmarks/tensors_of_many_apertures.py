"""Permeability tensors of 400 cases of two axes of apertures, by another build and by this one.

Through YAML on two workers, without figures; processor time of all processes, what they take to
start included, medians of rounds in turns. `DEMFLOW_BASE` names the folder of the other build; each
runs the same study, and one of a single case, the first, by which is told what further cases take
and whether its tensor is what it is alone. `GRAINS`, 5,000 where it is not set, may be another
number.
"""

from __future__ import annotations

import os
import statistics
from pathlib import Path

import xarray as xr

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT, timed_run

GRAINS = int(os.environ.get("GRAINS", "5000"))
BOUND, EACH, SAME, ROUNDS = 1.4, 2.0, 1e-13, 3
AXIS = "from: 50 um, to: 500 um, count: 20, spacing: log"

STUDY = """
study: NAME
title: Tensors of two axes of apertures
scene:
  region: {shape: rectangle, width: 28 m, height: 28 m}
  grains: {count: COUNT, radius_ratio: 1.66, porosity: 0.16, seed: 1}
  matrix: {permeability: 0.458 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  fractures:
    one: {kind: set, angle: 65 deg, length: 5 m, spacing: 2.5 m, aperture: 100 um}
    two: {kind: set, angle: -10 deg, length: 4 m, spacing: 3 m, aperture: 100 um}
vary:
  one: {parameter: fractures.one.aperture, AXIS}
  two: {parameter: fractures.two.aperture, AXIS}
observe: [permeability]
"""


def run() -> Result:
    """Run both studies by both builds, in turns, and compare what they took and gave."""
    base = os.environ.get("DEMFLOW_BASE")
    if not base:
        bound = f"≥ {BOUND:g} times less, ≥ {EACH:g} times a further case"
        return Result("no other build", bound, False, "set DEMFLOW_BASE to a folder of one")
    folder = results_folder() / "tensors"
    folder.mkdir()
    builds = {"other": Path(base), "own": ROOT}
    found, computed = {}, {}
    every: dict[tuple[str, str], list[float]] = {}
    for lap in range(ROUNDS + 1):  # the first one compiles
        for name, axis in (("single", "values: [50 um]"), ("many", AXIS)):
            path = folder / f"{name}.yaml"
            text = STUDY.replace("NAME", name).replace("COUNT", str(GRAINS)).replace("AXIS", axis)
            path.write_text(text)
            for build, root in builds.items():
                results = folder / f"{build}_{name}_{lap}"
                done = timed_run(path, results, root=root, workers=2)
                every.setdefault((build, name), []).append(done.cpu)
                computed[build, name] = done.computed
                with xr.open_dataset(results / name / "dataset.nc") as dataset:
                    found[build, name] = dataset.permeability.load()
    took = {which: statistics.median(laps[1:]) for which, laps in every.items()}
    ratio = took["other", "many"] / took["own", "many"]
    cases = found["own", "many"].one.size * found["own", "many"].two.size
    each = {
        build: (took[build, "many"] - took[build, "single"]) / (cases - 1)
        for build in ("other", "own")
    }
    further = each["other"] / each["own"]
    alone = found["own", "single"].values.ravel()
    block = found["own", "many"].isel(one=0, two=0).values.ravel()
    off = float(abs(block - alone).max() / abs(alone).max())
    lines = [
        f"{build}: {took[build, 'many']:.1f} s of processor, {computed[build, 'many']} stage runs; "
        f"a single case {took[build, 'single']:.1f} s, each further one {1e3 * each[build]:.1f} ms"
        for build in ("other", "own")
    ]
    return Result(
        f"{ratio:.2f} times less, {further:.1f} times a further case, {off:.0e} from alone",
        f"≥ {BOUND:g} times less, ≥ {EACH:g} times a further case, ≤ {SAME:.0e}",
        ratio >= BOUND and further >= EACH and off <= SAME,
        "\n".join(lines),
    )
