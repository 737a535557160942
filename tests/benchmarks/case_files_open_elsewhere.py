"""Every case file that the shipped studies make is clean, and opens in other programs.

Of each case of each study (its smoke block applied) the UGRID file goes through the compliance
checker's CF 1.11 and through the checker of UGRID's conformance rules (ugrid-checks), and is
opened, stepped through time and drawn by xugrid, uxarray, MDAL (in QGIS) and CDO; the VTU and PVD
files are read by VTK, every pore's area with them. Values, times and areas must be those of the
case. Files of tests to failure have no pores and go through the checker of CF alone. CASES bounds
the cases of a study, STUDIES names some. `make peers` installs what comes from PyPI,
`apt-get install python3-qgis qgis-providers cdo` the rest.

What is left out, since CF 1.11 (section 5.9) takes it from UGRID: that the checker of CF knows no
`cf_role` of a mesh (findings/cf_checker_refuses_the_roles_of_meshes.sh).
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from demflow import sweep
from demflow.sweep.dataset.open import open_case
from demflow.sweep.engine import run_study
from demflow.sweep.errors import ResultsError
from tests.benchmarks.ran import STUDIES
from tests.benchmarks.result import Result
from tests.peers.lammps import ENVIRONMENT
from tests.peers.yade import PeerMissingError

LOT = 50  # cases that a reader takes at a time: starting one takes as long as reading ten
CASES = int(os.environ.get("CASES", "1000"))
READER = Path(__file__).parents[1] / "peers" / "case_files.py"
OF_PYPI = ("cf_checker", "ugrid_checker", "xugrid", "uxarray", "vtk")
OF_THE_SYSTEM = ("mdal", "cdo")


def run() -> Result:
    """Write every case both ways and have the others read it."""
    jobs = _jobs()
    cases: dict[str, xr.Dataset] = {}
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory(prefix="demflow-bench-") as home:
        files = Path(home, "files")
        files.mkdir()
        for name, case in _every_case(Path(home, "results")):
            cases[name] = case
            if "mesh" in case:
                sweep.write_case(case, files / f"{name}.nc")
                sweep.write_case(case, files / f"{name}.pvd")
            case.to_netcdf(files / f"{name}_as_opened.nc")
            if len(cases) % LOT == 0:
                _read(jobs, files, found)
        _read(jobs, files, found)
    faults: Counter[str] = Counter()
    counts: Counter[str] = Counter()
    for reader, told in found.items():
        for name, one in told.items():
            case = cases[name.removesuffix("_as_opened")]
            problem = _problem(reader, one, case, name.endswith("_as_opened"))
            counts[reader] += problem is not None
            if problem:
                faults[f"{reader}: {name}: {problem}"] += 1
    files_read = ", ".join(f"{name} {number}" for name, number in counts.items())
    lines = [f"files read: {files_read}", *list(faults)[:40]]
    total = sum(counts.values())
    return Result(f"{len(faults)} of {total} readings not right", "0", not faults, "\n".join(lines))


Jobs = list[tuple[Path | str, tuple[str, ...]]]


def _jobs() -> Jobs:
    """Pythons and the readers that each has. Raises PeerMissingError."""
    python = Path(os.environ.get("PEERS_PYTHON", ENVIRONMENT / "bin" / "python"))
    system = os.environ.get("QGIS_PYTHON", "/usr/bin/python3")
    if not python.exists():
        raise PeerMissingError("xugrid, uxarray and VTK are not installed: make peers")
    if shutil.which("cdo") is None or subprocess.run([system, "-c", "import qgis"]).returncode:
        raise PeerMissingError("apt-get install python3-qgis qgis-providers cdo")
    return [*((python, (reader,)) for reader in OF_PYPI), (system, OF_THE_SYSTEM)]


def _every_case(results: Path) -> Iterator[tuple[str, xr.Dataset]]:
    """The maps of all cases of all studies, each run before."""
    named = os.environ.get("STUDIES", "").split()
    for study in sorted(STUDIES.glob("*.yaml")):
        if named and study.stem not in named:
            continue
        run_study(study, workers=2, results=results, smoke=True, figures=False)
        number = 0
        for name, case in _cases(results / sweep.load_study(study).name):
            yield f"{study.stem}_{name}", case
            number += 1
        print(f"{study.stem}: {number} cases written", file=sys.stderr, flush=True)


def _read(jobs: Jobs, files: Path, found: dict[str, dict[str, Any]]) -> None:
    """Have all files of a folder read, each reader started once, and take them away."""
    if not any(files.iterdir()):
        return
    with ThreadPoolExecutor(2) as pool:
        for told in pool.map(_told, *zip(*jobs, strict=True), itertools.repeat(files)):
            for reader, one in told.items():
                found.setdefault(reader, {}).update(one)
    for file in files.iterdir():
        file.unlink()


def _cases(folder: Path) -> Iterator[tuple[str, xr.Dataset]]:
    """The maps of every case that has some."""
    with sweep.open_results(folder) as dataset:
        axes = [name for name in dataset["status"].dims]
        values = [dataset[name].values.tolist() for name in axes]
    number = 0
    for at in itertools.product(*values):
        try:
            case = open_case(folder, **dict(zip(map(str, axes), at, strict=True)))
        except ResultsError:
            continue  # it failed, as hard cases are to, or `where` leaves it out
        yield f"case_{number}", case
        number += 1
        if number == CASES:
            return


def _told(python: Path | str, readers: tuple[str, ...], folder: Path) -> dict[str, Any]:
    """What readers told of all files of a folder."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    told = subprocess.run(
        [python, READER, folder, *readers], capture_output=True, text=True, env=environment
    )
    if told.returncode:
        raise RuntimeError(told.stderr[-2000:])
    found: dict[str, Any] = json.loads(told.stdout.splitlines()[-1])
    return found


