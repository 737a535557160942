"""Inflow into an excavated drift: Goodman's without closure, and less by the stress around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from demflow.model import simulate
from demflow.model.scene import Circle, CircularHole, Scene
from tests.benchmarks.ran import ran
from tests.benchmarks.result import Result
from tests.benchmarks.tunnel_inflow_against_goodman import in_the_box, logarithm

OPEN, STRESSED = 0.05, 0.05  # bounds of the two errors
PLACES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95)  # a²/r² at which the permeability is measured
SEEDS, GRAINS = (1, 2, 3), 2_000


def radial_permeability(scene: Scene) -> np.ndarray:
    """Permeability towards a round hole at the places, m², where σ far away is `stress.yy`.

    That of discs of the same rock without a hole, under Kirsch's σ (1 − a²/r²) in the direction
    of flow and σ (1 + a²/r²) across it.
    """
    found = np.empty((len(SEEDS), len(PLACES)))
    assert scene.stress is not None
    far = scene.stress.yy
    for row, seed in enumerate(SEEDS):
        for column, part in enumerate(PLACES):
            disc = replace(
                scene,
                region=Circle(10.0),
                grains=replace(scene.grains, count=GRAINS, seed=seed),
                stress=replace(scene.stress, xx=far * (1.0 - part), yy=far * (1.0 + part)),
                excavate=(),
                gravity=None,
                boundaries=(),
                observe=("permeability",),
            )
            found[row, column] = simulate(disc)["permeability"][0, 0]
    return found.mean(axis=0)


def skin(k: np.ndarray) -> float:
    """What the permeability around adds to the logarithm: ∫ (k_far/k − 1) dr/r."""
    places = np.array(PLACES)
    fine = np.linspace(0.0, 1.0, 2001)[1:]
    more = np.interp(fine, places, k[0] / k) - 1.0
    return float(0.5 * np.mean(more / fine))  # dr/r = −dρ/(2 ρ)


def run() -> Result:
    """Mean inflow over packings against both laws; it falls with stress in every packing."""
    study = ran("drift_inflow")
    flow = -study.dataset["boundary_flow"].sel(boundary="drift")
    lines = []
    scene = study.scene_of({"stress_xx": 1, "half_stress": 0, "seed": 0})
    drift, k = scene.excavate[0], scene.matrix.permeability
    assert isinstance(drift, CircularHole)
    assert k is not None
    assert scene.stress is not None
    law = in_the_box(scene, drift.at[1], drift.radius, k)
    without = flow.isel(half_stress=-1)
    free = float(without.mean()) / law - 1.0
    lines.append(
        f"without closure {float(without.mean()):.4g} m³/s, law {law:.4g}: {free:+.1%}, spread "
        f"{float(without.std() / without.mean()):.1%}"
    )
    whole = logarithm(scene, drift.at[1], drift.radius)
    worst = 0.0
    for number in range(flow.sizes["half_stress"] - 1):
        own = study.scene_of({"stress_xx": 1, "half_stress": number, "seed": 0})
        around = radial_permeability(own)
        half, more = float(flow["half_stress"][number]), skin(around)
        expected = law * float(around[0]) / k * whole / (whole + more)
        found = float(flow.isel(stress_xx=1, half_stress=number).mean())
        worst = max(worst, abs(found / expected - 1.0))
        lines.append(
            f"20 MPa all around, σ0 {half / 1e6:g} MPa: k/k_0 {np.round(around / k, 4)} at a²/r² "
            f"of {PLACES}, skin {more:.2f} beside {whole:.2f}; inflow {found:.4g} m³/s, "
            f"{found / expected - 1.0:+.1%} against {expected:.4g}"
        )
    falls = bool((flow.isel(half_stress=slice(0, -1)).diff("stress_xx") < 0.0).all())
    lines.append(f"falls with stress in every packing: {falls}")
    return Result(
        f"off by {abs(free):.1%} without closure, by {worst:.1%} with it",
        f"≤ {OPEN:.0%} and ≤ {STRESSED:.0%}, falling with stress",
        abs(free) <= OPEN and worst <= STRESSED and falls,
        "\n".join(lines),
    )
