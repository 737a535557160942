"""What traces cost in `open` and `flow`, beside another build: a map of an outcrop, the quickstart.

Outcrop KB11 in a box of 20 m with 20,000 grains, steady from side to side, and the twelve states of
the quickstart that its rates share, 2,500 grains each. Processor time of finding the lines, opening
them and solving the flow; packing, stress and network are left out. `DEMFLOW_BASE` names the folder
of the other build; both run the same scenes in processes of their own, by turns, with kernels
compiled and loaded before by the same scenes of fewer grains, and the least of some runs counts.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.benchmarks.outside_data import outside
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT

RUNS = 8
BOUNDS = {"outcrop": 0.5, "quickstart": 0.7}
COUNTED = ("walk", "open", "flow")

# It knows only what both builds have, and takes the map's file.
PROGRAM = """
import json, math, pickle, sys, time
import numpy as np
from model.scene import *
from model.stages import STAGES

def spent(scenes):
    made, total = {}, 0.0
    for scene in scenes:
        keys = {}
        for stage in STAGES:
            if stage.name == "observe" or not stage.wanted(scene):
                continue
            plain = {name: read(scene) for name, read in stage.reads.items()}
            given = stage.given(scene) if hasattr(stage, "given") else plain
            key = (stage.name, *(keys.get(p) for p in stage.parents), pickle.dumps(given))
            keys[stage.name] = key
            if key in made:
                continue
            began = time.process_time()
            made[key] = stage.run(*(made.get(keys.get(p)) for p in stage.parents), **given)
            total += (time.process_time() - began) * (stage.name in COUNTED)
    return total

def outcrop(count):
    lines = []
    for feature in json.load(open(sys.argv[1]))["features"]:
        form = feature["geometry"]
        several = form["type"] == "MultiLineString"
        for line in form["coordinates"] if several else [form["coordinates"]]:
            points = np.array(line)[:, :2]
            lines += zip(points[:-1], points[1:])
    pieces = np.array(lines)
    pieces -= 0.5 * (pieces.min(axis=(0, 1)) + pieces.max(axis=(0, 1)))
    near = (np.abs(pieces).min(axis=1) < 9.9).all(axis=1)
    traces = tuple(
        Trace(name=f"t{k}", start=tuple(a), end=tuple(b), aperture=1e-4)
        for k, (a, b) in enumerate(pieces[near].tolist())
    )
    return [
        Scene(
            region=Rectangle(20.0, 20.0),
            grains=Grains(count=count, porosity=0.17, seed=1),
            matrix=Matrix(aperture=2e-5),
            fluid=Fluid(viscosity=1e-3, bulk_modulus=2e9),
            fractures=traces,
            boundaries=(("left", 1e6), ("right", 0.0)),
            observe=("boundary_flow",),
        )
    ]

def quickstart(count):
    return [
        Scene(
            region=Circle(14.0),
            grains=Grains(
                count=count, radius_ratio=1.66, porosity=0.17, seed=1, modulus=2e10,
                stiffness_ratio=2.5, friction=0.5,
            ),
            bonds=Bonds(kind="parallel", tensile_strength=5e7, shear_strength=5e7),
            stress=Stress(xx=1e7, yy=yy),
            matrix=Matrix(permeability=5 * 9.869233e-16, half_force=5e6),
            fluid=Fluid(viscosity=1e-3, bulk_modulus=2.2e9),
            fractures=(
                FractureSet(
                    name="natural", angle=angle, length=6.0, spacing=4.0, aperture=aperture
                ),
            ),
            wells=(Well(name="producer", at=(0.0, 0.0), radius=1.0, rate=1e-5),),
            boundaries=(("outer", 2e7),),
            initial_pressure=2e7,
            times=tuple(np.geomspace(1.0, 1e5, 61).tolist()),
            observe=("well_pressure", "permeability", "boundary_flow", "pressure_map"),
        )
        for angle in (0.0, 0.25 * math.pi, 0.5 * math.pi)
        for aperture in (5e-5, 1.5e-4)
        for yy in (1e7, 2e7)
    ]

spent(outcrop(800)), spent(quickstart(300))
print(json.dumps({"outcrop": spent(outcrop(20000)), "quickstart": spent(quickstart(2500))}))
""".replace("COUNTED", repr(COUNTED))


def measured(root: Path) -> dict[str, float]:
    """Processor time of both by the build that lies at `root`, s."""
    data = outside("traces/KB11_traces.geojson")
    env = {**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(data)],
        env=env,
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def run() -> Result:
    """Ratios of the least processor times, this build over the other."""
    bound = ", ".join(f"{name} ≤ {value:g}" for name, value in BOUNDS.items())
    base = os.environ.get("DEMFLOW_BASE")
    if base is None:
        return Result("no other build", bound, False, "set DEMFLOW_BASE to a folder of one")
    took: dict[str, list[dict[str, float]]] = {"base": [], "this": []}
    for _ in range(RUNS):
        took["base"].append(measured(Path(base).resolve()))
        took["this"].append(measured(ROOT))
    least = {who: {n: min(one[n] for one in every) for n in BOUNDS} for who, every in took.items()}
    ratio = {name: least["this"][name] / least["base"][name] for name in BOUNDS}
    lines = [f"{who} {name}: {least[who][name]:.2f} s" for who in took for name in BOUNDS]
    return Result(
        ", ".join(f"{name} {value:.2f}" for name, value in ratio.items()),
        bound,
        all(ratio[name] <= BOUNDS[name] for name in BOUNDS),
        "\n".join(lines),
    )
