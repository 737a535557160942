"""Drawdown and build-up with storage and skin against the continuum's Laplace-space solution."""

from __future__ import annotations

import math

import numpy as np

from model.analytic.wellbore import horner_time, well_with_storage_and_skin
from model.region import Circle
from model.scene import Scene
from tests.benchmarks.ran import ran
from tests.benchmarks.result import Result

FIRST = 100.0  # s after a change; without storage, single pores show before it
HORNER_FROM = 600.0  # s after the shut-in


def continuum(scene: Scene, porosity: float, times: np.ndarray) -> np.ndarray:
    """Pressure of the well, Pa: steps of rate superposed (van Everdingen & Hurst, Agarwal)."""
    assert isinstance(scene.region, Circle)
    assert scene.uniform_pressure is not None
    well, fluid, k = scene.wells[0], scene.fluid, scene.matrix.permeability or math.nan
    radius = well.effective_radius
    unit = porosity * fluid.viscosity * radius**2 / (k * fluid.bulk_modulus)
    C_D = well.wellbore_storage * fluid.bulk_modulus / (2 * math.pi * porosity * radius**2)
    pressure = np.full(len(times), scene.uniform_pressure)
    before = 0.0
    for start, rate in well.rate_changes:
        acts = times > start
        p_D = well_with_storage_and_skin(
            (times[acts] - start) / unit,
            C_D,
            max(well.skin_factor, 0.0),
            scene.region.radius / radius,
        )
        pressure[acts] -= (rate - before) * fluid.viscosity / (2 * math.pi * k) * p_D
        before = rate
    return pressure


def run() -> Result:
    """Relative error of the pressure change, and of the permeability by Horner's line.

    A stimulated well is too wide for its flow to be radial before the rim is felt, so that its
    build-up has no Horner line here.
    """
    study = ran("build_up")
    data = study.dataset
    times = data["elapsed_time"].values
    lines, worst, horner = [], 0.0, 0.0
    for skin in range(data.sizes["skin"]):
        for storage in range(data.sizes["storage"]):
            index = {"skin": skin, "storage": storage}
            scene, case = study.scene_of(index), data.isel(index)
            well, mu = scene.wells[0], scene.fluid.viscosity
            (_, rate), (shut, _) = well.rate_changes
            found = case["well_pressure"].values[0]
            expected = continuum(scene, float(case["porosity"]), times)
            errors = []
            first = FIRST if well.wellbore_storage == 0.0 else 0.0
            for start in (0.0, shut):
                period = (times > start) & (times <= (shut if start == 0.0 else np.inf))
                settled = period & (times - start >= first)
                level = scene.uniform_pressure if start == 0.0 else expected[times == shut]
                reached = scene.uniform_pressure if start == 0.0 else found[times == shut]
                change, formula = found[settled] - reached, expected[settled] - level
                errors.append(np.abs(change / formula - 1).max())
            since = times - shut
            late = since >= HORNER_FROM
            text = (
                f"skin {well.skin_factor:+g}, storage {well.wellbore_storage:g} m³/Pa: Δp off by "
            )
            text += (
                f"{100 * errors[0]:.1f} % in the drawdown, {100 * errors[1]:.1f} % in the build-up"
            )
            if well.wellbore_storage == 0.0 and well.skin_factor >= 0.0:
                x = np.log(horner_time(since[late], shut))
                gradient = -np.polyfit(x, found[late], 1)[0]
                k = rate * mu / (4 * math.pi * gradient)
                off = k / scene.matrix.permeability - 1
                horner = max(horner, abs(off))
                text += f"; k by Horner's line {100 * off:+.1f} %"
            worst = max(worst, *errors)
            lines.append(text)
    return Result(
        f"Δp off by {100 * worst:.1f} % at most, permeability by Horner's line by "
        f"{100 * horner:.1f} %",
        "≤ 5 %, ≤ 6 %",
        bool(worst <= 0.05 and horner <= 0.06),
        "\n".join(lines),
    )
