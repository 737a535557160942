"""`demflow plan` foretells what shipped studies of which nothing was ever run will cost.

The quickstart is run, and two other studies with their smoke block. Five more, of other grains,
wells, sides, rates and sizes, are then foretold and run with figures as a user would. Their time is
that by the clock, process starts included, their memory the largest of a worker times the workers
and that of the process that leads, their disk what the results folder grows by without
figures and pages. Kernels are those of the user, who has compiled.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from unittest import mock

from demflow.sweep.store.costs import machine_file
from tests import cache
from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import timed_command

KNOWN = {"quickstart": (), "build_up": ("--smoke",), "outcrop": ("--smoke",)}
UNKNOWN = (
    "injector_producer", "field_well", "paper_radial", "permeability_under_stress",
    "layer_drainage",
)  # fmt: skip
WORKERS, BOUND = 2, 1.5


def run() -> Result:
    """Run what is to be known, then foretell each of the five and run it."""
    folder = results_folder() / "unknown"
    with mock.patch.dict(os.environ, cache.variables(results_folder() / "cache")):
        for name, more in KNOWN.items():
            _run(name, folder / "known", *more)
        found = [foretold(name, folder) for name in UNKNOWN]
    worst = max(max(ratio, 1.0 / ratio) for _, ratios in found for ratio in ratios.values())
    return Result(
        f"off by a factor {worst:.2f} at most",
        f"≤ {BOUND:g}",
        worst <= BOUND,
        "\n".join(line for line, _ in found),
    )


def foretold(name: str, folder: Path) -> tuple[str, dict[str, float]]:
    """What is foretold of a study over what it took, and both in words.

    Each is foretold by the same three studies alone, and noted by itself: its run finds no notes
    of others, among which its own would not be told apart. What else a user's cache holds it finds.
    """
    results = folder / name
    study = str(STUDIES / f"{name}.yaml")
    told = json.loads(
        timed_command("plan", study, "--results", str(results), *_workers(), "--json")[1]
    )
    own = folder / f"{name}-notes"
    shutil.copytree(os.environ["XDG_CACHE_HOME"], own, ignore=lambda *_: [machine_file().name])
    with mock.patch.dict(os.environ, cache.variables(own)):
        took = _run(name, results)
    costs = json.loads((results / "store" / "costs.json").read_text())
    worker = max(
        spent[4] or spent[5] for sizes in costs["stages"].values() for spent in sizes.values()
    )
    spent = {
        "seconds": took,
        "memory": float(costs["main"] + WORKERS * worker),
        "bytes": float(_bytes(results)),
    }
    ratios = {key: (told[key] or told["at_least"][key]) / value for key, value in spent.items()}
    words = ", ".join(f"{key} {spent[key]:.3g} ({ratio:.2f})" for key, ratio in ratios.items())
    unknown = f"; not foretold: {', '.join(told['unknown'])}" if told["unknown"] else ""
    line = f"{name}: {words}{unknown} (foretold over spent)"
    print(line, flush=True)
    return line, ratios


def _run(name: str, results: Path, *more: str) -> float:
    """Run a shipped study as a user would; its seconds by the clock."""
    study = str(STUDIES / f"{name}.yaml")
    return timed_command("run", study, "--results", str(results), *_workers(), *more)[0]


def _workers() -> tuple[str, str]:
    return ("--workers", str(WORKERS))


def _bytes(results: Path) -> int:
    """Bytes of all products and datasets."""
    return sum(
        path.stat().st_size
        for path in results.rglob("*")
        if path.is_file() and (path.name == "dataset.nc" or "store" in path.parts)
    )
