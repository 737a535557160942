"""What `check` tells of coupled scenes: how they are, and what fixed apertures would cost."""

from __future__ import annotations

from demflow.model.scene import Scene, SceneError
from demflow.sweep.study.cases import case_at
from demflow.sweep.study.load import Study


def told_coupling(study: Study) -> list[str]:
    """One line for the first case and one for the last, where these are coupled and differ.

    Parameters
    ----------
    study : a study that passed its check.

    Returns how each is coupled, and why, as far as it is known before anything runs.
    """
    ends = ((0,) * len(study.axes), tuple(size - 1 for size in study.shape))
    told = []
    for name, index in zip(("first", "last"), ends, strict=True):
        try:
            scene = case_at(study, index).scene
        except SceneError:
            continue  # a case that cannot be has no coupling to tell
        if scene.coupled:
            told.append((name, _told(scene)))
    if len({text for _, text in told}) <= 1:
        return [f"coupling: {text}" for _, text in told[:1]]
    return [f"coupling of the {name} case: {text}" for name, text in told]


def _told(scene: Scene) -> str:
    return f"{scene.coupling_method}; {scene.reckoned.reason}"
