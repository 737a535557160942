"""What a plan is made of: stage runs, and what decides their cost."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from demflow.model.scene import Scene
    from demflow.model.stages import Stage

SIZE_STEP = 0.1  # in the logarithm: sizes closer than that cost the same


class CostClass(NamedTuple):
    """What decides the cost of a stage run."""

    stage: str
    version: int
    variant: str  # how it is solved, "" where there is one way only
    step: int  # ln(its size) / SIZE_STEP
    kept: int = 0  # ln(1 + numbers of its product that times and the like make) / SIZE_STEP
    held: int = 0  # the same of numbers held at once
    manner: str = ""  # what there is in its scene that costs more, a word

    @classmethod
    def of(cls, stage: Stage, scene: Scene) -> CostClass:
        """The kind of a stage's run for a scene."""
        method = stage.reads.get("method")
        variant = "" if method is None else str(method(scene))
        size = round(math.log(stage.size(scene)) / SIZE_STEP)
        kept, held = (round(math.log1p(of(scene)) / SIZE_STEP) for of in (stage.kept, stage.held))
        return cls(stage.name, stage.version, variant, size, kept, held, stage.manner(scene))

    @property
    def bytes_kept(self) -> float:
        """Bytes of its product that times, rate changes and probes make."""
        return 8.0 * math.expm1(self.kept * SIZE_STEP)

    @property
    def bytes_held(self) -> float:
        """Bytes that these make a worker hold at once."""
        return 8.0 * math.expm1(self.held * SIZE_STEP)

    @property
    def key(self) -> str:
        """All but the size, as one word."""
        return f"{self.alike}/{self.manner}" if self.manner else self.alike

    @property
    def alike(self) -> str:
        """With which keys begin of what was done in the same way, to whatever scene."""
        return f"{self.stage}/{self.version}/{self.variant}"


class StageRun(NamedTuple):
    """One run of one stage, wanted by one case or by many."""

    id: str  # identity of its product
    stage: int  # row of the table of stages
    parents: tuple[int, ...]  # runs whose products it takes, −1 for a stage that is not run
    case: int  # the first case that wants it
    kind: CostClass
    leg: int = 0  # which one of a march; each has the one before among its parents
    members: tuple[int, ...] = ()  # cases of the family that it serves, or is made from


def origin(stage: Stage) -> int | tuple[int, str]:
    """What made a stage's results: its version, with its sources where these are told apart."""
    return (stage.version, stage.sources) if stage.sources else stage.version
