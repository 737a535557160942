"""A study read and planned, and what of it is stored: all that is known before anything runs."""

from __future__ import annotations

import functools
import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from demflow.model.outcome import Status
from demflow.model.parameters import SceneError
from demflow.model.quantities import FAILURE
from demflow.sweep.execution.limits import in_force
from demflow.sweep.execution.memory import available
from demflow.sweep.plan.graph import Plan, make_plan
from demflow.sweep.plan.table import MODEL, stage_table
from demflow.sweep.store.costs import Costs
from demflow.sweep.store.origins import with_origins
from demflow.sweep.store.products import DamagedError, MissingError, Store
from demflow.sweep.study.load import Limits, Study, load_study
from demflow.sweep.study.scenes import SceneBuilder

if TYPE_CHECKING:
    from demflow.model.scene import Scene
    from demflow.sweep.dataset.verdict import Verdict
    from demflow.sweep.plan.graph import Stages

SILENCE = 2.0  # s after which planning says how far it is
MORE = 1.25  # times the memory that was short, from which on a case is tried again


@dataclass(frozen=True)
class Project:
    """A study, its plan, and what of it is stored."""

    study: Study
    store: Store
    folder: Path  # results/<study>
    scene_of: Callable[[int], Scene]
    table: str = MODEL  # where the table of stages lies
    tell: Callable[[str], None] | None = None  # hears what takes long

    @functools.cached_property
    def plan(self) -> Plan:
        """All distinct stage runs of the study, made when first asked for.

        What draws a dataset that is known to be the study's needs none.
        """
        return planned(self.study, with_origins(stage_table(self.table), self.store), self.tell)

    def costs(self) -> Costs:
        """What stage runs cost so far on this machine."""
        return Costs.read(self.store, everywhere=self.table == MODEL)

    def keep(self, costs: Costs) -> None:
        """Keep what stage runs cost. Raises OSError."""
        costs.write(self.store, everywhere=self.table == MODEL)

    def stored(self) -> np.ndarray:
        """Which runs have their product, (runs,) bool."""
        has = (self.store.has(run.id) for run in self.plan.runs)
        return np.fromiter(has, dtype=bool, count=len(self.plan.runs))

    def failed(self, stored: np.ndarray, limits: Limits) -> np.ndarray:
        """Which runs are known to fail and would fail again under such limits, (runs,) bool."""
        failed = np.zeros(len(self.plan.runs), dtype=bool)
        for k in np.flatnonzero(~stored):
            record = self.store.failure(self.plan.runs[k].id)
            failed[k] = record is not None and not may_pass(record, limits)
        return failed

    def unanswered(self, stored: np.ndarray) -> np.ndarray:
        """Which stored runs serve a family some member of which has no result, (runs,) bool."""
        found = np.zeros(len(self.plan.runs), dtype=bool)
        for k in np.flatnonzero(stored):
            run = self.plan.runs[k]
            if run.stage in self.plan.serving and run.members:
                with suppress(MissingError, DamagedError):  # it is missed when it is read
                    found[k] = np.any(self.store.get(run.id).arrays[FAILURE] != "")
        return found

    def verdicts(self) -> list[Verdict]:
        """How each case stands, (cases,)."""
        from demflow.sweep.dataset.verdict import verdict

        stored = self.stored()
        every = range(len(self.plan.cases))
        return [verdict(self.plan, self.store, stored, case) for case in every]

    def tried_again(self, verdicts: list[Verdict], workers: int = 2) -> np.ndarray:
        """Which cases have failed and yet would be tried again by the next run, (cases,) bool."""
        stored = self.stored()
        limits = in_force(self.study.limits, workers)
        left = self.plan.to_run(stored, self.failed(stored, limits))
        waits = np.append(left, False)[self.plan.cases].any(axis=1)  # −1: not run
        good = (Status.DONE, Status.NOT_RUN, Status.LEFT_OUT)
        bad = [v.status not in good for v in verdicts]
        found: np.ndarray = waits & np.array(bad, dtype=bool)
        return found


def may_pass(record: Mapping[str, Any], limits: Limits) -> bool:
    """Whether what ended a run has changed: a limit was raised, or more memory is free now."""
    ended = {Status.TIMED_OUT: "time", Status.OUT_OF_MEMORY: "memory"}
    which = ended.get(Status(record["status"]))
    if which is None:
        return False
    if "room" in record:  # the machine was short, not the limit
        found: bool = available() > MORE * record["room"]
        return found
    then, now = record.get("limits", {}).get(which), getattr(limits, which)
    return then is None or now is None or now > then


def prepare(
    path: str | Path,
    results: str | Path = "results",
    *,
    smoke: bool = False,
    table: str = MODEL,
    create: bool = False,
    tell: Callable[[str], None] | None = None,
) -> Project:
    """Read a study and open the store of its results; its plan is made when first asked for.

    Nothing is written unless `create` says so. Raises StudyError, StoreError.

    Parameters
    ----------
    path : of the study
    results : folder that holds the results of all studies
    smoke : whether the overrides under `smoke:` hold
    table : the table of stages, as `module:name`
    create : whether the folder of results is made
    tell : hears what takes long of planning
    """
    study = load_study(path, smoke=smoke)
    builder = SceneBuilder(study.values, study.axes)

    @functools.lru_cache(maxsize=512)
    def scene_of(case: int) -> Scene:
        return builder.scene(tuple(int(k) for k in np.unravel_index(case, study.shape)))

    root = Path(results)
    store = Store.open(root / "store", create=create)
    return Project(study, store, root / study.name, scene_of, table, tell)


def planned(
    study: Study,
    stages: Stages | None = None,
    tell: Callable[[str], None] | None = None,
) -> Plan:
    """Return the plan of all cases of a study, by the model's table of stages or another.

    Parameters
    ----------
    study : the study, read and checked
    stages : table of stages; None: the model’s
    tell : hears what takes long
    """
    builder = SceneBuilder(study.values, study.axes)
    return make_plan(_scenes(study, builder, tell), stages or stage_table())


def _scenes(
    study: Study, builder: SceneBuilder, tell: Callable[[str], None] | None
) -> Iterator[Scene | SceneError | None]:
    """The scene of each case; where there are many, how far it is, every few seconds."""
    cases, last = math.prod(study.shape), time.monotonic()
    for number, index in enumerate(itertools.product(*map(range, study.shape))):
        if tell is not None and number % 1000 == 0 and time.monotonic() - last > SILENCE:
            last = time.monotonic()
            tell(f"planning: {number:,} of {cases:,} cases")
        if study.leaves_out(index):
            yield None
            continue
        try:
            yield builder.scene(index)
        except SceneError as error:
            yield error
