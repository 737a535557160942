"""One poison case among 100 costs nothing but itself, and says what it was.

On stages of a few lines, which can do what a model must not: kill their process, hang, hang in
compiled code, eat memory, raise, return NaN. On the model itself: a case too large for the
study's limits of time and memory, and one that cannot be.

No other case may be run twice once it is stored. The stages of a few lines write down whenever
they are executed: a healthy one once, or, where a worker died, once more if it was there.
"""

from __future__ import annotations

import os
import shutil
from collections import Counter
from pathlib import Path

from demflow.model.outcome import Status
from demflow.sweep.dataset.open import open_results
from demflow.sweep.engine import Finished, run_study
from tests.benchmarks.ran import results_folder
from tests.benchmarks.result import Result
from tests.sweep import toy_stages, toys
from tests.sweep.processes import Watch, products

CASES, POISONED = 100, 37
MEMORY, TIME = "{memory: 250 MB}", "{time: 3 s}"

TOYS = {
    "kills its worker": (toy_stages.DIES, "", Status.WORKER_DIED, "its worker process died"),
    "hangs": (toy_stages.HANGS, TIME, Status.TIMED_OUT, "not done after 3 s"),
    "hangs in compiled code": (toy_stages.HOLDS_ON, TIME, Status.TIMED_OUT, "not done after 3 s"),
    "eats memory": (toy_stages.GROWS, MEMORY, Status.OUT_OF_MEMORY, "more than 0.25 GB"),
    "is refused memory": (toy_stages.NO_MEMORY, "", Status.OUT_OF_MEMORY, "no memory left"),
    "raises": (toy_stages.RAISES, "", Status.FAILED, "the well is dry; try a smaller rate"),
    "breaks": (toy_stages.BREAKS, "", Status.FAILED, "ZeroDivisionError: one over nothing"),
    "returns NaN": (toy_stages.NO_NUMBER, "", Status.FAILED, "is not a finite number"),
}

MODEL = """
study: {name}
scene:
  region: {{shape: rectangle, width: 14 m, height: 14 m}}
  grains: {{count: 100, porosity: 0.17, seed: 1}}
  matrix: {{permeability: 1 mD}}
  fluid: {{viscosity: 1 Pa s, bulk_modulus: 1 GPa}}
  boundaries: {{left: 7 MPa, right: 5 MPa}}
  initial_pressure: 7 MPa
  times: [1 s, 10 s]
vary:
  case: {{parameters: [grains.seed, grains.count], values: {values}}}
observe: [boundary_flow]
limits: {limits}
"""
MODEL_CASES = {
    "larger than the time": (1_000_000, "{time: 10 s}", Status.TIMED_OUT, "not done after 10 s"),
    "larger than the memory": (
        2_000_000, "{memory: 500 MB}", Status.OUT_OF_MEMORY, "more than 0.5 GB",
    ),
}  # fmt: skip


def run() -> Result:
    """Run a study of 100 cases for each kind of poison."""
    folder = results_folder() / "poison"
    folder.mkdir()
    lines, wrong = [], 0
    for number, (kind, (rate, limits, status, words)) in enumerate(TOYS.items()):
        rates = [float(k + 1) for k in range(CASES)]
        rates[POISONED] = rate
        path = toys.write_study(
            folder, name=f"toy{number}", seeds=(), stresses=(), rates=tuple(rates), limits=limits
        )
        diary, watch = folder / f"diary{number}", Watch(folder / f"toy{number}")
        os.environ[toy_stages.DIARY] = str(diary)
        finished = toys.run(path, watch.results, workers=2, progress=watch.look)
        del os.environ[toy_stages.DIARY]
        begun = toy_stages.noted(diary, "begins")
        assert len(begun) == CASES
        del begun[f"1 {rate:g}"]
        wrong += judged(kind, finished, status, words, watch, begun, lines)
    for number, (kind, (count, limits, status, words)) in enumerate(MODEL_CASES.items()):
        path = model_study(folder, f"model{number}", count, limits)
        watch = Watch(folder / f"model{number}")
        finished = run_study(path, results=watch.results, figures=False, progress=watch.look)
        wrong += judged(kind, finished, status, words, watch, Counter(), lines)
    shutil.rmtree(folder)
    kinds = len(TOYS) + len(MODEL_CASES)
    return Result(
        f"{kinds - wrong} of {kinds} kinds cost one case of {CASES} and are named",
        "all",
        wrong == 0,
        "\n".join(lines),
    )


def model_study(folder: Path, name: str, count: int, limits: str) -> Path:
    """A study of the model in which one packing is far larger than the others."""
    values = [[seed + 1, count if seed == POISONED else 100] for seed in range(CASES)]
    path = folder / f"{name}.yaml"
    path.write_text(MODEL.format(name=name, values=values, limits=limits))
    return path


def judged(
    kind: str,
    finished: Finished,
    status: Status,
    words: str,
    watch: Watch,
    begun: Counter[str],
    lines: list[str],
) -> bool:
    """Whether another case is not good or was run twice, or the poisoned one is not told right.

    `begun` says how often each healthy case was executed, as far as that was written down.
    """
    dataset = open_results(finished.folder)
    ended = dataset.status.values
    good = int((ended == Status.DONE).sum())
    found, message = Status(int(ended[POISONED])), str(dataset.message.values[POISONED])
    assert finished.executed is not None
    lines.append(f"{kind}: {good} good; {found.name.lower()}: {message}")
    computed, stored = finished.executed.computed, len(products(finished.folder.parent))
    deaths, twice = finished.executed.deaths, sum(times > 1 for times in begun.values())
    lines[-1] += (
        f" ({computed} stage runs, {stored} stored, {len(watch.again)} stored again; "
        f"{deaths} deaths, {twice} healthy cases executed twice)"
    )
    often = max(begun.values(), default=0) > (2 if deaths else 1)
    told = found is status and words in message
    return good != CASES - 1 or not told or computed != stored or bool(watch.again) or often
