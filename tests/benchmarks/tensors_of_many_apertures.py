"""Permeability tensors of 400 cases of two axes of apertures, by another build and by this one.

Through YAML on two workers, without figures; processor time of all processes, what they take to
start included, medians of rounds in turns. `DEMFLOW_BASE` names the folder of the other build; each
runs the same study, and one of a single case, the first, by which is told what further cases take
and whether its tensor is what it is alone. `GRAINS`, 5,000 where it is not set, may be another
number.
"""

from __future__ import annotations

import os
from pathlib import Path

from tests.benchmarks.further_cases import further_cases
from tests.benchmarks.result import Result

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
    texts = [
        STUDY.replace("NAME", name).replace("COUNT", str(GRAINS)).replace("AXIS", axis)
        for name, axis in (("single", "values: [50 um]"), ("many", AXIS))
    ]
    found = further_cases("tensors", *texts, Path(base), ROUNDS)
    other, own = found["other"], found["own"]
    ratio, further = other.many / own.many, other.each / own.each
    return Result(
        f"{ratio:.2f} times less, {further:.1f} times a further case, {own.off:.0e} from alone",
        f"≥ {BOUND:g} times less, ≥ {EACH:g} times a further case, ≤ {SAME:.0e}",
        ratio >= BOUND and further >= EACH and own.off <= SAME,
        "\n".join(one.line(build) for build, one in found.items()),
    )
