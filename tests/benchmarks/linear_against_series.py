"""Linear flow in five packings of 5,000 grains against Eq. 24 at the paper's six times."""

from __future__ import annotations

import numpy as np

from demflow.sweep.analysis.linear_flow import compare_linear
from tests.benchmarks.ran import ran
from tests.benchmarks.result import Result

PAPER_FLOW = {5e6: 1.365e-5, 8e6: 2.18e-5}  # m³/s at a left pressure in Pa
PAPER_TIMES = 6  # the study records one more, at which the flow is steady


def run() -> Result:
    """RMS of P_D over the six times and 15 bins; steady flow against the paper's."""
    linear = ran("paper_linear")
    found = compare_linear(linear.dataset, linear.scene_of, linear.maps_of)
    at_times = (found.computed - found.expected)[:, :PAPER_TIMES]
    rms = np.sqrt(np.nanmean(at_times**2, axis=(1, 2)))
    left = np.array([5e6, 8e6] * (len(found.flow) // 2))
    flow = found.flow / np.array([PAPER_FLOW[p] for p in left]) - 1
    by_pressure = [flow[left == p].mean() for p in PAPER_FLOW]
    lines = [
        f"{title}: RMS {100 * r:.2f} %, steady flow {q:.4g} m3/s ({100 * f:+.2f} %)"
        for title, r, q, f in zip(found.titles, rms, found.flow, flow, strict=True)
    ]
    lines.append(
        "steady flow, mean over packings: "
        + ", ".join(
            f"{p / 1e6:g} MPa {100 * f:+.2f} %"
            for p, f in zip(PAPER_FLOW, by_pressure, strict=True)
        )
    )
    return Result(
        f"RMS mean {100 * rms.mean():.2f} %, worst {100 * rms.max():.2f} %; "
        f"steady flow off by {100 * np.abs(flow).max():.2f} % at most",
        "≤ 1.0 %, ≤ 1.5 %; ≤ 2 %",
        bool(rms.mean() <= 0.01 and rms.max() <= 0.015 and np.abs(flow).max() <= 0.02),
        "\n".join(lines),
    )
