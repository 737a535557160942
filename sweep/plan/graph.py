"""From cases to the graph of distinct stage runs. Pure: nothing is read, nothing is run.

The table of stages is an argument everywhere, so that planning and running can be tried with
stages of a few lines (`plan.table`).

Two cases that agree on all that a stage reads, and on all that its parents read, share
its run. A plan holds numbers and names only, never scenes, so that it stays small for a
hundred thousand cases.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from demflow.sweep.plan.families import Families
from demflow.sweep.plan.identity import encode, product_id
from demflow.sweep.plan.runs import CostClass, StageRun, origin

if TYPE_CHECKING:
    from demflow.model.scene import Scene, SceneError
    from demflow.model.stages import Stage

    Stages = tuple[Stage, ...]  # a table of them


@dataclass(frozen=True)
class Plan:
    """Distinct stage runs, parents first, and which of them each case is made of."""

    stages: tuple[Stage, ...]
    runs: list[StageRun]
    # (cases, stages) int32: index of the run, of a march the last one, −1 where it is not run
    cases: np.ndarray
    impossible: dict[int, str] = field(default_factory=dict)  # cases without a scene, and why
    left_out: frozenset[int] = frozenset()  # combinations of the axes that are no cases
    # (cases,) int32: place of a case among the members of the run that serves it; empty where no
    # case is one of a family, −1 for one that is not
    member: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int32))

    @cached_property
    def observed(self) -> int:
        """The row of the table whose product is what is asked of a case."""
        return next(k for k, stage in enumerate(self.stages) if stage.observed)

    @cached_property
    def serving(self) -> list[int]:
        """The rows of the table whose runs serve the members of families."""
        return [k for k, stage in enumerate(self.stages) if stage.family and not stage.place]

    def result_of(self, case: int) -> tuple[int, int]:
        """The run whose product is what is asked of a case; its place in it, −1 where all is."""
        member = int(self.member[case]) if len(self.member) else -1
        run = (
            self.cases[case, self.observed] if member < 0 else self.cases[case, self.serving].max()
        )
        return int(run), member

    @cached_property
    def marches(self) -> list[int]:
        """The rows of the table that run leg by leg."""
        return [k for k, stage in enumerate(self.stages) if stage.legs is not None]

    @property
    def count(self) -> int:
        """Number of cases."""
        return len(self.cases) - len(self.left_out)

    def case_runs(self, case: int) -> list[int]:
        """Indices of the runs that a case is made of, parents first."""
        return [run for last in self.cases[case].tolist() for run in self.legs_to(last)]

    def legs_to(self, last: int) -> list[int]:
        """A run after those of its stage that it goes on from, the first leg first; −1: none."""
        if last < 0:
            return []
        legs, own = [last], self.runs[last].stage
        while self.runs[legs[-1]].leg > 0:
            parents = self.runs[legs[-1]].parents
            legs.append(next(p for p in parents if p >= 0 and self.runs[p].stage == own))
        return legs[::-1]

    def stage_of(self, run: int) -> Stage:
        """The row of the table that a run belongs to."""
        return self.stages[self.runs[run].stage]

    def counts(self) -> np.ndarray:
        """Number of distinct runs of each stage, shape (stages,)."""
        return np.bincount([run.stage for run in self.runs], minlength=len(self.stages))

    def wanted(self) -> np.ndarray:
        """Number of runs of each stage if no case shared any, shape (stages,)."""
        each = np.array([*(run.leg + 1 for run in self.runs), 0])
        total: np.ndarray = each[self.cases].sum(axis=0)  # −1: the last one
        return total

    def to_run(self, stored: np.ndarray, failed: np.ndarray) -> np.ndarray:
        """Which runs are left where some are stored and some are known to fail, (runs,) bool.

        What waits for a run that is known to fail is not left either.
        """
        there, left = stored.tolist(), (~stored & ~failed).tolist()
        for k, run in enumerate(self.runs):
            if left[k]:
                left[k] = all(p < 0 or there[p] or left[p] for p in run.parents)
        return np.array(left, dtype=bool)

    def digest(self) -> str:
        """Hash of the identities of all products of all cases, in their order (SHA-256)."""
        digest = hashlib.sha256()
        for number, case in enumerate(self.cases):
            for run in case:
                digest.update(self.runs[run].id.encode() if run >= 0 else b"-")
            if len(self.member) and self.member[number] >= 0:
                digest.update(b"member %d" % self.member[number])
            digest.update(self.impossible.get(number, "").encode() + b"\n")
        return digest.hexdigest()


def make_plan(scenes: Iterable[Scene | SceneError | None], stages: tuple[Stage, ...]) -> Plan:
    """Return the plan of the cases whose scenes are given, in their order.

    A stage runs where its `wanted` says so; its parents are passed over where theirs
    says no. A march runs once a leg; cases that begin alike share their first legs. Where many
    are a family, a few runs serve them all. An error in the place of a scene makes a case of which
    nothing is run, None a combination that is no case.
    """
    row = {stage.name: k for k, stage in enumerate(stages)}
    parent_rows = [[row[name] for name in stage.parents] for stage in stages]
    readers = [_Reader(stage.reads, stage.options) for stage in stages]
    runs: list[StageRun] = []
    index: dict[str, int] = {}
    kinds: dict[CostClass, CostClass] = {}  # one object each
    cases: list[np.ndarray] = []
    impossible: dict[int, str] = {}
    left_out: set[int] = set()
    families = Families(stages, parent_rows, readers)
    for number, scene in enumerate(scenes):
        own = np.full(len(stages), -1, dtype=np.int32)
        cases.append(own)
        if scene is None:
            left_out.add(number)
            continue
        if isinstance(scene, Exception):
            impossible[number] = str(scene)
            continue
        for k, stage in enumerate(stages):
            if not stage.wanted(scene):
                continue
            reads = readers[k](scene)
            for leg, part in enumerate(stage.legs_of(scene)):
                if stage.legs is not None:
                    reads["leg"] = encode(part)
                parents = tuple(int(own[p]) for p in parent_rows[k])
                parent_ids = {
                    name: runs[p].id if p >= 0 else None
                    for name, p in zip(stage.parents, parents, strict=True)
                }
                identity = product_id(stage.name, origin(stage), reads, parent_ids)
                run = index.setdefault(identity, len(runs))
                if run == len(runs):
                    kind = CostClass.of(stage, scene)
                    kind = kinds.setdefault(kind, kind)
                    runs.append(StageRun(identity, k, parents, number, kind, leg))
                own[k] = run
        families.note(number, scene, own)
    table = np.array(cases, dtype=np.int32).reshape(-1, len(stages))
    runs, table, member = families.joined(runs, table)
    return Plan(stages, runs, table, impossible, frozenset(left_out), member)


class _Reader:
    """Canonical bytes of what a stage reads; a value met again is not encoded again."""

    def __init__(self, reads: Any, options: Any):
        self.reads: dict[str, Callable[[Any], Any]] = {**reads, **options}
        self.options = frozenset(options)
        self.last: dict[str, tuple[Any, bytes]] = {}

    def __call__(self, scene: Any) -> dict[str, bytes]:
        encoded = {}
        for name, read in self.reads.items():
            value = read(scene)
            if value is None and name in self.options:
                continue
            previous = self.last.get(name)
            # by identity, not by equality: 1 == 1.0 == True
            if previous is None or previous[0] is not value:
                previous = self.last[name] = (value, encode(value))
            encoded[name] = previous[1]
        return encoded
