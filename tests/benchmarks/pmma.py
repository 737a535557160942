"""The fracture in PMMA of Rubin (1983) against what any fracture in plane strain can do.

Rubin, M. B. (1983), J. Energy Resour. Technol. 105, 116: a viscous fluid, injected at a constant
rate into a plate 55 mm thick; pressures and lengths at three times. A plane fracture at a constant
rate without leak-off has no length and no time of its own: whatever the rock's moduli and toughness
and the fluid's viscosity, its length grows as t^(2/3) and its pressure falls as t^(−1/3), with
factors that the dimensionless toughness K_m alone sets (Detournay 2004). The best that plane strain
can come to, of all materials and rates at once, is the factor that splits the largest misfit
evenly. What is asked is that lengths are met within 15 % and pressures within 20 %; the verdict is
on the statement that the lengths can be and the pressures cannot.

The fracture is as long as the plate is thick after 24 s: from then on it is no plane one. A march
through breaking bonds, in plane strain with the plate's viscosity and rate for its thickness,
grains of about its modulus and a weak plane of about its toughness, shows the same: its pressure
falls no faster than by that law. The closed forms are printed beside.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from demflow.model.analytic import kgd
from demflow.model.region import Rectangle
from demflow.model.scene import BiWing, Fluid, Joint, Refinement, Scene, Well
from demflow.model.stages import run_stages
from tests.benchmarks.kgd import Regime, fractured
from tests.benchmarks.result import Result

TIME = np.array([11.9, 24.3, 68.9])  # s
PRESSURE = np.array([5.43e6, 2.51e6, 0.97e6])  # Pa
LENGTH = np.array([0.030, 0.060, 0.112])  # m
BULK, SHEAR, TOUGHNESS = 4.11e9, 1.2e9, 1.2e6
VISCOSITY, RATE, HEIGHT = 97.7, 73.2e-9, 0.055
LENGTHS, PRESSURES = 0.15, 0.20
SIDE, STRENGTH, GRAINS = 0.6, 9e6, 700  # m, Pa: of the weak plane; grains
STEADY = 1.1  # by which the march's pressure may fall faster: it falls and rises at each break


def least_misfit(measured: np.ndarray, power: float) -> float:
    """Largest relative misfit of c t^power to what was measured, at the best c."""
    ratio = measured / TIME**power
    return float((ratio.max() - ratio.min()) / (ratio.max() + ratio.min()))


def plate() -> Scene:
    """A weak plane in sealed grains of about the plate's modulus."""
    rate = RATE / HEIGHT
    scene = fractured(1, Regime(VISCOSITY, rate, STRENGTH, 3e-6), GRAINS)
    plane = Joint(
        normal_stiffness=7e12,
        shear_stiffness=3.5e12,
        friction=1.0,
        cohesion=1e9,
        tensile_strength=STRENGTH,
    )
    near = Refinement(around="traces", within=0.03 * SIDE, factor=3.0)
    return dataclasses.replace(
        scene,
        region=Rectangle(SIDE, SIDE),
        grains=dataclasses.replace(scene.grains, modulus=2.2e9, refine=(near,)),
        fractures=(
            BiWing(name="plane", at=(0.0, 0.0), angle=0.0, half_length=0.35 * SIDE, joint=plane),
        ),
        fluid=Fluid(VISCOSITY, 2e9),
        wells=(Well(name="bore", at=(0.0, 0.0), radius=0.008 * SIDE, rate=-rate),),
        times=tuple(TIME.tolist()),
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
        f"pressures {PRESSURE / 1e6} MPa at {TIME} s"
    ]
    lines += [
        f"{name}: half-lengths {np.round(1e3 * of.half_length, 1)} mm, pressures "
        f"{np.round(of.pressure / 1e6, 2)} MPa"
        for name, of in (("friction alone", thick), ("toughness alone", tough))
    ]
    scene = plate()
    assert scene.stress is not None
    records = run_stages(scene)["fracture"].records
    net = records.well_pressure[:, 0] - scene.stress.yy
    fall, plane_fall = net[0] / net[-1], (TIME[-1] / TIME[0]) ** (1.0 / 3.0)
    lines.append(
        f"march: half-lengths {np.round(500.0 * records.crack_length, 1)} mm, pressures "
        f"{np.round(net / 1e6, 2)} MPa; they fall to 1/{fall:.2f}, as t^(-1/3) would to "
        f"1/{plane_fall:.2f}, the plate's to 1/{PRESSURE[0] / PRESSURE[-1]:.2f}"
    )
    return Result(
        f"plane strain misses lengths by {lengths:.0%} and pressures by {pressures:.0%} at the "
        f"least, whatever the material; the march's pressure falls to 1/{fall:.2f}",
        f"lengths can be within {LENGTHS:.0%}, pressures cannot within {PRESSURES:.0%}; "
        f"1/{STEADY * plane_fall:.2f}",
        bool(lengths <= LENGTHS and pressures > PRESSURES and fall <= STEADY * plane_fall),
        "\n".join(lines),
    )
