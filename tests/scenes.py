"""Random scenes of the public door, small enough for the oracle in extended precision."""

from __future__ import annotations

import numpy as np

from demflow.model.region import Rectangle
from demflow.model.scene import Fluid, Fracture, Grains, Matrix, Probe, Scene, Trace, Well

APERTURE, VISCOSITY, MODULUS = 1e-5, 1e-3, 1e9
START = 7e6


def random_scene(seed: int) -> Scene:
    """Wells, skins, storage, schedules, fractures and barriers, sides at a pressure.

    Conductances up to 1e9 apart; pressures that sources make up to a thousand times apart, in a
    window of 3 to 7 decades that ends when the region may have come to rest.
    """
    rng = np.random.default_rng(seed)
    width, height = 2.0, float(rng.uniform(1.2, 2.0))
    region = Rectangle(width, height)

    def place(room: float = 0.35) -> tuple[float, float]:
        x, y = rng.uniform(-0.5, 0.5, 2) * (width - room, height - room)
        return float(x), float(y)

    fractures: list[Fracture] = []
    for k in range(int(rng.integers(0, 4))):
        if rng.random() < 0.3:
            fractures.append(
                Trace(
                    name=f"f{k}",
                    start=place(),
                    end=place(),
                    transmissibility_multiplier=float(10 ** rng.uniform(-4, -1)),
                )
            )
        else:
            fractures.append(
                Trace(
                    name=f"f{k}",
                    start=place(),
                    end=place(),
                    aperture=APERTURE * float(10 ** rng.uniform(0.3, 3.0)),
                )
            )
    # k of the matrix is some w³ / (24 r), and eta = k K_f / (mu porosity)
    grains = int(rng.integers(90, 180))
    radius = np.sqrt(0.84 * width * height / grains / np.pi)
    mobility = APERTURE**3 / (24.0 * radius) / VISCOSITY
    rest = 0.17 * width**2 / (mobility * MODULUS)
    last = float(rest * 10 ** rng.uniform(-1.0, 1.0))
    first = last * float(10 ** -rng.uniform(3.0, 7.0))
    times = np.geomspace(first, last, int(rng.integers(15, 40)))

    wells: list[Well] = []
    for k in range(int(rng.integers(1, 4))):
        at = place()
        if any(np.hypot(at[0] - w.at[0], at[1] - w.at[1]) < 0.4 for w in wells):
            continue
        skin = float(rng.choice([0.0, rng.uniform(0.0, 10.0)]))
        storage = (
            float(rng.choice([0.0, 10 ** rng.uniform(-2, 1)])) / MODULUS * width * height * 0.01
        )
        given = {"name": f"w{k}", "at": at, "radius": 0.03, "skin_factor": skin}
        rate = mobility * 10 ** rng.uniform(4.0, 7.0) * float(rng.choice([-1.0, 1.0]))
        kind = rng.random()
        if kind < 0.25:
            pressure = START + 10 ** rng.uniform(4.0, 6.5) * float(rng.choice([-1.0, 1.0]))
            wells.append(Well(pressure=float(pressure), **given))
        elif kind < 0.6:
            wells.append(Well(rate=float(rate), wellbore_storage=storage, **given))
        else:
            at_times = np.sort(rng.choice(times[:-4], int(rng.integers(1, 3)), replace=False))
            factors = [1.0, *rng.choice([0.0, 0.5, 2.0, -1.0], len(at_times))]
            schedule = tuple(
                (float(t), float(rate * f)) for t, f in zip((0.0, *at_times), factors, strict=True)
            )
            wells.append(Well(schedule=schedule, wellbore_storage=storage, **given))
    sides = [s for s in ("left", "right", "bottom", "top") if rng.random() < 0.35]
    boundaries = tuple(
        (s, float(START + rng.choice([0.0, 10 ** rng.uniform(4.0, 6.5)]))) for s in sides
    )
    probes = tuple(Probe(f"p{k}", place(0.1)) for k in range(3))
    observe = ["well_pressure", "probe_pressure", "pressure_map"]
    if boundaries:
        observe.append("boundary_flow")
    return Scene(
        region=region,
        grains=Grains(count=grains, porosity=0.17, seed=seed),
        matrix=Matrix(aperture=APERTURE),
        fluid=Fluid(VISCOSITY, MODULUS),
        fractures=tuple(fractures),
        wells=tuple(wells),
        boundaries=boundaries,
        probes=probes,
        initial_pressure=START,
        times=tuple(float(t) for t in times),
        observe=tuple(observe),
    )
