"""Consolidation of layers that drain at the top against Terzaghi's degree of consolidation."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from demflow.model.analytic.terzaghi import consolidation_degree
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, Coupling, Fluid, Grains, Matrix, Scene, Solver
from demflow.model.stages import run_stages
from tests.benchmarks.result import Result

RADIUS, APERTURE, VISCOSITY, LOAD = 0.01, 1e-4, 1e-3, 1e6
HIGH, WIDE = 220.0, 120.0  # mean radii
SEEDS = tuple(range(1, 7))
T_V = np.geomspace(0.05, 1.0, 14)
LATTICE, MEAN, EACH = 3e-3, 0.02, 0.05


def layer(grains: Grains, width: float, height: float) -> Scene:
    """A laterally held specimen that is loaded and drained at its top."""
    return Scene(
        region=Rectangle(width, height),
        grains=grains,
        matrix=Matrix(aperture=APERTURE),
        fluid=Fluid(VISCOSITY, 2.2e9),
        bonds=Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9),
        boundaries=(("top", 0.0),),
        initial_pressure=0.0,
        coupling=Coupling(method="linear", held="right", load_yy=LOAD),
        times=(1e6,),
        solver=Solver(tolerance=1e-6),
        observe=("wall_displacement", "permeability"),
    )


def errors(scene: Scene) -> np.ndarray:
    """Relative errors of the degree of consolidation at T_V.

    By the drained way and the undrained one of the same specimen, its storage and permeability.
    """
    products = run_stages(scene)
    found, box = products["observe"], products["pack"].box
    observed = ("wall_displacement",)
    sealed = run_stages(dataclasses.replace(scene, boundaries=(), observe=observed))["observe"]
    height = box[3] - box[2]
    drained, undrained = (one["wall_displacement"][3, -1] for one in (found, sealed))
    storage = float(found["porosity"]) / 2.2e9
    compliance = -drained / height / LOAD
    diffusivity = found["permeability"][1, 1] / VISCOSITY / (storage + compliance)
    times = tuple((T_V * height**2 / diffusivity).tolist())
    way = run_stages(dataclasses.replace(scene, times=times, observe=observed))["observe"]
    degree = (way["wall_displacement"][3] - undrained) / (drained - undrained)
    return np.asarray(degree / consolidation_degree(T_V) - 1.0)


def run() -> Result:
    """Largest error on square lattices of two heights, and over random packings."""
    largest = []
    for rows in (30, 60):
        grains = Grains(mean_radius=RADIUS, packing="square", modulus=2e10)
        found = errors(layer(grains, 20 * RADIUS, 2 * rows * RADIUS))
        largest.append(np.abs(found).max())
    order = math.log2(largest[0] / largest[1])
    lines = [
        f"square lattice, 30 and 60 rows: {largest[0]:.2%}, {largest[1]:.3%}, order {order:.2f}"
    ]
    worst = []
    for seed in SEEDS:
        grains = Grains(mean_radius=RADIUS, porosity=0.17, seed=seed, modulus=2e10)
        found = errors(layer(grains, WIDE * RADIUS, HIGH * RADIUS))
        worst.append(found[np.argmax(np.abs(found))])
        lines.append(f"random packing {seed}: {worst[-1]:+.2%}")
    mean, each = abs(np.mean(worst)), np.abs(worst).max()
    holds = largest[1] <= LATTICE and largest[0] <= LATTICE and abs(order - 2.0) < 0.2
    holds = holds and mean <= MEAN and each <= EACH
    return Result(
        f"square {largest[0]:.2%} with order {order:.2f}; {len(worst)} random packings {mean:.1%} "
        f"in the mean, {each:.1%} at most",
        f"≤ {LATTICE:.1%} with order 2; ≤ {MEAN:.0%}, ≤ {EACH:.0%}",
        bool(holds),
        "\n".join(lines),
    )
