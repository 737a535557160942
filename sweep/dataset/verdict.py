"""How each case stands."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from demflow.model.outcome import Status
from demflow.model.quantities import FAILURE, STOPPED
from demflow.sweep.plan.graph import Plan
from demflow.sweep.store.products import DamagedError, MissingError, Store


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a case ended."""

    status: Status
    message: str = ""


def verdict(plan: Plan, store: Store, stored: np.ndarray, case: int) -> Verdict:
    """How a case stands: done where all its products are there, else the first that is not.

    One that marches may have stopped early, as what was observed of it tells. `stored` tells
    which runs of the plan have their product, (runs,) bool.

    Parameters
    ----------
    plan : all distinct stage runs of the study
    store : products by their identities
    stored : which runs of the plan have their product, (runs,) bool
    case : number of the case
    """
    if case in plan.left_out:
        return Verdict(Status.LEFT_OUT, "left out by `where`")
    if case in plan.impossible:
        return Verdict(Status.FAILED, plan.impossible[case])
    for run in plan.case_runs(case):
        if stored[run]:
            continue
        failure = store.failure(plan.runs[run].id)
        if failure is not None:
            stage = plan.stage_of(run).name
            return Verdict(Status(failure["status"]), f"{stage}: {failure['message']}")
        return Verdict(Status.NOT_RUN, "not run yet; `demflow run` computes it")
    run, member = plan.result_of(case)
    if member >= 0:
        with suppress(MissingError, DamagedError):
            why = str(_failures(store, plan.runs[run].id)[member])
            if why:
                return Verdict(Status.FAILED, f"{plan.stage_of(run).name}: {why}")
    if any(plan.cases[case, row] >= 0 for row in plan.marches):
        with suppress(MissingError, DamagedError):  # it is missed when it is read
            if stopped := store.meta(plan.runs[run].id).get(STOPPED):
                return Verdict(Status.STOPPED, stopped)
    return Verdict(Status.DONE)


@lru_cache(maxsize=2)
def _failures(store: Store, identity: str) -> np.ndarray:
    """Why each member of a family has no result, (members,) words, "" where it has one."""
    return store.get(identity).arrays[FAILURE]
