"""What a results folder that another version worked in still holds for this one.

Products carry the version of their stage in their identity, so nothing stale is ever taken;
this only tells a user which stages' results stay good, and which are computed anew and why.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from sweep.durable import write_durably
from sweep.store import Store
from sweep.versions import installed

if TYPE_CHECKING:
    from model.stages import Stage


def note(store: Store, stages: Iterable[Stage]) -> None:
    """Keep the versions of the stages that work in this store now. Raises OSError."""
    told = {"demflow": installed("demflow"), "stages": {s.name: s.version for s in stages}}
    content = json.dumps(told, indent=1).encode()
    path = _file(store)
    if not path.exists() or path.read_bytes() != content:
        write_durably(path, content)


def inherited(store: Store, stages: Iterable[Stage]) -> str | None:
    """Say what of an earlier version's results can be kept; None where all of it can.

    Nothing is known of a store without the note of its versions, and nothing said.
    """
    try:
        told = json.loads(_file(store).read_text())
        before: Mapping[str, int] = dict(told["stages"])
        made_by = str(told["demflow"])
    except (OSError, ValueError, TypeError, KeyError):
        return None
    kept: list[str] = []
    anew: dict[str, str] = {}
    for stage in stages:
        follows = [parent for parent in stage.parents if parent in anew]
        if stage.name not in before:
            anew[stage.name] = "new"
        elif before[stage.name] != stage.version:
            anew[stage.name] = f"version {before[stage.name]}, now {stage.version}"
        elif follows:
            anew[stage.name] = f"follows {', '.join(follows)}"
        else:
            kept.append(stage.name)
    if not anew:
        return None
    return (
        f"demflow {made_by} worked in this folder before; kept are its results of "
        f"{', '.join(kept) or 'no stage'}; computed anew: "
        f"{', '.join(f'{name} ({why})' for name, why in anew.items())}"
    )


def _file(store: Store) -> Path:
    return store.root / "stages.json"
