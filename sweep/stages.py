"""The stages of a case, as the model states them in `model.stages`.

Everything below takes the table as an argument, so that planning and running can be
tried with stages of a few lines. A table is named by where it lies, which is how the
worker processes find the same one.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from model.outcome import Status

if TYPE_CHECKING:
    import numpy as np

    from model.scene import Scene
    from model.stages import Stage

__all__ = ["MODEL", "Status", "case_maps", "stage_table"]

MODEL = "model.stages:STAGES"


def stage_table(reference: str = MODEL) -> tuple[Stage, ...]:
    """Return the table of stages at `module:name`, in an order in which parents come first.

    Raises ValueError where a stage names a parent that does not stand before it.
    """
    module, _, name = reference.partition(":")
    stages: tuple[Stage, ...] = tuple(getattr(importlib.import_module(module), name))
    earlier: set[str] = set()
    for stage in stages:
        if missing := [parent for parent in stage.parents if parent not in earlier]:
            raise ValueError(f"{reference}: {stage.name} stands before its parent {missing[0]}")
        earlier.add(stage.name)
    return stages


def case_maps(scene: Scene, products: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return the maps of one case, from the products of its stages by their names."""
    from model.maps import case_maps as of_the_model

    return of_the_model(scene, products)
