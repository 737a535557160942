"""Permeabilities of 400 states of stress of one bonded rock, by another build and by this one.

Through YAML on two workers, without figures; processor time of all processes, what they take to
start included, medians of rounds in turns, and what the products take on the disk. `DEMFLOW_BASE`
names the folder of the other build; each runs the same study with `stress.method: static`, and one
of a single case, the first, by which is told what a further state takes and whether its tensor is
what it is alone. Under contact bonds a state is a sum of unit loads; under parallel ones contacts
of the grains themselves slip, so that it is corrected some times. `GRAINS`, 5,000 where it is not
set, may be another number.
"""

from __future__ import annotations

import os
from pathlib import Path

from tests.benchmarks.further_cases import further_cases
from tests.benchmarks.result import Result

GRAINS = int(os.environ.get("GRAINS", "5000"))
EACH, DISK, SAME, ROUNDS = 1.5, 10.0, 1e-13, 3
STRENGTHS = "tensile_strength: 157 MPa, shear_strength: 157 MPa"
BONDS = {
    "contact": f"{{kind: contact, installation_gap: 0.01, {STRENGTHS}}}",
    "parallel": f"{{kind: parallel, {STRENGTHS}}}",
}
FIRST, SECOND = "from: 20 MPa, to: 24 MPa, count: 20", "from: 18 MPa, to: 20 MPa, count: 20"

STUDY = """
study: NAME
title: States of stress
scene:
  region: {shape: rectangle, width: 28 m, height: 28 m}
  grains: {count: COUNT, radius_ratio: 1.66, porosity: 0.165, seed: 1,
           modulus: 40 GPa, stiffness_ratio: 2.5, friction: 0.5}
  bonds: BONDS
  stress: {xx: 20 MPa, yy: 20 MPa, method: static}
  matrix: {permeability: 1 mD, half_force: 5 MN/m}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
vary:
  xx: {parameter: stress.xx, FIRST}
  yy: {parameter: stress.yy, SECOND}
observe: [permeability]
"""


def study(name: str, bonds: str, xx: str, yy: str) -> str:
    """The text of a study."""
    told = {"NAME": name, "COUNT": str(GRAINS), "BONDS": BONDS[bonds], "FIRST": xx, "SECOND": yy}
    text = STUDY
    for word, value in told.items():
        text = text.replace(word, value)
    return text


def run() -> Result:
    """Run both rocks by both builds, in turns, and compare what they took and gave."""
    base, bound = (
        os.environ.get("DEMFLOW_BASE"),
        f"≥ {EACH:g} times a further state of contact bonds",
    )
    if not base:
        return Result("no other build", bound, False, "set DEMFLOW_BASE to a folder of one")
    figures, lines, holds = [], [], True
    for bonds in BONDS:
        single = study("single", bonds, "values: [20 MPa]", "values: [18 MPa]")
        many = study("many", bonds, FIRST, SECOND)
        found = further_cases(f"{bonds} states", single, many, Path(base), ROUNDS)
        other, own = found["other"], found["own"]
        further, disk = other.each / own.each, other.stored / own.stored
        least = EACH if bonds == "contact" else 1.0
        holds &= further >= least and disk >= DISK and own.off <= SAME
        figures.append(
            f"{bonds} bonds: a further state {further:.2f} times cheaper, "
            f"{disk:.0f} times less on the disk, {own.off:.0e} from alone"
        )
        lines += [one.line(f"{bonds} bonds, {build}") for build, one in found.items()]
    return Result(
        "; ".join(figures),
        f"{bound}, of parallel ones no dearer; ≥ {DISK:g} times less; ≤ {SAME:.0e}",
        holds,
        "\n".join(lines),
    )
