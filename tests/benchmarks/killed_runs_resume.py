"""Runs that are killed 200 times at random moments resume: same bits, nothing computed twice.

The run's own process gets SIGKILL, as from the kernel when memory is out; its workers have
to end by themselves. A run is killed up to four times, at moments drawn evenly over the time
of an undisturbed one, then resumed to its end, compared, and begun afresh.
"""

from __future__ import annotations

import json
import random
import shutil
import time

from sweep.results import open_results
from sweep.upkeep import verify
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.same_bits_any_workers import differing
from tests.sweep import toys
from tests.sweep.processes import leftovers, products, start

KILLS, MOST_IN_A_ROW = 200, 4
SECONDS_TO_END = 5.0  # s within which no process may be left


def run() -> Result:
    """Kill, look what is left, resume, compare."""
    folder = results_folder() / "killed_runs"
    folder.mkdir()
    rates = tuple(float(k) for k in range(1, 17))
    path = toys.write_study(folder, rates=rates, seconds=0.05)
    begin = time.monotonic()
    status, out, _ = start(path, folder / "calm", "--json").finish()
    whole = time.monotonic() - begin
    calm, runs = open_results(folder / "calm" / "toy"), json.loads(out)["computed"]
    chance = random.Random(1)
    wrong: dict[str, int] = dict.fromkeys(
        ("processes left", "products computed again", "products lost", "runs not resumed",
         "runs that computed what was stored", "datasets that differ", "files left"), 0
    )  # fmt: skip
    kills = resumed = with_products = 0
    results = folder / "results"
    before: dict[str, tuple[int, int]] = {}
    while kills < KILLS:
        for _ in range(min(chance.randint(1, MOST_IN_A_ROW), KILLS - kills)):
            running = start(path, results)
            time.sleep(chance.uniform(0.0, whole))
            if running.process.poll() is not None:  # resumed so late that it was quicker
                running.finish()
                before = products(results)
                break
            running.process.kill()
            running.process.communicate()
            kills += 1
            wrong["processes left"] += len(running.left_after(SECONDS_TO_END))
            after = products(results)
            with_products += bool(after)
            wrong["products lost"] += len(before.keys() - after.keys())
            wrong["products computed again"] += _changed(before, after)
            before = after
        status, out, _ = start(path, results, "--json").finish()
        resumed += 1
        wrong["runs not resumed"] += status != 0
        wrong["runs that computed what was stored"] += json.loads(out)["computed"] != runs - len(
            before
        )
        wrong["products computed again"] += _changed(before, products(results))
        wrong["datasets that differ"] += bool(differing(calm, open_results(results / "toy")))
        wrong["files left"] += len(leftovers(results)) + len(verify(results).damaged)
        shutil.rmtree(results)
        before = {}
    shutil.rmtree(folder)
    lines = [
        f"{kills} kills within {whole:.1f} s, {with_products} of them with products stored; "
        f"{resumed} runs resumed to their end, {runs} stage runs each",
        *(f"{what}: {count}" for what, count in wrong.items()),
    ]
    faults = sum(wrong.values())
    return Result(f"{faults} faults in {kills} kills", "0", faults == 0, "\n".join(lines))


def _changed(before: dict[str, tuple[int, int]], after: dict[str, tuple[int, int]]) -> int:
    return sum(after.get(name, file) != file for name, file in before.items())
