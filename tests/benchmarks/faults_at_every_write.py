"""No space, an I/O error, permission refused, at every call that changes the disk, in turn.

A layer between the run and the disk (`fail_at.c`, loaded with LD_PRELOAD into the run and its
workers, so that it sees what netCDF and HDF5 write as well) counts all calls that create, write,
flush, rename or remove something in the results folder. Each of them fails in a run of its own:
in a new folder; in one that holds the results of an earlier, smaller study of the same name;
with every product stored, while the dataset is made anew; and while figures are drawn. The three
kinds of fault take turns over the calls. Each run must end with the status that its outcome has
and one line that names the place; all that was there must be whole; the next run must complete
with the same bits.

With EVERY in the environment only every so many-th call fails (no multiple of three, so that the
kinds still take turns). It needs Linux and a C compiler (`cc`), which nothing else of demflow does.
"""

from __future__ import annotations

import errno
import json
import mmap
import os
import shutil
import struct
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from demflow import sweep
from demflow.sweep.command.upkeep import verify
from demflow.sweep.dataset.open import open_results
from tests.benchmarks.ran import STUDIES, results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.same_bits_any_workers import differing
from tests.sweep import toys
from tests.sweep.processes import ROOT, leftovers, products

EVERY = int(os.environ.get("EVERY", "1"))
LAYER = Path(__file__).parent / "fail_at.c"
STATE = struct.Struct("llll")  # calls so far, the one that fails, its error, whether it lasts
KINDS = {
    "no space": (errno.ENOSPC, True),  # from then on, for all that needs space
    "I/O error": (errno.EIO, False),
    "permission refused": (errno.EACCES, False),
}

# one process that has imported everything, from which each run is forked
_RUNS = """
import os, sys
from demflow.sweep.command import cli
from tests.sweep import toys
import netCDF4, psutil, sweep.dataset.collect, sweep.execution.loop, sweep.figures, sweep.report
for line in sys.stdin:
    command, study, results, log = line.split()
    pid = os.fork()
    if pid == 0:
        sys.stdin.close()
        with open(log, "w") as out:
            os.dup2(out.fileno(), 1)
            os.dup2(out.fileno(), 2)
        status = 99
        try:
            if command == "run":
                status = toys.demflow("run", study, "--results", results, "--workers", "1")
            else:
                status = cli.main(["report", study, "--results", results, "--smoke"])
        except BaseException:
            import traceback
            traceback.print_exc()
        sys.exit(status)  # as a program ends: what it shares with others is given back
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


@dataclass
class Disk:
    """Runs below a folder of which chosen calls fail."""

    folder: Path
    state: mmap.mmap
    process: subprocess.Popen[str]

    def run(
        self, study: Path, turn: int = 0, error: int = 0, lasting: bool = False, do: str = "run"
    ) -> int:
        """`demflow run` or `report`, while the call number `turn` fails; return its exit status."""
        self.state[:] = bytes(len(self.state))
        self.state[: STATE.size] = STATE.pack(0, turn, error, lasting)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(do, study, self.results, self.log, file=self.process.stdin, flush=True)
        return int(self.process.stdout.readline())

    @property
    def results(self) -> Path:
        """Where runs write, and calls fail."""
        return self.folder / "results"

    @property
    def log(self) -> Path:
        """What the last run said."""
        return self.folder / "log"

    @property
    def calls(self) -> int:
        """Calls that the last run made."""
        return STATE.unpack_from(self.state)[0]

    @property
    def what(self) -> str:
        """The call that failed, and its file."""
        return bytes(self.state[STATE.size :]).partition(b"\0")[0].decode()


def start(folder: Path, compiler: str) -> Disk:
    """Compile the layer and start the process from which runs are forked."""
    folder.mkdir()
    library, shared = folder / "fail_at.so", folder / "state"
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(LAYER), "-ldl"], check=True
    )
    shared.write_bytes(bytes(STATE.size + 5000))
    with shared.open("r+b") as file:
        state = mmap.mmap(file.fileno(), 0)
    layer = {
        "LD_PRELOAD": str(library),
        "FAULT_STATE": str(shared),
        "FAULT_ROOT": str(folder / "results"),
    }
    process = subprocess.Popen(
        [sys.executable, "-c", _RUNS],
        env={**os.environ, **layer, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    return Disk(folder, state, process)


Way = Callable[[Disk], Iterator["Trial"]]


def run() -> Result:
    """Let each call of a run fail in turn, and look what that did."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or not sys.platform.startswith("linux"):
        return Result("not run: it needs Linux and a C compiler", "0 faults", False)
    lane = partial(in_a_lane, results_folder(), compiler)
    with ProcessPoolExecutor(len(WAYS), get_context("spawn")) as lanes:
        trials = list(chain(*lanes.map(lane, WAYS)))
    problems = [f"{trial.kind}, {trial.what}: {p}" for trial in trials for p in trial.problems]
    where = Counter(trial.where for trial in trials)
    calls = Counter(trial.what.partition(" ")[0] for trial in trials)
    lines = [*problems, *(f"{name}: {count} faults" for name, count in where.items())]
    lines.append(json.dumps(dict(calls)))
    return Result(
        f"{len(problems)} problems after {len(trials)} faults", "0", not problems, "\n".join(lines)
    )


