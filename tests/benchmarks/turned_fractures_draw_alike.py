"""A set of fractures turned about a well in the middle of a disc leaves its drawdown as it was."""

from __future__ import annotations

import numpy as np

from demflow.model.mechanics.packing.packing import pack
from demflow.model.region import Circle
from demflow.model.scene import Trace, Well
from tests.benchmarks.result import Result
from tests.benchmarks.wells_of_any_width import spacing, transmits
from tests.reservoirs import reservoir

ANGLES, PACKINGS, GRAINS, BOUND = 12, 3, 5_000, 0.006
MATRIX, WIDE = 1e-5, 1.5e-4  # m
DISC = Circle(1.0)


def fractures(turned: float) -> tuple[Trace, ...]:
    """Sixteen of two directions, drawn once, none through the well, turned by an angle."""
    rng = np.random.default_rng(6)
    middle = rng.uniform(-0.6, 0.6, 16) + 1j * rng.uniform(-0.6, 0.6, 16)
    along = np.exp(1j * np.where(np.arange(16) % 2 == 0, 0.3, 1.5))
    middle += 0.1 * middle / np.abs(middle)
    ends = [(middle + side * 0.2 * along) * np.exp(1j * turned) for side in (-1, 1)]
    return tuple(
        Trace(name=f"t{k}", aperture=WIDE, start=(a.real, a.imag), end=(b.real, b.imag))
        for k, (a, b) in enumerate(zip(*ends, strict=True))
    )


def run() -> Result:
    """Standard deviation over angles, of the mean over them, at each time and packing."""
    worst, lines = 0.0, []
    for seed in range(1, PACKINGS + 1):
        packing = pack(
            region=DISC, count=GRAINS, mean_radius=None, packing="random",
            radius_ratio=1.66, porosity=0.16, seed=seed,
        )  # fmt: skip
        plain = reservoir(packing, DISC, MATRIX)
        h = spacing(plain)
        diffusivity = transmits(plain) / (2 * np.pi) * plain.bulk_modulus / plain.network.porosity
        # from when the pressure is some pores away to when the flow is steady
        times = tuple(np.append(np.geomspace(4 * h**2, 1.0, 7), 10.0) / diffusivity)
        well = Well(name="w", at=(0.0, 0.0), radius=0.3 * h, rate=1.0)
        seen = []
        for k in range(ANGLES):
            rock = reservoir(packing, DISC, MATRIX, fractures(np.pi * k / ANGLES))
            found = rock.observed(
                (well,), (("outer", 0.0),), 0.0, times, tolerance=1e-6, record_map=False
            )
            seen.append(-found["well_pressure"][0])
        spread = np.std(seen, axis=0) / np.mean(seen, axis=0)
        worst = max(worst, float(spread.max()))
        lines.append(f"packing {seed}, from early to steady: {np.round(100 * spread, 2)} %")
    return Result(
        f"at most {100 * worst:.2f} %", f"≤ {100 * BOUND:g} %", worst <= BOUND, "\n".join(lines)
    )
