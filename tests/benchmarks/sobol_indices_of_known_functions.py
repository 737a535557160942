"""Sobol' indices lie inside their stated intervals, failed cases or not; longer samples add cases.

Ishigami's function, and the steady inflow between two sides of a square packing, c w³ Δp / μ, whose
indices are known in closed form: six parameters, two of them idle, and 5 % of the cases failed, by
chance or where the aperture is largest. Each is sampled 100 times, by 100 seeds. That the inflow is
what the formula says is seen in a run of the study, which then is doubled.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

from demflow import sweep
from demflow.model.outcome import Status
from demflow.sweep.analysis.sensitivity import sensitivity
from demflow.sweep.study.designs import design
from demflow.sweep.study.laws import Law
from tests.benchmarks.result import Result

Array = np.ndarray
REPEATS, COUNT, LEAST = 100, 512, 95
STUDY = """\
study: indices
scene:
  region: {{shape: rectangle, width: 1 m, height: 1 m}}
  grains: {{count: 64, packing: square}}
  matrix: {{aperture: 10 um}}
  fluid: {{viscosity: 1 cP, bulk_modulus: 1 GPa}}
  boundaries: {{left: 2 MPa, right: 1 MPa}}
vary:
  w: {{parameter: matrix.aperture, distribution: {{uniform: [8 um, 16 um]}}}}
  mu: {{parameter: fluid.viscosity, distribution: {{uniform: [0.5 cP, 2 cP]}}}}
  left: {{parameter: boundaries.left, distribution: {{uniform: [3 MPa, 5 MPa]}}}}
  right: {{parameter: boundaries.right, distribution: {{uniform: [1 MPa, 2 MPa]}}}}
  bulk: {{parameter: fluid.bulk_modulus, distribution: {{uniform: [1 GPa, 3 GPa]}}}}
  gap: {{parameter: matrix.gap_factor, distribution: {{uniform: [0.3, 0.7]}}}}
