"""Drawdown and build-up with storage and skin against the continuum's Laplace-space solution."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import xarray as xr

from demflow.model.analytic.wellbore import horner_time, well_with_storage_and_skin
from demflow.model.region import Circle
from demflow.model.scene import Scene
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


class Compared(NamedTuple):
    """One case against the continuum."""

    drawdown: np.ndarray  # Δp over the formula's
    build_up: np.ndarray
    permeability: float  # by Horner's line over that of the rock


def compared(scene: Scene, case: xr.Dataset) -> Compared:
    """Ratios of one packing to the continuum."""
    assert scene.fluid is not None
    assert scene.matrix is not None
    assert scene.matrix.permeability is not None
    assert scene.uniform_pressure is not None
    times = case["elapsed_time"].values
    well = scene.wells[0]
    (_, rate), (shut, _) = well.rate_changes
    found = case["well_pressure"].values[0]
    expected = continuum(scene, float(case["porosity"]), times)
    first = FIRST if well.wellbore_storage == 0.0 else 0.0
    ratios = []
    for start in (0.0, shut):
        period = (times > start) & (times <= (shut if start == 0.0 else np.inf))
        settled = period & (times - start >= first)
        level = scene.uniform_pressure if start == 0.0 else expected[times == shut]
        reached = scene.uniform_pressure if start == 0.0 else found[times == shut]
        ratios.append((found[settled] - reached) / (expected[settled] - level))
    since = times - shut
    late = since >= HORNER_FROM
    gradient = -np.polyfit(np.log(horner_time(since[late], shut)), found[late], 1)[0]
    k = rate * scene.fluid.viscosity / (4 * math.pi * gradient)
    return Compared(ratios[0], ratios[1], k / scene.matrix.permeability)


def run() -> Result:
    """Relative error of the pressure change, and of the permeability by Horner's line.

    Means over the packings. A stimulated well is too wide for its flow to be radial before the
    rim is felt, so that its build-up has no Horner line here.
    """
    study = ran("build_up")
    data = study.dataset
    lines, worst, horner = [], 0.0, 0.0
    for skin in range(data.sizes["skin"]):
        for storage in range(data.sizes["storage"]):
            cases = [
                {"skin": skin, "storage": storage, "seed": seed}
                for seed in range(data.sizes["seed"])
            ]
            well = study.scene_of(cases[0]).wells[0]
            each = [compared(study.scene_of(case), data.isel(case)) for case in cases]
            off = [
                [float(np.abs(ratio - 1).max()) for ratio in (one.drawdown, one.build_up)]
                for one in each
            ]
            mean = [
                float(np.abs(np.mean(ratios, axis=0) - 1).max())
                for ratios in zip(*((one.drawdown, one.build_up) for one in each), strict=True)
            ]
            worst = max(worst, *mean)
            text = (
                f"skin {well.skin_factor:+g}, storage {well.wellbore_storage:g} m³/Pa: Δp off by "
                f"{mean[0]:.1%} in the drawdown, {mean[1]:.1%} in the build-up (one packing "
                f"{np.max(off):.1%})"
            )
            if well.wellbore_storage == 0.0 and well.skin_factor >= 0.0:
                by_line = float(np.mean([one.permeability for one in each])) - 1
                horner = max(horner, abs(by_line))
                text += f"; k by Horner's line {by_line:+.1%}"
            lines.append(text)
    return Result(
        f"Δp off by {worst:.1%} at most, permeability by Horner's line by {horner:.1%}, means "
        f"over {data.sizes['seed']} packings",
        "≤ 5 %, ≤ 6 %",
        bool(worst <= 0.05 and horner <= 0.06),
        "\n".join(lines),
    )
