"""The table of stages by where it lies, which is how worker processes find the same one.

They import nothing else of the plan.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from demflow.model.stages import Stage

MODEL = "demflow.model.stages:STAGES"


def stage_table(reference: str = MODEL) -> tuple[Stage, ...]:
    """Return the table of stages at `module:name`, in an order in which parents come first.

    Raises ValueError where a stage names a parent that does not stand before it, unless it is its
    own, as that of a march is; and where not exactly one stage is observed.
    """
    module, _, name = reference.partition(":")
    stages: tuple[Stage, ...] = tuple(getattr(importlib.import_module(module), name))
    earlier: set[str] = set()
    for stage in stages:
        known = earlier if stage.legs is None else {*earlier, stage.name}
        if missing := [parent for parent in stage.parents if parent not in known]:
            raise ValueError(f"{reference}: {stage.name} stands before its parent {missing[0]}")
        if stage.legs is not None and stage.name not in stage.parents:
            raise ValueError(f"{reference}: {stage.name} has legs and is no parent of its own")
        earlier.add(stage.name)
    if sum(stage.observed for stage in stages) != 1:
        raise ValueError(f"{reference}: one stage's product is what is observed, and no other's")
    return stages
