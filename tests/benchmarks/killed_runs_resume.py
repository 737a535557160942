"""Runs that are killed 200 times at random moments resume: same bits, nothing computed twice.

The run's own process gets SIGKILL, as from the kernel when memory is out; its workers have
to end by themselves. A run is killed up to four times, at moments drawn evenly over the time
of an undisturbed one, then resumed to its end, compared, and begun afresh. KILLS (of the
environment) is how many there are.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from demflow.sweep.command.upkeep import verify
from demflow.sweep.dataset.open import open_results
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.same_bits_any_workers import differing
from tests.sweep import toys
from tests.sweep.processes import leftovers, products, start

KILLS, MOST_IN_A_ROW = int(os.environ.get("KILLS", "200")), 4
LANES = 2  # storms at once, each in a folder of its own
KILLED, STORED, RESUMED = "kills", "kills with products stored", "runs resumed"
FAULTS = (
    "processes left",
    "products lost",
    "products computed again",
    "runs not resumed",
    "runs that computed what was stored",
    "datasets that differ",
    "files left",
)
SECONDS_TO_END = 5.0  # s within which no process may be left


def run() -> Result:
    """Kill, look what is left, resume, compare; in some folders side by side."""
    folder = results_folder() / "killed_runs"
    folder.mkdir()
    rates = tuple(float(k) for k in range(1, 17))
    path = toys.write_study(folder, rates=rates, seconds=0.05)
    begin = time.monotonic()
    _, out, _ = start(path, folder / "calm", "--json").finish()
    whole = time.monotonic() - begin
    runs = json.loads(out)["computed"]
    with ProcessPoolExecutor(LANES, get_context("spawn")) as lanes:
        found = list(lanes.map(partial(storm, path, whole, runs), range(LANES)))
    shutil.rmtree(folder)
    counts = {what: sum(wrong[what] for wrong in found) for what in found[0]}
    kills, stored, resumed = (counts.pop(what) for what in (KILLED, STORED, RESUMED))
    lines = [
        f"{kills} kills within {whole:.1f} s, {stored} of them with products stored; "
        f"{resumed} runs resumed to their end, {runs} stage runs each",
        *(f"{what}: {count}" for what, count in counts.items()),
    ]
    faults = sum(counts.values())
    return Result(
        f"{faults} faults in {kills} kills", "0", faults == 0 and kills == KILLS, "\n".join(lines)
    )


def storm(path: Path, whole: float, runs: int, lane: int) -> Counter[str]:
    """Kill and resume in a folder until this lane has its share of kills; what happened."""
    chance = random.Random(lane)
    calm = open_results(path.parent / "calm" / "toy")
    results = path.parent / f"results_{lane}"
    before: dict[str, tuple[int, int]] = {}
    told: Counter[str] = Counter(dict.fromkeys((KILLED, STORED, RESUMED, *FAULTS), 0))
    while (left := KILLS // LANES - told[KILLED]) > 0:
        for _ in range(min(chance.randint(1, MOST_IN_A_ROW), left)):
            running = start(path, results)
            time.sleep(chance.uniform(0.0, whole))
            if running.process.poll() is not None:  # resumed so late that it was quicker
                running.finish()
                before = products(results)
                break
            running.process.kill()
            running.process.communicate()
            told[KILLED] += 1
            told["processes left"] += len(running.left_after(SECONDS_TO_END))
            after = products(results)
            told[STORED] += bool(after)
            told["products lost"] += len(before.keys() - after.keys())
            told["products computed again"] += _changed(before, after)
            before = after
        status, out, _ = start(path, results, "--json").finish()
        told[RESUMED] += 1
        told["runs not resumed"] += status != 0
        computed = json.loads(out)["computed"] if out else -1
        told["runs that computed what was stored"] += computed != runs - len(before)
        told["products computed again"] += _changed(before, products(results))
        told["datasets that differ"] += bool(differing(calm, open_results(results / "toy")))
        told["files left"] += len(leftovers(results)) + len(verify(results).damaged)
        shutil.rmtree(results)
        before = {}
    return told


def _changed(before: dict[str, tuple[int, int]], after: dict[str, tuple[int, int]]) -> int:
    return sum(after.get(name, file) != file for name, file in before.items())
