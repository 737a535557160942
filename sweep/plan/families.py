"""Families of cases that a few runs serve together, in place of runs of their own.

A stage of the table that takes `members` serves cases that agree on all that it reads and on its
parents. Where they are many enough, runs of such stages take the place of all runs that only what
is observed of these cases needs. Which members a run was made from, and which it serves, stands in
its identity: the same case alone, or in another family, is another product.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from demflow.sweep.plan.identity import encode, product_id
from demflow.sweep.plan.runs import CostClass, StageRun, origin

if TYPE_CHECKING:
    from demflow.model.scene import Scene
    from demflow.model.stages import Stage

# Different members from which on a family is worth its model, that takes as long as some thirty.
LEAST = 64
CHOSEN = 24  # members that a model is made from


@dataclass
class _Family:
    """Cases that agree on what the shared stages read, and on their parents."""

    shared: list[int]  # rows of the stages that may serve it
    reads: list[dict[str, bytes]]  # of each shared stage
    kinds: list[CostClass]
    cases: list[int] = field(default_factory=list)
    brings: list[list[bytes]] = field(default_factory=list)  # of each shared stage, digests
    places: list[tuple[float, ...]] = field(default_factory=list)

    def without(self, served: np.ndarray) -> _Family:
        """Those of its cases that are not served, (all cases,) bool, by others."""
        left = [k for k, case in enumerate(self.cases) if not served[case]]
        return replace(
            self,
            cases=[self.cases[k] for k in left],
            brings=[self.brings[k] for k in left],
            places=[self.places[k] for k in left],
        )

    @property
    def different(self) -> int:
        """How many lie or, of stages without a place, bring what no other does."""
        return len(set(self.places) if any(self.places) else {one[-1] for one in self.brings})


class Families:
    """Finds the families of a plan while its cases pass by, and joins them at the end."""

    def __init__(
        self,
        stages: tuple[Stage, ...],
        parent_rows: Sequence[Sequence[int]],
        readers: Sequence[Callable[[Any], dict[str, bytes]]],
    ) -> None:
        self.stages, self.parent_rows, self.readers = stages, parent_rows, readers
        # rows of stages that serve the same families, by what tells whose these are
        self.chains: dict[Callable[[Any], bool], list[int]] = {}
        for k, stage in enumerate(stages):
            if stage.family is not None:
                self.chains.setdefault(stage.family, []).append(k)
        self.found: dict[bytes, _Family] = {}

    def note(self, case: int, scene: Scene, own: np.ndarray) -> None:
        """A case whose runs are `own` (stages,); it may be one of a family, or of several.

        Parameters
        ----------
        case : number of the case
        scene : of the case
        own : identity of its own part
        """
        for may, shared in self.chains.items():
            if may(scene):
                self._join(shared, case, scene, own)

    def _join(self, shared: list[int], case: int, scene: Scene, own: np.ndarray) -> None:
        """Add a case to the family that is served by these rows."""
        reads = [dict(self.readers[k](scene)) for k in shared]
        parents = [int(own[p]) for k in shared for p in self.parent_rows[k]]
        key = hashlib.sha256(encode([*shared, *parents]))
        for one in reads:
            for name in sorted(one):
                key.update(encode(name) + one[name])
        family = self.found.get(key.digest())
        if family is None:
            kinds = [CostClass.of(self.stages[k], scene) for k in shared]
            family = self.found[key.digest()] = _Family(shared, reads, kinds)
        family.cases.append(case)
        brings = [self.stages[k].brings for k in shared]
        family.brings.append([hashlib.sha256(encode(of(scene))).digest() for of in brings if of])
        place = self.stages[shared[0]].place
        family.places.append(place(scene) if place else ())

    def joined(
        self, runs: list[StageRun], cases: np.ndarray
    ) -> tuple[list[StageRun], np.ndarray, np.ndarray]:
        """The runs and what each case is made of, as `Plan` has them, families served together.

        The third is `Plan.member`. Of two families the one whose stages stand first in the table
        serves a case, if it is large.
        """
        member = np.full(len(cases), -1, dtype=np.int32)
        for found in sorted(self.found.values(), key=lambda family: family.shared):
            family = found.without(member >= 0)
            if family.different >= LEAST:
                self._serve(family, runs, cases, member)
        if not np.any(member >= 0):
            return runs, cases, np.empty(0, dtype=np.int32)
        return *_pruned(runs, cases), member

    def _serve(
        self, family: _Family, runs: list[StageRun], cases: np.ndarray, member: np.ndarray
    ) -> None:
        """Add the runs of a family, and let its cases be served by them (in place)."""
        every = np.array(family.cases)
        for number, k in enumerate(family.shared):
            most = self.stages[k].block
            if self.stages[k].place is not None:
                blocks = [_apart(family.places, CHOSEN)]
            else:
                blocks = [
                    list(range(b, min(b + most, len(every)))) for b in range(0, len(every), most)
                ]
            for block in blocks:
                first = every[block[0]]
                own = cases[first]
                parents = tuple(int(own[p]) for p in self.parent_rows[k])
                named = zip(self.stages[k].parents, parents, strict=True)
                identity = product_id(
                    self.stages[k].name,
                    origin(self.stages[k]),
                    {
                        **family.reads[number],
                        "members": b"".join(family.brings[m][number] for m in block),
                    },
                    {name: runs[p].id if p >= 0 else None for name, p in named},
                )
                members = tuple(every[block].tolist())
                kind = family.kinds[number]
                runs.append(StageRun(identity, k, parents, min(members), kind, members=members))
                serves = every if self.stages[k].place is not None else every[block]
                cases[serves, k] = len(runs) - 1
                if self.stages[k].place is None:
                    member[serves] = np.arange(len(block))
        # what the run that serves them does not go back to
        left = np.array(passed_over(self.stages, family.shared[-1]), dtype=int)
        cases[np.ix_(every, left)] = -1


def passed_over(stages: tuple[Stage, ...], last: int) -> list[int]:
    """Rows of the table of stages that a run of one of them, `last`, does not go back to."""
    row = {stage.name: k for k, stage in enumerate(stages)}
    kept = {last}
    for k in range(len(stages) - 1, -1, -1):
        if k in kept:
            kept.update(row[name] for name in stages[k].parents)
    return [k for k in range(len(stages)) if k not in kept]


def _apart(places: list[tuple[float, ...]], most: int) -> list[int]:
    """Some of the places, the middle first, then each time the one farthest from those taken."""
    at = np.array(places)
    taken = [int(np.abs(at - 0.5 * (at.min(axis=0) + at.max(axis=0))).max(axis=1).argmin())]
    distance = np.full(len(at), np.inf)
    while len(taken) < most:
        distance = np.minimum(distance, np.abs(at - at[taken[-1]]).sum(axis=1))
        if distance.max() == 0.0:
            break
        taken.append(int(distance.argmax()))
    return taken


def _pruned(runs: list[StageRun], cases: np.ndarray) -> tuple[list[StageRun], np.ndarray]:
    """The same without the runs that no case is made of any more."""
    used = np.zeros(len(runs), dtype=bool)
    used[np.unique(cases[cases >= 0])] = True
    for k in range(len(runs) - 1, -1, -1):
        if used[k]:
            used[[p for p in runs[k].parents if p >= 0]] = True
    number = np.append(np.where(used, np.cumsum(used) - 1, -1), -1).astype(np.int32)
    left = [
        run._replace(parents=tuple(int(number[p]) for p in run.parents))
        for run, keeps in zip(runs, used, strict=True)
        if keeps
    ]
    return left, number[cases]
