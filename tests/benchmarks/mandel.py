"""Slabs pressed between plates that drain at both sides against Mandel's rise of pressure."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import CubicSpline

from demflow.model.analytic.mandel import mandel_peak, slab
from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, Coupling, Fluid, Grains, Matrix, Probe, Scene, Solver
from demflow.model.stages import run_stages
from tests.benchmarks.result import Result

RADIUS, APERTURE, VISCOSITY, FLUID, LOAD = 0.01, 1e-4, 1e-3, 2.2e9, 1e6
WIDE, HIGH = 160.0, 80.0  # mean radii, of random slabs
SEEDS = tuple(range(1, 9))
PEAK, TIME, MEAN, EACH = 2e-3, 0.02, 0.01, 0.05


def pressed(grains: Grains, width: float, height: float) -> Scene:
    """A slab between plates; probes stand in a column in its middle."""
    column = np.linspace(-0.4, 0.4, 33) * height
    return Scene(
        region=Rectangle(width, height),
        grains=grains,
        matrix=Matrix(aperture=APERTURE),
        fluid=Fluid(VISCOSITY, FLUID),
        bonds=Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9),
        boundaries=(("left", 0.0), ("right", 0.0)),
        probes=tuple(Probe(f"p{k}", (0.0, float(y))) for k, y in enumerate(column)),
        initial_pressure=0.0,
        coupling=Coupling(method="linear", load_yy=LOAD),
        times=tuple(np.geomspace(2e-4, 1e-1, 109).tolist()),
        solver=Solver(tolerance=1e-6),
        observe=("probe_pressure", "wall_displacement", "permeability"),
    )


def peaks(scene: Scene) -> tuple[float, float]:
    """Peak of the pressure in the middle over Mandel's, and its time over his."""
    products = run_stages(scene)
    found, packing = products["observe"], products["pack"]
    width = packing.box[1] - packing.box[0]
    moduli = _moduli(scene)
    storage = float(found["porosity"]) / FLUID
    rock = slab(moduli, storage, found["permeability"][0, 0] / VISCOSITY)
    exact, at = mandel_peak(rock.ratio)
    middle = found["probe_pressure"].mean(axis=0)
    peak, time = _top(np.log(np.array(scene.times)), middle)
    reduced = rock.diffusivity * time / (0.5 * width) ** 2
    return float(peak / (exact * rock.pressure * LOAD)), float(reduced / at)


def _top(log: np.ndarray, pressure: np.ndarray) -> tuple[float, float]:
    """Largest pressure and its time, s, by a spline over the logarithm of time."""
    spline = CubicSpline(log, pressure)
    places = spline.derivative().roots(extrapolate=False)
    top = places[np.argmax(spline(places))]
    return float(spline(top)), float(np.exp(top))


def _moduli(scene: Scene) -> np.ndarray:
    """Drained moduli (2, 2) Pa of the specimen, by the last ways of its walls under each load."""
    compliance = np.zeros((2, 2))
    for column, load in enumerate(("load_xx", "load_yy")):
        loaded = dataclasses.replace(
            scene,
            coupling=Coupling(method="linear", **{load: LOAD}),
            observe=("wall_displacement",),
            times=(1e5,),
        )
        products = run_stages(loaded)
        box = products["pack"].box
        way = products["observe"]["wall_displacement"][[1, 3], -1]
        compliance[:, column] = -way / LOAD / np.array([box[1] - box[0], box[3] - box[2]])
    return np.linalg.inv(compliance)


def run() -> Result:
    """Peak and its time on a square lattice, and over random packings."""
    grains = Grains(mean_radius=RADIUS, packing="square", modulus=2e10)
    peak, time = peaks(pressed(grains, 120 * RADIUS, 40 * RADIUS))
    lines = [f"square lattice, 60 columns: peak {peak - 1:+.3%}, its time {time - 1:+.2%}"]
    off = []
    for seed in SEEDS:
        grains = Grains(mean_radius=RADIUS, porosity=0.17, seed=seed, modulus=2e10)
        found, when = peaks(pressed(grains, WIDE * RADIUS, HIGH * RADIUS))
        off.append(found - 1.0)
        lines.append(f"random packing {seed}: peak {off[-1]:+.2%}, its time {when - 1:+.1%}")
    mean, each = abs(np.mean(off)), np.abs(off).max()
    holds = abs(peak - 1) <= PEAK and abs(time - 1) <= TIME and mean <= MEAN and each <= EACH
    return Result(
        f"square peak {peak - 1:+.2%}, its time {time - 1:+.1%}; {len(off)} random packings: peak "
        f"{mean:.1%} in the mean, {each:.1%} at most",
        f"≤ {PEAK:.1%}, ≤ {TIME:.0%}; ≤ {MEAN:.0%}, ≤ {EACH:.0%}",
        bool(holds),
        "\n".join(lines),
    )
