"""Drainage of a layer in three packings against Terzaghi's series: pressure and outflow."""

from __future__ import annotations

import numpy as np

from demflow.model.analytic.terzaghi import drainage_rate, excess_pressure
from demflow.model.region import Rectangle
from tests.benchmarks.ran import ran
from tests.benchmarks.result import Result

FIRST = 0.01  # T_v from which the front spans several pores


def run() -> Result:
    """RMS of u/u0 at the probes and the mean relative error of the flow, over packings."""
    study = ran("layer_drainage")
    data = study.dataset
    rms, flow_off, lines = [], [], []
    for seed in range(data.sizes["seed"]):
        scene, case = study.scene_of({"seed": seed}), data.isel(seed=seed)
        assert isinstance(scene.region, Rectangle)
        assert scene.uniform_pressure is not None
        k, mu, start = scene.matrix.permeability, scene.fluid.viscosity, scene.uniform_pressure
        assert k is not None
        height, width = scene.region.height, scene.region.width
        diffusivity = k * scene.fluid.bulk_modulus / (float(case["porosity"]) * mu)
        T_v = diffusivity * case["elapsed_time"].values / height**2
        late = T_v >= FIRST
        depth = (0.5 * height - case["probe_y"].values) / height
        expected = excess_pressure(depth[:, None], T_v[late])
        rms.append(
            np.sqrt(np.mean((case["probe_pressure"].values[:, late] / start - expected) ** 2))
        )
        unit = k * width * start / (mu * height)
        outflow = -case["boundary_flow"].values[0, late] / unit
        counts = T_v[late] < 2.0  # later next to nothing flows
        ratio = outflow[counts] / drainage_rate(T_v[late][counts])
        flow_off.append(np.abs(ratio - 1).mean())
        lines.append(
            f"seed {seed + 1}: RMS of u/u0 {100 * rms[-1]:.2f} %, flow off by "
            f"{100 * flow_off[-1]:.1f} % in the mean over T_v {FIRST:g} … 2"
        )
    return Result(
        f"RMS of u/u0 {100 * np.mean(rms):.2f} %, flow off by {100 * np.mean(flow_off):.1f} %",
        "≤ 2 %, ≤ 4 %",
        bool(np.mean(rms) <= 0.02 and np.mean(flow_off) <= 0.04),
        "\n".join(lines),
    )
