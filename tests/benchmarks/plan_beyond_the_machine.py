"""`demflow plan` warns of studies beyond the machine; its memory and disk hold within a factor 2.

One small study is run. After that, larger ones are foretold and then run: more grains, more times,
maps at many times, many probes, a schedule of many changes. Twelve that no machine of today's size
could run are only foretold, and must be warned of.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT

FACTOR = 2.0
TEXT = """
study: {name}
scene:
  region: {{shape: rectangle, width: 10 m, height: 10 m}}
  grains: {{count: {grains}, porosity: 0.17, seed: 1}}
  matrix: {{permeability: 10 mD}}
  fluid: {{viscosity: 1 cP, bulk_modulus: 2.2 GPa}}
  wells: {{w: {{at: [0 m, 0 m], radius: 0.5 m, {control}}}}}
  boundaries: {{left: 7 MPa}}
  probes: {{line: {{from: [-4 m, 0 m], to: [4 m, 0 m], count: {probes}}}}}
  initial_pressure: 7 MPa
  times: {times}
vary:
  seed: {{parameter: grains.seed, values: {seeds}}}
observe: [well_pressure, probe_pressure{maps}]
solver: {{method: krylov}}
"""


def study(
    folder: Path,
    name: str,
    *,
    grains: int = 300,
    times: int = 30,
    changes: int = 1,
    probes: int = 2,
    maps: bool = False,
    cases: int = 1,
) -> Path:
    """A study with so many of each."""
    begin = np.linspace(0.0, 1e4, changes, endpoint=False) + np.linspace(0, 1, changes) ** 2
    steps = ", ".join(
        f"[{t:.9g} s, {1e-6 * (k % 2 + 1)} m3/s]" for k, t in enumerate(begin - begin[0])
    )
    text = TEXT.format(
        name=name,
        grains=grains,
        control="rate: 1e-6 m3/s" if changes == 1 else f"schedule: [{steps}]",
        probes=probes,
        times="[" + ", ".join(f"{t:.9g} s" for t in np.geomspace(1.0, 2e4, times)) + "]",
        seeds=list(range(1, cases + 1)),
        maps=", pressure_map" if maps else "",
    )
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


RUN = {
    "more grains": {"grains": 3000},
    "more times": {"times": 3000},
    "more probes": {"probes": 2000, "times": 300},
    "maps": {"grains": 1000, "times": 500, "maps": True},
    "a schedule": {"changes": 700, "times": 200, "probes": 20},
    "more cases": {"cases": 6, "times": 200, "probes": 50},
}
BEYOND = {
    "grains and maps": {"grains": 2_000_000, "times": 3000, "maps": True},
    "maps of many times": {"grains": 200_000, "times": 10_000, "maps": True, "cases": 40},
    "maps of many cases": {"grains": 20_000, "times": 1000, "maps": True, "cases": 2000},
    "a long schedule": {"changes": 12_000, "times": 9000, "probes": 9000},
    "a long schedule of maps": {"changes": 4000, "times": 1000, "grains": 20_000, "maps": True},
    "probes": {"probes": 10_000, "times": 10_000, "cases": 500},
    "probes of a schedule": {"probes": 10_000, "changes": 3000, "times": 1000},
    "cases": {"cases": 20_000, "grains": 20_000, "times": 100, "maps": True},
    "large cases": {"cases": 3000, "grains": 1_000_000},
    "a schedule over cases": {"changes": 2000, "times": 2000, "probes": 100, "cases": 500},
    "times over cases": {"times": 10_000, "probes": 1000, "cases": 3000},
    "grains": {"grains": 2_000_000, "times": 10_000, "maps": True, "cases": 3},
}  # fmt: skip


def demflow(*arguments: str) -> dict[str, Any]:
    """What a command prints as JSON, on a machine that ran nothing else, but has compiled."""
    kernels = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    own = {"XDG_CACHE_HOME": str(results_folder() / "cache"), "NUMBA_CACHE_DIR": kernels}
    command = [sys.executable, "-m", "demflow", *arguments, "--json"]
    done = subprocess.run(
        command, cwd=ROOT, check=True, capture_output=True, text=True, env={**os.environ, **own}
    )
    return json.loads(done.stdout)


def run() -> Result:
    """Foretell and run, foretell and compare with the machine."""
    folder = results_folder() / "beyond"
    folder.mkdir()
    first = folder / "results"
    demflow("run", str(study(folder, "small")), *_place(first))
    shutil.rmtree(results_folder() / "cache" / "demflow", ignore_errors=True)  # costs of the rest
    lines, off, silent = [], [1.0], []
    for name, more in RUN.items():
        path = study(folder, name.replace(" ", "-"), **more)
        results = shutil.copytree(first, folder / path.stem)
        told = demflow("plan", str(path), *_place(results))
        before, main = _bytes(results), _told(results)["main"]
        demflow("run", str(path), *_place(results))
        shutil.rmtree(results_folder() / "cache" / "demflow", ignore_errors=True)
        disk, worker = _bytes(results) - before, _peak(results)
        held = told["at_least"]["memory"] - main
        lines.append(
            f"{name}: disk {told['bytes'] / 1e6:.2f} MB foretold, {disk / 1e6:.2f} MB; "
            f"a worker {held / 1e6:.0f} MB foretold, {worker / 1e6:.0f} MB"
        )
        off += [told["bytes"] / disk, disk / told["bytes"], held / worker, worker / held]
    for name, more in BEYOND.items():
        path = study(folder, name.replace(" ", "-"), **more)
        told = demflow("plan", str(path), *_place(first))
        lines.append(f"{name}: {'; '.join(told['warnings']) or 'NOT WARNED OF'}")
        if not told["warnings"]:
            silent.append(name)
    return Result(
        f"{len(BEYOND) - len(silent)} of {len(BEYOND)} beyond the machine warned of; "
        f"memory and disk of {len(RUN)} within a factor {max(off):.2f}",
        f"all; {FACTOR:g}",
        not silent and max(off) <= FACTOR,
        "\n".join(lines),
    )


def _place(results: Path) -> tuple[str, ...]:
    return ("--results", str(results), "--workers", "1")


def _bytes(results: Path) -> int:
    """Bytes of all products and datasets."""
    names = ("dataset.nc", "study.yaml")
    return sum(
        path.stat().st_size
        for path in results.rglob("*")
        if path.is_file() and (path.name in names or "store" in path.parts)
    )


def _told(results: Path) -> dict[str, Any]:
    return json.loads((results / "store" / "costs.json").read_text())


def _peak(results: Path) -> float:
    """Largest memory of a worker in any run, bytes."""
    stages = _told(results)["stages"].values()
    return max(spent[4] or spent[5] for sizes in stages for spent in sizes.values())
