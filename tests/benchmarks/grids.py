"""A table of one stage that gives 20 × 200 numbers in no time, for checks of what comes after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from demflow.model.quantities import checked
from demflow.model.scene import Scene
from demflow.model.stages import Stage

PROBES, TIMES = 20, 200


def observe(*, rate: float) -> Mapping[str, Any]:
    """Numbers that no compression would shrink to nothing."""
    return {"probe_pressure": np.random.default_rng(int(rate)).random((PROBES, TIMES))}


def _rate(scene: Scene) -> float:
    return scene.wells[0].rate


def _always(_: Scene) -> bool:
    return True


STAGES = (
    Stage(
        "observe", f"{__name__}:observe", 1, (), {"rate": _rate}, _always, dict,
        check=checked, observed=True,
    ),
)  # fmt: skip
