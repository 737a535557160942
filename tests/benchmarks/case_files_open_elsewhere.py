"""Case files are opened and stepped through time by xugrid, uxarray and VTK, values and all."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from demflow import sweep
from tests.benchmarks.result import Result
from tests.peers.lammps import ENVIRONMENT
from tests.peers.yade import PeerMissingError

STUDY = """
study: elsewhere
scene:
  region: {shape: circle, radius: 5 m}
  grains: {count: 300, porosity: 0.18, seed: 1}
  matrix: {permeability: 1 mD}
  fluid: {viscosity: 1 cP, bulk_modulus: 1 GPa}
  fractures: {f: {kind: trace, from: [-2 m, 0 m], to: [2 m, 1 m], aperture: 100 um}}
  wells: {producer: {at: [0 m, 0 m], radius: 0.5 m, rate: 1e-6 m3/s}}
  boundaries: {outer: 7 MPa}
  initial_pressure: 7 MPa
  times: {first: 1 s, last: 1 d, per_decade: 3}
observe: [well_pressure, pressure_map, grain_map]
"""


def run() -> Result:
    """Write one case both ways and read it back by other programs."""
    python = Path(os.environ.get("PEERS_PYTHON", ENVIRONMENT / "bin" / "python"))
    if not python.exists():
        raise PeerMissingError("xugrid, uxarray and VTK are not installed: make peers")
    with tempfile.TemporaryDirectory() as folder:
        study = Path(folder, "elsewhere.yaml")
        study.write_text(STUDY)
        sweep.run(study, results=Path(folder, "results"))
        case = sweep.open_case(Path(folder, "results", "elsewhere"))
        files = [Path(folder, "case.nc"), Path(folder, "case.pvd")]
        for file in files:
            sweep.write_case(case, file)
        reader = Path(__file__).parents[1] / "peers" / "case_files.py"
        told = subprocess.run(
            [python, reader, *files], capture_output=True, text=True, check=True
        ).stdout
    expected = case.pressure.sum("domain").values
    lines, good = [], 0
    found = json.loads(told.splitlines()[-1])
    for name, sums in found.items():
        same = len(sums) == len(expected) and np.allclose(sums, expected, rtol=1e-12)
        good += bool(same)
        lines.append(f"{name}: {f'{len(sums)} times, the same values' if same else sums}")
    return Result(f"{good} of {len(found)} read every time", "all", good == 4, "\n".join(lines))
