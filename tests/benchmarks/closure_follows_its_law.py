"""A joint and a set close as each law says from 0.1 to 50 MPa, and k falls at every angle."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from demflow.model.network.fractures.closure import closed
from demflow.model.products import StressState
from demflow.model.scene import (
    BartonBandis,
    Bonds,
    Circle,
    Closure,
    Fluid,
    Fracture,
    FractureSet,
    Grains,
    Joint,
    Matrix,
    Scene,
    Stress,
    Trace,
)
from demflow.model.stages import STAGES
from tests.benchmarks.result import Result

STRESSES = (1e5, 1e6, 5e6, 20e6, 50e6)
ANGLES = (0.0, 30.0, 60.0, 90.0)
SEEDS = {"joint": (1, 2), "set": (1, 2, 3, 4, 5, 6)}
GRAINS = {"joint": 2_000, "set": 3_000}
APERTURE, BOUND = 1e-4, 0.01
LAWS = {
    "none": Closure(law="none"),
    "half_stress": Closure(half_stress=5e6),
    "stiffness": Closure(stiffness=2e12),
    "hyperbolic": Closure(stiffness=5e11, largest_closure=5e-5),
    "barton_bandis": Closure(barton_bandis=BartonBandis(jrc=8.0, jcs=8e7)),
    "table": Closure(table=((0.0, 1e-4), (1e6, 8e-5), (1e7, 5e-5), (5e7, 3e-5))),
}
PLANE = Joint(normal_stiffness=4e11, shear_stiffness=4e11, friction=0.6)


def rock(kind: str, seed: int, stress: float, fracture: Fracture) -> Scene:
    """A disc of bonded grains, packed loosely enough for 0.1 MPa to press on it."""
    return Scene(
        region=Circle(10.0),
        grains=Grains(
            count=GRAINS[kind], porosity=0.17, modulus=1e10, packing_stress=1.01e5, seed=seed
        ),
        bonds=Bonds(kind="parallel", tensile_strength=1e9, shear_strength=1e9),
        stress=Stress(xx=stress, yy=1.5 * stress),
        matrix=Matrix(permeability=1e-16, half_stress=5e6),
        fluid=Fluid(viscosity=1e-3, bulk_modulus=1e9),
        fractures=(fracture,),
        observe=("permeability",),
    )


def drawn(kind: str, angle: float) -> Fracture:
    """A joint through all of the disc, or a set."""
    if kind == "set":
        return FractureSet(name="set", angle=angle, length=5.0, spacing=2.5, aperture=APERTURE)
    x, y = 20.0 * math.cos(angle), 20.0 * math.sin(angle)
    return Trace(name="joint", start=(-x, -y), end=(x, y), aperture=APERTURE, joint=PLANE)


@cache
def shared(kind: str, seed: int) -> dict[str, Any]:
    """What all stresses and angles of a packing share."""
    scene = rock(kind, seed, 1e6, drawn("set", 0.0))
    wanted = ("pack", "unit_loads", "network", "calibrate")
    return run_some(scene, {}, wanted)


def run_some(scene: Scene, made: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    """The products with those of some stages beside."""
    made = dict(made)
    for stage in STAGES:
        if stage.name in names and stage.wanted(scene):
            parents = [made.get(name) for name in stage.parents]
            made[stage.name] = stage.run(*parents, **stage.given(scene))
    return made


def borne(state: StressState, start: np.ndarray, end: np.ndarray) -> float:
    """Mean stress across a line by all forces from grains on one side to those on the other."""
    along = (end - start) / np.hypot(*(end - start))
    n = np.array([-along[1], along[0]])
    place = np.column_stack([state.x, state.y]) - start
    a, b = state.contact_a, state.contact_b
    ha, hb = place[a] @ n, place[b] @ n
    part = ha / np.where(ha == hb, 1.0, ha - hb)
    at = (place[a] + part[:, None] * (place[b] - place[a])) @ along
    cut = (ha * hb < 0.0) & (at > 0.0) & (at < np.hypot(*(end - start)))
    branch = place[b] - place[a]
    normal = branch / np.hypot(*branch.T)[:, None]
    tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
    force = state.normal_force[:, None] * normal + state.shear_force[:, None] * tangent
    towards = np.where(hb > ha, 1.0, -1.0) * (force @ n)
    return float(towards[cut].sum() / np.hypot(*(end - start)))


def uniform(scene: Scene, angle: float) -> float:
    """Stress across a trace in a uniform stress, n · σ · n."""
    assert scene.stress is not None
    xx, yy, xy = scene.stress.components
    n = np.array([-math.sin(angle), math.cos(angle)])
    return float(n @ np.array([[xx, xy], [xy, yy]]) @ n)


def compared(kind: str, degrees: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each stress (and law): aperture over its law's, k (both by seeds), stress over uniform."""
    angle, seeds = math.radians(degrees), SEEDS[kind]
    ratio = np.empty((len(seeds), len(STRESSES), len(LAWS)))
    k, felt = np.empty_like(ratio), np.empty(ratio.shape[:2])
    for index in np.ndindex(*felt.shape):
        seed, stress = seeds[index[0]], STRESSES[index[1]]
        scene = rock(kind, seed, stress, drawn(kind, angle))
        made = run_some(scene, shared(kind, seed), ("stress", "walk"))
        across = uniform(scene, angle)
        if kind == "joint":
            walk = made["walk"]
            across = borne(made["stress"], walk.line_start[0], walk.line_end[0])
        felt[index] = across / uniform(scene, angle)
        for column, law in enumerate(LAWS.values()):
            closing = replace(scene, fractures=(replace(scene.fractures[0], closure=law),))
            opened = run_some(closing, made, ("open", "measure"))
            apertures, lengths = opened["open"].branch_aperture, opened["open"].branch_length
            expected = closed(np.array([APERTURE]), np.array([across]), law)[0]
            ratio[(*index, column)] = np.average(apertures, weights=lengths) / expected
            k[(*index, column)] = np.trace(opened["measure"].tensor)
    return ratio, k, felt


def run() -> Result:
    """Mean apertures over the law's: at n · σ · n of a set, at what the joint itself bears."""
    worst, falls, lines = 0.0, True, []
    for kind in GRAINS:
        for degrees in ANGLES:
            ratio, k, felt = compared(kind, degrees)
            off = np.abs(ratio.mean(axis=0) - 1.0).max(axis=0)
            worst = max(worst, float(off.max()))
            column = list(LAWS).index("none")
            closing = np.delete(k, column, axis=2)
            falls &= bool(np.all(np.diff(closing, axis=1) < 0.0))
            told = ", ".join(f"{name} {one:.2%}" for name, one in zip(LAWS, off, strict=True))
            lines.append(f"{kind} at {degrees:g}°: largest error over 0.1 to 50 MPa {told}")
            if kind == "joint":
                lines.append(f"  bears {felt.mean():.3f} ± {felt.std():.3f} of the uniform stress")
    lines.append(f"k falls with stress in every packing at every angle: {falls}")
    return Result(
        f"mean aperture off its law by {worst:.2%} at most",
        f"≤ {BOUND:.0%}, k falling with stress at every angle",
        worst <= BOUND and falls,
        "\n".join(lines),
    )
