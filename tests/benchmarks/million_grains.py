"""One million grains, from packing to a transient of eight decades, fit into a common machine.

A study of one case, run through YAML on two workers of a machine that has compiled: a random tile
that repeats itself, two sets of embedded fractures, a well, and maps. Stage by stage, time is that
of its runs and memory the largest of the worker that ran them. Each size is run in some rounds,
and how the network's time grows is told by medians: at 100,000 grains it is less than a tenth of
a second. What the largest takes as a whole is the worst of its rounds.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import statistics
import sys
from pathlib import Path
from typing import NamedTuple
from unittest import mock

from tests import cache
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import timed_run

SIZES = (20_000, 100_000, 1_000_000)
TILE, ROUNDS = 20_000, 3
MINUTES, MEMORY, NETWORK, EXPONENT = 10.0, 12.0, 3.0, 1.1  # GB, µs a grain
TEXT = """
study: million_{grains}
scene:
  region: {{shape: rectangle, width: {width} m, height: {width} m}}
  grains: {{count: {grains}, packing: periodic, tile: {tile}, porosity: 0.17, seed: 1}}
  matrix: {{permeability: 1 mD}}
  fluid: {{viscosity: 1 cP, bulk_modulus: 2.2 GPa}}
  fractures:
    steep: {{kind: set, angle: 70 deg, length: {length} m, spacing: {spacing} m, aperture: 100 um}}
    flat: {{kind: set, angle: 10 deg, length: {length} m, spacing: {spacing} m, aperture: 50 um}}
  wells: {{producer: {{at: [0 m, 0 m], radius: 0.5 m, rate: 1e-5 m3/s}}}}
  boundaries: {{outer: 20 MPa}}
  initial_pressure: 20 MPa
  times: {{first: 1 s, last: 1e8 s, per_decade: 10}}
observe: [well_pressure, pressure_map]
solver: {{tolerance: 1e-4}}
figures: {{maps: [1e4 s]}}
"""


class Took(NamedTuple):
    """What one size took."""

    seconds: float  # by the clock
    stages: dict[str, tuple[float, float]]  # s, and bytes of a worker

    @property
    def memory(self) -> float:
        """Largest memory of a worker, bytes."""
        return max(memory for _, memory in self.stages.values())


def measured(grains: int) -> Took:
    """Run the study with so many grains."""
    width = 40.0 * math.sqrt(grains / 20_000)  # m: grains stay as large
    folder = results_folder() / f"million_{grains}"
    shutil.rmtree(folder, ignore_errors=True)  # of the round before
    folder.mkdir()
    path = folder / "study.yaml"
    path.write_text(
        TEXT.format(grains=grains, tile=TILE, width=width, length=width / 5, spacing=width / 10)
    )
    own = cache.variables(folder / "cache")  # notes of this run, and of no other
    with mock.patch.dict(os.environ, own):
        took = timed_run(path, folder / "results", workers=2)
    return Took(took.seconds, _stages(folder / "results"))


def _stages(results: Path) -> dict[str, tuple[float, float]]:
    """Seconds of each stage, and bytes of a worker after it."""
    told = json.loads((results / "store" / "costs.json").read_text())["stages"]
    return {
        key.partition("/")[0]: (
            sum(spent[1] for spent in sizes.values()),
            max(spent[4] or spent[5] for spent in sizes.values()),
        )
        for key, sizes in told.items()
    }


def line(grains: int, took: Took) -> str:
    """A size in words."""
    stages = ", ".join(
        f"{name} {seconds:.2f} s {memory / 1e9:.2f} GB"
        for name, (seconds, memory) in took.stages.items()
    )
    return f"{grains}: {took.seconds:.1f} s, {took.memory / 1e9:.2f} GB; {stages}"


def run() -> Result:
    """Time and memory of the largest, and how the network's time grows."""
    measured(2_000)  # loads libraries and kernels
    rounds = [{grains: measured(grains) for grains in SIZES} for _ in range(ROUNDS)]
    *_, middle, largest = SIZES
    minutes = max(found[largest].seconds for found in rounds) / 60.0
    memory = max(found[largest].memory for found in rounds) / 1e9
    few, many = (
        statistics.median(found[grains].stages["network"][0] for found in rounds)
        for grains in (middle, largest)
    )
    exponent = math.log(many / few) / math.log(largest / middle)
    each = 1e6 * many / largest
    return Result(
        f"{minutes:.1f} min, {memory:.1f} GB; network {each:.2f} µs a grain, "
        f"exponent {exponent:.2f}",
        f"≤ {MINUTES:g} min, ≤ {MEMORY:g} GB; ≤ {NETWORK:g} µs, ≤ {EXPONENT:g}",
        minutes <= MINUTES and memory <= MEMORY and each <= NETWORK and exponent <= EXPONENT,
        "\n".join(line(grains, took) for found in rounds for grains, took in found.items()),
    )


if __name__ == "__main__":  # some sizes alone
    for count in map(int, sys.argv[1:]):
        print(line(count, measured(count)), flush=True)
