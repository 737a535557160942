"""A table of stages of a few lines, which can also do all that a stage must not do.

The rate of the well says how `flow` behaves, the viscosity how long it takes in seconds.
Where the environment names a file, `flow` writes a line there whenever it begins and ends,
so that it shows what was really executed, and how often.
"""

from __future__ import annotations

import asyncio
import ctypes
import os
import signal
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from demflow.model.compilation import compilation
from demflow.model.memory import foresee
from demflow.model.outcome import ModelError
from demflow.model.quantities import checked
from demflow.model.scene import Scene
from demflow.model.stages import Stage

SLOW_SEED, SLOW_SECONDS = 77, 1.2  # a packing that takes its time
RAISES, DIES, HANGS, GROWS, BREAKS, NO_MEMORY = -1.0, -2.0, -3.0, -4.0, -5.0, -6.0
NO_NUMBER, HOLDS_ON, FORESEES = -7.0, -8.0, -9.0
COMPILES, COMPILES_AND_HANGS, COMPILING_SECONDS = -10.0, -11.0, 1.1
LONG, LONG_SECONDS = 1e5, 0.6  # rates from which on a flow takes longer than the others
ANSWERS_SLOWLY, DIES_ANSWERING, ANSWER_SECONDS = -12.0, -13.0, 1.0
FORGETS, LITTLE_MEMORY = -14.0, 1_500_000  # bytes: a packing, but no stress beside it
DIARY = "DEMFLOW_TOY_DIARY"  # of the environment: the file of what was executed


class Packed(NamedTuple):
    x: Any
    seed: Any


class Loaded(NamedTuple):
    force: Any


class Flowed(NamedTuple):
    pressure: Any


def pack(*, count: int, seed: int) -> Packed:
    if seed == SLOW_SEED:
        time.sleep(SLOW_SECONDS)
    return Packed(np.random.default_rng(seed).random(count), np.asarray(seed))


def stress(packed: Packed, *, stress: Any) -> Loaded:
    return Loaded(packed.x * stress.xx + stress.yy)


def flow(  # noqa: C901 (as many ways to end as there are)
    packed: Packed, loaded: Loaded | None, *, rate: float, viscosity: float, times: Any
) -> Flowed:
    _note("begins", packed, rate)
    if rate == RAISES:
        raise ModelError("the well is dry; try a smaller rate")
    if rate == DIES:
        os.kill(os.getpid(), signal.SIGKILL)
    if rate == HANGS:
        time.sleep(3600)
    if rate == GROWS:
        kept = np.ones(30_000_000)
        time.sleep(3600)
        kept += 1
    if rate == BREAKS:
        raise ZeroDivisionError("one over nothing")
    if rate == NO_MEMORY:
        raise MemoryError
    if rate == FORESEES:
        foresee("a toy", 1e8)
    if rate in (COMPILES, COMPILES_AND_HANGS):
        for _ in range(2):
            for _ in range(2):  # one within the other
                compilation.start()
            time.sleep(COMPILING_SECONDS)
            for _ in range(2):
                compilation.end()
        if rate == COMPILES_AND_HANGS:
            time.sleep(3600)
    if rate in (ANSWERS_SLOWLY, DIES_ANSWERING):
        _answer_slowly(dies=rate == DIES_ANSWERING)
    if rate == FORGETS:
        vars(sys.modules["demflow.sweep.execution.worker"])["_memory"].n = LITTLE_MEMORY
    if rate == NO_NUMBER:
        rate = np.nan
    if rate == HOLDS_ON:  # as a compiled loop does: no other thread of the process runs
        ctypes.PyDLL(None).sleep(3600)
    time.sleep(LONG_SECONDS if rate >= LONG else viscosity)
    _note("ends", packed, rate)
    base = packed.x.mean() + (0.0 if loaded is None else loaded.force.mean())
    return Flowed(base + rate * np.log1p(np.asarray(times)))


def _answer_slowly(dies: bool) -> None:
    """Have this worker take its time to give an answer away; or, the first time, die of it."""
    from distributed import get_worker  # only in a worker: runs without any start without Dask

    worker = get_worker()
    give = worker.handlers["get_data"]
    died = Path("died")  # in the worker's own folder, which its nanny gives to its successor

    async def slowly(comm: Any, **options: Any) -> Any:
        await asyncio.sleep(ANSWER_SECONDS)
        if dies and not died.exists():
            died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return await give(comm, **options)

    worker.handlers["get_data"] = slowly


def _note(what: str, packed: Packed, rate: float) -> None:
    if path := os.environ.get(DIARY):
        with Path(path).open("ab", buffering=0) as file:  # one line at a time, whoever else writes
            file.write(f"{what} {int(packed.seed)} {rate:g}\n".encode())


def noted(diary: Path, what: str) -> Counter[str]:
    """How often each flow, by seed and rate, `begins` or `ends` in a diary."""
    lines = diary.read_text().splitlines() if diary.exists() else []
    return Counter(line.partition(" ")[2] for line in lines if line.startswith(what))


def observe(packed: Packed, loaded: Loaded | None, flowed: Flowed) -> dict[str, np.ndarray]:
    found = {
        "well_pressure": flowed.pressure[None, :],
        "porosity": packed.x.std(),
        "grain_count": np.asarray(len(packed.x)),
    }
    if loaded is not None:
        found["stress_achieved"] = loaded.force[:3]
    return found


def _always(scene: Scene) -> bool:
    return True


def _loaded(scene: Scene) -> bool:
    return scene.stress is not None


def observe_poorly(
    packed: Packed, loaded: Loaded | None, flowed: Flowed, *, rate: float
) -> dict[str, np.ndarray]:
    """What `observe` finds, with a balance that is as bad as the rate is large."""
    poor = {"mass_balance_error": rate, "lowest_pressure": -rate, "tolerance_met": np.nan}
    return observe(packed, loaded, flowed) | {name: np.asarray(v) for name, v in poor.items()}


STAGES = (
    Stage(
        "pack",
        f"{__name__}:pack",
        1,
        (),
        {"count": lambda s: s.grains.count, "seed": lambda s: s.grains.seed},
        _always,
        Packed,
    ),
    Stage(
        "stress",
        f"{__name__}:stress",
        1,
        ("pack",),
        {"stress": lambda s: s.stress},
        _loaded,
        Loaded,
    ),
    Stage(
        "flow",
        f"{__name__}:flow",
        1,
        ("pack", "stress"),
        {
            "rate": lambda s: s.wells[0].rate,
            "viscosity": lambda s: s.fluid.viscosity,
            "times": lambda s: s.times,
        },
        _always,
        Flowed,
    ),
    Stage(
        "observe",
        f"{__name__}:observe",
        1,
        ("pack", "stress", "flow"),
        {},
        _always,
        dict,
        check=checked,
        observed=True,
    ),
)

POOR = (
    *STAGES[:-1],
    Stage(
        "observe",
        f"{__name__}:observe_poorly",
        1,
        ("pack", "stress", "flow"),
        {"rate": lambda s: s.wells[0].rate},
        _always,
        dict,
        observed=True,
    ),
)
