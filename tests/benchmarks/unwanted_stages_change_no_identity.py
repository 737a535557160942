"""A stage that no scene wants, as a parent of *observe*, changes no identity of any study."""

from __future__ import annotations

from dataclasses import replace

from demflow.model.products import Packing
from demflow.model.scene import Scene
from demflow.model.stages import STAGES, Stage
from demflow.sweep.plan.graph import Plan
from demflow.sweep.prepared import planned
from demflow.sweep.study.load import load_study
from tests.benchmarks.ran import STUDIES
from tests.benchmarks.result import Result


def _never(_: Scene) -> bool:
    return False


UNWANTED = Stage("unwanted", f"{__name__}:run", 1, ("pack",), {}, _never, Packing)


def table() -> tuple[Stage, ...]:
    """The model's stages, with one more before the last, which takes it."""
    *earlier, observe = STAGES
    return (*earlier, UNWANTED, replace(observe, parents=(*observe.parents, UNWANTED.name)))


def identities(plan: Plan) -> list[str]:
    """Of all runs, in their order."""
    return [run.id for run in plan.runs]


def run() -> Result:
    """Plan every shipped study with and without it, whole and with its smoke block."""
    lines, changed, known = [], 0, 0
    for path in sorted(STUDIES.glob("*.yaml")):
        for smoke in (False, True):
            study = load_study(path, smoke=smoke)
            before, after = identities(planned(study)), identities(planned(study, table()))
            differ = sum(a != b for a, b in zip(before, after, strict=True))
            changed, known = changed + differ, known + len(before)
            lines.append(f"{path.name}{' smoke' if smoke else ''}: {differ} of {len(before)}")
    figure = f"{changed} of {known} identities changed"
    return Result(figure, "0", changed == 0 and known > 0, "\n".join(lines))
