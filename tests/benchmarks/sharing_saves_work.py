"""400 cases that share stages take a twentieth of the CPU time of 400 cases run alone, or less.

Run alone are some cases in which every value of every axis occurs equally often, in one process
with its kernels loaded: no process start, no store. Their mean stands for all 400. The sweep's
side is the CPU time of all its processes from start to dataset, process starts included.
"""

from __future__ import annotations

import time

import numpy as np

from demflow.model.scene import Scene
from demflow.sweep.plan.table import stage_table
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import load_study
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import four_axes, four_hundred_cases

GRAINS, SAMPLES, BOUND = 2000, 20, 20.0  # 20: each of 5 values four times, of 4 values five times


def run_alone(scene: Scene) -> float:
    """CPU seconds of all stages of one case."""
    begin = time.process_time()
    products = {}
    for stage in stage_table():
        if stage.wanted(scene):
            reads = {name: read(scene) for name, read in stage.reads.items()}
            parents = [products.get(name) for name in stage.parents]
            products[stage.name] = stage.run(*parents, **reads)
    return time.process_time() - begin


def run() -> Result:
    """Compare CPU times; the sample is taken before and stands for every case."""
    study = load_study(four_axes("four_axes", grains=GRAINS))
    count = int(np.prod(study.shape))
    scenes = [
        case_at(study, [k % len(axis.values) for axis in study.axes]).scene for k in range(SAMPLES)
    ]
    run_alone(scenes[0])  # compiles or loads the kernels
    alone = [run_alone(scene) for scene in scenes]
    _, _, took = four_hundred_cases(GRAINS)
    ratio = float(np.mean(alone)) * count / took.cpu
    details = [
        f"{count} cases of {GRAINS} grains on two workers: {took.cpu:.1f} s of CPU, "
        f"{took.seconds:.1f} s by the clock, {took.computed} stage runs, {took.failed} failed",
        f"{SAMPLES} cases alone: {min(alone):.2f} to {max(alone):.2f} s of CPU each, "
        f"hence {np.mean(alone) * count:.0f} s for {count}",
    ]
    return Result(
        f"{ratio:.0f} times less CPU",
        f"≥ {BOUND:g}",
        ratio >= BOUND and took.failed == 0,
        "\n".join(details),
    )
