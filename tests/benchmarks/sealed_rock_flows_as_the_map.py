"""In a sealed rock the flow is that of the map's own graph, for random sets and outcrop KB11."""

from __future__ import annotations

import math

import numpy as np

from demflow.model import simulate
from demflow.model.fracture_network import describe
from demflow.model.region import Rectangle
from demflow.model.scene import (
    Fluid,
    Fracture,
    Grains,
    LogNormal,
    Matrix,
    PowerLaw,
    RandomSet,
    Scene,
    Solver,
    TraceMap,
    Uniform,
)
from demflow.sweep.study.map_files import read_map
from tests.benchmarks.outside_data import outside
from tests.benchmarks.result import Result

VISCOSITY, DROP, BOUND = 1e-3, 1e6, 1e-9
SETS = 100
REGION = Rectangle(10.0, 8.0)


def random_set(seed: int) -> RandomSet:
    """200 fractures of unequal lengths and apertures; about half the sets join the sides."""
    return RandomSet(
        name="r",
        seed=seed,
        count=200,
        length=PowerLaw(2.0, 0.4, 6.0),
        angle=Uniform((0.0, math.pi)),
        aperture=LogNormal(0.5, 1e-4),
    )


def off(fracture: Fracture, region: Rectangle, grains: Grains) -> tuple[float, float]:
    """Flow by the graph alone, and by which part of it the model is off; of none, any flow."""
    sides = ("left", "right")
    alone = describe(
        region=region, fractures=(fracture,), viscosity=VISCOSITY, wells=(), sides=sides
    ).conductance[0, 0]
    scene = Scene(
        region=region,
        grains=grains,
        matrix=Matrix(aperture=1e-12),
        fluid=Fluid(VISCOSITY, 1e9),
        fractures=(fracture,),
        boundaries=(("left", DROP), ("right", 0.0)),
        observe=("boundary_flow",),
        solver=Solver(method="steady"),
    )
    flow = simulate(scene)["boundary_flow"]
    wanted = alone * DROP
    # where traces join nothing the flow counts over that of one fracture from side to side
    one = 1e-4**3 / (12.0 * VISCOSITY) * DROP / region.width
    return wanted, float(np.abs(flow - (wanted, -wanted)).max()) / (wanted if wanted > 0.0 else one)


def run() -> Result:
    """Sets of 200 in small packings of several seeds, and a box of the outcrop."""
    told, worst, joined = [], 0.0, 0
    for seed in range(SETS):
        grains = Grains(count=600, porosity=0.17, seed=seed % 5)
        wanted, error = off(random_set(seed), REGION, grains)
        joined += wanted > 0.0
        worst = max(worst, error)
        if error > BOUND:
            told.append(f"set {seed}: {wanted:.4g} m³/s, off by {error:.2g}")
    told.append(f"{joined} of {SETS} sets join the sides; worst {worst:.2g}")
    path = outside("traces/KB11_traces.geojson")
    mapped = TraceMap(
        name="m",
        file=read_map({path.name: path.read_bytes()}),
        origin="centroid",
        snap=1e-3,
        aperture=1e-4,
    )
    wanted, error = off(mapped, Rectangle(20.0, 20.0), Grains(count=4000, porosity=0.17))
    told.append(f"KB11, 20 m: {wanted:.4g} m³/s, off by {error:.2g}")
    worst = max(worst, error)
    return Result(f"off by {worst:.2g}", f"≤ {BOUND:g}", worst <= BOUND, "\n".join(told))
