"""Steady inflow into a drained tunnel against Goodman's formula, and its images in the box."""

from __future__ import annotations

import math

import numpy as np

from demflow.model.analytic.wells import tunnel_inflow
from demflow.model.region import Rectangle
from demflow.model.scene import Scene
from tests.benchmarks.ran import ran
from tests.benchmarks.result import Result

IMAGES = 40  # on each side; the sum is taken in pairs that cancel


def in_the_box(scene: Scene, y: float, radius: float, k: float) -> float:
    """Inflow with the sealed sides and bottom: images of the tunnel, the table's with sign −.

    The tunnel stands at (0, y) and has a radius (m), the rock the permeability k (m²).
    """
    table = dict(scene.boundaries)["top"]
    return 2.0 * math.pi * k * table / (scene.fluid.viscosity * logarithm(scene, y, radius))


def logarithm(scene: Scene, y: float, radius: float) -> float:
    """What stands for Goodman's ln(2h/r) in the box."""
    assert isinstance(scene.region, Rectangle)
    width, height = scene.region.width, scene.region.height
    depth = 0.5 * height - y
    sum_of_logs = 0.0
    for column in range(-IMAGES, IMAGES + 1):
        x = column * width
        for row in range(-IMAGES, IMAGES + 1):
            # the top mirrors with a change of sign, the bottom without: period 2 H with sign −
            sign = (-1.0) ** row
            near = math.hypot(x, 2.0 * row * height) or radius
            far = math.hypot(x, 2.0 * row * height + 2.0 * depth)
            sum_of_logs += sign * math.log(far / near)
    return sum_of_logs


def run() -> Result:
    """Mean over packings of the inflow over each formula; a skin S adds S to the logarithm."""
    study = ran("tunnel_inflow")
    rate = study.dataset["well_rate"].isel(elapsed_time=-1, well=0)
    lines, off = [], []
    for lining in range(rate.sizes["lining"]):
        scene = study.scene_of({"seed": 0, "lining": lining})
        tunnel, k, mu = scene.wells[0], scene.matrix.permeability, scene.fluid.viscosity
        assert k is not None
        assert isinstance(scene.region, Rectangle)
        table = dict(scene.boundaries)["top"]
        depth = 0.5 * scene.region.height - tunnel.at[1]
        resistance = mu / (2.0 * math.pi * k) * tunnel.skin_factor
        goodman = table / (table / tunnel_inflow(table, mu, k, depth, tunnel.radius) + resistance)
        alone = in_the_box(scene, tunnel.at[1], tunnel.radius, k)
        boxed = table / (table / alone + resistance)
        found = rate.isel(lining=lining).values
        off.append(found.mean() / boxed - 1)
        against = found.mean() / goodman - 1
        lines.append(
            f"skin {tunnel.skin_factor:g}: {found.mean():.4g} m³/s per metre, spread "
            f"{100 * found.std(ddof=1) / found.mean():.1f} %; {100 * against:+.1f} "
            f"% against Goodman's {goodman:.4g}, {100 * off[-1]:+.1f} % with the images in the box"
        )
    worst = float(np.abs(off).max())
    return Result(
        f"mean inflow off by {100 * worst:.1f} % from Goodman's formula with the box's images",
        "≤ 5 %",
        worst <= 0.05,
        "\n".join(lines),
    )
