"""A trace in a sealed matrix carries w³/(12 μ) along it; a sealed barrier lets nothing pass."""

from __future__ import annotations

import math

import numpy as np

from demflow.model import simulate
from demflow.model.scene import Fluid, Grains, Matrix, Rectangle, Scene, Trace
from tests.benchmarks.result import Result

APERTURE, VISCOSITY, TRACES = 1e-4, 1e-3, 40
PACKINGS = {
    "square": {"packing": "square"},
    "hexagonal": {"packing": "hexagonal"},
    "random": {"porosity": 0.17, "seed": 3},
}


def flow_through(grains: Grains, matrix: Matrix, fracture: tuple[Trace, ...]) -> float:
    """Steady flow from left to right under 1 Pa."""
    found = simulate(
        Scene(
            region=Rectangle(4.0, 4.0),
            grains=grains,
            matrix=matrix,
            fluid=Fluid(viscosity=VISCOSITY, bulk_modulus=2e9),
            fractures=fracture,
            boundaries=(("left", 1.0), ("right", 0.0)),
            observe=("boundary_flow",),
        )
    )
    return float(found["boundary_flow"][0])


def run() -> Result:
    """Largest errors over packings and random traces, a grain row and a grain centre."""
    rng = np.random.default_rng(7)
    worst_along = worst_across = 0.0
    lines = []
    for name, recipe in PACKINGS.items():
        grains = Grains(count=600, **recipe)
        along, across = [], []
        whole = flow_through(grains, Matrix(aperture=APERTURE), ())
        heights = [(0.0, 0.0), *rng.uniform(-1.8, 1.8, (TRACES, 2))]
        for left, right in heights:
            slope = (right - left) / 4.0
            ends = {"start": (-2.5, left - 0.5 * slope), "end": (2.5, right + 0.5 * slope)}
            fracture = Trace(name="f", aperture=APERTURE, **ends)
            expected = APERTURE**3 / (12 * VISCOSITY) / math.hypot(4.0, right - left)
            along.append(
                abs(flow_through(grains, Matrix(aperture=0.0), (fracture,)) / expected - 1)
            )
        for bottom, top in rng.uniform(-1.5, 1.5, (TRACES // 4, 2)):
            slope = (top - bottom) / 4.0
            ends = {"start": (bottom - 0.5 * slope, -2.5), "end": (top + 0.5 * slope, 2.5)}
            barrier = Trace(name="b", transmissibility_multiplier=0.0, **ends)
            across.append(abs(flow_through(grains, Matrix(aperture=APERTURE), (barrier,)) / whole))
        worst_along = max(worst_along, *along)
        worst_across = max(worst_across, *across)
        lines.append(
            f"{name:9} {len(along)} traces: error along {max(along):.1e}; "
            f"{len(across)} barriers: flow across {max(across):.1e} of the open flow"
        )
    return Result(
        f"error along {worst_along:.1e}, flow across {worst_across:.1e}",
        "≤ 1e-9 both",
        worst_along <= 1e-9 and worst_across <= 1e-9,
        "\n".join(lines),
    )
