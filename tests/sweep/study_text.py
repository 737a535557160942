"""A small valid study as text, and ways to break it."""

from pathlib import Path

from demflow.sweep.study.load import Study, StudyError, load_study

# the example of the documentation, word by word
EXAMPLE = """\
study: fractured-reservoir            # names results/<study>/
title: Natural-fracture angle, aperture, stress and rate
scene:
  region: {shape: circle, radius: 14 m}        # or {shape: rectangle, width: 14 m, height: 14 m}
  grains: {count: 4000, radius_ratio: 1.66, porosity: 0.16, seed: 1,   # packing: random (default)
           modulus: 20 GPa, stiffness_ratio: 2.5, friction: 0.5, density: 2650 kg/m3}
  bonds: {kind: parallel, tensile_strength: 10 MPa, shear_strength: 20 MPa}   # optional
  stress: {xx: 20 MPa, yy: 10 MPa}             # optional; without it nothing mechanical is run
  matrix:                                      # permeability, hydraulic_conductivity or aperture
    permeability: 0.458 mD                     # w0 found from it, in the unstressed state
    half_force: 5 MN/m                         # F0; optional
    gap_factor: 0.5                            # m
  fluid: {viscosity: 1 Pa s, bulk_modulus: 1 GPa}
  fractures:
    hydraulic: {kind: bi-wing, at: [0 m, 0 m], angle: 0 deg, half_length: 5 m, permeability: 2670 mD}
    natural:   {kind: set, angle: 65 deg, length: 5 m, spacing: 2.5 m, aperture: 100 um}
    other:     {kind: trace, from: [-3 m, 1 m], to: [4 m, 2 m], aperture: 100 um}
  wells:
    producer: {at: [0 m, 0 m], radius: 0.964 m, rate: 2e-5 m3/s}
  boundaries: {outer: 7 MPa}                   # rectangle: left, right, bottom, top
  probes: {inner: {at: [3 m, 0 m]}, line: {from: [0 m, 0 m], to: [13.8 m, 0 m], count: 50}}
  initial_pressure: 7 MPa
  times: {first: 1 s, last: 24000 s, per_decade: 20}               # or a list
vary:                                          # each key is an axis; axes multiply
  fracture_angle: {parameter: fractures.natural.angle, values: [0 deg, 30 deg, 65 deg]}
  aperture:       {parameter: fractures.natural.aperture, from: 20 um, to: 500 um, count: 5, spacing: log}
  stress_yy:      {parameter: stress.yy, values: [5 MPa, 10 MPa, 20 MPa]}
  rate:           {parameter: wells.producer.rate, values: [1e-5 m3/s, 2e-5 m3/s]}
observe: [well_pressure, permeability, pressure_map]
solver: {method: auto, tolerance: 1e-4}        # auto | explicit | implicit | krylov | steady
smoke: {grains.count: 300}                     # what the test suite overrides
"""  # noqa: E501

SMALL = """\
study: small
scene:
  region: {shape: rectangle, width: 14 m, height: 14 m}
  grains: {count: 500, porosity: 0.17, modulus: 20 GPa}
  stress: {xx: 20 MPa, yy: 10 MPa}
  matrix: {permeability: 1 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  fractures:
    natural: {kind: set, angle: 65 deg, length: 5 m, spacing: 2 m, aperture: 100 um}
    joint: {kind: trace, from: [-3, 1], to: [4, 2], aperture: 100 um}
  wells:
    producer: {at: [0, 0], radius: 1 ft, rate: 1 bbl/day}
  boundaries: {left: 7 MPa, right: 5 MPa}
  probes: {p: {at: [3, 0]}}
  initial_pressure: 7 MPa
  times: [1 s, 1 min, 1 h]
vary:
  yy: {parameter: stress.yy, values: [5 MPa, 10 MPa]}
observe: [well_pressure, pressure_map]
solver: {tolerance: 1e-3}
"""


def load(folder: Path, text: str, **options: bool) -> Study:
    path = folder / "study.yaml"
    path.write_text(text, encoding="utf-8")
    return load_study(path, **options)


def broken(old: str, new: str, text: str = SMALL) -> str:
    assert text.count(old) == 1, old
    return text.replace(old, new)


def problems(folder: Path, text: str) -> list[str]:
    """`line:column: message` of each problem."""
    try:
        load(folder, text)
    except StudyError as error:
        return [str(p).removeprefix(f"{folder / 'study.yaml'}:") for p in error.problems]
    return []


def place_of(text: str, part: str, offset: int = 0) -> str:
    """`line:column` at which a part of a text stands, counted from 1."""
    assert text.count(part) == 1, part
    before = text[: text.index(part) + offset]
    return f"{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"
