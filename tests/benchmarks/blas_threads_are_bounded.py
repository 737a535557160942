"""A solve of 20,000 pores takes no longer with BLAS left alone than pinned to one thread."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.benchmarks.result import Result

RATIO = 1.1
ROUNDS = 4
PINS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

REPEATS = 12
SOLVE = """
import sys, time
import numpy as np
from demflow import model
from demflow.model.region import Circle
from demflow.model.scene import Fluid, Grains, Matrix, Scene, Solver, Well

def scene(count):
    return Scene(
        region=Circle(10.0),
        grains=Grains(count=count, packing="hexagonal"),
        matrix=Matrix(permeability=1e-14),
        fluid=Fluid(1e-3, 2.2e9),
        wells=(Well(name="w", at=(0.3, 0.2), radius=0.5, rate=1e-6),),
        boundaries=(("outer", 1e7),),
        initial_pressure=1e7,
        times=tuple(np.geomspace(1e-2, 1e5, 60).tolist()),
        observe=("well_pressure",),
        solver=Solver(method="krylov", tolerance=1e-5),
    )

model.simulate(scene(500))  # compiles
wanted = scene(10_000)
took = []
for _ in range(int(sys.argv[1])):
    begin, cpu = time.perf_counter(), time.process_time()
    found = model.simulate(wanted)
    took.append((time.perf_counter() - begin, time.process_time() - cpu))
print(min(t[0] for t in took), min(t[1] for t in took), int(found["domain_count"]))
"""


def solved(pinned: bool) -> tuple[float, float, int]:
    """Wall and processor time of one solve in a process of its own, s, and its pores."""
    environment = {name: value for name, value in os.environ.items() if name not in PINS}
    if pinned:
        environment |= dict.fromkeys(PINS, "1")
    done = subprocess.run(
        [sys.executable, "-c", SOLVE, str(REPEATS)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    wall, cpu, pores = done.stdout.split()
    return float(wall), float(cpu), int(pores)


def run() -> Result:
    """The least of several solves each way, in turns."""
    free, pinned = [], []
    for _ in range(ROUNDS):
        free.append(solved(pinned=False))
        pinned.append(solved(pinned=True))
    wall = min(s[0] for s in free) / min(s[0] for s in pinned)
    cpu = min(s[1] for s in free) / min(s[1] for s in pinned)
    lines = [f"{free[0][2]} pores, {os.cpu_count()} cores; s of wall and processor time"]
    lines += [f"left alone {a[0]:.3f} {a[1]:.3f}   pinned {b[0]:.3f} {b[1]:.3f}"
              for a, b in zip(free, pinned, strict=True)]  # fmt: skip
    holds = wall <= RATIO and cpu <= RATIO
    figure = f"{wall:.2f} times the wall time, {cpu:.2f} times the processor time"
    return Result(figure, f"≤ {RATIO} times", holds, "\n".join(lines))