def in_a_lane(folder: Path, compiler: str, way: Way) -> list[Trial]:
    """What the faults did that fail one of the ways to write, on a disk of its own."""
    disk = start(folder / f"faults_{way.__name__}", compiler)
    trials = list(way(disk))
    disk.process.communicate()
    shutil.rmtree(disk.folder)
    return trials


class Trial(NamedTuple):
    """What one fault did."""

    where: str
    kind: str
    what: str  # the call that failed, and its file
    problems: list[str]


def compute(disk: Disk) -> Iterator[Trial]:
    """Let each call fail by which products and dataset are written."""
    small = toys.write_study(disk.folder, seeds=(1,), stresses=(), rates=(1.0,))
    earlier = disk.folder / "earlier"
    assert disk.run(small) == 0
    disk.results.rename(earlier)
    study = toys.write_study(disk.folder, seeds=(1,), stresses=(), rates=(1.0, 2.0))
    assert disk.run(study) == 0
    calm = open_results(disk.results / "toy")
    stored = disk.folder / "stored"
    shutil.copytree(disk.results, stored)
    shutil.copytree(earlier / "toy", stored / "toy", dirs_exist_ok=True)
    starts = {"a new folder": None, "an earlier study": earlier, "all stored": stored}
    for name, before in starts.items():
        _reset(disk, before)
        assert disk.run(study) == 0
        for turn, kind, error in _turns(disk.calls):
            _reset(disk, before)
            kept = products(disk.results)
            status = disk.run(study, turn, *error)
            what = disk.what
            if before is not stored and "/dataset.nc" in what:
                break  # of the same products the last of the starts makes it
            if not what:
                continue  # workers answer in another order now and then
            problems = [
                *said(disk, status, os.strerror(error[0])),
                *harm(disk.results, kept),
                *(() if status else outcome(disk.results, calm)),
            ]
            if (again := disk.run(study)) != 0:
                problems.append(f"the next run ends with {again}: {disk.log.read_text()}")
            else:
                problems += outcome(disk.results, calm)
            problems += [f"left: {path}" for path in leftovers(disk.results)]
            yield Trial(name, kind, what, problems)


def draw(disk: Disk) -> Iterator[Trial]:
    """Let each call fail by which figures and report of the quickstart are written."""
    _reset(disk, None)
    study = STUDIES / "quickstart.yaml"
    sweep.run(study, results=disk.results, smoke=True)
    folder = disk.results / sweep.load_study(study).name
    drawn = {path.name for path in (folder / "figures").iterdir()}
    assert disk.run(study, do="report") == 0
    for turn, kind, error in _turns(disk.calls):
        (folder / "report.html").unlink(missing_ok=True)
        shutil.rmtree(folder / "figures", ignore_errors=True)
        status = disk.run(study, turn, *error, do="report")
        what = disk.what
        problems = [*said(disk, status, os.strerror(error[0])), *harm(disk.results, {})]
        if (again := disk.run(study, do="report")) != 0:
            problems.append(f"the next report ends with {again}: {disk.log.read_text()}")
        elif {path.name for path in (folder / "figures").iterdir()} != drawn:
            problems.append("figures are missing")
        yield Trial("figures and report", kind, what, problems)


WAYS = (compute, draw)  # side by side


def _turns(calls: int) -> Iterator[tuple[int, str, tuple[int, bool]]]:
    """Every call once, with one kind of fault after the other."""
    for turn in range(1, calls + 1, EVERY):
        yield turn, *list(KINDS.items())[turn % len(KINDS)]


def _reset(disk: Disk, before: Path | None) -> None:
    shutil.rmtree(disk.results, ignore_errors=True)
    if before is not None:
        shutil.copytree(before, disk.results)


def said(disk: Disk, status: int, reason: str) -> list[str]:
    """What is wrong with how a run ended and what it said."""
    told = disk.log.read_text().strip()
    if status == 0:  # what failed was not needed
        return []
    last = told.splitlines()[-1] if told else ""
    clear = last.startswith("demflow: ") and str(disk.results) in last
    clear = clear and (reason in last or "netCDF" in last)
    if status not in (1, 2) or not clear or "Traceback" in told or "HDF5-DIAG" in told:
        return [f"status {status}, and it says: {told}"]
    if status == 2 and any(disk.results.glob("store/*/*.product")) and "cases done" in told:
        return [f"status 2 though something was run: {told}"]
    return []


def harm(results: Path, kept: dict[str, Any]) -> list[str]:
    """What is no longer whole."""
    found = []
    if (results / "store" / "FORMAT").exists():
        found += [f"damaged: {path}: {what}" for path, what in verify(results).damaged]
    there = products(results)
    found += [f"changed: {name}" for name, file in kept.items() if there.get(name) != file]
    return found


def outcome(results: Path, calm: Any) -> list[str]:
    """Where a dataset differs from that of an undisturbed run."""
    return [f"{name} differs" for name in differing(calm, open_results(results / "toy"))]
