"""Radial flow to a well in thirty packings of 5,000 grains against Eq. 29 at the paper's times."""

from __future__ import annotations

import math
import re
from functools import cache

import numpy as np

from demflow import sweep
from demflow.model.analytic.radial import radial_roots
from demflow.sweep.analysis.radial_flow import compare_radial
from tests.benchmarks.ran import STUDIES, Ran, results_folder
from tests.benchmarks.result import Result

PAPER_ROOTS = {1: 0.1701, 2: 0.3946, 3: 0.6236, 50: 11.730}  # Table 5 and its evaluation
PAPER_RADIUS = 14.26  # R_De of Table 5
PAPER_WELL_PRESSURE = 3.49e6  # Pa, steady
PAPER_TIMES = 5  # the study records one more, at which the flow is steady


PACKINGS = 30


@cache
def ensemble() -> Ran:
    """The paper's radial study with thirty packings, without maps and figures."""
    text = (STUDIES / "paper_radial.yaml").read_text()
    text = re.sub(r"values: \[1, 2, 3, 4, 5\]", f"from: 1, to: {PACKINGS}, count: {PACKINGS}", text)
    text = text.replace("study: paper-radial", "study: paper-radial-ensemble")
    text = re.sub(r"^figures:.*\n", "", text.replace("pressure_map, ", ""), flags=re.MULTILINE)
    path = results_folder() / "paper_radial_ensemble.yaml"
    path.write_text(text)
    study = sweep.load_study(path)
    dataset = sweep.run(path, workers=2, results=results_folder())
    return Ran(study, dataset, results_folder() / study.name)


def run() -> Result:
    """P_D of the well, mean over packings ± its standard error; steady pressure; Eq. 30's roots."""
    radial = ensemble()
    found = compare_radial(radial.dataset, radial.scene_of, None)
    relative = (found.well / found.expected - 1)[:, :PAPER_TIMES]
    mean, deviation = relative.mean(axis=0), relative.std(axis=0, ddof=1)
    error = deviation / math.sqrt(len(relative))
    pressures = found.steady_pressure / PAPER_WELL_PRESSURE - 1
    roots = radial_roots(PAPER_RADIUS, 50)
    roots_hold = all(abs(roots[n - 1] - value) < 5e-4 for n, value in PAPER_ROOTS.items())
    lines = [
        f"t_D {t:8.2f}: mean {100 * m:+.2f} ± {100 * e:.2f} %, one packing {100 * s:.2f} %, "
        f"at worst {100 * worst:.2f} %"
        for t, m, e, s, worst in zip(
            found.t_D.mean(axis=0),
            mean,
            error,
            deviation,
            np.abs(relative).max(axis=0),
            strict=False,
        )
    ]
    steady, steady_error = pressures.mean(), pressures.std(ddof=1) / math.sqrt(len(pressures))
    lines.append(f"steady well pressure {found.steady_pressure.mean() / 1e6:.3f} MPa in the mean")
    lines.append("roots of Eq. 30: " + ", ".join(f"{roots[n - 1]:.4f}" for n in PAPER_ROOTS))
    apart = np.abs(mean) / error
    return Result(
        f"means over {len(relative)} packings "
        + ", ".join(f"{100 * m:+.2f} ± {100 * e:.2f} %" for m, e in zip(mean, error, strict=True))
        + f", at most {apart.max():.1f} standard errors from 0; steady pressure "
        f"{100 * steady:+.2f} ± {100 * steady_error:.2f} %",
        "≤ 2 standard errors; ≤ 2 %",
        bool(np.all(apart <= 2.0) and abs(steady) <= 0.02 and roots_hold),
        "\n".join(lines),
    )
