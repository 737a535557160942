"""The pure model: from an immutable scene to named arrays.

`model.simulate(scene)` runs it; `model.scene` holds what a scene is made of; each
stage (`pack`, `stress`, `network`, `open`, `flow`) is a function of
`model.stages`. Heavy imports wait until they are needed, so that a study
can be checked without them.
"""

from __future__ import annotations

from typing import Any

__all__ = ["Scene", "SceneError", "simulate"]


def __getattr__(name: str) -> Any:
    if name in ("Scene", "SceneError"):
        from demflow.model import scene

        return getattr(scene, name)
    if name == "simulate":
        from demflow.model.stages import simulate

        return simulate
    raise AttributeError(f"module 'demflow.model' has no attribute {name!r}")


if __name__ == "model":
    from demflow.checkout import alias

    alias("model")
