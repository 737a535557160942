"""Collecting 1,000 cases of 20 × 200 numbers takes a tenth of opening 1,000 files, in flat memory.

Side by side: from the store to a flushed `dataset.nc`, and from one netCDF file per case to
the loaded dataset by `xarray.open_mfdataset`. Memory is that of a process which only
collects, for 1,000 cases and for 4,000, of which each has 32 kB of numbers: more than a tile of
cases both, so that what one case more takes is no number of its own.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import xarray as xr

from tests.benchmarks.grids import PROBES, TIMES, observe
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import ROOT, timed_run
from tests.sweep.toys import TEXT

CASES, MORE, BOUND, REPEATS = 1000, 4000, 0.1, 3
GROWTH = 5.0  # kB that one case more may take while collecting
GRIDS = "tests.benchmarks.grids:STAGES"

_COLLECT = """
import json, resource, sys, time
from demflow.sweep.dataset.collect import collect
from demflow.sweep.prepared import prepare
prepared = prepare(sys.argv[1], sys.argv[2], table=sys.argv[3])
verdicts = prepared.verdicts()
begin = time.perf_counter()
path = prepared.folder / "again.nc"
args = (prepared.study, prepared.plan, prepared.store, prepared.scene_of, verdicts, path, "")
assert collect(*args) == (verdicts, [])
seconds = time.perf_counter() - begin
print(json.dumps([seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024]))
"""


def run() -> Result:
    """Collect and open in turn."""
    folder = results_folder() / "collect"
    folder.mkdir()
    few, peak_few = collected(folder, CASES)
    many, peak_many = collected(folder, MORE)
    opened = opened_by_xarray(folder / "files")
    ratio, each = few / opened, (peak_many - peak_few) / (MORE - CASES) / 1e3
    lines = [
        f"collect   {CASES:5} cases: {few:6.2f} s, peak {peak_few / 1e6:.0f} MB",
        f"collect   {MORE:5} cases: {many:6.2f} s, peak {peak_many / 1e6:.0f} MB",
        f"open_mfdataset {CASES} files: {opened:6.2f} s",
    ]
    # a tile of cases is held at once, and no more than a tile
    return Result(
        f"{ratio:.3f} of its time, {each:.1f} kB for one case more",
        f"≤ {BOUND}, ≤ {GROWTH:g} kB",
        ratio <= BOUND and each <= GROWTH,
        "\n".join(lines),
    )


def collected(folder: Path, cases: int) -> tuple[float, float]:
    """Median seconds and peak bytes of processes that collect a study of so many cases."""
    rates = [float(k + 1) for k in range(cases)]
    vary = f"vary:\n  rate: {{parameter: wells.producer.rate, values: {rates}}}"
    text = TEXT.format(name=f"grid-{cases}", seconds=1.0, vary=vary, limits="")
    text = text.replace("observe: [well_pressure]", "observe: [probe_pressure]")
    text = text.replace("  times: [1 s, 10 s, 100 s]\n", PLACES)
    path = folder / f"grid-{cases}.yaml"
    path.write_text(text)
    timed_run(path, folder / "results", workers=2, table=GRIDS)
    command = [sys.executable, "-c", _COLLECT, str(path), str(folder / "results"), GRIDS]
    found = []
    for _ in range(REPEATS):
        done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
        found.append(json.loads(done.stdout))
    seconds, peak = np.median(found, axis=0)
    return float(seconds), float(peak)


PLACES = f"""  times: {[float(k + 1) for k in range(TIMES)]}
  probes: {{line: {{from: [-6 m, 0 m], to: [6 m, 0 m], count: {PROBES}}}}}
"""


def opened_by_xarray(folder: Path) -> float:
    """Seconds of `open_mfdataset` over a file per case, until its numbers are in memory."""
    folder.mkdir()
    for k in range(CASES):
        rate = float(k + 1)
        numbers = observe(rate=rate)["probe_pressure"]
        xr.Dataset(
            {"probe_pressure": (("rate", "probe", "elapsed_time"), numbers[None])},
            coords={"rate": [rate], "elapsed_time": np.arange(TIMES) + 1.0},
        ).to_netcdf(folder / f"{k:04}.nc", engine="netcdf4")
    files = sorted(folder.glob("*.nc"))
    begin = time.perf_counter()
    with xr.open_mfdataset(
        files, combine="nested", concat_dim="rate", engine="netcdf4", decode_times=False
    ) as dataset:
        dataset.load()
    return time.perf_counter() - begin