def _problem(reader: str, told: dict[str, Any], case: xr.Dataset, as_opened: bool) -> str | None:
    """What is wrong with what a reader told, "" where nothing is; None: it is not asked."""
    asked = reader in ("cf_checker", "ugrid_checker")
    if ("mesh" not in case and reader != "cf_checker") or (as_opened and not asked):
        return None
    if "error" in told:
        return str(told["error"])
    if asked:
        messages = [
            one for one in told["messages"] if "cf_role" not in one or reader != "cf_checker"
        ]
        return "; ".join(messages)
    values = case["pressure"] if "pressure" in case else case["volume"]
    stepped = "elapsed_time" in values.dims
    times = case["elapsed_time"].values if stepped else np.zeros(1)
    expected = values.sum("domain").values.reshape(-1)
    sums = np.array(told["sums"])
    if sums.shape != expected.shape or not np.allclose(sums, expected, rtol=1e-9):
        return f"{len(sums)} values, {len(expected)} times, or others than the case's"
    if "drawn" in told and not 0.2 < told["drawn"] <= 1.0:
        return f"drawn on {told['drawn']:.0%} of the picture"
    if "hours" in told and stepped and not np.allclose(told["hours"], times / 3600.0, atol=1e-6):
        return "other times"
    if reader == "vtk":
        areas = _areas(case)
        if not np.allclose(told["areas"], areas) or not np.allclose(told["stored_areas"], areas):
            return "other areas"
        if not np.array_equal(told["times"], times):
            return "other times"
    return ""


def _areas(case: xr.Dataset) -> list[float]:
    """Area of each pore, m², corner by corner."""
    x, y = case["mesh_node_x"].values, case["mesh_node_y"].values
    areas = []
    for face in case["mesh_face_nodes"].values:
        corners = [int(k) for k in face if k >= 0]
        pairs = zip(corners, corners[1:] + corners[:1], strict=True)
        areas.append(0.5 * abs(sum(x[a] * y[b] - x[b] * y[a] for a, b in pairs)))
    return areas