sample: {{method: saltelli, count: {count}}}
observe: [boundary_flow]
solver: {{method: steady}}
"""
LAWS = tuple(
    Law("uniform", ends)
    for ends in ((8e-6, 16e-6), (5e-4, 2e-3), (3e6, 5e6), (1e6, 2e6), (1e9, 3e9), (0.3, 0.7))
)


def ishigami(u: Array) -> Array:
    """sin x₁ + 7 sin² x₂ + 0.1 x₃⁴ sin x₁, each x between −π and π (Ishigami and Homma 1990)."""
    x = np.pi * (2.0 * u - 1.0)
    return np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def ishigami_indices() -> tuple[Array, Array]:
    """First-order and total indices of it."""
    first = 0.5 * (1.0 + 0.1 * np.pi**4 / 5.0) ** 2
    second, mixed = 49.0 / 8.0, 8.0 * 0.01 * np.pi**8 / 225.0
    whole = first + second + mixed
    return np.array([first, second, 0.0]) / whole, np.array([first + mixed, second, mixed]) / whole


def inflow(u: Array) -> Array:
    """w³ (left − right) / μ at points of the unit cube."""
    w, mu, left, right = (np.array(law.quantile(u[:, k])) for k, law in enumerate(LAWS[:4]))
    return w**3 * (left - right) / mu


def inflow_indices() -> tuple[Array, Array]:
    """Indices of a product of independent factors, the third of two parameters."""

    def moment(k: int, power: float) -> float:
        a, b = LAWS[k].numbers
        if power == -1.0:
            return float(np.log(b / a) / (b - a))
        return float((b ** (power + 1) - a ** (power + 1)) / ((power + 1) * (b - a)))

    wide = moment(0, 6.0) / moment(0, 3.0) ** 2 - 1.0
    thin = moment(1, -2.0) / moment(1, -1.0) ** 2 - 1.0
    mean = moment(2, 1.0) - moment(3, 1.0)
    sides = [(moment(k, 2.0) - moment(k, 1.0) ** 2) / mean**2 for k in (2, 3)]
    whole = (1.0 + wide) * (1.0 + thin) * (1.0 + sum(sides)) - 1.0
    alone = np.array([wide, thin, *sides, 0.0, 0.0])
    others = np.array([1.0 + wide, 1.0 + thin, *[1.0 + sum(sides)] * 2, 1.0, 1.0])
    rest = (1.0 + whole) / others
    return alone / whole, alone * rest / whole


def sampled(values: Callable[[Array], Array], d: int, seed: int, failed: str) -> xr.Dataset:
    """A dataset as a run would leave it."""
    points = design("saltelli", d, COUNT, seed)
    y = values(points)
    bad = np.zeros(len(y), dtype=bool)
    if failed:
        chance = np.random.default_rng(seed).random(len(y)) < 0.05
        bad = chance if failed == "by chance" else points[:, 0] > 0.95
    names = " ".join(f"p{k}" for k in range(d))
    made_by = {
        "sampling_method": "saltelli",
        "sampling_count": COUNT,
        "sampling_seed": seed,
        "sampled": names,
    }
    status = np.where(bad, Status.FAILED, Status.DONE).astype(np.int8)
    return xr.Dataset(
        {"y": ("sample", np.where(bad, np.nan, y)), "status": ("sample", status)},
        {"sample": ("sample", np.arange(len(y)), made_by)},
    )


def held(
    values: Callable[[Array], Array],
    truth: tuple[Array, Array],
    failed: str,
    limits: tuple[float, float] | None,
) -> tuple[int, str]:
    """Of so many samples, in how many the index that is missed most often is inside."""
    inside = np.zeros((2, len(truth[0])), dtype=int)
    widths = []
    for seed in range(REPEATS):
        found = sensitivity(
            sampled(values, len(truth[0]), seed, failed), "y", limits=limits, resamples=400
        )
        for k, name in enumerate(("first_order", "total")):
            low, high = found[f"{name}_low"].values, found[f"{name}_high"].values
            inside[k] += (low <= truth[k] + 1e-12) & (truth[k] <= high + 1e-12)
            widths.append((high - low).mean())
    told = f"inside {inside.min()} to {inside.max()} of {REPEATS}, mean width {np.mean(widths):.2f}"
    return int(inside.min()), f"{values.__name__}, failed {failed or 'none'}: {told}"


def extended(folder: Path) -> tuple[float, int, int]:
    """How far a run is from the formula, and the runs of a doubled sample: done, and new ones."""
    path = folder / "study.yaml"

    def run(count: int) -> tuple[xr.Dataset, int]:
        path.write_text(STUDY.format(count=count))
        command = [sys.executable, "-m", "demflow", "run", str(path), "--json", "--results"]
        ran = subprocess.run([*command, str(folder)], capture_output=True, check=True, text=True)
        dataset = sweep.open_results(folder / "indices")
        return dataset, json.loads(ran.stdout)["computed"]

    first, once = run(16)
    second, more = run(32)
    again = sum(
        not np.array_equal(first[name], second[name].isel(sample=slice(first.sizes["sample"])))
        for name in ("w", "boundary_flow")
    )
    flow = second["boundary_flow"].sel(boundary="left").values.ravel()
    w, mu, left, right = (second[name].values for name in ("w", "mu", "left", "right"))
    ratio = flow / (w**3 * (left - right) / mu)
    return float(np.ptp(ratio) / ratio.mean()), more - once, again


def run() -> Result:
    """All functions, then the run."""
    whole = inflow(np.array([[1.0, 0.0, 1.0, 0.0, 0.5, 0.5], [0.0, 1.0, 0.0, 1.0, 0.5, 0.5]]))
    limits = (float(whole[1]), float(whole[0]))
    worst, lines = [], []
    for values, truth, failed, between in (
        (ishigami, ishigami_indices(), "", None),
        (inflow, inflow_indices(), "", None),
        (inflow, inflow_indices(), "by chance", limits),
        (inflow, inflow_indices(), "where the aperture is largest", limits),
    ):
        count, told = held(values, truth, failed, between)
        worst.append(count)
        lines.append(told)
    with tempfile.TemporaryDirectory() as folder:
        off, extra, again = extended(Path(folder))
    lines.append(f"the run follows the formula within {off:.1e}")
    figure = (
        f"the index missed most often is inside in {min(worst)} of {REPEATS}; a doubled sample "
        f"computes {extra:+d} runs beside as many again, and changes {again} results"
    )
    holds = min(worst) >= LEAST and extra <= 0 and again == 0 and off < 1e-6
    return Result(figure, f"≥ {LEAST} of {REPEATS}; none more; none", holds, "\n".join(lines))
