"""A march of 40 legs is killed and meets its limit of time: no finished leg is computed again.

Its run, or one of its workers, gets SIGKILL at a random moment, and the run goes on or is begun
again; then, in another folder, the limit of time ends it at its half and is raised. Two
schedules share their first 30 legs. A leg counts as finished once its product is stored.
"""

from __future__ import annotations

import json
import random
import time
from collections import Counter
from pathlib import Path

import psutil

from demflow.model.outcome import Status
from demflow.sweep.dataset.open import open_results
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.same_bits_any_workers import differing
from tests.sweep import marches, toys
from tests.sweep.processes import Run, leftovers, products
from tests.sweep.processes import start as start_toys

LEGS, SHARED, KILLS = 40, 30, 30
SECONDS, LONGER = 0.1, 0.25  # of a leg; of one that a run sees pass, which looks every 0.2 s
TABLE = {toys.OTHER_TABLE: marches.TOY}
FAULTS = (
    "products lost",
    "products computed again",
    "limits not kept",
    "files left",
    "variables that differ",
)


def run() -> Result:
    """Kill, resume, limit, compare."""
    folder = results_folder() / "marches"
    folder.mkdir()
    beginning = [1.0 + k % 3 for k in range(SHARED)]
    steps = [[*beginning, *(float(end) for _ in range(LEGS - SHARED))] for end in (4, 5)]
    path = _write(folder, steps)
    begin = time.monotonic()
    status, out, _ = start(path, folder / "calm").finish()
    whole, runs = time.monotonic() - begin, json.loads(out)["computed"]
    assert (status, runs) == (0, 1 + SHARED + 2 * (LEGS - SHARED) + 2)
    wrong: Counter[str] = Counter(dict.fromkeys(FAULTS, 0))
    resumed = _kill_and_resume(path, folder / "killed", whole, wrong)
    half = _limit_and_raise(folder, steps, wrong)
    for name in ("killed", "limited"):
        results = folder / name
        wrong["files left"] += len(leftovers(results))
        calm, found = (open_results(f / "marched") for f in (folder / "calm", results))
        wrong["variables that differ"] += len(differing(calm, found))
    lines = [
        f"{KILLS} kills of runs of {whole:.1f} s and {runs} stage runs, {resumed} of them resumed",
        f"the limit of time ended the march after {half} of {SHARED + 2 * (LEGS - SHARED)} legs",
        *(f"{what}: {count}" for what, count in wrong.items()),
    ]
    faults = sum(wrong.values())
    good = faults == 0 and resumed > 0 and half > 0
    return Result(f"{faults} faults in {KILLS} kills and a limit", "0", good, "\n".join(lines))


def start(path: Path, results: Path) -> Run:
    """Begin or resume a run."""
    return start_toys(path, results, "--json", **TABLE)


def _write(
    folder: Path, steps: list[list[float]], seconds: float = SECONDS, limits: str = ""
) -> Path:
    last = 10.0 * LEGS
    return marches.write_study(folder, steps, last=last, seconds=seconds, limits=limits)


def _kill_and_resume(path: Path, results: Path, whole: float, wrong: Counter[str]) -> int:
    """Kill runs and workers in turn, and let the last run end; how many runs were resumed."""
    chance, before, resumed = random.Random(1), products(results), 0
    running = start(path, results)
    for kill in range(KILLS):
        time.sleep(chance.uniform(0.0, 0.5 * whole))
        before = _compared(before, results, wrong)
        if kill % 2 == 0 and (workers := running.workers()):
            try:
                chance.choice(workers).kill()
            except psutil.NoSuchProcess:
                continue
        else:
            running.process.kill()
            running.process.communicate()
            running.left_after(5.0)
            before = _compared(before, results, wrong)
            running, resumed = start(path, results), resumed + 1
    running.finish()
    start(path, results).finish()
    _compared(before, results, wrong)
    return resumed


def _limit_and_raise(folder: Path, steps: list[list[float]], wrong: Counter[str]) -> int:
    """End a march by its limit, raise that, resume; legs that were finished before it."""
    results, half = folder / "limited", 0.5 * LEGS * LONGER
    status, _, _ = start(_write(folder, steps, LONGER, f"{{time: {half} s}}"), results).finish()
    ended = open_results(results / "marched").status.values
    wrong["limits not kept"] += status != 1 or set(ended.ravel()) != {int(Status.TIMED_OUT)}
    before = products(results)
    start(_write(folder, steps, LONGER), results).finish()
    _compared(before, results, wrong)
    return len(before) - 1


def _compared(
    before: dict[str, tuple[int, int]], results: Path, wrong: Counter[str]
) -> dict[str, tuple[int, int]]:
    after = products(results)
    wrong["products lost"] += len(before.keys() - after.keys())
    again = (name for name in before.keys() & after.keys() if before[name] != after[name])
    wrong["products computed again"] += sum(1 for _ in again)
    return after
