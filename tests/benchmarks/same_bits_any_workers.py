"""One worker, two workers and a second run give the same bits in every computed variable."""

from __future__ import annotations

import numpy as np
import xarray as xr

from demflow import sweep
from demflow.model.quantities import SWEEP
from tests.benchmarks.ran import STUDIES, ran, results_folder
from tests.benchmarks.result import Result

MEASURED = tuple(SWEEP)  # measured times are no results of the model


def differing(a: xr.Dataset, b: xr.Dataset) -> list[str]:
    """Variables whose bytes differ."""
    return [
        name
        for name in a.variables
        if name not in MEASURED
        and (name not in b.variables or not _same(a[name].values, b[name].values))
    ]


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    if a.dtype.kind in "OUS":
        return bool(np.array_equal(a.astype(str), b.astype(str)))
    return a.dtype == b.dtype and a.tobytes() == b.tobytes()


def run() -> Result:
    """Compare the quickstart's dataset between runs."""
    path = STUDIES / "quickstart.yaml"
    two = ran("quickstart").dataset
    one = sweep.run(path, workers=1, results=results_folder() / "one")
    again = sweep.run(path, workers=2, results=results_folder() / "again")
    repeated = sweep.run(path, workers=2, results=results_folder() / "again")
    pairs = {"1 worker": one, "2 workers anew": again, "second run": repeated}
    found = {name: differing(two, dataset) for name, dataset in pairs.items()}
    lines = [f"{name}: {', '.join(names) or 'identical'}" for name, names in found.items()]
    count = sum(len(names) for names in found.values())
    return Result(
        f"{count} of {len(set(two.variables) - set(MEASURED))} variables differ",
        "0",
        count == 0,
        "\n".join(lines),
    )
