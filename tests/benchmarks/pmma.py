"""The fracture in PMMA of Rubin (1983): why no fracture in plane strain can be it.

Rubin, M. B. (1983), J. Energy Resour. Technol. 105, 116: a viscous fluid, injected at a constant
rate into a plate 55 mm thick; pressures and lengths at three times. Two things forbid it, whatever
the fluid and whatever resists:

- *Volume.* Open over the length that was told, under the pressure of the well all along, which is
  more than any fluid brings, a crack in plane strain of the plate's modulus holds 2 π ℓ² p / E'
  (Sneddon 1946): less than was injected by then. What was told is taken as half-lengths; as whole
  ones they would hold a fourth of that.
- *Pressure.* A plane fracture at a constant rate without leak-off has no length and no time of its
  own: its length grows as t^(2/3), its pressure falls as t^(−1/3), with factors that the
  dimensionless toughness K_m alone sets (Detournay 2004). The best that all materials and rates at
  once can come to is the factor that splits the largest misfit evenly.

The study *pmma* has the plate's modulus, toughness, viscosity and rate in two packings; nothing is
free. Its lengths are held against the limit of friction in the fluid (K_m is near 1), with the
packing's own modulus and way of its pipes as in `kgd`: what misses the plate is plane strain, not
the grains. The fracture is 9, 15 and 30 grains long on either side at the three times.
"""

from __future__ import annotations

import numpy as np

from demflow.model.analytic import kgd
from demflow.model.stages import run_stages
from demflow.sweep.study.load import load_study
from demflow.sweep.study.scenes import SceneBuilder
from tests.benchmarks.kgd import (
    broken_by,
    given_of,
    growth,
    plane_modulus,
    plane_of,
    toughness,
    way,
)
from tests.benchmarks.result import Result

TIME = np.array([11.9, 24.3, 68.9])  # s
PRESSURE = np.array([5.43e6, 2.51e6, 0.97e6])  # Pa
LENGTH = np.array([0.030, 0.060, 0.112])  # m
BULK, SHEAR, TOUGHNESS = 4.11e9, 1.2e9, 1.2e6
VISCOSITY, RATE, HEIGHT = 97.7, 73.2e-9, 0.055
LENGTHS, PRESSURES = 0.15, 0.20
GROWN = 0.03, 0.10  # m: half-lengths between which the toughness of grains is measured


def least_misfit(measured: np.ndarray, power: float) -> float:
    """Largest relative misfit of c t^power to what was measured, at the best c."""
    ratio = measured / TIME**power
    return float((ratio.max() - ratio.min()) / (ratio.max() + ratio.min()))


def told(name: str, half: np.ndarray, pressure: np.ndarray) -> str:
    """Half-lengths and pressures at the three times, and over what was measured."""
    return (
        f"{name}: half-lengths {np.round(1e3 * half, 1)} mm, {np.round(half / LENGTH, 2)} of the "
        f"plate's; pressures {np.round(pressure / 1e6, 2)} MPa, {np.round(pressure / PRESSURE, 2)}"
    )


def run() -> Result:
    """The least misfits of all plane fractures, and the plate's own."""
    plane = 4.0 * SHEAR * (3.0 * BULK + SHEAR) / (3.0 * BULK + 4.0 * SHEAR)  # E / (1 − ν²)
    own = {"plane_modulus": plane, "rate": RATE / HEIGHT}
    strong = kgd.dimensionless_toughness(**own, toughness=TOUGHNESS, viscosity=VISCOSITY)
    thick = kgd.viscosity_dominated(TIME, **own, viscosity=VISCOSITY)
    tough = kgd.toughness_dominated(TIME, **own, toughness=TOUGHNESS)
    lengths, pressures = least_misfit(LENGTH, 2.0 / 3.0), least_misfit(PRESSURE, -1.0 / 3.0)
    lines = [
        f"E' {plane / 1e9:.2f} GPa, K_m {strong:.2f}; measured lengths {1e3 * LENGTH} mm, "
        f"pressures {PRESSURE / 1e6} MPa at {TIME} s",
        told("friction alone", thick.half_length, thick.pressure),
        told("toughness alone", tough.half_length, tough.pressure),
    ]
    held = 2.0 * np.pi * LENGTH**2 * PRESSURE / plane / (RATE / HEIGHT * TIME)
    lines.append(
        f"a plane crack of those lengths and pressures holds at most {np.round(100 * held)} % of "
        "what was injected"
    )
    study = load_study("studies/pmma.yaml")
    built = SceneBuilder(study.values, study.axes)
    found, over = [], []
    for seed in range(study.shape[0]):
        scene = built.scene((seed,))
        assert scene.stress is not None
        assert scene.fluid is not None
        products = run_stages(scene)
        march, given = products["fracture"], given_of(scene, products["pack"])
        weak = plane_of(given)
        grown = growth(scene, march, given, weak)
        at = np.searchsorted(grown.time, TIME - 1e-6)
        found.append((grown.half_length[at], grown.pressure[at]))
        modulus = plane_modulus(given, products["pack"])
        longer = way(given, weak, VISCOSITY, broken_by(march))
        exact = [
            kgd.viscosity_dominated(
                time, plane_modulus=modulus, viscosity=longer * VISCOSITY, rate=rate
            ).half_length
            for time, rate in zip(TIME, grown.rate[at], strict=True)
        ]
        over.append(grown.half_length[at] / np.array(exact))
        lines.append(
            told(f"packing {seed + 1}", *found[-1]) + f"; E' {modulus / 1e9:.2f} GPa, K_Ic "
            f"{toughness(given, weak, scene.stress.yy, GROWN) / 1e6:.2f} MPa√m, χ {longer:.2f}; "
            f"{np.round(over[-1], 2)} of the limit's lengths; "
            f"{march.state.stopped!s}"
        )
    half, pressure = np.mean(found, axis=0)
    off = float(np.abs(np.mean(over, axis=0) - 1.0).max())
    holds = held.max() < 1.0 and pressures > PRESSURES and off <= LENGTHS
    return Result(
        f"plane strain holds {', '.join(f'{one:.0%}' for one in held)} of the volume at the most "
        f"and misses pressures by {pressures:.0%} at the least (lengths by {lengths:.0%}); the "
        f"march's lengths are {', '.join(f'{one:+.0%}' for one in half / LENGTH - 1.0)} beside the "
        f"plate's, its pressures {', '.join(f'{one:+.0%}' for one in pressure / PRESSURE - 1.0)}, "
        f"its lengths within {off:.0%} of the closed form's",
        f"forbidden: < 100% and > {PRESSURES:.0%}; ≤ {LENGTHS:.0%}",
        bool(holds),
        "\n".join(lines),
    )
