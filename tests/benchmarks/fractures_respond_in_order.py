"""Pressure falls first in the hydraulic fracture, then in the first set, the second, the matrix.

The paper's rate moves its reservoir by a few kPa in 7 MPa within its times, so that "fallen
by 1 %" is taken of the well's own fall at the last of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from demflow.model.maps import case_maps
from demflow.model.stages import run_stages
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import load_study
from tests.benchmarks.ran import STUDIES
from tests.benchmarks.result import Result

RINGS = ((5.5, 6.5), (6.5, 7.5))  # m from the well; every class has pores there
CLASSES = {"hydraulic": ("hydraulic",), "first set": ("first",), "second set": ("second",)}


def run() -> Result:
    """Median time of a 1 % fall in each class of pores, in rings about the well."""
    scene = case_at(load_study(STUDIES / "paper_fractured.yaml"), ()).scene
    last = scene.times[-1]
    scene = replace(scene, times=tuple(np.geomspace(1.0, 1e3 * last, 240)))
    products = run_stages(scene)
    maps = case_maps(scene, products)
    times = np.array(scene.times)
    fall = scene.initial_pressure - maps["pressure"]
    well_fall = scene.initial_pressure - products["observe"]["well_pressure"][0]
    threshold = 0.01 * np.interp(last, times, well_fall)
    reached = np.array([np.interp(threshold, column, times, right=np.inf) for column in fall.T])

    kind = np.full(len(maps["x"]), "matrix", dtype="<U12")
    for name, prefixes in reversed(CLASSES.items()):
        for index, fracture in enumerate(scene.fractures):
            if fracture.name.startswith(prefixes):
                on = maps["on_fracture"] == index
                ends = np.concatenate([maps["from_domain"][on], maps["to_domain"][on]])
                kind[ends[ends >= 0]] = name
    radius = np.hypot(maps["x"], maps["y"])
    ordered, lines = True, [f"1 % of the well's fall at {last:.0f} s is {threshold:.3g} Pa"]
    for low, high in RINGS:
        ring = (radius > low) & (radius < high)
        median = [np.median(reached[ring & (kind == name)]) for name in (*CLASSES, "matrix")]
        ordered &= bool(np.all(np.diff(median) > 0))
        lines.append(
            f"{low} to {high} m: "
            + ", ".join(
                f"{name} {t:.4g} s" for name, t in zip((*CLASSES, "matrix"), median, strict=True)
            )
        )
    return Result(
        "ordered in every ring" if ordered else "out of order",
        "hydraulic < first set < second set < matrix",
        ordered,
        "\n".join(lines),
    )
