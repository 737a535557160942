"""A study read and planned, and what of it is stored: all that is known before anything runs."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from model.parameters import SceneError
from sweep.plan import Plan, make_plan
from sweep.scenes import SceneBuilder
from sweep.stages import MODEL, Status, stage_table
from sweep.store import Store
from sweep.study import Study, load_study

if TYPE_CHECKING:
    from model.scene import Scene
    from sweep.dataset.verdict import Verdict

STUDY_FILE, DATASET_FILE = "study.yaml", "dataset.nc"


@dataclass(frozen=True)
class Prepared:
    """A study, its plan, and what of it is stored."""

    study: Study
    plan: Plan
    store: Store
    folder: Path  # results/<study>
    scene_of: Callable[[int], Scene]

    def stored(self) -> np.ndarray:
        """Which runs have their product, (runs,) bool."""
        has = (self.store.has(run.id) for run in self.plan.runs)
        return np.fromiter(has, dtype=bool, count=len(self.plan.runs))

    def failed(self, stored: np.ndarray) -> np.ndarray:
        """Which runs are known to fail and would fail again, (runs,) bool."""
        failed = np.zeros(len(self.plan.runs), dtype=bool)
        for k in np.flatnonzero(~stored):
            record = self.store.failure(self.plan.runs[k].id)
            failed[k] = record is not None and not self._may_pass(record)
        return failed

    def verdicts(self) -> list[Verdict]:
        """How each case stands, (cases,)."""
        from sweep.dataset.verdict import verdict

        stored = self.stored()
        every = range(len(self.plan.cases))
        return [verdict(self.plan, self.store, stored, case) for case in every]

    def _may_pass(self, record: dict[str, Any]) -> bool:
        """Whether a limit that ended a run has been raised since."""
        ended = {Status.TIMED_OUT: "time", Status.OUT_OF_MEMORY: "memory"}
        which = ended.get(Status(record["status"]))
        then = record.get("limits", {}).get(which)
        now = getattr(self.study.limits, which) if which else None
        return then is not None and (now is None or now > then)


def prepare(
    path: str | Path,
    results: str | Path = "results",
    *,
    smoke: bool = False,
    table: str = MODEL,
    create: bool = False,
) -> Prepared:
    """Read a study, make its plan and open the store of its results.

    Nothing is written unless `create` says so. Raises StudyError, StoreError.
    """
    study = load_study(path, smoke=smoke)
    builder = SceneBuilder(study.values, study.axes)
    plan = planned(study, table)

    @functools.lru_cache(maxsize=512)
    def scene_of(case: int) -> Scene:
        return builder.scene(tuple(int(k) for k in np.unravel_index(case, study.shape)))

    root = Path(results)
    return Prepared(
        study, plan, Store.open(root / "store", create=create), root / study.name, scene_of
    )


def planned(study: Study, table: str = MODEL) -> Plan:
    """Return the plan of all cases of a study."""
    builder = SceneBuilder(study.values, study.axes)
    return make_plan(_scenes(study, builder), stage_table(table))


def _scenes(study: Study, builder: SceneBuilder) -> Iterator[Scene | SceneError]:
    for index in itertools.product(*map(range, study.shape)):
        try:
            yield builder.scene(index)
        except SceneError as error:
            yield error
