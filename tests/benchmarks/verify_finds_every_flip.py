"""`verify` finds every flipped bit and every cut file, and a run computes just those anew.

First one file after the other is damaged and looked for. Then all damages are done again, many at
once and flips and cuts mixed, over the products of all stages, the records of failures and the
dataset; after each lot a run has to make exactly the damaged files again, with the same arrays.
"""

from __future__ import annotations

import random
import shutil
from pathlib import Path

from demflow.sweep.command.upkeep import verify
from demflow.sweep.store.products import unpack
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.benchmarks.sweeps import TOYS, timed_run
from tests.sweep import toy_stages, toys

FLIPS, CUTS, AT_ONCE = 1000, 300, 65
RATES = (*map(float, range(1, 16)), toy_stages.RAISES)


def run() -> Result:
    """Damage one file after the other, then many at once before a run."""
    folder = results_folder() / "flips"
    folder.mkdir()
    path, results = toys.write_study(folder, rates=RATES), folder / "results"
    timed_run(path, results, workers=2, table=TOYS)
    chance = random.Random(1)
    missed, false_alarms = one_by_one(results, chance)
    wrong, rounds, products, records = at_once(path, results, chance)
    sound = verify(results).damaged == []
    count = len(stored(results))
    shutil.rmtree(folder)
    lines = [
        f"{count} products and records of failures, and a dataset",
        f"{FLIPS} bit flips, one at a time: {missed['flip']} missed",
        f"{CUTS} truncations, one at a time: {missed['cut']} missed",
        f"whole files called damaged: {false_alarms}",
        f"the same numbers mixed, {AT_ONCE} at once in {rounds} rounds, a run after each: "
        f"{products} products and {records} records of failures made again, {wrong} files wrong, "
        "not made again, or made again without need",
    ]
    wrong += sum(missed.values()) + false_alarms
    holds = wrong == 0 and sound and products > 0 and records > 0
    return Result(f"{wrong} of {2 * (FLIPS + CUTS)} wrong", "0", holds, "\n".join(lines))


def one_by_one(results: Path, chance: random.Random) -> tuple[dict[str, int], int]:
    """Damages that `verify` misses, by their kind, and whole files that it calls damaged."""
    files = [*stored(results), *results.glob("*/dataset.nc")]
    missed, false_alarms = {"flip": 0, "cut": 0}, 0
    for number in range(FLIPS + CUTS):
        kind = "flip" if number < FLIPS else "cut"
        file = chance.choice(files)
        whole = file.read_bytes()
        file.write_bytes(damaged(whole, kind, chance))
        found = [where for where, _ in verify(results).damaged]
        missed[kind] += file not in found
        false_alarms += len(set(found) - {file})
        file.write_bytes(whole)
        remove_damaged(results)
    return missed, false_alarms


def at_once(path: Path, results: Path, chance: random.Random) -> tuple[int, int, int, int]:
    """Files that a run makes again wrongly or not; rounds, products and records made again."""
    kinds = ["flip"] * FLIPS + ["cut"] * CUTS
    chance.shuffle(kinds)
    (dataset,) = results.glob("*/dataset.nc")
    wrong = rounds = products = records = 0
    while kinds:
        rounds += 1
        before = {file: (identity(file), file.read_bytes()) for file in stored(results)}
        lot, kinds = kinds[:AT_ONCE], kinds[AT_ONCE:]
        hit = {dataset, *chance.sample(sorted(before), len(lot) - 1)}
        for file, kind in zip(sorted(hit), lot, strict=True):
            whole = file.read_bytes()
            file.write_bytes(damaged(whole, kind, chance))
            before[file] = identity(file), whole
        wrong += len(hit ^ {where for where, _ in verify(results).damaged})
        remove_damaged(results)
        again = timed_run(path, results, workers=2, table=TOYS)
        now = set(stored(results))
        made = {f for f in now if f not in before or identity(f) != before[f][0]}
        wrong += len(made ^ (hit - {dataset})) + len(now ^ (before.keys() - {dataset}))
        wrong += sum(not same(before[f][1], f.read_bytes()) for f in made & before.keys())
        wrong += again.computed != sum(f.suffix == ".product" for f in made)
        wrong += not dataset.exists() or bool(verify(results).damaged)
        products += again.computed
        records += sum(f.suffix == ".failed" for f in made)
    return wrong, rounds, products, records


def stored(results: Path) -> list[Path]:
    """Products and records of failures."""
    return sorted([*results.glob("store/*/*.product"), *results.glob("store/*/*.failed")])


def identity(file: Path) -> tuple[int, int]:
    """What tells a file from one that takes its place."""
    found = file.stat()
    return found.st_ino, found.st_mtime_ns


def same(before: bytes, after: bytes) -> bool:
    """Whether two products hold the same arrays, bit by bit; times in them differ."""
    first, second = unpack(before).arrays, unpack(after).arrays
    return first.keys() == second.keys() and all(
        first[name].tobytes() == second[name].tobytes() for name in first
    )


def remove_damaged(results: Path) -> None:
    """Remove what was set aside."""
    for left in results.rglob("*.damaged"):
        left.unlink()


def damaged(content: bytes, kind: str, chance: random.Random) -> bytes:
    """The content with one bit flipped, or cut somewhere."""
    if kind == "cut":
        return content[: chance.randrange(len(content))]
    changed = bytearray(content)
    changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)
