"""One study whose workers are killed 100 times: every case good, the same bits.

Now and then one of its worker processes, be it at work, idle or just starting, gets SIGKILL.
Each kill may cost the one long stage run that the worker was at, which the stage itself writes
down; no product that is stored is ever made again.
"""

from __future__ import annotations

import json
import random
import shutil
import time

import psutil

from demflow.sweep.dataset.open import open_results
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.same_bits_any_workers import differing
from tests.sweep import toy_stages, toys
from tests.sweep.processes import Watch, leftovers, products, start

KILLS, BETWEEN = 100, (0.1, 1.0)  # s between two kills, drawn evenly
CASES, SECONDS = 300, 0.2  # enough that the study outlasts the kills


def run() -> Result:
    """Kill workers of one run and compare it with an undisturbed one."""
    folder = results_folder() / "killed_workers"
    folder.mkdir()
    rates = tuple(float(k) for k in range(1, CASES // 2 + 1))
    path = toys.write_study(folder, stresses=(), rates=rates, seconds=SECONDS)
    status, out, _ = start(path, folder / "calm", "--json").finish()
    calm, runs = open_results(folder / "calm" / "toy"), json.loads(out)["computed"]
    chance = random.Random(1)
    results = folder / "results"
    diary, watch = folder / "diary", Watch(results)
    running = start(path, results, "--json", **{toy_stages.DIARY: str(diary)})
    begin = time.monotonic()
    kills = 0
    while kills < KILLS and running.process.poll() is None:
        time.sleep(chance.uniform(*BETWEEN))
        watch.look()
        if workers := running.workers():
            try:
                chance.choice(workers).kill()
            except psutil.NoSuchProcess:
                continue
            kills += 1
    stormy = time.monotonic() - begin
    ended_early = running.process.poll() is not None
    status, out, err = running.finish()
    if not (results / "toy" / "dataset.nc").exists():
        return Result(f"exit status {status} after {kills} kills", "0", False, err)
    dataset = open_results(results / "toy")
    failed = int((dataset.status != 0).sum())
    differ = differing(calm, dataset)
    left = running.left_after(5.0)
    faults = failed + len(differ) + len(left) + len(leftovers(results)) + (status != 0)
    watch.look()
    begun = toy_stages.noted(diary, "begins")
    more = begun.total() - CASES
    faults += len(products(results)) != runs or bool(watch.again)
    faults += len(begun) != CASES or more > kills
    lines = [
        f"{kills} kills in {stormy:.0f} s, in {CASES} cases of {SECONDS:g} s on 2 workers",
        f"exit status {status}, {failed} cases failed, {len(differ)} variables differ",
        f"{json.loads(out)['computed']} stage runs counted, {runs} in the undisturbed run",
        f"{more} flows executed again, {len(watch.again)} products stored again",
        f"processes left: {len(left)}, files left: {len(leftovers(results))}",
    ]
    if ended_early:
        lines.append(f"the study ended before all kills: {err.strip().splitlines()[-1]}")
    shutil.rmtree(folder)
    return Result(
        f"{CASES - failed} of {CASES} cases good after {kills} kills",
        f"all after {KILLS}",
        faults == 0 and kills == KILLS,
        "\n".join(lines),
    )
