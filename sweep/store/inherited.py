"""What a results folder that another version worked in still holds for this one.

Products carry in their identity all that they depend on, so nothing stale is ever taken; this
only tells a user which stages' results stay good, and which are computed anew and why. A run
notes the study that it was of and the identities of some of its products. The next one plans
these cases by its own table: what is the same then is kept, whatever else has changed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from demflow.model.parameters import SceneError
from demflow.sweep.plan.graph import Plan, make_plan
from demflow.sweep.store.durable import write_durably
from demflow.sweep.store.kept import keep_study
from demflow.sweep.store.products import Store
from demflow.sweep.store.versions import installed
from demflow.sweep.study.load import Study, StudyError, load_study
from demflow.sweep.study.scenes import SceneBuilder


def note(store: Store, study: Study, plan: Plan) -> None:
    """Keep what the stages that work in this store now make of a study. Raises OSError.

    Parameters
    ----------
    store : products by their identities
    study : the study, read and checked
    plan : all distinct stage runs of the study
    """
    record = {
        "demflow": installed("demflow"),
        "stages": {stage.name: stage.version for stage in plan.stages},
        "sources": {stage.name: stage.sources for stage in plan.stages},
        "smoke": study.smoke,
        "products": _first_products(plan),
    }
    keep_study(store.root / _STUDY, study)
    path, content = store.root / _NOTE, json.dumps(record, indent=1).encode()
    if not path.exists() or path.read_bytes() != content:
        write_durably(path, content)


def inherited(store: Store, plan: Plan) -> str | None:
    """Say what of an earlier version's results can be kept; None where all of it can.

    Nothing is known of a store without the note of its versions, and nothing said.
    """
    try:
        record: Mapping[str, Any] = json.loads((store.root / _NOTE).read_text())
        before: Mapping[str, int] = dict(record["stages"])
        sources: Mapping[str, str] = dict(record.get("sources", {}))
        there = {name: store.has(made) for name, (_, made) in _first_products(plan).items()}
        made_by = str(record["demflow"])
        same = _same_products(store, plan, record)
    except (OSError, ValueError, TypeError, KeyError, IndexError):
        return None
    kept: list[str] = []
    anew: dict[str, str] = {}
    for stage in plan.stages:
        follows = [parent for parent in stage.parents if parent in anew]
        if stage.name not in before:
            anew[stage.name] = "new"
        elif before[stage.name] != stage.version:
            anew[stage.name] = f"version {before[stage.name]}, now {stage.version}"
        elif there.get(stage.name):
            kept.append(stage.name)
        elif sources.get(stage.name, "") != stage.sources:
            anew[stage.name] = "its sources have changed"
        elif follows and not same.get(stage.name, False):
            anew[stage.name] = f"follows {', '.join(follows)}"
        elif not same.get(stage.name, True):
            anew[stage.name] = "it reads something else"
        else:
            kept.append(stage.name)
    if not anew:
        return None
    return (
        f"demflow {made_by} worked in this folder before; kept are its results of "
        f"{', '.join(kept) or 'no stage'}; computed anew: "
        f"{', '.join(f'{name} ({why})' for name, why in anew.items())}"
    )


def _first_products(plan: Plan) -> dict[str, tuple[int, str]]:
    """The first case that wants each stage, and the identity of its product."""
    found: dict[str, tuple[int, str]] = {}
    for run in plan.runs:
        found.setdefault(plan.stages[run.stage].name, (run.case, run.id))
    return found


def _same_products(store: Store, plan: Plan, record: Mapping[str, Any]) -> dict[str, bool]:
    """Whether each stage gives what was noted the same identity, as far as that can be seen."""
    noted = {stage: (int(case), str(made)) for stage, (case, made) in record["products"].items()}
    try:
        study = load_study(store.root / _STUDY, smoke=bool(record["smoke"]))
    except StudyError:  # by what a study may be now
        return {}
    numbers = sorted({case for case, _ in noted.values()})
    now = make_plan(_scenes(study, numbers), plan.stages)
    same: dict[str, bool] = {}
    for row, stage in enumerate(plan.stages):
        if stage.name in noted:
            case, made = noted[stage.name]
            runs = now.legs_to(int(now.cases[numbers.index(case), row]))
            if runs:
                same[stage.name] = now.runs[runs[0]].id == made
    return same


def _scenes(study: Study, numbers: list[int]) -> Iterator[Any]:
    builder = SceneBuilder(study.values, study.axes)
    for number in numbers:
        try:
            yield builder.scene(tuple(int(k) for k in np.unravel_index(number, study.shape)))
        except SceneError as error:
            yield error


_NOTE, _STUDY = "stages.json", "stages.yaml"
