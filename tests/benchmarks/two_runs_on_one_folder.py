"""Of two runs on one folder the second is refused; once the first is killed it takes over.

Twenty times: a run is under way, a second one must say which process holds the folder and
end with exit status 2, having changed nothing; the first gets SIGKILL, and a third run,
begun at once, must finish what is missing without anyone removing a lock.
"""

from __future__ import annotations

import json
import random
import shutil
import time

from demflow.sweep.dataset.open import open_results
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.same_bits_any_workers import differing
from tests.sweep import toys
from tests.sweep.processes import leftovers, products, start

TIMES = 20


def run() -> Result:
    """Let runs meet on one folder."""
    folder = results_folder() / "two_runs"
    folder.mkdir()
    path = toys.write_study(folder, stresses=(), rates=tuple(map(float, range(1, 21))), seconds=0.4)
    _, out, _ = start(path, folder / "calm", "--json").finish()
    calm, runs = open_results(folder / "calm" / "toy"), json.loads(out)["computed"]
    results = folder / "results"
    wrong = dict.fromkeys(("not refused", "not told by whom", "not taken over", "differ"), 0)
    chance = random.Random(1)
    told = ""
    for _ in range(TIMES):
        first = start(path, results)
        while not products(results):
            time.sleep(0.02)
        status, _, told = start(path, results).finish()
        wrong["not refused"] += status != 2
        wrong["not told by whom"] += f"in use by process {first.process.pid} on" not in told
        time.sleep(chance.uniform(0.0, 0.2))
        first.process.kill()
        third = start(path, results, "--json")  # at once: workers of the first may still be ending
        first.finish()
        status, out, _ = third.finish()
        computed = json.loads(out)["computed"] if status == 0 else 0
        wrong["not taken over"] += status != 0 or not 0 < computed < runs
        wrong["not taken over"] += bool(leftovers(results))
        wrong["differ"] += bool(differing(calm, open_results(results / "toy")))
        shutil.rmtree(results)
    shutil.rmtree(folder)
    lines = [f"the second is told: {told.strip()}", *(f"{k}: {n}" for k, n in wrong.items())]
    faults = sum(wrong.values())
    return Result(f"{faults} faults in {TIMES} meetings", "0", faults == 0, "\n".join(lines))
