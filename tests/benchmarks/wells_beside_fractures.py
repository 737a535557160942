"""Wells half a pore to two pores beside a fracture that conducts without resistance, or its tip.

In a disc with its rim at a constant pressure and the fracture along its diameter at the same, a
well at z falls by ln((1 − |z|²) / |1 − z²|) + arcosh(|Im z| / r_w) over 2π k/μ.
With a fracture along a radius alone the disc is half a disc in √z, and the well's radius there
r_w / |2 √z|.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from demflow.model.mechanics.packing.packing import pack
from demflow.model.scene import Trace
from tests.benchmarks.result import Result
from tests.benchmarks.wells_of_any_width import DISC, fall, spacing, transmits
from tests.reservoirs import reservoir

PACKINGS, PLACES = 6, 40
ACROSS = Trace(name="across", aperture=3e-3, start=(-1.5, 0.0), end=(1.5, 0.0))
HALF = Trace(name="half", aperture=3e-3, start=(0.0, 0.0), end=(1.5, 0.0))


def beside_a_line(at: complex, radius: float) -> float:
    """2π k/μ times the fall of the pressure in the continuum."""
    away = math.acosh(abs(at.imag) / radius)  # of a circle from a straight line
    return math.log((1 - abs(at) ** 2) / abs(1 - at**2)) + away


def around_a_tip(at: complex, radius: float) -> float:
    """2π k/μ times the fall of the pressure in the continuum, the tip in the middle."""
    w = cmath.sqrt(at)
    w = w if w.imag > 0 else -w
    half = 2 * w.imag * (1 - abs(w) ** 2) / abs(1 - w * w)
    return math.log(half * 2 * abs(w) / radius)


def run() -> Result:
    """Mean, standard deviation and largest of the relative errors of the drawdown."""
    rng = np.random.default_rng(11)
    found: dict[str, list[float]] = {"0.5 to 1 pores away": [], "1 to 2 pores away": [], "tip": []}
    for seed in range(1, PACKINGS + 1):
        packing = pack(
            region=DISC, count=1500, mean_radius=None, packing="random",
            radius_ratio=1.66, porosity=0.16, seed=seed,
        )  # fmt: skip
        rock = reservoir(packing, DISC)
        lined = reservoir(packing, DISC, fractures=(ACROSS,))
        slit = reservoir(packing, DISC, fractures=(HALF,))
        h, unit = spacing(rock), transmits(rock)
        for number in range(PLACES):
            away = rng.uniform(0.5, 2.0)
            at = complex(rng.uniform(-0.6, 0.6), away * h * rng.choice([-1, 1]))
            radius = (0.01, 0.1, 0.3)[number % 3] * h
            off = fall(lined, at, radius) * unit / beside_a_line(at, radius) - 1
            found["0.5 to 1 pores away" if away < 1.0 else "1 to 2 pores away"].append(off)
            at = h * away * cmath.exp(1j * rng.uniform(0.3 * math.pi, 1.7 * math.pi))
            radius = (0.01, 0.03, 0.1)[number % 3] * h
            found["tip"].append(fall(slit, at, radius) * unit / around_a_tip(at, radius) - 1)
    off = np.concatenate([np.array(part) for part in found.values()])
    lines = [
        f"{name}: mean {100 * np.mean(part):+.2f} ± "
        f"{100 * np.std(part) / math.sqrt(len(part)):.2f} %, deviation {100 * np.std(part):.2f} %, "
        f"at worst {100 * np.abs(part).max():.2f} %, {len(part)} wells"
        for name, part in found.items()
    ]
    return Result(
        f"mean {100 * off.mean():+.2f} %, deviation {100 * off.std():.2f} %, at worst "
        f"{100 * np.abs(off).max():.2f} %",
        "≤ 2, 3, 8 %",
        bool(abs(off.mean()) <= 0.02 and off.std() <= 0.03 and np.abs(off).max() <= 0.08),
        "\n".join(lines),
    )
