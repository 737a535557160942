"""Inflow of 63 mapped traces in permeable rock, against a conforming solution (2018 benchmark).

Case 4 of Flemisch et al. 2018, Adv. Water Resour. 111, 239–258, at 1 Pa s. The inflow of any
pressure that is continuous over triangles is above the true one (`tests/traces_on_triangles.py`).
Linear ones on three meshes gave 6.46, 6.39 and 6.353e-8 m³/s, which was carried on to 6.34e-8;
quadratic ones give 6.314e-8 here and 6.3130e-8 on the finest of others' meshes tried.

The rock is one (`scatter: even`): among 5,000 grains as they happen to lie the rock between the
traces differs by enough to move the inflow by up to 6.5 %.
"""

from __future__ import annotations

import csv

import numpy as np

from demflow.model import simulate
from demflow.model.scene import Fluid, Grains, Matrix, Rectangle, Scene, Trace
from tests.benchmarks.outside_data import outside
from tests.benchmarks.result import Result
from tests.traces_on_triangles import flow

WIDTH, HEIGHT = 700.0, 600.0
PERMEABILITY, DROP = 1e-14, 1_013_250.0
SIZES_OF_TRIANGLES = (0.1, 0.25, 12.0)  # m at tips and crossings, growth, m far away
LINEAR = 6.34e-8  # m³/s, from linear pressures
APERTURE = (12.0 * 1e-10) ** (1 / 3)  # of the transmissivity 1e-2 m · 1e-8 m²
PACKINGS = 6
SIZES = {5_000: (0.03, 0.06), 20_000: (0.02, 0.04), 80_000: (0.01, 0.02)}  # mean, worst
DATA = "traces/flemisch_case_4.csv"  # id, x0, y0, x1, y1 in m


def inflow(traces: tuple[Trace, ...], grains: int, seed: int) -> float:
    """Flow that enters at the left."""
    found = simulate(
        Scene(
            region=Rectangle(WIDTH, HEIGHT),
            grains=Grains(count=grains, seed=seed, porosity=0.17, scatter="even"),
            matrix=Matrix(permeability=PERMEABILITY),
            fluid=Fluid(viscosity=1.0, bulk_modulus=1e9),
            fractures=traces,
            boundaries=(("left", DROP), ("right", 0.0)),
            observe=("boundary_flow",),
        )
    )
    return float(found["boundary_flow"][0])


def run() -> Result:
    """Mean and worst deviation over packings of each size."""
    bound = "; ".join(f"{n}: mean ≤ {m:.0%}, worst ≤ {w:.0%}" for n, (m, w) in SIZES.items())
    with outside(DATA).open(newline="") as file:
        rows = np.array([[float(v) for v in row[1:5]] for row in list(csv.reader(file))[1:]])
    open_ = APERTURE**3 / 12.0 / PERMEABILITY
    expected = PERMEABILITY * DROP * flow(WIDTH, HEIGHT, rows, open_, *SIZES_OF_TRIANGLES)
    rows -= 0.5 * np.array([WIDTH, HEIGHT, WIDTH, HEIGHT])
    traces = tuple(
        Trace(name=f"t{k}", aperture=APERTURE, start=tuple(row[:2]), end=tuple(row[2:]))
        for k, row in enumerate(rows.tolist())
    )
    figures, holds = [], True
    lines = [
        f"{expected:.4e} m³/s by quadratic pressures; over {LINEAR:.2e} {expected / LINEAR:.4f}"
    ]
    for grains, (mean, worst) in SIZES.items():
        off = np.array([inflow(traces, grains, s + 1) / expected - 1.0 for s in range(PACKINGS)])
        error = off.std(ddof=1) / np.sqrt(PACKINGS)
        holds &= abs(off.mean()) <= mean and np.abs(off).max() <= worst
        figures.append(f"{grains}: mean {off.mean():+.1%}, worst {np.abs(off).max():.1%}")
        lines.append(f"{grains} grains: {off.mean():+.4f} ± {error:.4f}, {np.round(off, 4)}")
    return Result("; ".join(figures), bound, bool(holds), "\n".join(lines))
