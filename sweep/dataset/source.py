"""What the stages of each case left in the store."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from demflow.model.quantities import FAILURE
from demflow.sweep.plan.graph import Plan
from demflow.sweep.store.products import DamagedError, MissingError, Store


@dataclass
class Source:
    """Reads what the stages left in the store, and notes where it comes from."""

    plan: Plan
    store: Store
    damaged: list[str] = field(default_factory=list)
    origins: dict[str, set[str]] = field(default_factory=dict)  # versions and machines met

    def __post_init__(self) -> None:
        wanted = self.plan.wanted()
        self.rows = [row for row in range(len(self.plan.stages)) if wanted[row]]
        self.stages = tuple(self.plan.stages[row].name for row in self.rows)
        self.times = np.full((len(self.plan.runs), 2), np.nan)  # s by the clock, of the processor
        self.met = np.zeros(len(self.plan.runs), dtype=bool)  # runs whose times were looked up
        self._last: tuple[int, Mapping[str, np.ndarray]] | None = None  # run and product read last

    def result(self, case: int) -> Mapping[str, np.ndarray]:
        """What was observed of a case; nothing where that is damaged."""
        run, member = self.plan.result_of(case)
        if self._last is None or self._last[0] != run:
            try:
                stored = self.store.get(self.plan.runs[run].id)
            except (DamagedError, MissingError) as error:
                self.damaged.append(str(error))
                return {}
            self._note(run, stored.meta)
            self._last = (run, stored.arrays)
        arrays = self._last[1]
        if member < 0:
            return arrays
        return {name: array[member] for name, array in arrays.items() if name != FAILURE}

    def spent(self, case: int) -> dict[str, np.ndarray]:
        """Times of a case in s, under their names in `model.quantities.SWEEP`."""
        times, caused = np.full((len(self.plan.stages), 2), np.nan), [0.0]
        for row in self.rows:
            legs = self.plan.legs_to(int(self.plan.cases[case, row]))
            for number, run in enumerate(legs):
                if not self.met[run]:
                    self._look_up(run)
                times[row] = self.times[run] + (times[row] if number else 0.0)
                if self.plan.runs[run].case == case:
                    caused.append(self.times[run, 0])
        solver = [row for row in self.rows if self.plan.stages[row].name == "flow"]
        return {
            "compute_time": np.nansum(caused),
            "stage_time": times[self.rows, 0],
            "solver_time": times[solver, 1].sum() if solver else np.asarray(math.nan),
        }

    def _look_up(self, run: int) -> None:
        identity = self.plan.runs[run].id
        try:
            self._note(run, self.store.meta(identity))
        except MissingError:
            self._note(run, self.store.failure(identity) or {})
        except DamagedError as error:
            self.damaged.append(str(error))

    def _note(self, run: int, meta: Mapping[str, Any]) -> None:
        self.met[run] = True
        self.times[run] = meta.get("seconds", math.nan), meta.get("cpu_seconds", math.nan)
        for name, number in meta.get("versions", {}).items():
            self.origins.setdefault(f"{name}_version", set()).add(number)
        if "machine" in meta:
            self.origins.setdefault("machine", set()).add(meta["machine"])
