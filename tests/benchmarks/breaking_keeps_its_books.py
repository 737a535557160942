"""A fracturing run of 1,440 grains: factorisations an event, books of volume and energy.

Fluid is injected into a hole until a fracture runs from it. A factor of an earlier matrix serves on
where a few solves with it are enough, so that an event costs few factorisations, its solves are
told beside. The volume that entered, and what every pore lacks; the work put in less what friction
in the fluid, sliding contacts and breaks took and what is stored, step by step and without signs.
"""

from __future__ import annotations

import numpy as np

from demflow.model.region import Rectangle
from demflow.model.scene import Bonds, Fluid, Grains, Matrix, Scene, Stress, Well
from demflow.model.scene.coupling import Coupling
from demflow.model.stages import simulate
from tests.benchmarks.result import Result

GRAINS = 1440
PER_EVENT, VOLUME, ENERGY = 12.0, 1e-9, 1e-4


def bored(
    seed: int,
    *,
    count: int = GRAINS,
    stress: tuple[float, float] = (10e6, 10e6),
    radius: float = 0.14,
    times: tuple[float, ...] = (0.25, 0.5, 0.75, 1.0),
) -> Scene:
    """A hole in stressed, cemented grains that fluid is injected into."""
    return Scene(
        region=Rectangle(2.0, 2.0),
        grains=Grains(count=count, porosity=0.16, seed=seed, modulus=20e9),
        bonds=Bonds(kind="parallel", tensile_strength=10e6, shear_strength=40e6),
        stress=Stress(*stress),
        matrix=Matrix(aperture=5e-6, gap_factor=1.0),
        fluid=Fluid(1e-3, 2.2e9),
        wells=(Well(name="bore", at=(0.0, 0.0), radius=radius, rate=-1e-3),),
        boundaries=(("outer", 0.0),),
        initial_pressure=0.0,
        coupling=Coupling(method="breaking"),
        times=times,
        observe=("well_pressure", "crack_length", "injected_volume"),
    )


def run() -> Result:
    """One run, through breakdown."""
    found = simulate(bored(1))
    events = len(found["event_time"])
    cost = float(found["breaking_factorisations"]) / max(events, 1)
    volume = max(float(found["mass_balance_error"]), float(found["mass_imbalance"]))
    energy = float(found["energy_imbalance"])
    lines = [
        f"{events} events, {found['breaking_factorisations']} factorisations, "
        f"{found['breaking_solves']} solves, stopped: {str(found.get('stopped', ''))!r}",
        f"well pressure in MPa {np.round(found['well_pressure'][0] / 1e6, 2).tolist()}",
        f"work that opening and closing within steps hides {found['energy_jerks']:.1e}",
        f"largest force out of balance over the mean contact force {found['unbalanced_ratio']:.1e}",
    ]
    return Result(
        f"{cost:.1f} factorisations an event; volume {volume:.1e}, energy {energy:.1e} of the work",
        f"≤ {PER_EVENT:g}; ≤ {VOLUME:g}, ≤ {ENERGY:g}",
        bool(events > 5 and cost <= PER_EVENT and volume <= VOLUME and energy <= ENERGY),
        "\n".join(lines),
    )
