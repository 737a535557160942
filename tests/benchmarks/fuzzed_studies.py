"""Damaged studies, 50,000 of them: `demflow check` ends in clean words or success, quickly.

Good studies are changed where it may hurt: keys, types, units, nesting, numbers, words, axes that
reach into blocks that are not there, laws, conditions, fits; the files beside them too. Each goes
through the command itself. Whatever it ends in besides its two exit statuses is a fault; so are
words that a terminal does not show, more than 1 s of processor time, and a process that comes to
200 MB. A process checks 5,000 of them, so that starting Python and loading libraries count seldom,
and memory is that of all these together. By itself the check takes a seed and a count:
`python -m tests.benchmarks.fuzzed_studies --seed 7 --count 500`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import random
import resource
import sys
import tempfile
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from demflow.sweep.command import cli
from tests.benchmarks.result import Result
from tests.sweep.damaged_studies import FILES, STUDIES, beside, damaged, studies, text

COUNT, SECONDS, MEGABYTES = 50_000, 1.0, 200.0
LONGEST = 200_000  # characters that a check may say
LOT = 5_000  # studies that a process checks


class Checked(NamedTuple):
    """How one check ended."""

    fault: str  # "" where there is none
    valid: bool
    seconds: float


def written(good: list[Any], seed: int, number: int, folder: Path) -> Path:
    """Write a damaged study and what lies beside it."""
    chance = random.Random(f"{seed}/{number}")
    path = folder / "study.yaml"
    path.write_bytes(damaged(good, chance))
    for name, content in beside(chance).items():
        (folder / name).write_bytes(content)
    return path


def checked(path: Path) -> Checked:
    """Check a study by the command."""
    said = io.StringIO()
    begin, fault, status = time.process_time(), "", None
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            status = cli.main(["check", str(path)])
    except BaseException:
        fault = traceback.format_exc(limit=-4)
    seconds = time.process_time() - begin
    told = said.getvalue()
    if not fault and status not in (0, 2):
        fault = f"exit status {status}"
    elif not fault and not all(map(str.isprintable, told.split("\n"))):
        fault = "words that a terminal does not show"
    elif not fault and len(told) > LONGEST:
        fault = f"{len(told)} characters of words"
    return Checked(fault, status == 0, seconds)


def load_modules(good: list[Any], folder: Path) -> None:
    """Load what a check takes from libraries, which takes a process longer than most checks."""
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    for tree in good:
        (folder / "study.yaml").write_text(text(tree, random.Random(0)))
        checked(folder / "study.yaml")


def peak_memory() -> float:
    """Most memory that this process has had, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


class Lot(NamedTuple):
    """What was found in the studies of a process; places are numbers of studies."""

    valid: int
    faults: list[str]
    slowest: tuple[float, int]  # s, and where
    highest: tuple[float, int]  # MB of memory, and where


def lot(seed: int, first: int, end: int) -> Lot:
    """Check damaged studies of a seed from one number up to another."""
    good = studies()
    faults: list[str] = []
    slowest, valid = (0.0, first), 0
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "maps").symlink_to(STUDIES / "maps")
        load_modules(good, Path(folder))
        highest = (peak_memory(), first)
        for number in range(first, end):
            one = checked(written(good, seed, number, Path(folder)))
            slowest = max(slowest, (one.seconds, number))
            valid += one.valid
            highest = max(highest, (peak_memory(), -number))
            if one.fault:
                faults.append(f"number {number}: {one.fault}")
    return Lot(valid, faults, slowest, (highest[0], abs(highest[1])))


def run(count: int = COUNT, seed: int = 1) -> Result:
    """Check so many damaged studies."""
    firsts = range(0, count, LOT)
    ends = [min(first + LOT, count) for first in firsts]
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        lots = list(pool.map(lot, [seed] * len(ends), firsts, ends))
    faults = [fault for one in lots for fault in one.faults]
    valid = sum(one.valid for one in lots)
    slowest = max(one.slowest for one in lots)
    highest = max(one.highest for one in lots)
    lines = [f"{count} studies, seed {seed}: {valid} valid", *faults[:20]]
    lines.append(f"slowest: number {slowest[1]}, {slowest[0]:.2f} s")
    lines.append(f"most memory: number {highest[1]}, {highest[0]:.0f} MB")
    unclean = f"{len(faults)} of {count} without a clean end"
    return Result(
        f"{unclean}; at most {slowest[0]:.2f} s, {highest[0]:.0f} MB",
        f"0; {SECONDS:g} s, {MEGABYTES:g} MB",
        not faults and slowest[0] <= SECONDS and highest[0] <= MEGABYTES,
        "\n".join(lines),
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--keep", nargs=2, metavar=("NUMBER", "FOLDER"), help="write one, and end")
    asked = parser.parse_args()
    if asked.keep is not None:
        written(studies(), asked.seed, int(asked.keep[0]), Path(asked.keep[1]))
        sys.exit()
    result = run(asked.count, asked.seed)
    print(result.details, result.line, sep="\n")
    sys.exit(not result.holds)
