"""When the flow periods of wells start."""

from __future__ import annotations

from collections.abc import Sequence

from demflow.model.scene import Scene
from demflow.model.transient import flow_periods


def period_starts(scene: Scene, wells: Sequence[str]) -> list[list[float]]:
    """Times (s) at which the rate of each named well changes; none of a well that is not there."""
    own = {well.name: well for well in scene.wells}
    return [
        flow_periods(own[name].rate_changes)[0].tolist()
        if name in own and own[name].pressure is None
        else []
        for name in wells
    ]
