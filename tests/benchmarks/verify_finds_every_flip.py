"""`verify` finds every flipped bit and every cut file, and a run computes just those anew."""

from __future__ import annotations

import random
import shutil

from sweep.upkeep import verify
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import TOYS, timed_run
from tests.sweep import toys

FLIPS, CUTS, AT_ONCE = 1000, 300, 7


def run() -> Result:
    """Damage one file after the other, then several at once before a run."""
    folder = results_folder() / "flips"
    folder.mkdir()
    path, results = toys.write_study(folder), folder / "results"
    timed_run(path, results, workers=2, table=TOYS)
    files = sorted([*results.glob("store/*/*.product"), *results.glob("*/dataset.nc")])
    chance = random.Random(1)
    missed = {"flip": 0, "cut": 0}
    false_alarms = 0
    for number in range(FLIPS + CUTS):
        kind = "flip" if number < FLIPS else "cut"
        file = chance.choice(files)
        whole = file.read_bytes()
        file.write_bytes(damaged(whole, kind, chance))
        found = [where for where, _ in verify(results).damaged]
        missed[kind] += file not in found
        false_alarms += len(set(found) - {file})
        file.write_bytes(whole)
        for left in file.parent.glob("*.damaged"):
            left.unlink()
    products = [file for file in files if file.suffix == ".product"]
    for file in chance.sample(products, AT_ONCE):
        file.write_bytes(damaged(file.read_bytes(), "flip", chance))
    found_at_once = len(verify(results).damaged)
    again = timed_run(path, results, workers=2, table=TOYS)
    sound = verify(results).damaged == []
    shutil.rmtree(folder)
    lines = [
        f"{FLIPS} bit flips, one at a time: {missed['flip']} missed",
        f"{CUTS} truncations, one at a time: {missed['cut']} missed",
        f"whole files called damaged: {false_alarms}",
        f"{AT_ONCE} at once: {found_at_once} found, {again.computed} stage runs computed again",
    ]
    wrong = sum(missed.values()) + false_alarms
    holds = wrong == 0 and found_at_once == again.computed == AT_ONCE and sound
    return Result(f"{wrong} of {FLIPS + CUTS} wrong", "0", holds, "\n".join(lines))


def damaged(content: bytes, kind: str, chance: random.Random) -> bytes:
    """The content with one bit flipped, or cut somewhere."""
    if kind == "cut":
        return content[: chance.randrange(len(content))]
    changed = bytearray(content)
    changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)
