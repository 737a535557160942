"""Inflow of 63 mapped traces in permeable rock, against a conforming solution (2018 benchmark)."""

from __future__ import annotations

import csv

import numpy as np

from demflow.model import simulate
from demflow.model.scene import Fluid, Grains, Matrix, Rectangle, Scene, Trace
from tests.benchmarks.outside_data import outside
from tests.benchmarks.result import Result

# Case 4 of Flemisch et al. 2018, Adv. Water Resour. 111, 239–258, and its inflow in m³/s at 1 Pa s.
INFLOW = 6.34e-8
APERTURE = (12.0 * 1e-10) ** (1 / 3)  # of the transmissivity 1e-2 m · 1e-8 m²
PACKINGS = 6
SIZES = {5_000: (0.03, 0.06), 20_000: (0.02, 0.04), 80_000: (0.01, 0.02)}  # mean, worst
DATA = "traces/flemisch_case_4.csv"  # id, x0, y0, x1, y1 in m


def inflow(traces: tuple[Trace, ...], grains: int, seed: int) -> float:
    """Flow that enters at the left."""
    found = simulate(
        Scene(
            region=Rectangle(700.0, 600.0),
            grains=Grains(count=grains, seed=seed, porosity=0.17),
            matrix=Matrix(permeability=1e-14),
            fluid=Fluid(viscosity=1.0, bulk_modulus=1e9),
            fractures=traces,
            boundaries=(("left", 1_013_250.0), ("right", 0.0)),
            observe=("boundary_flow",),
        )
    )
    return float(found["boundary_flow"][0])


def run() -> Result:
    """Mean and worst deviation over packings of each size."""
    bound = "; ".join(f"{n}: mean ≤ {m:.0%}, worst ≤ {w:.0%}" for n, (m, w) in SIZES.items())
    with outside(DATA).open(newline="") as file:
        rows = np.array([[float(v) for v in row[1:5]] for row in list(csv.reader(file))[1:]])
    rows -= np.array([350.0, 300.0, 350.0, 300.0])
    traces = tuple(
        Trace(name=f"t{k}", aperture=APERTURE, start=tuple(row[:2]), end=tuple(row[2:]))
        for k, row in enumerate(rows.tolist())
    )
    figures, lines, holds = [], [], True
    for grains, (mean, worst) in SIZES.items():
        off = np.array([inflow(traces, grains, s + 1) / INFLOW - 1.0 for s in range(PACKINGS)])
        error = off.std(ddof=1) / np.sqrt(PACKINGS)
        holds &= abs(off.mean()) <= mean and np.abs(off).max() <= worst
        figures.append(f"{grains}: mean {off.mean():+.1%}, worst {np.abs(off).max():.1%}")
        lines.append(f"{grains} grains: {off.mean():+.4f} ± {error:.4f}, {np.round(off, 4)}")
    return Result("; ".join(figures), bound, bool(holds), "\n".join(lines))
