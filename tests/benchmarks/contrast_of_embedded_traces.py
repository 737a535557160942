"""Steady flow with traces 1e12 times as conductive as a pipe is right in every component.

Traces that cross, end at both rims, run side by side within a pore, and along a row of grains,
each as long as it is with a well near, against dense elimination in extended precision.
"""

from __future__ import annotations

import numpy as np

from demflow.model.controls import sites
from demflow.model.flow.equation.balance import steady_flow
from demflow.model.flow.linear.factor import analyse, factorise
from demflow.model.products import Packing
from demflow.model.region import Rectangle
from demflow.model.scene import Trace
from tests.benchmarks.contrasts import SIDES, WELL, reference, residual
from tests.benchmarks.result import Result
from tests.reservoirs import reservoir
from tests.rocks import random_graph, square_lattice

CONTRAST, MATRIX = 1e12, 1e-5
PRESSURE, BALANCE = 1e-13, 1e-12
BOX = Rectangle(2.0, 2.0)


def lines(kind: str) -> list[tuple[float, float, float, float]]:
    """Ends of the traces of a kind."""
    rng = np.random.default_rng(4)
    if kind == "crossing":
        return [tuple(rng.uniform(-0.9, 0.9, 4)) for _ in range(12)]
    if kind == "ending at rims":
        return [(-1.0, -0.313, 1.0, 0.217), (-0.41, -1.0, 0.08, 1.0), (-1.0, 0.6, 0.3, 0.7)]
    if kind == "side by side in a pore":
        return [(-0.8, -0.3 + shift, 0.7, 0.4 + shift) for shift in (0.0, 2e-3, 5e-3)]
    return [(-1.0, row, 1.0, row) for row in (-0.2, 0.0, 0.32)]


def rock(kind: str, seed: int) -> Packing:
    """A random packing, or a lattice of which a row of grains lies at each multiple of 0.08."""
    if kind == "along a row of grains":
        return square_lattice(1.1, 0.04)
    packing = random_graph(1.1, 600, seed)
    return packing._replace(radius=0.5 * packing.radius)


def run() -> Result:
    """Largest relative error of any unknown, and of the balance, for a unit of each source."""
    worst, told = np.zeros(2), []
    kinds = ("crossing", "ending at rims", "side by side in a pore", "along a row of grains")
    for kind in kinds:
        for seed in (1, 2) if "grains" not in kind else (1,):
            wide = MATRIX * CONTRAST ** (1 / 3)
            traces = tuple(
                Trace(name=f"t{k}", aperture=wide, start=line[:2], end=line[2:])
                for k, line in enumerate(lines(kind))
            )
            made = reservoir(rock(kind, seed), BOX, MATRIX, traces)
            system = made.assembled(sites((WELL,)), tuple(name for name, _ in SIDES))
            factor = factorise(
                analyse(system.n, system.edge_i, system.edge_j), system.edge_g, system.excess
            )
            off = balance = 0.0
            for source in range(system.source_count):
                rhs = system.source(source)
                found = steady_flow(system, factor, source)
                exact = reference(system, rhs)
                off = max(off, float((np.abs(found.pressure - exact) / np.abs(exact)).max()))
                rest, _ = residual(system, source, found.pressure, found.remainder)
                moved = float(np.abs(found.link).sum() + np.abs(rhs[system.well_node]).sum())
                balance = max(balance, abs(float(rest.sum())) / moved)
            seen = made.observed((WELL,), SIDES, method="steady", record_map=False)
            balance = max(balance, float(seen["mass_balance_error"]))
            worst = np.maximum(worst, [off, balance])
            told.append(f"{kind}, {system.n} unknowns: pressure {off:.1e}, balance {balance:.1e}")
    return Result(
        "pressure {:.1e}, balance {:.1e}".format(*worst),
        f"≤ {PRESSURE:g}, ≤ {BALANCE:g}",
        bool(np.all(worst <= [PRESSURE, BALANCE])),
        "\n".join(told),
    )
