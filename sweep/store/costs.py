"""What stage runs have cost so far on this kind of machine, and what others would cost by that.

A run costs what runs of its kind did: the same stage and version, the same solver, a scene of
about the same size. Where none of that size was seen, the nearest size is scaled by a power law
fitted to those that were. Kept beside the store, and in the user's cache folder for the results
folders to come, in files that may be lost without harm.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from demflow.sweep.plan.runs import SIZE_STEP, CostClass
from demflow.sweep.store.durable import write_durably
from demflow.sweep.store.products import Store
from demflow.sweep.store.versions import machine

GROWTH = 1.0  # exponent of a stage that was seen at one size only: as the size
DOUBT = 0.05  # weight of that exponent beside the spread of the sizes that were seen
STEEPEST = 1.5  # exponent of a planar graph's factor; no stage grows faster
LIBRARIES = 3e7  # bytes of what single stages import; they do not grow
LEAST_PART = 0.01  # of a product that grows with the size, however much is counted beside it
ONCE = ("start", "drawing", "leading")  # times that a run takes once, whatever it runs
OUTLIERS = 3  # runs from which the slowest, which imports what is late, does not count


class Spent(NamedTuple):
    """Totals over the runs of one kind."""

    runs: int = 0
    seconds: float = 0.0
    slowest: float = 0.0  # s
    stored: int = 0  # bytes
    memory: int = 0  # largest resident memory of a worker after such a run, bytes
    bound: int = 0  # the same of workers that had compiled too, whose compiler counts, bytes
    kept: float = 0.0  # what times and the like made of what is stored, bytes
    held: float = 0.0  # and of the memory, the most, bytes
    loading: float = 0.0  # s that compiled code took to load beside a run, the most

    def and_one(
        self,
        kind: CostClass,
        seconds: float,
        stored: int,
        memory: int,
        compiled: bool,
        loading: float,
    ) -> Spent:
        """With one more run.

        Parameters
        ----------
        kind : class of runs that cost alike
        seconds : s that it took
        stored : bytes of its product
        memory : bytes that its process had at most
        compiled : whether kernels were compiled in it
        loading : s that compiled kernels took to load, beside the run itself
        """
        return Spent(
            self.runs + 1,
            self.seconds + seconds,
            max(self.slowest, seconds),
            self.stored + stored,
            max(self.memory, 0 if compiled else memory),
            max(self.bound, memory),
            self.kept + kind.bytes_kept,
            max(self.held, kind.bytes_held),
            max(self.loading, loading),
        )

    @property
    def possible(self) -> bool:
        """Whether these can be totals of runs: others may have written the file."""
        return all(0 <= float(number) < math.inf for number in self) and self.runs >= 1

    @property
    def peak(self) -> int:
        """Memory of a worker, bytes: no more than that where all of them had compiled."""
        return self.memory or self.bound

    @property
    def rest(self) -> float:
        """Memory of a worker without what times and the like made it hold, bytes."""
        return max(self.memory - self.held, min(self.memory, LIBRARIES))

    @property
    def typical(self) -> float:
        """Seconds of a run, without the slowest of several."""
        if self.runs < OUTLIERS:
            return self.seconds / self.runs
        return (self.seconds - self.slowest) / (self.runs - 1)


class Costs:
    """What was measured: totals by kind of run."""

    def __init__(self) -> None:
        self.known: dict[str, dict[int, Spent]] = {}  # by key, then by step of the size
        self.start: float | None = None  # s until the workers of a run stood, the last time
        self.drawing: float | None = None  # s that figures and report took, the last time
        self.leading: float | None = None  # s of a run besides: planning, collecting, the last time
        self._noted: set[str] = set()  # which of these are of this run
        self.main: int = 0  # memory of the process that leads a run, bytes: the least one seen

    @classmethod
    def read(cls, store: Store, *, everywhere: bool = False) -> Costs:
        """Return what earlier runs measured, nothing where that cannot be read.

        What another kind of machine took says nothing about this one. What runs with other
        results folders measured here counts where it is asked for, and this one knows nothing.
        """
        costs = cls()
        for file in (machine_file(), _file(store)) if everywhere else (_file(store),):
            costs._take(file)
        return costs

    def _take(self, file: Path) -> None:
        """Let what a file tells stand before what is known."""
        try:
            record: dict[str, Any] = json.loads(file.read_text())
            if record["machine"] != machine():
                return
            known = {
                key: {int(step): spent for step, spent in _spent(sizes) if spent.possible}
                for key, sizes in record["stages"].items()
            }
            once = {name: _seconds(record.get(name)) for name in ONCE}
            main = int(record.get("main", 0))
        except (OSError, ValueError, TypeError, AttributeError, KeyError):
            return
        for key, sizes in known.items():
            self.known[key] = self.known.get(key, {}) | sizes
        for name, told in once.items():
            if told is not None:
                setattr(self, name, told)
        self.main = main or self.main

    def write(self, store: Store, *, everywhere: bool = False) -> None:
        """Keep the totals for the next run; raises OSError where the store cannot be written.

        What a study took that is drawn or led once says little of another one: for those to come
        the mean of what was known and of the last one is kept.
        """
        record = {
            "machine": machine(),
            **{name: getattr(self, name) for name in ONCE},
            "main": self.main,
            "stages": self.known,
        }
        write_durably(_file(store), json.dumps(record, indent=1).encode())
        if everywhere:
            with suppress(OSError):
                others = Costs()
                others._take(machine_file())
                record["stages"] = {
                    key: others.known.get(key, {}) | self.known.get(key, {})
                    for key in others.known | self.known
                }
                for part in self._noted:
                    if (before := getattr(others, part)) is not None:
                        record[part] = 0.5 * (before + record[part])
                write_durably(machine_file(), json.dumps(record, indent=1).encode())

    def add(
        self,
        kind: CostClass,
        seconds: float,
        stored: int = 0,
        memory: int = 0,
        compiled: bool = False,
        loading: float = 0.0,
    ) -> None:
        """Count one more run; whether its worker had compiled kernels before.

        Parameters
        ----------
        kind : class of runs that cost alike
        seconds : s that it took
        stored : bytes of its product
        memory : bytes that its process had at most
        compiled : whether kernels were compiled in it
        loading : s that compiled kernels took to load, beside the run itself
        """
        sizes = self.known.setdefault(kind.key, {})
        sizes[kind.step] = sizes.get(kind.step, Spent()).and_one(
            kind, seconds, stored, memory, compiled, loading
        )

    def note(self, part: str, seconds: float) -> None:
        """Note what a part of this run took that comes once, s; one of `ONCE`."""
        setattr(self, part, seconds)
        self._noted.add(part)

    def led(self, memory: int) -> None:
        """Note the memory of a process that led a run, bytes."""
        self.main = min(self.main or memory, memory)

    def seconds(self, kind: CostClass) -> float | None:
        """Expected seconds of a run, None if its stage was never run."""
        times = {step: spent.typical for step, spent in self._sizes(kind).items()}
        return scaled(times, self._sizes(kind), kind.step, beyond=GROWTH)

    def loading(self, kinds: Iterable[CostClass]) -> float:
        """Expected seconds in which a process loads the compiled code of some stages, each once."""
        known = [self._sizes(kind).values() for kind in {kind.key: kind for kind in kinds}.values()]
        return sum(max((spent.loading for spent in sizes), default=0.0) for sizes in known)

    def stored(self, kind: CostClass) -> float | None:
        """Expected bytes of a product, None if its stage was never run.

        What times, rate changes and probes make of it is counted; the rest grows with the size.
        """
        sizes = {
            step: max(spent.stored - spent.kept, LEAST_PART * spent.stored) / spent.runs
            for step, spent in self._sizes(kind).items()
        }
        rest = scaled(sizes, self._sizes(kind), kind.step)
        return None if rest is None else rest + kind.bytes_kept

    def memory(self, kind: CostClass) -> float | None:
        """Expected memory of a worker after a run, bytes; None if its stage was never run.

        What a process holds before it does anything does not grow with the case: as much as
        the smallest that was seen. Nor does what a compiler takes: workers that have compiled
        count as they are, and only where no other ran the stage.
        """
        sizes = self._sizes(kind)
        peaks = {step: spent.memory for step, spent in sizes.items() if spent.memory}
        if not peaks:
            most = max((spent.bound for spent in sizes.values()), default=0)
            return most + kind.bytes_held if most else None
        rests = [s.rest for known in self.known.values() for s in known.values() if s.memory]
        least, near = min(rests), _nearest(peaks, kind.step)
        growth = math.exp(SIZE_STEP * (kind.step - near))
        # of one size alone nobody can tell what grows with it from what the stage imports
        fixed = 0.0 if len(peaks) > 1 else min(LIBRARIES, sizes[near].rest - least)
        grown = sizes[near].rest - least - fixed
        return least + fixed + grown * growth + kind.bytes_held

    def _sizes(self, kind: CostClass) -> dict[int, Spent]:
        """What is known of its kind, or else of what was done in the same way to other scenes."""
        others = (key for key in self.known if f"{key}/".startswith(f"{kind.alike}/"))
        return self.known.get(kind.key) or self.known.get(next(others, ""), {})


def _spent(sizes: dict[str, Any]) -> Iterator[tuple[str, Spent]]:
    yield from ((step, Spent(*entry)) for step, entry in sizes.items())


def _seconds(told: Any) -> float | None:
    """A time that a file tells, None where it is none."""
    return None if told is None or not 0.0 <= float(told) < math.inf else float(told)


def scaled(
    values: dict[int, float], seen: dict[int, Spent], step: int, *, beyond: float = 0.0
) -> float | None:
    """The value at a size: as measured there, else by a power law through the nearest size.

    Parameters
    ----------
    values : positive values by size (steps of ln size).
    seen : how often each size was seen.
    step : the size that is asked for.
    beyond : least exponent above all sizes that were seen: what small ones take that does not grow
        hides how the rest of it does.
    """
    if not values:
        return None
    if step in values:
        return values[step]
    # first runs import what is late, which does not grow with the size
    often = {size: value for size, value in values.items() if seen[size].runs >= OUTLIERS}
    values = often or values
    near = _nearest(values, step)
    growth = exponent(values, seen)
    if step > max(values):
        growth = max(growth, beyond)
    return values[near] * math.exp(growth * SIZE_STEP * (step - near))


def exponent(values: dict[int, float], seen: dict[int, Spent]) -> float:
    """Slope of ln value over ln size, by least squares, each size by its runs.

    It is drawn towards `GROWTH`, from which a few sizes close together do not take it away.
    """
    steps = [step for step, value in values.items() if value > 0.0]
    if len(steps) < 2:
        return GROWTH
    x = SIZE_STEP * np.array(steps)
    y = np.log([values[step] for step in steps])
    weight = np.array([min(seen[step].runs, 10) for step in steps], dtype=float)
    weight /= weight.sum()
    x, y = x - weight @ x, y - weight @ y
    slope = (weight @ (x * y) + DOUBT * GROWTH) / (weight @ (x * x) + DOUBT)
    return float(min(max(slope, 0.0), STEEPEST))


def _nearest(values: dict[int, Any], step: int) -> int:
    return min(values, key=lambda near: (abs(near - step), near))


def machine_file() -> Path:
    """Where the costs of all results folders are kept for one user of this machine."""
    home = os.environ.get("XDG_CACHE_HOME", "") or Path.home() / ".cache"
    return Path(home) / "demflow" / "costs.json"


def _file(store: Store) -> Path:
    return store.root / "costs.json"
